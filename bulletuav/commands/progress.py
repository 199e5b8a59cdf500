"""Progress on standard error: a bar on terminals, lines otherwise."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from bulletuav.compiled import dispatcher
from bulletuav.compiled.dispatcher import Compilation

LINE_PERIOD = 10.0
"""Minimum time between two lines, s"""
DRAWING_PERIOD = 0.1
"""Minimum time between two redraws of a bar, s"""
EXPECTED_FUNCTIONS = 270
"""Typical number of functions compiled on the first run: 246 (point_mass) to 300 (bullet)"""
Show = Callable[[float, str], None]
"""Function that displays the finished amount and a note"""
Clock = Callable[[], float]
"""Function that returns a time, s"""


class ProgressReport:
    """Callback that displays the finished amount with the last note."""

    def __init__(self, show: Show) -> None:
        """Set the display function."""
        self._show, self._note = show, ""

    def __call__(self, done: float) -> None:
        """Display the finished amount and the last note."""
        self._show(done, self._note)

    def note(self, text: str) -> None:
        """Set the text that is displayed next to the progress."""
        self._note = text


@contextlib.contextmanager
def show_progress(
    activity: str, total: int, unit: str, is_compilation: bool = False
) -> Iterator[ProgressReport]:
    """Show the progress of an activity.

    Args:
        activity: Name of the activity, such as "flying".
        total: Total amount of work.
        unit: Unit of `total`, such as "decisions".
        is_compilation: Whether the activity itself is compilation. Otherwise compilation is shown
            separately, and does not count towards the time of the activity.

    Yields:
        The callback for the finished amount. Nothing is shown before its first call, so that input
        errors are printed first.
    """
    console = Console(stderr=True)
    clock = time.monotonic if is_compilation else _working_time
    if console.is_terminal:
        display = _bar(console, activity, total, unit, clock)
    else:
        display = _lines(activity, total, unit, clock)
    try:
        with display as show:
            if is_compilation:
                dispatcher.COMPILATION.watch = lambda _: None
            yield ProgressReport(show)
    finally:
        dispatcher.COMPILATION.forget_watch()


def _working_time() -> float:
    """Return the time without compilation, for estimates of the remaining time."""
    return time.monotonic() - dispatcher.COMPILATION.seconds


def _compiled(compilation: Compilation) -> str:
    """Return a text with the progress of the compilation."""
    number = compilation.num_functions
    left = f" of about {EXPECTED_FUNCTIONS}" if number <= EXPECTED_FUNCTIONS else ""
    return f"{number}{left} functions, {compilation.seconds:.0f} s, kept for later runs"


@contextlib.contextmanager
def _bar(console: Console, activity: str, total: int, unit: str, clock: Clock) -> Iterator[Show]:
    """Show a bar with the remaining time, and another bar during compilation."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[amount]}"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    # Without a refresh thread of Rich: a worker that is forked while the thread holds the lock of
    # the terminal would wait for this lock forever
    with Progress(*columns, console=console, get_time=clock, auto_refresh=False) as progress:
        bars: dict[str, TaskID] = {}
        next_drawing = 0.0

        def draw() -> None:
            nonlocal next_drawing
            if time.monotonic() >= next_drawing:
                progress.refresh()
                next_drawing = time.monotonic() + DRAWING_PERIOD

        def show_compilation(compilation: Compilation) -> None:
            if "compiling" not in bars:
                bars["compiling"] = progress.add_task(
                    "compiling", total=EXPECTED_FUNCTIONS, amount="", note=""
                )
            number, amount = compilation.num_functions, _compiled(compilation)
            progress.update(bars["compiling"], completed=number, amount=amount)
            draw()

        def show(done: float, note: str) -> None:
            # The compilation is over, or interrupted by other work
            if "compiling" in bars:
                progress.remove_task(bars.pop("compiling"))
            # The bar appears with the first report
            if activity not in bars:
                bars[activity] = progress.add_task(activity, total=total, amount="", note="")
            amount = f"{done:,.0f} of {total:,.0f} {unit}"
            progress.update(bars[activity], completed=done, amount=amount, note=note)
            draw()

        dispatcher.COMPILATION.watch = show_compilation
        yield show


@contextlib.contextmanager
def _lines(activity: str, total: int, unit: str, clock: Clock) -> Iterator[Show]:
    """Print a line at the start, every `LINE_PERIOD`, and at the end."""
    begin: float | None = None  # time of the first report; earlier time is not counted
    next_line = 0.0  # compilation time at which the next line is due
    last: tuple[float, float] | None = None  # time and finished amount of the last line

    def show_compilation(compilation: Compilation) -> None:
        nonlocal next_line
        # A few functions compile too fast to be worth a line
        if compilation.num_functions >= dispatcher.MANY and compilation.seconds >= next_line:
            next_line = compilation.seconds + LINE_PERIOD
            sys.stderr.write(f"compiling: {_compiled(compilation)}\n")
            sys.stderr.flush()

    def show(done: float, note: str) -> None:
        nonlocal begin, last
        now = clock()
        begin = now if begin is None else begin
        # Trainers may exceed the total, as they finish the last rollout
        done = min(done, total)
        if last is not None:
            last_time, last_done = last
            is_new = done != last_done
            is_due = done >= total or now >= last_time + LINE_PERIOD
            if not (is_new and is_due):
                return
        last = (now, done)
        share = f"{100 * done / total:.0f} %" if total else "all"
        sys.stderr.write(
            f"{activity}: {done:,.0f} of {total:,.0f} {unit} ({share}), {now - begin:.0f} s"
            f"{note and ', '}{note}\n"
        )
        sys.stderr.flush()

    dispatcher.COMPILATION.watch = show_compilation
    yield show
