"""Runs: many operations from one integer, and the few of them that show a failure."""

import faulthandler
import gc
import time
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from . import faults  # noqa: F401  # adds operations
from .at_work import OPERATIONS, SLOTS, Sim, Turn, unexpected
from .invariants import Broken, Resources, tell
from .operations import build

PATIENCE = 600.0
"""Time that some operations may take before the process tells where it hangs, and ends, s"""
EVERY = 50
SHRINKING = 60
"""Runs that are spent on finding fewer operations"""


class Failure(NamedTuple):
    """What went wrong.

    Attributes:
        seed: Of the run.
        operation: Number of the operation; -1 for what was left in the end.
        name: Its name.
        what: What does not hold.
        notes: What the operation was about.
    """

    seed: int
    operation: int
    name: str
    what: str
    notes: str

    @property
    def kind(self) -> str:
        """What tells it from other failures."""
        return f"{self.name}: {self.what[:60]}"


class Outcome(NamedTuple):
    """What came of a run.

    Attributes:
        seed: Of the run.
        counts: How often each operation had each outcome.
        digest: Hash of all that came out.
        failure: What went wrong, if anything.
        seconds: How long each operation took in all.
        ran: Numbers of the operations that ran.
    """

    seed: int
    counts: Counter[tuple[str, str]]
    digest: str
    failure: Failure | None
    seconds: Counter[str]
    ran: list[int]


def drawn(seed: int, number: int) -> tuple[str, int, np.random.Generator]:
    """Draw an operation: its name, the slot that it is about, and its random numbers."""
    rng = np.random.default_rng([seed, number])
    weights = np.array([weight for weight, _ in OPERATIONS.values()])
    chosen = rng.choice(len(weights), p=weights / weights.sum())
    return list(OPERATIONS)[chosen], int(rng.integers(SLOTS)), rng


def run(
    seed: int,
    operations: int,
    folder: Any,
    wide: bool = False,
    only: Iterable[int] | None = None,
    patience: float = PATIENCE,
    skip: Iterable[str] = (),
) -> Outcome:
    """Do operations until one of them fails.

    Args:
        seed: What everything follows from.
        operations: How many.
        folder: Where files are written.
        wide: Whether to draw from everything, or from what is soon compiled.
        only: Numbers of the operations to do; all when left out.
        patience: Time that `EVERY` of them may take, s.
        skip: Names of operations that are left out.
    """
    sim, before = Sim(wide, folder), Resources.now()
    gc.freeze()  # what is compiled by now stays: searches for garbage leave it out
    counts: Counter[tuple[str, str]] = Counter()
    seconds: Counter[str] = Counter()
    failure, ran = None, []
    numbers: Sequence[int] = range(operations) if only is None else sorted(only)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for k, number in enumerate(numbers):
            if k % EVERY == 0:
                faulthandler.dump_traceback_later(patience, exit=True)
            name, slot, rng = drawn(seed, number)
            turn = Turn(sim, slot, rng)
            if sim.slots[slot] is None:
                name = "build"
            if name in skip:
                continue
            action = build if name == "build" else OPERATIONS[name][1]
            sim.notes, begin = "", time.perf_counter()
            ran.append(number)
            try:
                outcome = action(turn)
                if surprise := unexpected(told):
                    raise Broken(f"warns: {surprise[0]}")
                told.clear()
            except Broken as error:
                failure = Failure(seed, number, name, str(error), about(sim, slot))
            except Exception as error:
                failure = Failure(seed, number, name, f"raised {tell(error)}", about(sim, slot))
            if failure is not None:
                break
            counts[name, outcome] += 1
            seconds[name] += time.perf_counter() - begin
    faulthandler.cancel_dump_traceback_later()
    sim.close()
    after = Resources.now()
    # A pipe or a thread of the libraries may come once
    if failure is None and _has_more(after, before):
        failure = Failure(seed, -1, "end", f"left behind: {after}, before {before}", "")
    return Outcome(seed, counts, str(sim.digest), failure, seconds, ran)


def _has_more(after: Resources, before: Resources) -> bool:
    """Tell whether a process holds more than before, but for what libraries keep open."""
    kept = after.descriptors - before.descriptors > 3
    return kept or any(now > then for now, then in zip(after[1:], before[1:], strict=True))


def about(sim: Sim, slot: int) -> str:
    """Tell what an operation was about."""
    face = sim.slots[slot]
    return f"{sim.notes} | {face.form if face is not None else 'no environment'}"


def shrink(failure: Failure, ran: list[int], folder: Any, wide: bool) -> list[int]:
    """Find fewer operations that fail in the same way."""
    left, tries, size = list(ran), 0, max(1, len(ran) // 2)
    while size and tries < SHRINKING:
        at = 0
        while at < len(left) - 1 and tries < SHRINKING:
            trial = left[:at] + left[min(at + size, len(left) - 1) :]
            tries += 1
            again = run(failure.seed, 0, folder, wide, only=trial).failure
            if again is not None and again.kind == failure.kind:
                left = trial
            else:
                at += size
        size //= 2
    return left


def table(outcomes: Iterable[Outcome]) -> str:
    """Write how often each operation had each outcome, and how long it took."""
    counts: Counter[tuple[str, str]] = Counter()
    seconds: Counter[str] = Counter()
    for one in outcomes:
        counts.update(one.counts)
        seconds.update(one.seconds)
    lines = [f"{'operation':<14} {'done':>8} {'s':>7}  outcomes"]
    for name in sorted({name for name, _ in counts}):
        own = {result: n for (known, result), n in counts.items() if known == name}
        told = ", ".join(f"{result} {n}" for result, n in sorted(own.items()))
        lines.append(f"{name:<14} {sum(own.values()):>8} {seconds[name]:>7.1f}  {told}")
    return "\n".join(lines)
