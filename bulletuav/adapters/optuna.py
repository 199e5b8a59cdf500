"""Suggestion of hyperparameters by Optuna for studies of training runs; needs the extra `tune`."""

import contextlib
import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.errors import missing_extra
from bulletuav.policies.space import Choices, Range, Space

try:
    import optuna
    from optuna.distributions import (
        BaseDistribution,
        CategoricalDistribution,
        FloatDistribution,
        IntDistribution,
    )
except ImportError:
    raise missing_extra("tuning", "tune") from None

FinishedTrial = tuple[Mapping[str, Any], float]
"""Values of a trial by name, and its result, NaN if it failed"""


def suggest(
    space: Space, finished: Sequence[FinishedTrial], count: int, seed: Sequence[int], maximise: bool
) -> list[dict[str, Any]]:
    """Suggest the values of further trials by a tree-structured Parzen estimator.

    The Optuna study exists in memory for this call only. The result therefore depends on the
    arguments alone, not on which process ran the trials, or when.

    Args:
        space: Search space.
        finished: Finished trials.
        count: Number of trials to suggest.
        seed: Integers that seed the sampler.
        maximise: If True, larger results are better.

    Returns:
        Values by name, for each suggested trial.
    """
    drawn = {name: _distribution(one) for name, one in space.items()}
    number = int(np.random.SeedSequence(seed).generate_state(1)[0])
    with _quiet():
        # constant_liar: trials of one batch differ although their results are unknown
        sampler = optuna.samplers.TPESampler(seed=number, multivariate=True, constant_liar=True)
        direction = "maximize" if maximise else "minimize"
        study = optuna.create_study(sampler=sampler, direction=direction)
        for values, result in finished:
            study.add_trial(_finished_trial(drawn, space, values, result))
        asked = [study.ask(drawn).params for _ in range(count)]
    return [
        {name: _decode(space[name], value) for name, value in params.items()} for params in asked
    ]


def _distribution(one: Range | Choices) -> BaseDistribution:
    """Convert a range to a distribution of Optuna, whose choices must be strings, not lists."""
    if not isinstance(one, Range):
        return CategoricalDistribution(list(_choices_by_text(one)))
    if one.is_whole:
        return IntDistribution(int(one.low), int(one.high), log=one.log, step=int(one.step or 1))
    return FloatDistribution(one.low, one.high, log=one.log, step=one.step)


def _choices_by_text(one: Choices) -> dict[str, Any]:
    """Return the choices by their JSON texts."""
    return {json.dumps(value): value for value in one.values}


def _decode(one: Range | Choices, value: Any) -> Any:
    """Convert a value that Optuna drew to a setting."""
    return value if isinstance(one, Range) else _choices_by_text(one)[value]


def _finished_trial(
    drawn: Mapping[str, BaseDistribution], space: Space, values: Mapping[str, Any], result: float
) -> Any:
    """Return a finished trial as an Optuna trial."""
    params = {
        name: value if isinstance(space[name], Range) else json.dumps(value)
        for name, value in values.items()
    }
    if np.isnan(result):
        state, value = optuna.trial.TrialState.FAIL, None
    else:
        state, value = optuna.trial.TrialState.COMPLETE, result
    return optuna.trial.create_trial(
        state=state, value=value, params=params, distributions=dict(drawn)
    )


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence the log messages and experimental warnings of Optuna."""
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(before)
