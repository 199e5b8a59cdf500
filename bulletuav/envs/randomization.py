"""What is uncertain in an environment: drawn anew for every episode, applied to drones, wind, sensors and radio."""

import dataclasses
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.errors import as_sequence, finite, shown, unknown
from bulletuav.sensors.gps import Gps
from bulletuav.sensors.radio import Radio
from bulletuav.vehicle.swarm import Swarm
from bulletuav.vehicle.wind import Wind

Range = float | tuple[float, float]

LEAST_THRUST = 0.5  # share of the thrust that is left when the battery is low


@dataclass(frozen=True)
class Randomization:
    """What is uncertain: a number for all, or (low, high) to draw from, uniformly, when an episode begins.

    Points have no rotors: `point_mass` feels mass, drag and wind, the integrators none of the first five nor wind.

    For each drone:
    mass, thrust, drag, motor_lag  factors on the airframe's mass and inertia, thrust, rotor drag and lag; controllers know
                 the airframe's own values only
    battery      share of the thrust lost a minute, down to half
    gps_noise    standard deviation of known positions, m (of known velocities a tenth of it, m/s)
    gps_walk     random walk of known positions, m after one second, growing with the root of time
    gps_dropout  probability that a reading fails at a decision; the last one stays
    lidar_noise  standard deviation of ranges, m
    lidar_dropout  probability that a beam does not come back
    accelerometer_noise, gyroscope_noise  standard deviation of each axis of the inertial measurement, m/s^2, rad/s
    accelerometer_walk, gyroscope_walk    random walk of their biases after one second, growing with the root of time
    For each world:
    wind         each axis of a steady wind, m/s, beside those of the options `wind` and `turbulence`
    radio_delay  of the messages by which drones know of each other, s
    radio_loss   probability that one is lost
    radio_range  how far one reaches, m
    """

    mass: Range = 1.0
    thrust: Range = 1.0
    drag: Range = 1.0
    motor_lag: Range = 1.0
    battery: Range = 0.0
    gps_noise: Range = 0.0
    gps_walk: Range = 0.0
    gps_dropout: Range = 0.0
    lidar_noise: Range = 0.0
    lidar_dropout: Range = 0.0
    accelerometer_noise: Range = 0.0
    accelerometer_walk: Range = 0.0
    gyroscope_noise: Range = 0.0
    gyroscope_walk: Range = 0.0
    wind: Range = 0.0
    radio_delay: Range = 0.0
    radio_loss: Range = 0.0
    radio_range: Range = float("inf")

    @classmethod
    def of(cls, given: "Randomization | Mapping[str, Any] | None") -> "Randomization":
        """From a dict by name, or none. Raises ValueError for what cannot be, naming it."""
        if isinstance(given, cls):
            return given
        if given is not None and not isinstance(given, Mapping):
            raise ValueError(
                f"randomization is {shown(given)}: a dict of names and numbers, or (low, high), is needed"
            )
        names = {field.name for field in dataclasses.fields(cls)}
        for name in given or {}:
            if name not in names:
                raise unknown("randomization", name, names)
        return cls(**(given or {}))

    def __post_init__(self):
        for field in dataclasses.fields(self):
            low, high = self.bounds(field.name)
            least, most = LIMITS[field.name]
            if not least <= low <= high <= most:
                raise ValueError(
                    f"randomization {field.name} is {shown(getattr(self, field.name))}: from low to high within {least:g} "
                    f"and {most:g} is needed"
                )

    def bounds(self, name: str) -> tuple[float, float]:
        """Lowest and highest value. Raises ValueError for what is neither a number nor two."""
        value = getattr(self, name)
        label = f"randomization {name}"
        if not isinstance(value, bool) and isinstance(value, numbers.Real):
            value = (value, value)
        low, high = as_sequence(label, value, 2)
        return (
            (low, high)
            if low == high == np.inf and name == "radio_range"
            else (finite(label, low), finite(label, high))
        )

    @property
    def active(self) -> tuple[str, ...]:
        """Names of what differs from none."""
        return tuple(
            field.name
            for field in dataclasses.fields(self)
            if self.bounds(field.name) != (field.default, field.default)
        )


LIMITS = {
    "mass": (0.1, 10.0),
    "thrust": (0.1, 10.0),
    "drag": (0.0, 100.0),
    "motor_lag": (0.0, 100.0),
    "battery": (0.0, 1.0),
    "gps_noise": (0.0, 1000.0),
    "gps_walk": (0.0, 1000.0),
    "gps_dropout": (0.0, 1.0),
    "lidar_noise": (0.0, 1000.0),
    "lidar_dropout": (0.0, 1.0),
    "accelerometer_noise": (0.0, 1000.0),
    "accelerometer_walk": (0.0, 1000.0),
    "gyroscope_noise": (0.0, 1000.0),
    "gyroscope_walk": (0.0, 1000.0),
    "wind": (-100.0, 100.0),
    "radio_delay": (0.0, 10.0),
    "radio_loss": (0.0, 1.0),
    "radio_range": (0.0, np.inf),
}
FACTORS = {
    "mass": ("mass", "inertia"),
    "thrust": ("thrust_coefficient", "torque_coefficient"),
    "drag": ("drag_xy", "drag_z"),
    "motor_lag": ("lag_up", "lag_down"),
}
"""Which parameters of a drone each factor changes"""
GPS = {"gps_noise": "noise", "gps_walk": "walk", "gps_dropout": "dropout"}
RADIO = {"radio_delay": "delay", "radio_loss": "loss", "radio_range": "range"}
"""What of the sensors each changes"""


