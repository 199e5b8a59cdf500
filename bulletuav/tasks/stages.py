"""Rewards, ends and observations as parts of a program; see `bulletuav.compiled.program`."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import Bound


class Judgement(NamedTuple):
    """What a task makes of a decision, in arrays (W, N) that a program fills.

    Attributes:
        ended: Whose episode the task ends.
        success: Who is where the task wants it.
        terms: Reward terms by name, unweighted.
    """

    ended: np.ndarray
    success: np.ndarray
    terms: Mapping[str, np.ndarray]


class Kept:
    """Arrays that a task makes anew for each decision, kept where compiled loops find them."""

    def __init__(self, program: Program, frame: Frame) -> None:
        """Begin with none.

        Args:
            program: In which they are copied, before the first loop that reads them.
            frame: The decision.
        """
        self._program, self._frame = program, frame
        self._arrays: dict[str, np.ndarray] = {}

    def add(self, bound: Bound, out: np.ndarray) -> None:
        """Add to the program that an ingredient fills `out`."""
        if bound.loop is None:  # it takes all drones at once
            self._program.callback(lambda: bound.fill(self._frame, out))
            return
        arguments = [self._argument(name, source) for name, source in bound.sources.items()]
        self._program.call(bound.loop, *arguments, out)

    def _argument(self, name: str, source: Any) -> Any:
        """Find an argument where it stays, or copy it there."""
        if name in self._arrays:
            return self._arrays[name]
        value = source.read(self._frame)
        if source.stays or not isinstance(value, np.ndarray):
            return value
        kept = self._arrays[name] = np.array(value)

        def copy() -> None:
            kept[...] = source.read(self._frame)

        self._program.callback(copy)
        return kept


def add_outcome(program: Program, task: Task[Any], frame: Frame, judgement: Judgement) -> None:
    """Add to a program that a task works out ends and successes, and what it needs for them.

    The task has evaluated a frame before.

    Args:
        program: To be added to.
        task: The task; what it overrides is Python's turn.
        frame: The decision.
        judgement: What is filled.
    """

    def evaluate() -> None:
        result = task.evaluate_step(frame)
        judgement.ended[:] = result.terminated
        judgement.success[:] = result.success
        _copy(result.terms, judgement)

    # A task that judges by itself takes Python's turn
    kind, bound = type(task), task.bound
    if kind.evaluate_step is not Task.evaluate_step:
        program.callback(evaluate)
        return
    # Own methods where there are some, and compiled ingredients beside them
    own = None if kind.terminated is Task.terminated else task.terminated
    _add_flags(program, frame, judgement.ended, own, bound.ends)
    own = None if kind.succeeded is Task.succeeded else task.succeeded
    success = () if bound.success is None else (bound.success,)
    _add_flags(program, frame, judgement.success, own, success)


def add_judgement(program: Program, task: Task[Any], frame: Frame, judgement: Judgement) -> None:
    """Add to a program that a task works out what `add_outcome` tells, and reward terms."""
    add_outcome(program, task, frame, judgement)
    kind, bound = type(task), task.bound
    if kind.evaluate_step is Task.evaluate_step:
        _add_terms(program, task, frame, judgement)
    # Terms that users add, by the task's own way or as ingredients
    if kind.extra_terms is not Task.extra_terms:
        program.callback(lambda: _copy(task.extra_terms(frame), judgement))
        return
    kept = Kept(program, frame)
    for name, term in bound.extra.items():
        if name in judgement.terms:
            kept.add(term, judgement.terms[name])


def _add_flags(
    program: Program,
    frame: Frame,
    out: np.ndarray,
    own: Callable[[Frame], np.ndarray] | None,
    bounds: Sequence[Bound],
) -> None:
    """Add to a program that `out` tells where any ingredient does, or what a task's own method."""
    if own is not None:
        method = own
        program.callback(lambda: np.copyto(out, method(frame)))
        return
    kept = Kept(program, frame)
    for bound in bounds[:1]:
        kept.add(bound, out)
    for bound in bounds[1:]:
        another = np.zeros(out.shape, dtype=bool)
        kept.add(bound, another)
        program.call(_join, another, out)


def _add_terms(program: Program, task: Task[Any], frame: Frame, judgement: Judgement) -> None:
    """Add to a program that a task's own reward terms are worked out."""
    if type(task).reward_terms is not Task.reward_terms:
        program.callback(lambda: _copy(task.reward_terms(frame), judgement))
        return
    kept = Kept(program, frame)
    for name, term in task.bound.terms.items():
        kept.add(term, judgement.terms[name])
    if any(task.weights.get(name) for name in task.computed_terms):
        own = {name: judgement.terms[name] for name in task.bound.terms}
        program.callback(lambda: _copy(task.compute_terms(frame, own), judgement))


def _copy(terms: Mapping[str, np.ndarray], judgement: Judgement) -> None:
    """Keep terms that a task gave."""
    for name, term in terms.items():
        judgement.terms[name][:] = term


@kernel
def _join(another: np.ndarray, out: np.ndarray) -> None:
    """Set `out` (W, N) also where `another` is set."""
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[w, i] = out[w, i] or another[w, i]


@kernel
def clear(table: np.ndarray) -> None:
    """Write zeros to an array of three axes."""
    for a in range(table.shape[0]):
        for b in range(table.shape[1]):
            for c in range(table.shape[2]):
                table[a, b, c] = 0.0
