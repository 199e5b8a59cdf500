"""What a study varies: settings of a run by name, each with the values that it may have.

Names are those of `run.yaml`, with dots: `model.gamma`, `options.weights.conflict`, `worlds`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from bulletuav.errors import finite, shown, unknown
from bulletuav.policies.run import SCENE, RunConfig, plain_value, whole_number

VARIED = ("worlds", "steps", "shared_reward", "options", "curriculum", "model")
"""Settings of a run that can vary; those of evaluations are the same for all trials"""


@dataclass(frozen=True)
class Range:
    """Numbers from one to another, both included.

    Attributes:
        low: The least.
        high: The greatest.
        log: Whether they are drawn by their logarithm.
        step: Their distance; whole numbers have 1, others may have any.
    """

    low: float
    high: float
    log: bool = False
    step: float | None = None

    @property
    def first(self) -> float:
        """The least."""
        return self.low

    @property
    def is_whole(self) -> bool:
        """Whether they are whole numbers."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def plain(self) -> dict[str, Any]:
        """Give what a file holds."""
        told: dict[str, Any] = {"low": self.low, "high": self.high}
        told |= {"log": True} if self.log else {}
        return told | ({} if self.step is None else {"step": self.step})


@dataclass(frozen=True)
class Choices:
    """Some values, without order.

    Attributes:
        values: The values, made of lists, dicts, texts and numbers.
    """

    values: tuple[Any, ...]

    @property
    def first(self) -> Any:
        """The first of them."""
        return self.values[0]

    def plain(self) -> dict[str, Any]:
        """Give what a file holds."""
        return {"choices": list(self.values)}


Space = dict[str, Range | Choices]
"""What varies, by the name of the setting"""


def parse_space(values: Mapping[str, Any]) -> Space:
    """Make a space of what a file holds.

    Args:
        values: Names as in `run.yaml`, in each other or with dots. At the ends are `low` and
            `high`, with `log: true` or `step`, or else `choices`.

    Raises:
        ValueError: A name is none of a run's settings, or a range is impossible.
    """
    space = {name: _searched(name, one) for name, one in _leaves(values)}
    if not space:
        raise ValueError("nothing varies: name settings and ranges, such as model.gamma=0.9:0.999")
    for name in space:
        first = name.partition(".")[0]
        if first not in VARIED:
            raise unknown("setting that varies:", first, VARIED)
    return space


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """List what stands at the ends, with names joined by dots."""
    for name, one in values.items():
        if not isinstance(one, Mapping):
            raise ValueError(
                f"{prefix}{name} is {shown(one)}: low and high are needed, or a list of choices"
            )
        if {"low", "high", "choices"} & set(one):
            yield f"{prefix}{name}", one
        else:
            yield from _leaves(one, f"{prefix}{name}.")


def _searched(name: str, given: Mapping[str, Any]) -> Range | Choices:
    """Make one range or some choices."""
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
    """Check and make a range."""
    if not isinstance(log, bool):
        raise ValueError(f"{name}: log is {shown(log)}: true or false is needed")
    if low >= high:
        raise ValueError(f"{name}: low is {low} and high is {high}: low has to be less")
    if log and (low <= 0 or step is not None):
        raise ValueError(f"{name}: a logarithm needs low above 0, and no step")
    if step is not None and finite(f"{name}: step", step) <= 0:
        raise ValueError(f"{name}: step is {step}: more than 0 is needed")
    return Range(low, high, log, step)


def with_values(run: RunConfig, values: Mapping[str, Any]) -> RunConfig:
    """Change a run as a trial says.

    Args:
        run: The settings that do not vary.
        values: Values by names with dots.

    Returns:
        The settings of the trial.

    Raises:
        ValueError: They are impossible together.
    """
    settings = run.plain()
    del settings["version"]
    for name, value in values.items():
        first, *rest = name.split(".")
        if first == "model" and len(rest) > 1:
            # What stands in a setting of the algorithm stands beside its defaults.
            settings["model"].setdefault(rest[0], plain_value(run.settings.get(rest[0], {})))
        _put(settings, [first, *rest], name, value)
    return RunConfig.of(settings)


def _put(settings: dict[str, Any], path: list[str], name: str, value: Any) -> None:
    """Put a value into dicts that stand in each other."""
    for key in path[:-1]:
        settings = settings.setdefault(key, {})
        if not isinstance(settings, dict):
            raise ValueError(f"{name} varies, and {key} is {shown(settings)}, which has no names")
    settings[path[-1]] = value


def check_space(run: RunConfig, space: Space) -> None:
    """Refuse what no run takes, what would evaluate other things, and what would have no effect.

    Raises:
        ValueError: A setting that varies is none, changes what evaluations fly, or stages set it.
    """
    for name, one in space.items():
        with_values(run, {name: one.first})
        first, _, option = name.partition(".")
        if first != "options":
            continue
        if option in SCENE and option not in run.evaluation:
            raise ValueError(
                f"{name} varies, and so would the evaluations: fix it there by "
                f"evaluation: {{{option}: ...}} in the settings of the run"
            )
        if any(option.split(".")[0] in stage for stage in run.stages):
            raise ValueError(f"{name} varies, and stages of the run set it: leave one of them out")
