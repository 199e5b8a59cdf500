"""Short flights that together use all compiled functions of the package's own ingredients.

Functions are compiled for types of arguments, and each option, size and policy uses other
functions and types. `bulletuav compile` and `tools/build_code.py` fly all of `list_flights`.
"""

import contextlib
import dataclasses
import functools
import itertools
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from bulletuav.analysis.evaluation import evaluate
from bulletuav.analysis.recording import fly_episode
from bulletuav.compiled.deferred import compile_deferred
from bulletuav.dynamics import DYNAMICS
from bulletuav.envs.airspace import Airspace
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.grid import MIN_POINTS
from bulletuav.identification.example import fly_example, write_example_log
from bulletuav.identification.identify import identify
from bulletuav.policies import find_policy, policy_names
from bulletuav.policies.run import FAST, FOUNDATION
from bulletuav.registry import names
from bulletuav.tasks import find_task, list_tasks
from bulletuav.training.schedules import default_run
from bulletuav.training.trainer import train
from bulletuav.vehicle.airframes import available_airframes, load_airframe

UNCERTAIN: Mapping[str, Any] = MappingProxyType(
    {
        "mass": (0.8, 1.2),
        "thrust": (0.9, 1.1),
        "drag": (0.5, 1.5),
        "motor_lag": (0.5, 2.0),
        "battery": (0.0, 0.1),
        "gps_noise": (0.1, 1.0),
        "gps_walk": (0.0, 0.1),
        "gps_dropout": (0.0, 0.2),
        "lidar_noise": 0.1,
        "lidar_dropout": 0.05,
        "accelerometer_noise": 0.1,
        "gyroscope_walk": 0.01,
        "wind": (-2.0, 2.0),
        "radio_delay": (0.005, 0.2),
        "radio_loss": (0.0, 0.3),
        "radio_range": (50.0, 200.0),
    }
)
"""Randomization of all that compiled functions randomize"""
DECISIONS = 3
WORLDS = 3
"""Number of worlds; arrays of a single world have other memory layouts"""
BOUNDARIES = ("end", "soft", "hard", "open")
GOALS = ("leave", "land", "hold")
CITIES = ("suburban", "high_rise", "open")
IMAGES = (("rgb", "depth", "segmentation"), ("velocity", "ray_depth"))
EFFECTS = ("drag", "downwash")
THREADED: Mapping[str, Any] = MappingProxyType({"threads": 2, "num_drones": MIN_POINTS})
"""Options of large worlds that several threads fly"""
CONTACTS = ("stop", "impulse", "bullet")
POLICY_TASKS = ("converge", "hover", "default", "lidar_navigation", "coverage", "los", "mec")
"""Tasks in which each policy flies that supports them; each task is flown by its baseline"""
RECORDED = ("hover", "navigation")
"""Tasks of which an episode is recorded, as `bulletuav fly` does"""
WHOLE = ("race", "pursuit")
"""Tasks whose episodes cannot be short, as a lap has to fit"""


class CoveringFlight(NamedTuple):
    """A short flight.

    Attributes:
        name: Name of the flight, for the progress.
        fly: Flies; raises ValueError for options that cannot be combined.
    """

    name: str
    fly: Callable[[], Any]

    def run(self) -> None:
        """Fly, unless the options cannot be combined, and compile or load deferred functions."""
        with warnings.catch_warnings(), contextlib.suppress(ValueError):
            warnings.simplefilter("ignore")
            self.fly()
        compile_deferred()


def list_flights() -> list[CoveringFlight]:
    """List the flights, the most usual first."""
    flown = [
        CoveringFlight(task, functools.partial(fly_shortly, task, **options))
        for task, options in list_environments()
    ]
    pairs = [*itertools.product(policy_names(), POLICY_TASKS)]
    pairs += [(find_task(task).baseline, task) for task in list_tasks()]
    flown += [
        CoveringFlight(f"{task}, {policy}", functools.partial(_evaluate, task, policy))
        for policy, task in pairs
    ]
    flown += [
        CoveringFlight(f"{task}, recorded", functools.partial(_record, task)) for task in RECORDED
    ]
    flown += [
        CoveringFlight(f"airspace, {dynamics}", functools.partial(_fly_airspace, dynamics, sensors))
        for dynamics, sensors in itertools.product(DYNAMICS, ([], names("sensor")))
    ]
    flown += [
        CoveringFlight(
            f"threads, {dynamics}",
            functools.partial(fly_shortly, "crossing", 1, dynamics=dynamics, **THREADED),
        )
        for dynamics in ("rigid_body", "point_mass")
    ]
    flown.append(CoveringFlight("training", _train_shortly))
    return [*flown, CoveringFlight("identification", _identify)]


