"""Progress of commands on standard error: a bar on a terminal, lines elsewhere."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

LINE_PERIOD = 10.0
"""Least time between two lines, s"""
Report = Callable[[float], None]
"""Function that takes how much is done so far"""


@contextlib.contextmanager
def show_progress(activity: str, total: int, unit: str) -> Iterator[Report]:
    """Show how much of something is done.

    Args:
        activity: What is going on, such as "flying".
        total: How much there is to do.
        unit: What `total` counts, such as "decisions".

    Yields:
        A function to call with how much is done so far. Nothing is shown before its first
        call, so that errors of input come first.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        display = _bar(console, activity, total, unit)
    else:
        display = _lines(activity, total, unit)
    with display as report:
        yield report


@contextlib.contextmanager
def _bar(console: Console, activity: str, total: int, unit: str) -> Iterator[Report]:
    """Show a bar with the time that remains."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} " + unit),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:

        def report(done: float) -> None:
            # The bar appears with the first report.
            if not progress.tasks:
                progress.add_task(activity, total=total)
            progress.update(progress.tasks[0].id, completed=done)

        yield report


@contextlib.contextmanager
def _lines(activity: str, total: int, unit: str) -> Iterator[Report]:
    """Print a line at the beginning, every `LINE_PERIOD`, and when all is done."""
    begin = time.monotonic()
    last: tuple[float, float] | None = None  # when the last line was printed, and what was done

    def report(done: float) -> None:
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
            f"{activity}: {done:,.0f} of {total:,.0f} {unit} ({share}), {now - begin:.0f} s\n"
        )
        sys.stderr.flush()

    yield report