CERTAIN = Randomization()
"""Nothing uncertain"""


class Uncertainty:
    """A `Randomization` at work in W worlds of N drones.

    drawn     what was drawn by name, (W, N); of worlds (W, 1), the wind's axes (W, 3)
    """

    def __init__(
        self, spec: Randomization, engine: Engine, parameters: np.ndarray, wind: Wind, period: float
    ):
        """`parameters` (W, N): the rows that the dynamics flies with, which it changes; `period` of decisions, s."""
        self._spec, self._engine, self._wind = spec, engine, wind
        self._parameters, self._nominal = parameters, parameters.copy()
        shape: tuple[int, int] = parameters.shape
        worlds, drones = shape
        widths: dict[str, int] = {"wind": 3, **dict.fromkeys(RADIO, 1)}
        self.drawn = {name: np.zeros((worlds, widths.get(name, drones))) for name in spec.active}
        self._gps = Gps(shape, period) if not self.drawn.keys().isdisjoint(GPS) else None
        self._told: dict[str, np.ndarray] | None = None  # what was drawn, as infos tell it
        self._radio = None
        if not self.drawn.keys().isdisjoint(RADIO):
            self._radio = Radio(shape, period, spec.bounds("radio_delay")[1])
        for name, values in self.drawn.items():  # which the sensors read where they stand
            if name in GPS:
                setattr(self._gps, GPS[name], values)
            elif name in RADIO:
                setattr(self._radio, RADIO[name], values[:, 0])

    def start(self, k: int, swarm: Swarm, rng: np.random.Generator) -> None:
        """Draw what world k is like in its new episode, and take the first readings."""
        self._told = None
        for name, values in self.drawn.items():
            values[k] = rng.uniform(*self._spec.bounds(name), values.shape[1])
            for parameter in FACTORS.get(name, ()):
                nominal = self._nominal[parameter][k]
                self._parameters[parameter][k] = (nominal.T * values[k]).T
        if "mass" in self.drawn:
            self._engine.set_masses(k, self._parameters["mass"][k], self._parameters["inertia"][k])
        if "wind" in self.drawn:
            self._wind.steady[k] = self._wind.given + self.drawn["wind"][k]
        if self._gps is not None:
            self._gps.start(k, swarm.position[k], swarm.velocity[k], rng)
        if self._radio is not None:
            self._radio.start(k, self._known(k, swarm), swarm.position[k], rng)

    def drain(self, time: np.ndarray) -> None:
        """Weaken the rotors by what the batteries lost after `time` (W,) s of flight."""
        if "battery" in self.drawn:
            left = np.maximum(
                1 - self.drawn["battery"] * time[:, None] / 60, LEAST_THRUST
            ) * self.drawn.get("thrust", 1.0)
            for parameter in FACTORS["thrust"]:
                self._parameters[parameter][:] = left * self._nominal[parameter]

    def sense(
        self, swarm: Swarm, flown: np.ndarray, rngs: Sequence[np.random.Generator | None]
    ) -> None:
        """The readings after a decision, in the worlds where any drone of `flown` (W, N) flew it."""
        flying = np.any(flown, axis=1)
        if self._gps is not None:
            self._gps.read(swarm.position, swarm.velocity, flying, rngs)
        if self._radio is None:
            return
        for k in np.flatnonzero(flying).tolist():
            rng = rngs[k]
            assert rng is not None  # a world that flies was reset
            self._radio.hear(k, self._known(k, swarm), swarm.position[k], flown[k], rng)

    def _known(self, k: int, swarm: Swarm) -> np.ndarray:
        """(N, 6) position and velocity of world k's drones as they know them."""
        source = swarm if self._gps is None else self._gps
        return np.concatenate([source.position[k], source.velocity[k]], axis=-1)

    def readings(self) -> dict[str, np.ndarray]:
        """What drones know of themselves and of each other, by the names that `Frame` tells, as it is now."""
        readings: dict[str, np.ndarray] = {}
        if self._gps is not None:
            readings |= {
                "position": self._gps.position.copy(),
                "velocity": self._gps.velocity.copy(),
            }
        if self._radio is not None:
            message = self._radio.message.copy()
            readings |= {
                "heard_position": message[..., :3],
                "heard_velocity": message[..., 3:],
                "heard": self._radio.heard,
            }
        return readings

    @property
    def communicates(self) -> bool:
        """Whether there is a radio."""
        return self._radio is not None

    def info(self) -> dict[str, np.ndarray]:
        """What was drawn, and the messages that came in the last decision where there is communication, (W, N) by name."""
        if self._told is None:
            self._told = self._tell()
        return (
            self._told
            if self._radio is None
            else self._told | {"messages": self._radio.received.copy()}
        )

    def _tell(self) -> dict[str, np.ndarray]:
        told: dict[str, np.ndarray] = {}
        for name, values in self.drawn.items():
            axes = (
                {f"{name}_{axis}": values[:, [k]] for k, axis in enumerate("xyz")}
                if name == "wind"
                else {name: values}
            )
            for key, column in axes.items():
                told[f"random/{key}"] = np.broadcast_to(column, self._parameters.shape).copy()
                told[
                    f"random/{key}"
                ].flags.writeable = False  # one array for all infos of the episode
        return told