def list_environments() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the task and the options of each environment."""
    for task, dynamics in itertools.product(list_tasks(), DYNAMICS):
        for difficulty, worlds in itertools.product(("easy", "extreme"), (1, WORLDS)):
            options = {"dynamics": dynamics, "difficulty": difficulty}
            yield task, options | {"num_worlds": worlds}
        yield task, options | {"num_worlds": WORLDS, "randomization": dict(UNCERTAIN)}
        yield task, options | {"num_worlds": 1, "num_drones": 1}
    for task in list_tasks():
        yield task, {"weights": "all"}
        yield task, {"normalise": True}
        for preset in find_task(task).presets:
            yield task, {"preset": preset}
    for task, block in itertools.product(
        ("obstacles", "mec_advanced", "race"), names("observation")
    ):
        yield (
            task,
            {"observation": (block,), "dynamics": "rigid_body", "randomization": dict(UNCERTAIN)},
        )
    for task, action in itertools.product(("hover", "crossing"), names("action")):
        for worlds, controller in itertools.product((1, WORLDS), ("lee", "pid")):
            yield task, {"action": action, "controller": controller, "num_worlds": worlds}
            yield (
                task,
                {
                    "action": action,
                    "controller": controller,
                    "num_worlds": worlds,
                    "dynamics": "rigid_body",
                },
            )
    for images in IMAGES:
        yield "navigation", {"observation": images, "camera_size": (16, 12)}
    yield (
        "navigation",
        {
            "observation": ("depth", "normals", "flow"),
            "camera_size": (16, 12),
            "camera_range": (0.5, 100.0),
            "camera_depth": "inverse",
            "randomization": {"camera_depth_step": 0.003, "camera_edge_dropout": 0.1},
        },
    )
    for boundary, at_goal in itertools.product(BOUNDARIES, GOALS):
        yield "converge", {"boundary": boundary, "at_goal": at_goal}
    for ends in ("drone", "world"):
        yield "converge", {"conflict_ends": ends, "contact_ends": ends}
    for task, city in itertools.product(("navigation", "mobile_users"), CITIES):
        yield task, {"city": city}
    for mobility in names("mobility"):
        yield "mobile_users", {"mobility": mobility}
    for dynamics, airframe in itertools.product(("rigid_body", "bullet"), available_airframes()):
        yield "crossing", {"airframe": airframe, "dynamics": dynamics}
        yield "crossing", {"airframe": airframe, "dynamics": dynamics, "effects": EFFECTS}
        yield (
            "crossing",
            {"airframe": ["cf2x", airframe], "num_drones": 2, "dynamics": dynamics},
        )
    for dynamics in DYNAMICS:
        yield "crossing", {"dynamics": dynamics, "wind": (3, 1, 0), "turbulence": "severe"}
        yield "crossing", {"dynamics": dynamics, "airframe": "trainer", "thermals": {}}
        yield "crossing", {"dynamics": dynamics, "rays": "bullet"}
        for contacts in CONTACTS:
            yield "crossing", {"dynamics": dynamics, "contacts": contacts}
        yield "crossing", {"dynamics": dynamics, "energy": "actuator", "battery_capacity": 0.05}


def fly_shortly(task: str, num_worlds: int = WORLDS, **options: Any) -> None:
    """Fly a few decisions, and reset one world in the middle of the episode.

    Args:
        task: Name of the task.
        num_worlds: Number of worlds.
        **options: Options of the environment; "all" as `weights` gives each term a weight.

    Raises:
        ValueError: If the options cannot be combined.
    """
    if options.get("weights") == "all":
        aviary = Aviary(task, num_worlds)
        options["weights"] = dict.fromkeys(aviary.task.own_terms(everything=True), 1.0)
        aviary.close()
    aviary = Aviary(task, num_worlds, **options)
    try:
        aviary.reset(seeds=0)
        aviary.first_info()
        low = np.nan_to_num(aviary.action.low)
        for k in range(DECISIONS):
            aviary.step(np.broadcast_to(low, (num_worlds, *low.shape)).copy())
            aviary.reset(np.arange(num_worlds) == k % num_worlds)
            aviary.first_info()
        aviary.state()
    finally:
        aviary.close()


def _evaluate(task: str, policy: str) -> None:
    """Fly a policy in two episodes, short ones if the task permits."""
    options: dict[str, Any] = {} if task in WHOLE else {"horizon": DECISIONS}
    evaluate(task, policy, 2, **options)


def _record(task: str) -> None:
    """Record a short episode of a task's baseline."""
    spec = find_policy(find_task(task).baseline, task)
    aviary = Aviary(task, 1, **spec.complete(task, {"horizon": DECISIONS}))
    try:
        fly_episode(aviary, spec(aviary), 0)
    finally:
        aviary.close()


def _fly_airspace(dynamics: str, sensors: Sequence[str]) -> None:
    """Fly two drones without a task."""
    airspace = Airspace([(0.0, 0.0, 1.0), (1.0, 0.0, 1.0)], dynamics=dynamics, sensors=sensors)
    try:
        airspace.command(0, "position", (0.0, 0.0, 1.0))
        airspace.warm_up()
    finally:
        airspace.close()


def _identify() -> None:
    """Fit the constants of an airframe to a short flight."""
    with tempfile.TemporaryDirectory() as folder:
        airframe = load_airframe("cf2x")
        log = write_example_log(Path(folder, "flight.csv"), fly_example(airframe, 4.0, 0))
        identify([log], airframe)


def _train_shortly() -> None:
    """Train policies without PyTorch in a few decisions."""
    changes: dict[str, Any] = {"steps": 1, "worlds": 2, "evaluations": 1, "episodes": 1}
    evaluation = {"horizon": DECISIONS}
    for config in (default_run("crossing", FAST), default_run("hover", FOUNDATION)):
        with tempfile.TemporaryDirectory() as folder:
            train(dataclasses.replace(config, **changes, evaluation=evaluation), Path(folder))
