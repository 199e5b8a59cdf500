"""Progress of commands on standard error: a bar on a terminal, lines elsewhere."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

LINE_PERIOD = 10.0
"""Least time between two lines, s"""
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
def show_progress(
    activity: str,
    total: int,
    unit: str,
) -> Iterator[Report]:
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
    with display as show:
        yield Report(show)


@contextlib.contextmanager
def _bar(
    console: Console,
    activity: str,
    total: int,
    unit: str,
) -> Iterator[Show]:
    """Show a bar with the time that remains."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} " + unit),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=console) as progress:

        def show(done: float, note: str) -> None:
            # The bar appears with the first report.
            if not progress.tasks:
                progress.add_task(activity, total=total, note="")
            progress.update(progress.tasks[0].id, completed=done, note=note)

        yield show


@contextlib.contextmanager
def _lines(
    activity: str,
    total: int,
    unit: str,
) -> Iterator[Show]:
    """Print a line at the beginning, every `LINE_PERIOD`, and when all is done."""
    begin = time.monotonic()
    last: tuple[float, float] | None = None  # when the last line was printed, and what was done

    def show(done: float, note: str) -> None:
        nonlocal last
        now = time.monotonic()
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

    yield show
