"""Live views: world 0 of an environment, shown during the simulation, in browsers or in Foxglove.

Viewers receive two states at a time: the state before a decision, which they know, and the state
after it. The page for browsers is that of replays, with the same payload format.
"""

import functools
import weakref
from abc import ABC, abstractmethod
from typing import Protocol

from bulletuav.analysis.recorded import Recording
from bulletuav.analysis.recorder import Recorder
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.infos import lazy_infos
from bulletuav.envs.pacer import Pacer
from bulletuav.envs.viewer import parse_address
from bulletuav.report.feed import Feed, event
from bulletuav.report.replay import make_payload, make_rows_payload, render_page

TITLE = "bulletuav: live"
MAX_TRAIL_SEGMENTS = 200_000
"""Maximum number of trail segments in a viewer, after which it restarts"""


class Server(Protocol):
    """Server of a live view, in its own threads."""

    @property
    def is_watched(self) -> bool:
        """Whether there is any viewer."""

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until there is a viewer; return False after a timeout."""

    def restart_viewers(self) -> None:
        """Discard the previous flight in all viewers."""

    def close(self) -> None:
        """Disconnect all viewers and close the port; a second call does nothing."""


class LiveView(ABC):
    """Shows an aviary during the simulation; created by `render_mode` "web" and "foxglove".

    With viewers, flights are paced to real time. Without viewers, nothing is recorded or sent, and
    flights run at full speed.

    Attributes:
        invitation: Instructions for a person to connect a viewer.
    """

    invitation: str

    def __init__(self, aviary: Aviary, server: Server) -> None:
        """Store the aviary, of which only the options need to exist yet, and the server."""
        self._aviary = aviary
        self._server = server
        self._recorder: Recorder | None = None
        self._pacer: Pacer | None = None
        self._rows = 0
        # Closes the server even if the environment is never closed.
        self._finalizer = weakref.finalize(self, server.close)

    def wait(self) -> None:
        """Wait until there is a viewer."""
        self._server.wait()

    def begin(self) -> None:
        """Restart the view after a reset of world 0."""
        self._start()
        if self._pacer is not None:
            self._pacer.restart()

    def _start(self) -> None:
        """Restart all viewers with the present state, if there are any."""
        self._server.restart_viewers()
        self._rows = 0
        self._recorder = Recorder(self._aviary) if self._server.is_watched else None

    def show(self) -> None:
        """Send the last decision, and wait until its real time."""
        if not self._server.is_watched:
            self._recorder = self._pacer = None
            return
        if self._recorder is None or self._rows * self._aviary.num_drones > MAX_TRAIL_SEGMENTS:
            self._start()
        else:
            self._send(self._decision(self._recorder))
        if self._pacer is None:
            self._pacer = Pacer(1 / self._aviary.options.decision_hz)
        self._pacer.wait()

    def _decision(self, recorder: Recorder) -> Recording:
        """Record the last decision."""
        aviary = self._aviary
        recorder.record(aviary.given.copy(), aviary.rewards.copy(), lazy_infos(aviary.info_table()))
        recording = recorder.recording()
        recorder.discard_history()
        self._rows += 1
        return recording

    @abstractmethod
    def _send(self, recording: Recording) -> None:
        """Send a decision to all viewers."""

    def close(self) -> None:
        """Notify the viewers of the end and close the port; a second call does nothing."""
        self._recorder = None
        self._finalizer()


class PageView(LiveView):
    """Serves a live page.

    Attributes:
        feed: Server of the page.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Open the port of the option `render_address`.

        Raises:
            OSError: If the port is in use, or the address does not exist.
        """
        make_page = functools.cache(functools.partial(render_page, TITLE))
        self.feed = Feed(*parse_address(aviary.options.render_address), make_page)
        self.invitation = f"open http://{self.feed.address}/ in a browser"
        super().__init__(aviary, self.feed)

    def _send(self, recording: Recording) -> None:
        """Send a decision to all pages."""
        aviary = self._aviary
        drones = f"{aviary.num_drones} {'drones' if aviary.num_drones > 1 else 'drone'}"
        title = f"{aviary.task.name}: {drones}, live"
        news = event("rows", make_rows_payload(recording))
        self.feed.send(news, lambda: event("start", make_payload(recording, title)))


class FoxgloveView(LiveView):
    """Serves topics for Foxglove; needs the extra `foxglove`.

    Attributes:
        topics: Server of the topics.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Open the port of the option `render_address`.

        Raises:
            ImportError: If the extra is missing.
            OSError: If the port is in use, or the address does not exist.
        """
        from bulletuav.adapters.foxglove import FoxgloveServer  # which needs an extra

        self.topics = FoxgloveServer(*parse_address(aviary.options.render_address))
        self.invitation = f"connect Foxglove to {self.topics.address}"
        super().__init__(aviary, self.topics)

    def _send(self, recording: Recording) -> None:
        """Send a decision to all subscribers."""
        self.topics.send(recording.everything())
