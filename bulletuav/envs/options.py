"""Options of an environment: from keyword arguments to checked, frozen values."""

import dataclasses
import typing
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bulletuav.control.actions import ACTIONS
from bulletuav.control.cascade import CONTROLLERS, PID_LEVELS
from bulletuav.control.levels import Level
from bulletuav.envs.randomization import CERTAIN, Randomization
from bulletuav.errors import UnknownOptionError, finite, nearest, pick, several, unknown, whole
from bulletuav.physics.airframe import EFFECTS, STANDARD_GRAVITY, Airframe, load_airframe
from bulletuav.physics.ladder import LADDER
from bulletuav.physics.wind import TURBULENCE, WindField
from bulletuav.sensors.lidar import FRAMES
from bulletuav.tasks.base import Task
from bulletuav.tasks.terms.observations import NAMES

ENERGIES = ("zeng", "actuator")
SEVERAL = ("observation", "effects", "wind", "render_size", "camera_size", "lidar_elevations")
RENDER_MODES = ("rgb_array", "human")
ROTOR_ACTIONS = ("rotor", "rpm")


@dataclass(frozen=True)
class Options:
    """Options common to all tasks. Every ValueError names the value and the remedy.

    num_drones   drones in a world
    airframe     name of an airframe, path of a URDF, or an `Airframe`; or one of these for each drone
    dynamics     "bullet" (the engine), "rigid_body" (the same forces by RK4), "point_mass", "double_integrator" or
                 "single_integrator"
    action       a name in `bulletuav.control.actions.ACTIONS`
    observation  names of observation blocks, side by side; None for the task's own
    num_neighbours  how many of the nearest drones, and obstacles, are observed
    normalise    whether observations are scaled from their bounds to [-1, 1]
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
    randomization  what is uncertain, see `bulletuav.envs.randomization.Randomization`: a dict such as {"gps_noise": 1.0}
    turbulence   Dryden gusts: None, "light", "moderate", "severe", or the wind speed at 20 feet that sets them, m/s
    camera_size  width and height of the drones' cameras, pixels (observations "rgb", "depth", "segmentation", "ray_depth")
    camera_hz    their pictures a second; must divide decision_hz; None for one a decision
    gravity      m/s^2; 0 switches weight off
    num_beams    of the range finder (observation "lidar"), evenly around at each of its elevations
    max_range    how far range finder and clearance reach, m
    lidar_elevations  degrees above the horizon
    lidar_frame  "yaw" (the first beam along the drone's heading) or "world" (to the east)
    battery_capacity  W h; a drone's episode ends with its charge; None for batteries that never empty
    energy       what takes charge: "zeng" (rotary-wing formula) or "actuator" (the simulated rotors; also without gravity)
    """

    num_drones: int
    airframe: tuple[Airframe, ...]
    action: str
    decision_hz: int
    horizon: int
    max_speed: float
    dynamics: str = "bullet"
    observation: tuple[str, ...] | None = None
    num_neighbours: int = 3
    normalise: bool = False
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
    randomization: Randomization = CERTAIN
    camera_size: tuple[int, int] = (64, 48)
    camera_hz: int | None = None
    gravity: float = STANDARD_GRAVITY
    num_beams: int = 16
    max_range: float = 60.0
    lidar_elevations: tuple[float, ...] = (0.0,)
    lidar_frame: str = "yaw"
    battery_capacity: float | None = None
    energy: str = "zeng"

    def __post_init__(self):
        for name in ("num_drones", "num_neighbours", "horizon", "physics_hz", "decision_hz", "num_beams"):
            whole(name, getattr(self, name), 1)
        _divides("decision_hz", self.decision_hz, "physics_hz", self.physics_hz)
        if self.camera_hz is not None:
            whole("camera_hz", self.camera_hz, 1)
            _divides("camera_hz", self.camera_hz, "decision_hz", self.decision_hz)
        if self.seed is not None:
            whole("seed", self.seed, 0)
        if self.render_mode is not None and self.render_mode not in RENDER_MODES:
            raise unknown("render_mode", self.render_mode, RENDER_MODES)
        for name in ("render_size", "camera_size"):
            for side in several(name, getattr(self, name), 2):
                whole(name, side, 8)
        choices = {"dynamics": tuple(LADDER), "action": tuple(ACTIONS), "controller": tuple(CONTROLLERS)}
        choices |= {"lidar_frame": FRAMES, "energy": ENERGIES}
        for name, known in choices.items():
            pick(name, getattr(self, name), dict.fromkeys(known))
        for block in self.observation or ():
            pick("observation block", block, dict.fromkeys(NAMES))
        if not isinstance(self.normalise, bool):
            raise ValueError(f"normalise is {self.normalise!r}: True or False is needed")
        for effect in self.effects:
            pick("effect", effect, dict.fromkeys(EFFECTS))
        self._check_sensors()
        self._check_flight()

    def _check_sensors(self) -> None:
        if finite("max_range", self.max_range) <= 0:
            raise ValueError(f"max_range is {self.max_range:g} m: it must be above 0")
        for elevation in several("lidar_elevations", self.lidar_elevations):
            if not -90 <= finite("lidar_elevations", elevation) <= 90:
                raise ValueError(f"lidar_elevations has {elevation:g} degrees: from -90 (down) to 90 (up) is needed")
        if not self.lidar_elevations:
            raise ValueError("lidar_elevations is empty: give at least one angle")
        if self.battery_capacity is not None and finite("battery_capacity", self.battery_capacity) <= 0:
            raise ValueError(f"battery_capacity is {self.battery_capacity:g} W h: it must be above 0; None for no limit")

    def _check_flight(self) -> None:
        if len(self.airframe) != self.num_drones:
            raise ValueError(f"{len(self.airframe)} airframes for {self.num_drones} drones: give one, or one for each drone")
        finite("max_speed", self.max_speed)
        slowest = min(self.airframe, key=lambda airframe: airframe.max_speed)
        if not 0 < self.max_speed <= slowest.max_speed:
            raise ValueError(
                f"max_speed is {self.max_speed:g} m/s: it must be above 0 and at most the {slowest.max_speed:g} m/s of "
                f"airframe {slowest.name!r}"
            )
        self._check_air()
        if self.gravity == 0 and self.action not in ROTOR_ACTIONS:
            raise ValueError(
                f"action {self.action!r} needs gravity: use 'rotor' or 'rpm', all others steer thrust against weight"
            )
        if self.controller == "pid" and "lag" in self.effects:
            warnings.warn(
                "controller 'pid' is made for motors without lag and may turn a drone over: leave 'lag' out of effects",
                stacklevel=2,
            )
        for airframe in self.airframe:
            if airframe.max_thrust <= airframe.mass * self.gravity:
                raise ValueError(
                    f"gravity is {self.gravity:g} m/s^2: airframe {airframe.name!r} lifts at most "
                    f"{airframe.max_thrust / airframe.mass:.3g} m/s^2 and cannot hover"
                )
            if self.controller == "pid" and airframe.pwm is None:
                raise ValueError(
                    f"controller 'pid' drives motors by PWM, and airframe {airframe.name!r} has no <pwm> tag: use 'lee'"
                )

    def _check_air(self) -> None:
        if not callable(self.wind):
            for component in several("wind", self.wind, 3):
                finite("wind", component)
        if isinstance(self.turbulence, str) and self.turbulence not in TURBULENCE:
            raise unknown("turbulence", self.turbulence, TURBULENCE)
        if not isinstance(self.turbulence, str | None):
            finite("turbulence", self.turbulence)
            if self.turbulence < 0:
                raise ValueError(f"turbulence is {self.turbulence:g} m/s: it must not be negative")
        finite("gravity", self.gravity)
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
        if self.energy == "actuator" and dynamics < Level.ROTOR:
            raise ValueError(
                f"energy is 'actuator', and dynamics {self.dynamics!r} has no rotors: use 'zeng', 'rigid_body' or 'bullet'"
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


def _airframe(source: Any) -> Airframe:
    if not isinstance(source, str | Path | Airframe):
        raise ValueError(f"airframe is {source!r}: a name, the path of a URDF, or an Airframe is needed")
    return load_airframe(source)


def resolve(task: type[Task], given: Mapping[str, Any]) -> tuple[Options, Any]:
    """Common options and the task's config from keyword arguments.

    What is given goes before the preset's values, those before the difficulty's, those before the task's defaults. Raises
    ValueError for an unknown option (`UnknownOptionError`, which is a TypeError too), preset or difficulty, with the nearest
    names, or a value that cannot be.
    """
    common = {field.name for field in dataclasses.fields(Options)}
    own = {field.name for field in dataclasses.fields(task.Config)}
    for name in given:
        if name not in common | own:
            raise UnknownOptionError(  # in the words of Python's own TypeError, which some wrappers look for
                f"unknown option of task {task.name!r}: unexpected keyword argument {name!r}: {nearest(name, common | own)}"
            )
    difficulty = given.get("difficulty", task.defaults.get("difficulty", "easy"))
    level = pick("difficulty", difficulty, dict(task.difficulties))
    if given.get("preset") is not None and not task.presets:
        raise ValueError(f"preset is {given['preset']!r}: task {task.name!r} has none")
    preset = {} if given.get("preset") is None else pick("preset", given["preset"], dict(task.presets))
    values = {**task.defaults, **level, **preset, **given, "difficulty": difficulty}
    if isinstance(given.get("weights"), Mapping):
        values["weights"] = {**preset.get("weights", {}), **given["weights"]}
    for name in ("num_drones", "airframe", "action", "decision_hz", "horizon", "max_speed", "dynamics", "controller"):
        if values.get(name, "") is None:
            raise ValueError(f"{name} is None: leave it out for the task's default")
    for name in SEVERAL:
        if isinstance(values.get(name), str):
            values[name] = (values[name],)
        elif name in values and not callable(values[name]) and (name, values[name]) != ("observation", None):
            values[name] = several(name, values[name])
    if isinstance(values["airframe"], list | tuple):
        if not values["airframe"]:
            raise ValueError("airframe is an empty list: give one airframe, or one for each drone")
        values["airframe"] = tuple(_airframe(one) for one in values["airframe"])
        if "num_drones" not in given:
            values["num_drones"] = len(values["airframe"])
    else:
        whole("num_drones", values["num_drones"], 1)
        values["airframe"] = (_airframe(values["airframe"]),) * values["num_drones"]
    if "max_speed" not in given:
        values["max_speed"] = min(values["max_speed"], *(airframe.max_speed for airframe in values["airframe"]))
    values["randomization"] = Randomization.of(values.get("randomization"))
    options = Options(**{name: value for name, value in values.items() if name in common})
    config = task.Config(**{name: value for name, value in values.items() if name in own})
    _check_config(config)
    return options, config


def _check_config(config: Any) -> None:
    """Refuse values of a task's config that its field's type cannot hold; float fields are sizes, so not negative."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.type is int:
            whole(field.name, value, field.metadata.get("least", 1))
        elif typing.get_origin(field.type) is Literal:
            pick(field.name, value, dict.fromkeys(typing.get_args(field.type)))
        elif field.type is float and finite(field.name, value) < 0:
            raise ValueError(f"{field.name} is {value:g}: it must not be negative")
        elif field.type == tuple[float, float]:
            for number in several(field.name, value, 2):
                finite(field.name, number)
        elif field.name == "weights":
            if not isinstance(value, Mapping):
                raise ValueError(f"weights is {value!r}: a dict from reward terms to weights is needed")
            for term, weight in value.items():
                finite(f"weight of reward term {term!r}", weight)
    if config.d_safe == 0:
        raise ValueError("d_safe is 0: it must be above 0")
