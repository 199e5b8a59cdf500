"""Evaluation and observation of a decision as steps of a `bulletuav.compiled.program`."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import Bound
from bulletuav.tasks.parts.safety import deny_unsafe


class StepEvaluation(NamedTuple):
    """Termination, success and reward terms of a decision, (W, N) each, filled by a program.

    Attributes:
        ended: Drones whose episodes terminate.
        success: Drones that are successful.
        terms: Reward terms by name, unweighted.
    """

    ended: np.ndarray
    success: np.ndarray
    terms: Mapping[str, np.ndarray]


class StableArrays:
    """Fixed copies of arrays that a task allocates in each decision, for compiled loops."""

    def __init__(self, program: Program, frame: Frame) -> None:
        """Start without arrays.

        Args:
            program: Program that copies the arrays before the first loop that reads them.
            frame: The decision.
        """
        self._program, self._frame = program, frame
        self._arrays: dict[str, np.ndarray] = {}

    def add(self, bound: Bound, out: np.ndarray) -> None:
        """Add a step to the program that evaluates an ingredient into `out`."""
        if bound.loop is None:  # a NumPy function of the whole frame
            self._program.callback(lambda: bound.fill(self._frame, out))
            return
        arguments = [self._argument(name, source) for name, source in bound.sources.items()]
        self._program.call(bound.loop, *arguments, out)

    def _argument(self, name: str, source: Any) -> Any:
        """Return an argument's array if it is persistent, else a refreshed copy."""
        if name in self._arrays:
            return self._arrays[name]
        value = source.read(self._frame)
        if source.is_persistent or not isinstance(value, np.ndarray):
            return value
        kept = self._arrays[name] = np.array(value)

        def copy() -> None:
            kept[...] = source.read(self._frame)

        self._program.callback(copy)
        return kept


def add_outcome(
    program: Program, task: Task[Any], frame: Frame, evaluation: StepEvaluation
) -> None:
    """Add steps to a program that compute termination and success.

    The task must have evaluated a frame before.

    Args:
        program: Program to extend.
        task: The task. Methods that it overrides run as Python callbacks.
        frame: The decision.
        evaluation: Arrays to fill.
    """

    def evaluate() -> None:
        result = task.evaluate_step(frame)
        evaluation.ended[:] = result.terminated
        evaluation.success[:] = result.success
        _copy(result.terms, evaluation)

    # An overridden `evaluate_step` runs as a Python callback
    kind, bound = type(task), task.bound
    if kind.evaluate_step is not Task.evaluate_step:
        program.callback(evaluate)
        return
    own = None if kind.terminated is Task.terminated else task.terminated
    _add_flags(program, frame, evaluation.ended, own, bound.ends)
    own = None if kind.succeeded is Task.succeeded else task.succeeded
    success = () if bound.success is None else (bound.success,)
    _add_flags(program, frame, evaluation.success, own, success)
    if task.safety is not None:
        program.call(deny_unsafe, frame.scene.memory["violations"], evaluation.success)


def add_evaluation(
    program: Program, task: Task[Any], frame: Frame, evaluation: StepEvaluation
) -> None:
    """Add steps to a program that compute termination, success and reward terms.

    See `add_outcome`.
    """
    add_outcome(program, task, frame, evaluation)
    kind, bound = type(task), task.bound
    if kind.evaluate_step is Task.evaluate_step:
        _add_terms(program, task, frame, evaluation)
    if kind.extra_terms is not Task.extra_terms:
        program.callback(lambda: _copy(task.extra_terms(frame), evaluation))
        return
    kept = StableArrays(program, frame)
    for name, term in bound.extra.items():
        if name in evaluation.terms:
            kept.add(term, evaluation.terms[name])


def _add_flags(
    program: Program,
    frame: Frame,
    out: np.ndarray,
    own: Callable[[Frame], np.ndarray] | None,
    bounds: Sequence[Bound],
) -> None:
    """Add a step that sets `out` by a task's own method, or where any ingredient holds."""
    if own is not None:
        method = own
        program.callback(lambda: np.copyto(out, method(frame)))
        return
    kept = StableArrays(program, frame)
    for bound in bounds[:1]:
        kept.add(bound, out)
    for bound in bounds[1:]:
        another = np.zeros(out.shape, dtype=bool)
        kept.add(bound, another)
        program.call(_merge_flags, another, out)


def _add_terms(program: Program, task: Task[Any], frame: Frame, evaluation: StepEvaluation) -> None:
    if type(task).reward_terms is not Task.reward_terms:
        program.callback(lambda: _copy(task.reward_terms(frame), evaluation))
        return
    kept = StableArrays(program, frame)
    for name, term in task.bound.terms.items():
        kept.add(term, evaluation.terms[name])
    if any(task.weights.get(name) for name in task.computed_terms):
        own = {name: evaluation.terms[name] for name in task.bound.terms}
        program.callback(lambda: _copy(task.compute_terms(frame, own), evaluation))


def _copy(terms: Mapping[str, np.ndarray], evaluation: StepEvaluation) -> None:
    for name, term in terms.items():
        evaluation.terms[name][:] = term


@kernel
def _merge_flags(another: np.ndarray, out: np.ndarray) -> None:
    """Compute `out |= another`, both (W, N)."""
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[w, i] = out[w, i] or another[w, i]


@kernel
def clear(table: np.ndarray) -> None:
    """Fill a 3-d array with zeros."""
    for a in range(table.shape[0]):
        for b in range(table.shape[1]):
            for c in range(table.shape[2]):
                table[a, b, c] = 0.0
