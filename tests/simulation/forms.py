"""What is built: a task, a face and options, good and bad, drawn from what the package declares."""

import dataclasses
import typing
from typing import Any, Literal, NamedTuple

import numpy as np

import bulletuav
from bulletuav.control.cascade import CONTROLLERS
from bulletuav.engine.engine import RAY_METHODS
from bulletuav.envs.options import ENERGIES, FORMATS, EnvOptions
from bulletuav.envs.randomization import known_uncertainties
from bulletuav.registry import find, names
from bulletuav.sensors.lidar import FRAMES
from bulletuav.sensors.suite import known_sensors
from bulletuav.tasks import find_task
from bulletuav.tasks.observations.observer import known_observations
from bulletuav.vehicle.parameters import EFFECTS
from bulletuav.vehicle.wind import TURBULENCE

CHEAP = ("single_integrator", "point_mass")
COMPILED = {"action", "airframe", "contacts", "controller", "dynamics", "effects", "energy", "rays"}
COMPILED |= {"observation", "observation_format", "randomization", "reward", "sensors"}
COMPILED |= {"difficulty", "preset", "wind", "wind_profile", "battery_capacity", "normalise"}
"""Options that may need kernels which nothing else compiles"""
NEVER = {"num_drones", "horizon", "render_mode", "num_layouts", "area"}
"""Options that stay small and off the screen"""
BAD = (
    *(float("nan"), float("inf"), -float("inf"), -1, 0, -0.5, 1e300, 10**30, True, None),
    *("", "nonsense", b"bytes", [], {}, (), (1, 2, 3, 4, 5), [None], {"nonsense": 1}, 1j),
    *(object, lambda: None, np.full(3, np.nan), np.zeros((2, 2)), np.array("text"), {1: 2}),
)
IMAGES = {"rgb", "depth", "segmentation", "ray_depth", "normals", "flow"}


class Form(NamedTuple):
    """What an environment is made from.

    Attributes:
        face: Name of a class in `faces`.
        task: Name of a task.
        options: Keyword arguments.
        worlds: How many worlds, where the face has several.
        is_plain: Whether it has to be possible: nothing in it was drawn at random.
    """

    face: str
    task: str
    options: dict[str, Any]
    worlds: int
    is_plain: bool


def draw(rng: np.random.Generator, faces: tuple[str, ...], wide: bool, badly: float = 0.25) -> Form:
    """Draw a form.

    Args:
        rng: Random numbers.
        faces: Names to choose from.
        wide: Whether to draw from everything, or from forms whose kernels are soon compiled.
        badly: Share of values that no option is likely to take.
    """
    task = pick(rng, bulletuav.list_tasks())
    kind = find_task(task)
    options = plain(task)
    worlds = int(rng.integers(1, 5))
    options["num_drones"] = int(rng.integers(1, 7)) if not kind.team_names else 4
    if rng.random() < 0.8:
        options["horizon"] = int(rng.integers(2, 40))
    if task != "hover" and not kind.needs_cables:  # cheap dynamics have no cables
        options["dynamics"] = pick(rng, CHEAP)
        if wide and rng.random() < 0.4:
            options["dynamics"] = pick(rng, names("dynamics"))
    if rng.random() < 0.2:
        options |= {"render_mode": "rgb_array", "render_size": (32, 24)}
    face = pick(rng, faces)
    if rng.random() < 0.5:
        return Form(face, task, options, worlds, is_plain="horizon" not in options)
    fields = {one.name: one for one in (*fields_of(kind.Config), *fields_of(EnvOptions))}
    free = [name for name in fields if name not in NEVER and (wide or name not in COMPILED)]
    for name in rng.choice(free, int(rng.integers(1, 4)), replace=False).tolist():
        bad = rng.random() < badly
        options[name] = pick(rng, BAD) if bad else good(rng, kind, fields[name])
    if rng.random() < 0.05:
        options[pick(rng, ("nonsense", "num_drone", "first_world"))] = pick(rng, BAD)
    if rng.random() < 0.05:
        options[pick(rng, sorted(NEVER - {"render_mode"}))] = pick(rng, BAD)
    return Form(face, task, options, worlds, is_plain=False)


def plain(task: str) -> dict[str, Any]:
    """Options with which a task is small."""
    config = {one.name for one in fields_of(find_task(task).Config)}
    small: dict[str, Any] = {"num_drones": 4}
    if "num_layouts" in config:
        small |= {"num_layouts": 1, "area": 250.0}
    return small


def pick(rng: np.random.Generator, choices: Any) -> Any:
    """Pick one; unlike `rng.choice` it stays what it is."""
    choices = tuple(choices)
    return choices[int(rng.integers(len(choices)))]


def some(rng: np.random.Generator, choices: Any, most: int = 4) -> list[Any]:
    """Pick some, in the order in which they are."""
    choices = list(choices)
    chosen = rng.permutation(len(choices))[: int(rng.integers(1, most + 1))]
    return [choices[k] for k in sorted(chosen.tolist())]


def fields_of(config: type) -> list[dataclasses.Field[Any]]:
    """List the fields of a class of options that a user can give."""
    return [one for one in dataclasses.fields(config) if one.init]


