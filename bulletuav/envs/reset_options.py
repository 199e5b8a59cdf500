"""Validation of `reset(options=...)` for every environment class."""

import dataclasses
import difflib
from collections.abc import Mapping
from typing import Any

from bulletuav.envs.given_starts import STARTS
from bulletuav.envs.options import EnvOptions
from bulletuav.errors import shown
from bulletuav.tasks.given import PLACES

MASK = "reset_mask"
"""Option that selects the worlds to reset, in batches"""
WRAPPER_OPTIONS = ("minari_autoseed", "options")
"""Options that wrappers pass, which are ignored.

The first is from Minari's wrapper, the second from PettingZoo's `parallel_api_test`.
"""
ENV_OPTIONS = frozenset(field.name for field in dataclasses.fields(EnvOptions))
"""Options that are fixed when an environment is created"""
_START = "start positions are 'start'"
_GOAL = "goals of drones are 'goal'"
_VELOCITY = "velocities at the start are 'velocity'"
_ATTITUDE = "attitudes at the start are 'quaternion', body to world (x, y, z, w)"
_CHARGE = "charges at the start are 'charge', from 0 to 1"
_SCENE = "obstacles follow from the task's own options, set when the environment is created"
_WORLDS = "worlds of a batch are chosen by 'reset_mask' of batch_env and Gymnasium's vector classes"
REPLACEMENTS: Mapping[str, str] = {
    **dict.fromkeys(("position", "positions", "pos", "initial_positions", "init_pos"), _START),
    **dict.fromkeys(("initial_xyzs", "start_pos", "start_positions", "spawn", "state"), _START),
    **dict.fromkeys(("goals", "goal_position", "destination", "waypoints"), _GOAL),
    **dict.fromkeys(("target", "targets", "target_pos", "target_position"), _GOAL),
    **dict.fromkeys(("velocities", "initial_velocities", "init_vel"), _VELOCITY),
    **dict.fromkeys(("initial_rpys", "start_orn", "orientation", "attitude", "rpy"), _ATTITUDE),
    **dict.fromkeys(("battery", "battery_level", "soc", "state_of_charge"), _CHARGE),
    **dict.fromkeys(("obstacle", "obstacles", "num_obstacles", "world_scale"), _SCENE),
    **dict.fromkeys(("env_index", "env_ids", "env_idx", "indices", MASK), _WORLDS),
    **dict.fromkeys(
        ("flight_mode", "act", "action_type"), "the meaning of actions is the option action"
    ),
    "seed": "the seed is an argument of its own: reset(seed=...)",
    "return_info": "infos are always returned",
}
"""Replacements for names of other simulators, such as gym-pybullet-drones, PyFlyt and VMAS"""


def reset_options(options: Any, *also: str) -> dict[str, Any]:
    """Check the options of a reset.

    Args:
        options: A dict with any of `STARTS`; see `Aviary.reset`. None for nothing.
        also: Further valid names.

    Returns:
        The given options, without those of wrappers.

    Raises:
        ValueError: If options are neither a dict nor None, or an option has no effect.
    """
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(
            f"options is {shown(options)}: a dict such as {{'start': positions}}, or None, is "
            f"needed"
        )
    given = dict(options or {})
    known = (*STARTS, *also)
    for name in given:
        if name not in known and name not in WRAPPER_OPTIONS:
            raise ValueError(f"options: {_without_effect(name, known)}")
    return {name: given[name] for name in known if given.get(name) is not None}


def _without_effect(name: Any, known: tuple[str, ...]) -> str:
    """Return a message about an unknown reset option, with the remedy."""
    text = str(name)

    def likeness(one: str) -> float:
        return difflib.SequenceMatcher(None, text, one).ratio()

    near = difflib.get_close_matches(text, known, n=1)
    if near:
        remedy = f"did you mean {near[0]!r}?"
    elif text in REPLACEMENTS:
        remedy = f"{REPLACEMENTS[text]};"
    elif text in ENV_OPTIONS:
        remedy = f"{text} is fixed when the environment is created;"
    else:
        remedy = "all other options are set when the environment is created;"
    valid = ", ".join(sorted(known, key=likeness, reverse=True))
    return f"unknown option of a reset {shown(name)}: {remedy} a reset takes {valid}"


def check_setting(env: Any, name: str, config: Any) -> None:
    """Raise AttributeError if setting an attribute would have no effect.

    Wrappers and vector classes set attributes by name, such as `set_attr` of stable-baselines3.

    Args:
        env: The environment.
        name: Name of the attribute.
        config: Config of the task.

    Raises:
        AttributeError: If the name is an option of environments, or close to one, and no attribute
            of this environment that can be set.
    """
    if name.startswith("_") or name == "render_mode":
        return
    known = ENV_OPTIONS | {field.name for field in dataclasses.fields(config)}
    if name in known:
        raise AttributeError(
            f"setting {name} of a {type(env).__name__} has no effect: it is an option that is "
            f"set when the environment is created; {', '.join(PLACES)} are also options of a reset"
        )
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.8)
    if near and not hasattr(env, name):
        raise AttributeError(
            f"setting {name} of a {type(env).__name__} has no effect: did you mean {near[0]!r}? "
            f"It is an option that is set when the environment is created"
        )
