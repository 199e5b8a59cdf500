"""Progress of commands on standard error: a bar on a terminal, lines elsewhere."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from bulletuav.compiled import dispatcher
from bulletuav.compiled.dispatcher import Compilation

LINE_PERIOD = 10.0
"""Least time between two lines, s"""
DRAWING_PERIOD = 0.1
"""Least time between two drawings of a bar, s"""
USUAL_FUNCTIONS = 270
"""Functions that the first flight of `crossing` compiles: 246 as point_mass, 300 by bullet"""
Show = Callable[[float, str], None]
"""Function that shows how much is done so far, and a note"""


class Report:
    """What is called with how much is done so far."""

    def __init__(self, show: Show) -> None:
        """Keep the function that shows it."""
        self._show, self._note = show, ""

    def __call__(self, done: float) -> None:
        """Show how much is done so far, and the last note."""
        self._show(done, self._note)

    def note(self, text: str) -> None:
        """Keep what is shown beside it from now on."""
        self._note = text


@contextlib.contextmanager
def show_progress(activity: str, total: int, unit: str) -> Iterator[Report]:
    """Show how much of something is done.

    Args:
        activity: What is going on, such as "flying".
        total: How much there is to do.
        unit: What `total` counts, such as "decisions".

    Yields:
        What to call with how much is done so far. Nothing is shown before its first
        call, so that errors of input come first.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        display = _bar(console, activity, total, unit)
    else:
        display = _lines(activity, total, unit)
    try:
        with display as show:
            yield Report(show)
    finally:
        dispatcher.COMPILATION.forget_watch()


def _working_time() -> float:
    """Read a clock that stands still during compilation, which says nothing about what is left."""
    return time.monotonic() - dispatcher.COMPILATION.seconds


def _compiled(compilation: Compilation) -> str:
    """Describe how far compilation is."""
    number = compilation.num_functions
    left = f" of about {USUAL_FUNCTIONS}" if number <= USUAL_FUNCTIONS else ""
    return f"{number}{left} functions, {compilation.seconds:.0f} s (the first time only)"


@contextlib.contextmanager
def _bar(console: Console, activity: str, total: int, unit: str) -> Iterator[Show]:
    """Show a bar with the time that remains; while functions are compiled, one for them."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[amount]}"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    # Drawn here, not by a thread of Rich: workers may be forked meanwhile, and would wait forever
    # for a lock of the terminal that the thread holds
    with Progress(
        *columns, console=console, get_time=_working_time, auto_refresh=False
    ) as progress:
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
                    "compiling", total=USUAL_FUNCTIONS, amount="", note=""
                )
            number, amount = compilation.num_functions, _compiled(compilation)
            progress.update(bars["compiling"], completed=number, amount=amount)
            draw()

        def show(done: float, note: str) -> None:
            # What goes on now is no compilation any more, or not yet again
            if "compiling" in bars:
                progress.remove_task(bars.pop("compiling"))
            # The bar appears with the first report.
            if activity not in bars:
                bars[activity] = progress.add_task(activity, total=total, amount="", note="")
            amount = f"{done:,.0f} of {total:,.0f} {unit}"
            progress.update(bars[activity], completed=done, amount=amount, note=note)
            draw()

        dispatcher.COMPILATION.watch = show_compilation
        yield show


@contextlib.contextmanager
def _lines(activity: str, total: int, unit: str) -> Iterator[Show]:
    """Print a line at the beginning, every `LINE_PERIOD`, and when all is done."""
    begin: float | None = None  # when the first report came: what was before is no part of it
    next_line = 0.0  # when the next line about compilation is due
    last: tuple[float, float] | None = None  # when the last line was printed, and what was done

    def show_compilation(compilation: Compilation) -> None:
        nonlocal next_line
        # A few functions take no time worth a line
        if compilation.num_functions >= dispatcher.MANY and compilation.seconds >= next_line:
            next_line = compilation.seconds + LINE_PERIOD
            sys.stderr.write(f"compiling: {_compiled(compilation)}\n")
            sys.stderr.flush()

    def show(done: float, note: str) -> None:
        nonlocal begin, last
        now = _working_time()
        begin = now if begin is None else begin
        # Trainers may go beyond the total, as they end with a whole rollout.
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