def good(rng: np.random.Generator, kind: Any, field: dataclasses.Field[Any]) -> Any:
    """Draw a value that a field may well take: what contradicts others is refused, clearly."""
    named = _named(rng, kind)
    if field.name in named:
        return named[field.name]()
    owner = kind.Config if field.name in {one.name for one in fields_of(kind.Config)} else None
    hint = typing.get_type_hints(owner or EnvOptions)[field.name]
    if typing.get_origin(hint) is Literal:
        return pick(rng, typing.get_args(hint))
    if hint is bool:
        return bool(rng.integers(2))
    usual = field.default if field.default is not dataclasses.MISSING else None
    return _near(rng, usual)


def _near(rng: np.random.Generator, usual: Any) -> Any:
    """Draw something of the form of a usual value, and about as large."""
    factor = float(pick(rng, (0.0, 0.3, 0.9, 1.0, 1.1, 3.0)))
    if isinstance(usual, bool) or usual is None or isinstance(usual, str):
        return usual
    if isinstance(usual, int):
        return max(0, round(usual * factor) + int(rng.integers(-1, 2)))
    if isinstance(usual, float):
        return usual * factor
    if isinstance(usual, tuple):
        return tuple(_near(rng, one) for one in usual)
    return usual


def _named(rng: np.random.Generator, kind: Any) -> dict[str, Any]:
    """Tell how values are drawn of options whose default does not say what else they can be."""
    sensors = known_sensors()
    shown = [one for one in known_observations(sensors) if one not in IMAGES or rng.random() < 0.2]
    places = rng.uniform((-50, -50, 5), (50, 50, 60), (4, 3))
    return {
        "airframe": lambda: pick(rng, bulletuav.available_airframes()),
        "action": lambda: pick(rng, names("action")),
        "dynamics": lambda: pick(rng, names("dynamics")),
        "controller": lambda: pick(rng, tuple(CONTROLLERS)),
        "difficulty": lambda: pick(rng, kind.difficulties),
        "preset": lambda: pick(rng, (None, *kind.presets)),
        "observation": lambda: tuple(some(rng, shown)),
        "observation_format": lambda: pick(rng, FORMATS),
        "sensors": lambda: tuple(some(rng, names("sensor"), 2)),
        "reward": lambda: {"own": (find("reward", _reward(rng), callable), -0.1)},
        "weights": lambda: {_term(rng, kind): float(rng.normal())},
        "effects": lambda: tuple(some(rng, EFFECTS, len(EFFECTS))),
        "wind": lambda: tuple(rng.normal(0, 3, 3).tolist()),
        "wind_profile": lambda: pick(rng, (None, "power", "log", ("power", 0.2), ("log", 0.3))),
        "turbulence": lambda: pick(rng, (*TURBULENCE, 3.0)),
        "thermals": lambda: pick(rng, ({}, {"centres": [(0, 0)]}, {"count": 3, "side": 1500.0})),
        "randomization": lambda: _uncertain(rng, known_uncertainties(sensors)),
        "contacts": lambda: pick(rng, (None, "impulse", "stop", "bullet")),
        "rays": lambda: pick(rng, tuple(RAY_METHODS)),
        "lidar_frame": lambda: pick(rng, FRAMES),
        "energy": lambda: pick(rng, ENERGIES),
        "battery_capacity": lambda: pick(rng, (None, "airframe", 0.001, 10.0)),
        "physics_hz": lambda: pick(rng, (48, 120, 240, 480)),
        "decision_hz": lambda: pick(rng, (0.5, 1, 5, 10, 24, 240)),
        "camera_size": lambda: (16, 12),
        "camera_hz": lambda: pick(rng, (None, 1, 5)),
        "render_size": lambda: (24, 16),
        "seed": lambda: int(rng.integers(5)),
        "max_climb": lambda: float(rng.uniform(0.5, 5)),
        "heading": lambda: pick(rng, (None, 0.0, 90.0, "goal")),
        "start": lambda: places,
        "goal": lambda: (places + (0.0, 0.0, 10.0)).tolist(),
        "teams": lambda: (int(rng.integers(0, 4)), int(rng.integers(0, 4))),
        "city": lambda: pick(rng, ("open", "suburban", "urban", "dense", "high_rise")),
        "mobility": lambda: pick(rng, names("mobility")),
        "activity": lambda: float(rng.random()),
        "track": lambda: pick(rng, ("random", "oval", "figure_eight", "split_s")),
    }


def _reward(rng: np.random.Generator) -> str:
    return str(pick(rng, names("reward")))


def _term(rng: np.random.Generator, kind: Any) -> str:
    return str(pick(rng, (*kind.reward, *kind.reward, "nonsense")))


def _uncertain(rng: np.random.Generator, known: dict[str, Any]) -> dict[str, Any]:
    """Draw what is uncertain, by a little about what is usual."""
    drawn: dict[str, Any] = {}
    for name in some(rng, known):
        one = known[name]
        middle = one.usual if np.isfinite(one.usual) else min(one.most, 100.0)
        width = 0.3 * (abs(middle) or min(1.0, one.most))
        drawn[name] = (max(one.least, middle - width), min(one.most, middle + width))
    return drawn
