"""How commands tell how far they are: a bar on a terminal, lines elsewhere, both on standard error."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

EVERY = 10.0  # s, between two lines
Tell = Callable[[float], None]


@contextlib.contextmanager
def telling(what: str, total: int, unit: str) -> Iterator[Tell]:
    """Tell how far something is.

    Args:
        what: Is done, such as "flying".
        total: Of it.
        unit: That it is counted in, such as "decisions".

    Yields:
        A function to call with how much is done so far. Nothing is shown before its first call, in which errors of input
        would come.
    """
    console = Console(stderr=True)
    with (
        _bar(console, what, total, unit)
        if console.is_terminal
        else _lines(what, total, unit) as tell
    ):
        yield tell


@contextlib.contextmanager
def _bar(console: Console, what: str, total: int, unit: str) -> Iterator[Tell]:
    count = TextColumn("{task.completed:,.0f} of {task.total:,.0f} " + unit)
    columns = (TextColumn("{task.description}"), BarColumn(), count, TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:

        def tell(done: float) -> None:
            if not progress.tasks:
                progress.add_task(what, total=total)
            progress.update(progress.tasks[0].id, completed=done)

        yield tell


@contextlib.contextmanager
def _lines(what: str, total: int, unit: str) -> Iterator[Tell]:
    """A line at the beginning, every ten seconds, and when all is done."""
    begin = time.monotonic()
    told: list[tuple[float, float]] = []

    def tell(done: float) -> None:
        now, done = time.monotonic(), min(done, total)  # rollouts may end beyond it
        if told and (told[-1][1] == done or (done < total and now < told[-1][0] + EVERY)):
            return
        told.append((now, done))
        share = f"{100 * done / total:.0f} %" if total else "all"
        sys.stderr.write(
            f"{what}: {done:,.0f} of {total:,.0f} {unit} ({share}), {now - begin:.0f} s\n"
        )
        sys.stderr.flush()

    yield tell
