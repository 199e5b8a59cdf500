"""Settings of the algorithm `foundation`, and their checks."""

from typing import NamedTuple

from bulletuav.errors import as_int, finite, shown, suggest_names
from bulletuav.policies.recurrent import BLOCKS
from bulletuav.policies.run import DEFAULTS, FOUNDATION, RunConfig, whole_number
from bulletuav.tasks import find_task
from bulletuav.tasks.hover import Hover
from bulletuav.training.fast.dense import BLOCK

ACTION = "rotor"
"""Action of the policy"""
DRAWN = ("airframe", "num_drones")
"""Options that the algorithm sets itself"""
CONSTANT = ("decision_hz", "horizon")
"""Options that must not change during a run"""
MAX_COUNT = 10**9
"""Maximum of integer settings"""
MAX_WIDTH = 1024
"""Maximum width of the hidden state"""


class FoundationSettings(NamedTuple):
    """Checked settings of the algorithm.

    Attributes:
        airframes: Number of airframes that are drawn for each rollout, the drones of each world.
        hidden_size: Width of the hidden state.
        buffer_size: Number of episodes of drones that are kept, those of the last rollouts.
        batch_size: Number of episodes in each gradient step.
        gradient_steps: Number of gradient steps after each rollout.
        learning_rate: Step size at the start and at the end of the run.
        max_grad_norm: Maximum norm of the gradient.
    """

    airframes: int
    hidden_size: int
    buffer_size: int
    batch_size: int
    gradient_steps: int
    learning_rate: tuple[float, float]
    max_grad_norm: float


def require_hover(task: str) -> None:
    """Raise ValueError unless a task is `hover`, which the teachers fly."""
    if not issubclass(find_task(task), Hover):
        raise ValueError(
            f"{FOUNDATION} learns task 'hover', not {shown(task)}: its policy flies to any goal, "
            f"also in other tasks with action {ACTION!r}"
        )


def check_foundation_settings(config: RunConfig) -> FoundationSettings:
    """Check the settings of the algorithm, and the options of the run that it needs.

    Args:
        config: Settings of the run.

    Raises:
        ValueError: If a setting is unknown or invalid, or an option does not fit the algorithm.
    """
    require_hover(config.task)
    known = tuple(DEFAULTS[FOUNDATION])
    for name in config.model:
        if name not in known:
            raise ValueError(
                f"{FOUNDATION} has no setting {shown(name)}: {suggest_names(name, known)}"
            )
    for name in ("shared_reward", "staggered"):
        if getattr(config, name):
            raise ValueError(f"{name} is True, and {FOUNDATION} has no use for it: leave it out")
    for options in (config.options, *config.stages):
        for name in DRAWN:
            if name in options:
                raise ValueError(
                    f"{name} is {shown(options[name])}, and {FOUNDATION} draws airframes: set "
                    f"their number by --model airframes=64, and {name} in evaluations only"
                )
        if options.get("normalise"):
            raise ValueError(
                f"normalise is True, and {FOUNDATION} observes numbers in their units: leave it out"
            )
    for stage in config.stages:
        for name in CONSTANT:
            if name in stage:
                raise ValueError(
                    f"{name} is {shown(stage[name])} in a stage, and all episodes of {FOUNDATION} "
                    f"have one length: set {name} in options"
                )
    if config.action != ACTION:
        raise ValueError(
            f"action is {shown(config.action)}, and {FOUNDATION} commands rotors: choose {ACTION!r}"
        )
    observed = config.interface.get("observation", ())
    if isinstance(observed, str) or tuple(observed) != BLOCKS:
        raise ValueError(
            f"observation is {shown(observed)}, and {FOUNDATION} needs {list(BLOCKS)}: leave it out"
        )
    model = config.settings
    limits = {
        "airframes": (1, MAX_COUNT),
        "hidden_size": (1, MAX_WIDTH),
        "buffer_size": (1, MAX_COUNT),
        "batch_size": (1, MAX_COUNT),
        "gradient_steps": (1, MAX_COUNT),
    }
    counts = {
        name: as_int(name, whole_number(model[name]), *bounds) for name, bounds in limits.items()
    }
    if counts["batch_size"] % BLOCK:
        raise ValueError(f"batch_size is {counts['batch_size']}: a multiple of {BLOCK} is needed")
    rate = model["learning_rate"]
    first, last = rate if isinstance(rate, list | tuple) and len(rate) == 2 else (rate, rate)
    return FoundationSettings(
        **counts,
        learning_rate=(finite("learning_rate", first, 0.0), finite("learning_rate", last, 0.0)),
        max_grad_norm=finite("max_grad_norm", model["max_grad_norm"], 0.0),
    )
