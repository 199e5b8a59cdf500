"""Live view: world 0 of an environment in browsers, while it flies.

The page is that of replays. It gets the same block of numbers, two rows at a time: the state before
a decision, which it knows, and the one after it.
"""

import functools
import weakref

from bulletuav.analysis.recorder import Recorder
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.infos import later
from bulletuav.envs.pacer import Pacer
from bulletuav.envs.viewer import parse_address
from bulletuav.report.feed import Feed, event
from bulletuav.report.replay import page, rows_payload, whole_payload

TITLE = "bulletuav: live"
MOST_LINES = 200_000
"""Pieces of trails that a page keeps; after as many it begins anew"""


class LiveView:
    """Serves a live page of an aviary; `render_mode="web"` makes one.

    While somebody watches, flights are paced to real time. Without viewers nothing is kept or sent,
    and flights are as fast as ever.

    Attributes:
        feed: Server of the page.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Open the port that the option `render_address` tells.

        Args:
            aviary: The worlds. Only the options have to be there yet.

        Raises:
            OSError: The port is in use, or there is no such address.
        """
        self._aviary = aviary
        self._recorder: Recorder | None = None
        self._pacer: Pacer | None = None
        self._rows = 0
        host, port = parse_address(aviary.options.render_address)
        self.feed = Feed(host, port, functools.cache(functools.partial(page, TITLE)))
        # Also where nobody closes the environment.
        self._finalizer = weakref.finalize(self, self.feed.close)

    def begin(self) -> None:
        """Take in that world 0 was reset."""
        self._start()
        if self._pacer is not None:
            self._pacer.restart()

    def _start(self) -> None:
        """Let pages begin anew with the present state, if there are any."""
        self.feed.begin_anew()
        self._rows = 0
        self._recorder = Recorder(self._aviary) if self.feed.is_watched else None

    def show(self) -> None:
        """Send the decision that was flown, and wait until its time has come."""
        if not self.feed.is_watched:
            self._recorder = self._pacer = None
            return
        if self._recorder is None or self._rows * self._aviary.num_drones > MOST_LINES:
            self._start()
        else:
            self._send(self._recorder)
        if self._pacer is None:
            self._pacer = Pacer(1 / self._aviary.options.decision_hz)
        self._pacer.wait()

    def _send(self, recorder: Recorder) -> None:
        """Send the decision that was flown."""
        aviary = self._aviary
        recorder.note(aviary.given.copy(), aviary.rewards.copy(), later(aviary.telling()))
        recording = recorder.recording()
        recorder.forget()
        self._rows += 1
        drones = f"{aviary.num_drones} {'drones' if aviary.num_drones > 1 else 'drone'}"
        title = f"{aviary.task.name}: {drones}, live"
        news = event("rows", rows_payload(recording))
        self.feed.send(news, lambda: event("start", whole_payload(recording, title)))

    def close(self) -> None:
        """Tell pages that it is over, and close the port; a second call does nothing."""
        self._recorder = None
        self._finalizer()
