"""Search space of a hyperparameter study: ranges and choices of run settings.

Names are those of `run.yaml`, with dots: `model.gamma`, `options.weights.conflict`, `worlds`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from bulletuav.errors import finite, shown, unknown
from bulletuav.policies.run import SCENE, RunConfig, plain_value, whole_number

VARIED = ("worlds", "steps", "shared_reward", "options", "curriculum", "model")
"""Run settings that can be searched; evaluations are the same for all trials"""


@dataclass(frozen=True)
class Range:
    """Range of numbers, including both ends.

    Attributes:
        low: Lower bound.
        high: Upper bound.
        log: Whether values are sampled on a logarithmic scale.
        step: Step between values; integers have step 1, floats may have none.
    """

    low: float
    high: float
    log: bool = False
    step: float | None = None

    @property
    def first(self) -> float:
        """Lower bound."""
        return self.low

    @property
    def is_whole(self) -> bool:
        """Whether the range contains integers only."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def plain(self) -> dict[str, Any]:
        """Return the range as plain data for a file."""
        values: dict[str, Any] = {"low": self.low, "high": self.high}
        values |= {"log": True} if self.log else {}
        return values | ({} if self.step is None else {"step": self.step})


@dataclass(frozen=True)
class Choices:
    """Unordered set of values.

    Attributes:
        values: The values, as lists, dicts, strings and numbers.
    """

    values: tuple[Any, ...]

    @property
    def first(self) -> Any:
        """First value."""
        return self.values[0]

    def plain(self) -> dict[str, Any]:
        """Return the choices as plain data for a file."""
        return {"choices": list(self.values)}


Space = dict[str, Range | Choices]
"""Searched settings by name"""


def parse_space(values: Mapping[str, Any]) -> Space:
    """Parse a search space from the contents of a file.

    Args:
        values: Names as in `run.yaml`, nested or with dots. The leaves contain `low` and `high`,
            with `log: true` or `step`, or `choices`.

    Raises:
        ValueError: If a name is not a setting of a run, or a range is invalid.
    """
    space = {name: _parse_range(name, one) for name, one in _leaves(values)}
    if not space:
        raise ValueError(
            "the search space is empty: name settings and ranges, such as model.gamma=0.9:0.999"
        )
    for name in space:
        first = name.partition(".")[0]
        if first not in VARIED:
            raise unknown("setting that varies:", first, VARIED)
    return space


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the leaves of nested settings, with names joined by dots."""
    for name, one in values.items():
        if not isinstance(one, Mapping):
            raise ValueError(
                f"{prefix}{name} is {shown(one)}: low and high are needed, or a list of choices"
            )
        if {"low", "high", "choices"} & set(one):
            yield f"{prefix}{name}", one
        else:
            yield from _leaves(one, f"{prefix}{name}.")


def _parse_range(name: str, given: Mapping[str, Any]) -> Range | Choices:
    """Parse one range or set of choices."""
    known = ("choices",) if "choices" in given else ("low", "high", "log", "step")
    for key in given:
        if key not in known:
            raise unknown(f"key of {name}:", key, known)
    if "choices" in given:
        listed = given["choices"]
        if not isinstance(listed, list | tuple) or not listed:
            raise ValueError(f"{name}: choices is {shown(listed)}: a list of values is needed")
        return Choices(tuple(plain_value(one) for one in listed))
    for key in ("low", "high"):
        finite(f"{name}: {key}", whole_number(given.get(key)))
    return _range(name, **given)


def _range(name: str, low: Any, high: Any, log: Any = False, step: Any = None) -> Range:
    """Validate and create a range."""
    if not isinstance(log, bool):
        raise ValueError(f"{name}: log is {shown(log)}: true or false is needed")
    if low >= high:
        raise ValueError(f"{name}: low is {low} and high is {high}: low must be less than high")
    if log and (low <= 0 or step is not None):
        raise ValueError(f"{name}: a logarithmic range needs low above 0, and no step")
    if step is not None and finite(f"{name}: step", step) <= 0:
        raise ValueError(f"{name}: step is {step}: more than 0 is needed")
    return Range(low, high, log, step)


def with_values(run: RunConfig, values: Mapping[str, Any]) -> RunConfig:
    """Override settings of a run by the values of a trial.

    Args:
        run: The base configuration.
        values: Values by dotted names.

    Returns:
        The configuration of the trial.

    Raises:
        ValueError: If the combination is invalid.
    """
    settings = run.plain()
    del settings["version"]
    for name, value in values.items():
        first, *rest = name.split(".")
        if first == "model" and len(rest) > 1:
            # Keep the defaults next to a nested setting of the algorithm.
            settings["model"].setdefault(rest[0], plain_value(run.settings.get(rest[0], {})))
        _set_nested(settings, [first, *rest], name, value)
    return RunConfig.of(settings)


def _set_nested(settings: dict[str, Any], path: list[str], name: str, value: Any) -> None:
    """Set a value in nested dicts."""
    for key in path[:-1]:
        settings = settings.setdefault(key, {})
        if not isinstance(settings, dict):
            raise ValueError(
                f"{name} is searched, but {key} is {shown(settings)}, which has no nested settings"
            )
    settings[path[-1]] = value


def check_space(run: RunConfig, space: Space) -> None:
    """Check the searched settings of a study.

    Every searched setting must be valid, have an effect, and not change the evaluations.

    Raises:
        ValueError: If a setting is invalid, changes the evaluation environment, or is set by
            curriculum stages.
    """
    for name, one in space.items():
        with_values(run, {name: one.first})
        first, _, option = name.partition(".")
        if first != "options":
            continue
        if option in SCENE and option not in run.evaluation:
            raise ValueError(
                f"{name} is searched, and would change evaluations: fix it there with "
                f"evaluation: {{{option}: ...}} in the settings of the run"
            )
        if any(option.split(".")[0] in stage for stage in run.stages):
            raise ValueError(
                f"{name} is searched, and stages of the run set it: remove one of them"
            )
