"""Options of an environment: from keyword arguments to checked, frozen values."""

import dataclasses
import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.control.actions import ACTIONS
from bulletuav.control.cascade import CONTROLLERS, PID_LEVELS
from bulletuav.control.levels import Level
from bulletuav.errors import pick, unknown
from bulletuav.physics.airframe import EFFECTS, STANDARD_GRAVITY, Airframe, load_airframe
from bulletuav.tasks.base import Task
from bulletuav.tasks.terms.observations import BLOCKS

RENDER_MODES = ("rgb_array", "human")
DYNAMICS = ("bullet", "rigid_body")


@dataclass(frozen=True)
class Options:
    """Options common to all tasks. Every ValueError names the value and the remedy.

    num_drones   drones in a world
    airframe     name of an airframe, path of a URDF, or an `Airframe`
    dynamics     "bullet" (the engine) or "rigid_body" (the same forces, integrated by RK4)
    action       "velocity", "target_position", "rotor" or "rpm"
    observation  names of observation blocks, side by side; None for the task's own
    difficulty   "easy", "medium", "hard" or "extreme": values of other options, which you can still override
    physics_hz   substeps a second
    decision_hz  decisions a second; must divide physics_hz
    horizon      decisions until truncation
    max_speed    m/s, scale of velocity actions; at most the airframe's
    seed         of the first reset when `reset` is given none
    render_mode  None, "rgb_array" (pictures, no screen needed) or "human" (a live window)
    render_size  width and height of pictures, pixels
    controller   "lee" (geometric) or "pid" (the Crazyflie's own)
    effects      which of "lag", "drag", "ground_effect", "downwash" are simulated
    wind         steady wind (east, north, up), m/s
    gravity      m/s^2; 0 switches weight off
    """

    num_drones: int
    airframe: Airframe
    action: str
    decision_hz: int
    horizon: int
    max_speed: float
    dynamics: str = "bullet"
    observation: tuple[str, ...] | None = None
    difficulty: str = "easy"
    physics_hz: int = 240
    seed: int | None = None
    render_mode: str | None = None
    render_size: tuple[int, int] = (640, 480)
    controller: str = "lee"
    effects: tuple[str, ...] = EFFECTS
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self):
        for name in ("num_drones", "horizon", "physics_hz", "decision_hz"):
            _whole(name, getattr(self, name), 1)
        if self.physics_hz % self.decision_hz:
            divisors = [rate for rate in range(1, self.physics_hz + 1) if self.physics_hz % rate == 0]
            near = sorted(divisors, key=lambda rate: abs(rate - self.decision_hz))[:3]
            raise ValueError(
                f"decision_hz {self.decision_hz} does not divide physics_hz {self.physics_hz}: try {sorted(near)}"
            )
        if self.seed is not None:
            _whole("seed", self.seed, 0)
        if self.render_mode is not None and self.render_mode not in RENDER_MODES:
            raise unknown("render_mode", self.render_mode, RENDER_MODES)
        if len(self.render_size) != 2:
            raise ValueError(f"render_size is {self.render_size}: width and height in pixels are needed")
        for side in self.render_size:
            _whole("render_size", side, 16)
        for name, choices in (("dynamics", DYNAMICS), ("action", ACTIONS), ("controller", CONTROLLERS)):
            if getattr(self, name) not in choices:
                raise unknown(name, getattr(self, name), choices)
        for block in self.observation or ():
            if block not in BLOCKS:
                raise unknown("observation block", block, BLOCKS)
        for effect in self.effects:
            if effect not in EFFECTS:
                raise unknown("effect", effect, EFFECTS)
        self._check_flight()

    def _check_flight(self) -> None:
        _finite("max_speed", self.max_speed)
        if not 0 < self.max_speed <= self.airframe.max_speed:
            raise ValueError(
                f"max_speed is {self.max_speed:g} m/s: it must be above 0 and at most the {self.airframe.max_speed:g} m/s "
                f"of airframe {self.airframe.name!r}"
            )
        if len(self.wind) != 3:
            raise ValueError(f"wind is {self.wind}: three numbers (east, north, up) in m/s are needed")
        for component in self.wind:
            _finite("wind", component)
        _finite("gravity", self.gravity)
        if self.gravity < 0:
            raise ValueError(f"gravity is {self.gravity:g} m/s^2: it pulls down with 0 or more")
        if self.gravity == 0 and self.action not in ("rotor", "rpm"):
            raise ValueError(f"action {self.action!r} needs gravity: its controller steers by tilting thrust against weight")
        if self.controller == "pid" and self.airframe.pwm is None:
            raise ValueError(
                f"controller 'pid' drives motors by PWM, and airframe {self.airframe.name!r} has no <pwm> tag: use 'lee'"
            )

    def check_level(self, level: Level) -> None:
        """Raise ValueError when the controller does not take setpoints of `level`."""
        if self.controller == "pid" and level not in PID_LEVELS:
            raise ValueError(f"controller 'pid' takes no {level.name.lower()} setpoints: use controller 'lee'")


def _whole(name: str, value: Any, least: int) -> None:
    if not isinstance(value, int | np.integer) or value is True or value < least:
        raise ValueError(f"{name} is {value!r}: a whole number, at least {least}, is needed")


def _finite(name: str, value: Any) -> None:
    if not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}: a finite number is needed")


def resolve(task: type[Task], given: Mapping[str, Any]) -> tuple[Options, Any]:
    """Common options and the task's config from keyword arguments.

    What is given goes before the difficulty's values, those before the task's defaults. Raises ValueError for an unknown
    option (with the nearest names), an unknown difficulty, or a value that cannot be.
    """
    common = {field.name for field in dataclasses.fields(Options)}
    own = {field.name for field in dataclasses.fields(task.Config)}
    for name in given:
        if name not in common | own:
            raise unknown(f"option of task {task.name!r}:", name, common | own)
    difficulty = given.get("difficulty", task.defaults.get("difficulty", "easy"))
    values = {**task.defaults, **pick("difficulty", difficulty, dict(task.difficulties)), **given, "difficulty": difficulty}
    for name in ("num_drones", "airframe", "action", "decision_hz", "horizon", "max_speed", "dynamics", "controller"):
        if values.get(name, "") is None:
            raise ValueError(f"{name} is None: leave it out for the task's default")
    for name in ("observation", "effects", "wind", "render_size"):
        if isinstance(values.get(name), str):
            values[name] = (values[name],)
        elif values.get(name) is not None:
            values[name] = tuple(values[name])
    airframe = values.pop("airframe")
    if not isinstance(airframe, str | Path | Airframe):
        raise ValueError(f"airframe is {airframe!r}: a name, the path of a URDF, or an Airframe is needed")
    values["airframe"] = load_airframe(airframe)
    if "max_speed" not in given:
        values["max_speed"] = min(values["max_speed"], values["airframe"].max_speed)
    options = Options(**{name: value for name, value in values.items() if name in common})
    config = task.Config(**{name: value for name, value in values.items() if name in own})
    for field in dataclasses.fields(config):
        if field.type in (float, "float"):
            _finite(field.name, getattr(config, field.name))
            if getattr(config, field.name) < 0:
                raise ValueError(f"{field.name} is {getattr(config, field.name):g}: it must not be negative")
    if config.d_safe == 0:
        raise ValueError("d_safe is 0: it must be above 0")
    return options, config
