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
from bulletuav.physics.ladder import LADDER
from bulletuav.physics.wind import TURBULENCE, WindField
from bulletuav.tasks.base import Task
from bulletuav.tasks.terms.observations import BLOCKS, IMAGES

RENDER_MODES = ("rgb_array", "human")
ROTOR_ACTIONS = ("rotor", "rpm", "hover_rpm")


@dataclass(frozen=True)
class Options:
    """Options common to all tasks. Every ValueError names the value and the remedy.

    num_drones   drones in a world
    airframe     name of an airframe, path of a URDF, or an `Airframe`; or one of these for each drone
    dynamics     "bullet" (the engine), "rigid_body" (the same forces by RK4), "point_mass", "double_integrator" or
                 "single_integrator"
    action       a name in `bulletuav.control.actions.ACTIONS`
    observation  names of observation blocks, side by side; None for the task's own
    difficulty   "easy", "medium", "hard" or "extreme": values of other options, which you can still override
    preset       a named set of values of other options, see the task; goes before the difficulty
    physics_hz   substeps a second
    decision_hz  decisions a second; must divide physics_hz
    horizon      decisions until truncation
    max_speed    m/s, scale of velocity actions; at most the airframe's
    seed         of the first reset when `reset` is given none
    render_mode  None, "rgb_array" (pictures, no screen needed) or "human" (a live window)
    render_size  width and height of pictures, pixels
    controller   "lee" (geometric) or "pid" (the Crazyflie's own)
    effects      which of "lag", "drag", "ground_effect", "downwash" are simulated
    wind         steady wind (east, north, up), m/s, or a function of positions (W, N, 3) m and times (W,) s to (W, N, 3) m/s
    turbulence   Dryden gusts: None, "light", "moderate", "severe", or the wind speed at 20 feet that sets them, m/s
    camera_size  width and height of the drones' cameras, pixels (observations "rgb" and "depth")
    camera_hz    their pictures a second; must divide decision_hz; None for one a decision
    gravity      m/s^2; 0 switches weight off
    """

    num_drones: int
    airframe: tuple[Airframe, ...]
    action: str
    decision_hz: int
    horizon: int
    max_speed: float
    dynamics: str = "bullet"
    observation: tuple[str, ...] | None = None
    difficulty: str = "easy"
    preset: str | None = None
    physics_hz: int = 240
    seed: int | None = None
    render_mode: str | None = None
    render_size: tuple[int, int] = (640, 480)
    controller: str = "lee"
    effects: tuple[str, ...] = EFFECTS
    wind: tuple[float, float, float] | WindField = (0.0, 0.0, 0.0)
    turbulence: str | float | None = None
    camera_size: tuple[int, int] = (64, 48)
    camera_hz: int | None = None
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self):
        for name in ("num_drones", "horizon", "physics_hz", "decision_hz"):
            _whole(name, getattr(self, name), 1)
        _divides("decision_hz", self.decision_hz, "physics_hz", self.physics_hz)
        if self.camera_hz is not None:
            _whole("camera_hz", self.camera_hz, 1)
            _divides("camera_hz", self.camera_hz, "decision_hz", self.decision_hz)
        if self.seed is not None:
            _whole("seed", self.seed, 0)
        if self.render_mode is not None and self.render_mode not in RENDER_MODES:
            raise unknown("render_mode", self.render_mode, RENDER_MODES)
        for name in ("render_size", "camera_size"):
            if len(getattr(self, name)) != 2:
                raise ValueError(f"{name} is {getattr(self, name)}: width and height in pixels are needed")
            for side in getattr(self, name):
                _whole(name, side, 8)
        for name, choices in (("dynamics", LADDER), ("action", ACTIONS), ("controller", CONTROLLERS)):
            if getattr(self, name) not in choices:
                raise unknown(name, getattr(self, name), choices)
        for block in self.observation or ():
            if block not in {**BLOCKS, **IMAGES}:
                raise unknown("observation block", block, {**BLOCKS, **IMAGES})
        for effect in self.effects:
            if effect not in EFFECTS:
                raise unknown("effect", effect, EFFECTS)
        self._check_flight()

    def _check_flight(self) -> None:
        if len(self.airframe) != self.num_drones:
            raise ValueError(f"{len(self.airframe)} airframes for {self.num_drones} drones: give one, or one for each drone")
        _finite("max_speed", self.max_speed)
        slowest = min(self.airframe, key=lambda airframe: airframe.max_speed)
        if not 0 < self.max_speed <= slowest.max_speed:
            raise ValueError(
                f"max_speed is {self.max_speed:g} m/s: it must be above 0 and at most the {slowest.max_speed:g} m/s of "
                f"airframe {slowest.name!r}"
            )
        self._check_air()
        if self.gravity == 0 and self.action not in ROTOR_ACTIONS:
            raise ValueError(f"action {self.action!r} needs gravity: its controller steers by tilting thrust against weight")
        for airframe in self.airframe:
            if self.controller == "pid" and airframe.pwm is None:
                raise ValueError(
                    f"controller 'pid' drives motors by PWM, and airframe {airframe.name!r} has no <pwm> tag: use 'lee'"
                )

    def _check_air(self) -> None:
        if not callable(self.wind):
            if len(self.wind) != 3:
                raise ValueError(f"wind is {self.wind}: three numbers (east, north, up) in m/s, or a function, are needed")
            for component in self.wind:
                _finite("wind", component)
        if isinstance(self.turbulence, str) and self.turbulence not in TURBULENCE:
            raise unknown("turbulence", self.turbulence, TURBULENCE)
        if not isinstance(self.turbulence, str | None):
            _finite("turbulence", self.turbulence)
            if self.turbulence < 0:
                raise ValueError(f"turbulence is {self.turbulence:g} m/s: it must not be negative")
        _finite("gravity", self.gravity)
        if self.gravity < 0:
            raise ValueError(f"gravity is {self.gravity:g} m/s^2: it pulls down with 0 or more")

    @property
    def wind20(self) -> float:
        """Wind speed at 20 feet that sets the turbulence, m/s; 0 for none."""
        return TURBULENCE[self.turbulence] if isinstance(self.turbulence, str) else self.turbulence or 0.0

    def check_levels(self, action: Level, dynamics: Level) -> None:
        """Raise ValueError when the action's setpoint level cannot drive the dynamics through the controller."""
        if action > dynamics:
            raise ValueError(
                f"action {self.action!r} gives {action.name.lower()} setpoints, but dynamics {self.dynamics!r} is driven by "
                f"{dynamics.name.lower()}: use an action of that level or above, or dynamics 'rigid_body' or 'bullet'"
            )
        if self.controller == "pid" and dynamics < Level.ROTOR:
            raise ValueError(
                f"controller 'pid' drives motors, and dynamics {self.dynamics!r} has none: use controller 'lee'"
            )
        if self.controller == "pid" and action not in PID_LEVELS:
            raise ValueError(f"controller 'pid' takes no {action.name.lower()} setpoints: use controller 'lee'")


