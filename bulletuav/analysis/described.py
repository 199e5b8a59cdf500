"""Options of an environment as files tell them."""

import dataclasses
from pathlib import Path
from typing import Any, cast

from bulletuav.city.model import City
from bulletuav.envs.options import EnvOptions
from bulletuav.network.mobility.base import Mobility
from bulletuav.sensors.suite import find_sensor
from bulletuav.tasks.observations.observer import observation_name


def described(options: EnvOptions, config: Any) -> dict[str, Any]:
    """Tell all options of an environment, as a json file can hold them.

    Args:
        options: The common ones.
        config: The task's own, a dataclass.

    Returns:
        Their values by name; names stand for airframes, cities, mobility models and functions.
    """
    # Names stand for what a file cannot hold.
    ranges = options.randomization.ranges
    random = {name: ranges[name] for name in options.randomization.active}
    observed = options.observation
    own = {one.name: getattr(config, one.name) for one in dataclasses.fields(config)}
    city = own.get("city")
    if isinstance(city, City | Path):
        own["city"] = getattr(city, "name", "")
    mobility = own.get("mobility")
    if isinstance(mobility, Mobility):
        own["mobility"] = {
            "model": mobility.name,
            **dataclasses.asdict(cast(Any, mobility)),
        }
    return {
        **vars(options),
        "airframe": [airframe.name for airframe in options.airframe],
        "wind": "function" if callable(options.wind) else options.wind,
        "randomization": random,
        "dynamics": options.dynamics_name,
        "observation": observed and [observation_name(one) for one in observed],
        "sensors": [find_sensor(one).name for one in options.sensors],
        "reward": {
            name: (observation_name(term), weight)
            for name, (term, weight) in options.reward.items()
        },
        **own,
    }
