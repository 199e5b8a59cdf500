"""Live views: world 0 of an environment, shown while it flies, in browsers or in Foxglove.

Both get a flight two states at a time: the one before a decision, which they know, and the one
after it. The page for browsers is that of replays, with the same block of numbers.
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
from bulletuav.report.replay import page, rows_payload, whole_payload

TITLE = "bulletuav: live"
MOST_LINES = 200_000
"""Pieces of trails that viewers keep; after as many they begin anew"""


class Server(Protocol):
    """What serves a live view, in threads of its own."""

    @property
    def is_watched(self) -> bool:
        """Whether somebody watches."""

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until somebody watches, and tell whether somebody did in time."""

    def begin_anew(self) -> None:
        """Let viewers forget the flight before."""

    def close(self) -> None:
        """Let viewers go, and close the port; a second call does nothing."""


class LiveView(ABC):
    """Shows an aviary while it flies; `render_mode` "web" and "foxglove" make one.

    While somebody watches, flights are paced to real time. Without viewers nothing is kept or sent,
    and flights are as fast as ever.

    Attributes:
        invitation: What somebody who wants to watch does.
    """

    invitation: str

    def __init__(self, aviary: Aviary, server: Server) -> None:
        """Keep the aviary, of which only the options have to be there yet, and the server."""
        self._aviary = aviary
        self._server = server
        self._recorder: Recorder | None = None
        self._pacer: Pacer | None = None
        self._rows = 0
        # Also where nobody closes the environment.
        self._finalizer = weakref.finalize(self, server.close)

    def wait(self) -> None:
        """Wait until somebody watches."""
        self._server.wait()

    def begin(self) -> None:
        """Take in that world 0 was reset."""
        self._start()
        if self._pacer is not None:
            self._pacer.restart()

    def _start(self) -> None:
        """Let viewers begin anew with the present state, if there are any."""
        self._server.begin_anew()
        self._rows = 0
        self._recorder = Recorder(self._aviary) if self._server.is_watched else None

    def show(self) -> None:
        """Send the decision that was flown, and wait until its time has come."""
        if not self._server.is_watched:
            self._recorder = self._pacer = None
            return
        if self._recorder is None or self._rows * self._aviary.num_drones > MOST_LINES:
            self._start()
        else:
            self._send(self._decision(self._recorder))
        if self._pacer is None:
            self._pacer = Pacer(1 / self._aviary.options.decision_hz)
        self._pacer.wait()

    def _decision(self, recorder: Recorder) -> Recording:
        """Record the decision that was flown."""
        aviary = self._aviary
        recorder.note(aviary.given.copy(), aviary.rewards.copy(), lazy_infos(aviary.info_table()))
        recording = recorder.recording()
        recorder.forget()
        self._rows += 1
        return recording

    @abstractmethod
    def _send(self, recording: Recording) -> None:
        """Send a decision."""

    def close(self) -> None:
        """Tell viewers that it is over, and close the port; a second call does nothing."""
        self._recorder = None
        self._finalizer()


class PageView(LiveView):
    """Serves a live page.

    Attributes:
        feed: Server of the page.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Open the port that the option `render_address` tells.

        Raises:
            OSError: The port is in use, or there is no such address.
        """
        make_page = functools.cache(functools.partial(page, TITLE))
        self.feed = Feed(*parse_address(aviary.options.render_address), make_page)
        self.invitation = f"open http://{self.feed.address}/ in a browser"
        super().__init__(aviary, self.feed)

    def _send(self, recording: Recording) -> None:
        """Send a decision to all pages."""
        aviary = self._aviary
        drones = f"{aviary.num_drones} {'drones' if aviary.num_drones > 1 else 'drone'}"
        title = f"{aviary.task.name}: {drones}, live"
        news = event("rows", rows_payload(recording))
        self.feed.send(news, lambda: event("start", whole_payload(recording, title)))


class FoxgloveView(LiveView):
    """Serves topics for Foxglove; needs the extra `foxglove`.

    Attributes:
        topics: Server of the topics.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Open the port that the option `render_address` tells.

        Raises:
            ImportError: The extra is missing.
            OSError: The port is in use, or there is no such address.
        """
        from bulletuav.adapters.foxglove import FoxgloveServer  # which needs an extra

        self.topics = FoxgloveServer(*parse_address(aviary.options.render_address))
        self.invitation = f"connect Foxglove to {self.topics.address}"
        super().__init__(aviary, self.topics)

    def _send(self, recording: Recording) -> None:
        """Send a decision to all who have subscribed."""
        self.topics.send(recording.everything())