def _divides(name: str, rate: int, into: str, whole: int) -> None:
    if whole % rate:
        divisors = [divisor for divisor in range(1, whole + 1) if whole % divisor == 0]
        near = sorted(divisors, key=lambda divisor: abs(divisor - rate))[:3]
        raise ValueError(f"{name} {rate} does not divide {into} {whole}: try {sorted(near)}")


def _whole(name: str, value: Any, least: int) -> None:
    if not isinstance(value, int | np.integer) or value is True or value < least:
        raise ValueError(f"{name} is {value!r}: a whole number, at least {least}, is needed")


def _finite(name: str, value: Any) -> None:
    if not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}: a finite number is needed")


def _as_tuple(name: str, value: Any) -> tuple:
    try:
        return tuple(value)
    except TypeError:
        raise ValueError(f"{name} is {value!r}: several values in a list or tuple are needed") from None


def _airframe(source: Any) -> Airframe:
    if not isinstance(source, str | Path | Airframe):
        raise ValueError(f"airframe is {source!r}: a name, the path of a URDF, or an Airframe is needed")
    return load_airframe(source)


def resolve(task: type[Task], given: Mapping[str, Any]) -> tuple[Options, Any]:
    """Common options and the task's config from keyword arguments.

    What is given goes before the preset's values, those before the difficulty's, those before the task's defaults. Raises
    ValueError for an unknown option, preset or difficulty (with the nearest names), or a value that cannot be.
    """
    common = {field.name for field in dataclasses.fields(Options)}
    own = {field.name for field in dataclasses.fields(task.Config)}
    for name in given:
        if name not in common | own:
            raise unknown(f"option of task {task.name!r}:", name, common | own)
    difficulty = given.get("difficulty", task.defaults.get("difficulty", "easy"))
    level = pick("difficulty", difficulty, dict(task.difficulties))
    preset = {} if given.get("preset") is None else pick("preset", given["preset"], dict(task.presets))
    values = {**task.defaults, **level, **preset, **given, "difficulty": difficulty}
    for name in ("num_drones", "airframe", "action", "decision_hz", "horizon", "max_speed", "dynamics", "controller"):
        if values.get(name, "") is None:
            raise ValueError(f"{name} is None: leave it out for the task's default")
    for name in ("observation", "effects", "wind", "render_size", "camera_size"):
        if isinstance(values.get(name), str):
            values[name] = (values[name],)
        elif values.get(name) is not None and not callable(values[name]):
            values[name] = _as_tuple(name, values[name])
    if isinstance(values["airframe"], list | tuple):
        values["airframe"] = tuple(_airframe(one) for one in values["airframe"])
        if "num_drones" not in given:
            values["num_drones"] = len(values["airframe"])
    else:
        _whole("num_drones", values["num_drones"], 1)
        values["airframe"] = (_airframe(values["airframe"]),) * values["num_drones"]
    if "max_speed" not in given:
        values["max_speed"] = min(values["max_speed"], *(airframe.max_speed for airframe in values["airframe"]))
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
