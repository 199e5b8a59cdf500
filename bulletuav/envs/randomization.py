"""Domain randomization: parameters of drones, wind and sensors, drawn for every episode."""

import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.errors import as_sequence, finite, shown, unknown
from bulletuav.sensors.base import Sensor, Uncertain
from bulletuav.sensors.suite import uncertain_parameters
from bulletuav.vehicle.wind import Wind

Range = float | tuple[float, float]

MIN_MASS_RATIO, MAX_MASS_RATIO = 0.1, 10.0
"""Bounds of mass and inertia of a drone in flight, divided by those of its airframe"""
MIN_THRUST_FRACTION = 0.5
"""Fraction of the thrust that is left with a low battery"""
DRONES = {
    "mass": Uncertain(0.1, 10.0, usual=1.0),
    "thrust": Uncertain(0.1, 10.0, usual=1.0),
    "drag": Uncertain(0.0, 100.0, usual=1.0),
    "motor_lag": Uncertain(0.0, 100.0, usual=1.0),
    "battery": Uncertain(0.0, 1.0),
}
"""Of each drone: factors on mass and inertia, thrust, drag and lag; thrust lost per minute"""
WIND = {"wind": Uncertain(-100.0, 100.0, per="world")}
"""Each axis of a steady wind, m/s"""
FACTORS = {
    "mass": ("mass", "inertia"),
    "thrust": ("thrust_coefficient", "torque_coefficient"),
    # Of an aircraft with wings: of its fuselage and rotors, not of its wings
    "drag": ("drag_xy", "drag_z", "body_drag_xy", "body_drag_z", "damping"),
    "motor_lag": ("lag_up", "lag_down"),
}
"""Drone parameters that each factor scales"""
FIRST, LAST = ("gps", "lidar", "imu"), ("radio",)
"""Sensors whose parameters are drawn before the wind, and first after the wind"""


def known_uncertainties(sensors: Mapping[str, Sensor]) -> dict[str, Uncertain]:
    """Return everything that can be randomized by name, in the order of drawing.

    Args:
        sensors: All available sensors, by name.
    """

    def of(names: tuple[str, ...]) -> dict[str, Uncertain]:
        return uncertain_parameters({name: sensors[name] for name in names if name in sensors})

    others = tuple(name for name in sensors if name not in FIRST + LAST)
    return {**DRONES, **of(FIRST), **WIND, **of(LAST), **of(others)}


class Randomization:
    """Randomized parameters: a fixed number, or (low, high) of a uniform draw at each reset.

    For each drone:

    - mass, thrust, drag, motor_lag: factors on the airframe's mass and inertia, thrust, drag and
      damping, and lag. Controllers use the airframe's nominal values.
    - battery: fraction of the thrust lost per minute, down to half.
    - gps_noise: standard deviation of measured positions, m; of measured velocities a tenth of it,
      m/s.
    - gps_walk: random walk of measured positions, m after one second, growing with the square root
      of time.
    - gps_dropout: probability that a reading fails at a decision; the last reading stays.
    - lidar_noise: standard deviation of ranges, m.
    - lidar_dropout: probability that a beam has no return.
    - camera_depth_noise: standard deviation of a depth in pictures, divided by its square, 1/m;
      such as 0.0014, of a Kinect.
    - camera_depth_step: steps of 1/depth, 1/m, such as 0.00285, of a Kinect.
    - camera_edge_dropout: probability that a pixel at an edge has no depth.
    - camera_fov: vertical field of view of the drones' cameras, degrees; 90 by default.
    - camera_delay: delay of pictures, s; rounded to decisions.
    - detector_range: range of the detector of targets, m; 100 by default.
    - detector_fov: its field of view around the nose, degrees; 360 by default, all around.
    - detector_noise: standard deviation of a detection, as a fraction of its distance.
    - detector_dropout: probability that a drone detects nothing in a decision.
    - accelerometer_noise, gyroscope_noise: standard deviation of each axis, m/s^2, rad/s.
    - accelerometer_walk, gyroscope_walk: random walk of their biases after one second.

    For each world:

    - camera_colours: strength of random colours, sunlight and windows in `rgb`: 0 for the default
      colours, 1 for any.
    - wind: each axis of a steady wind, m/s, in addition to the options `wind` and `turbulence`.
    - radio_delay: delay of messages between drones, s.
    - radio_loss: probability that a message is lost.
    - radio_range: range of messages, m.

    Parameters of other sensors, such as "uwb_noise", can be randomized, too. Point dynamics have no
    rotors: `point_mass` depends on mass, drag and wind, the integrators neither on the first five
    nor on wind.

    Attributes:
        active: Names of parameters that differ from their defaults, in the order of drawing.
        known: Everything that can be randomized, by name.
    """

    def __init__(self, given: Any, known: Mapping[str, Uncertain]) -> None:
        """Check the ranges.

        Args:
            given: A dict by name, or None for nothing.
            known: Everything that can be randomized, by name, in the order of drawing.

        Raises:
            ValueError: If a name is unknown, or a value is invalid.
        """
        if isinstance(given, Randomization):
            given = given.ranges
        if given is not None and not isinstance(given, Mapping):
            raise ValueError(
                f"randomization is {shown(given)}: a dict of names and numbers, or (low, high), is "
                f"needed"
            )
        # Unknown names first, as they have no bounds
        self.known = dict(known)
        self.ranges: dict[str, Any] = dict(given or {})
        for name in self.ranges:
            if name not in known:
                raise unknown("randomization", name, known)
        for name, value in self.ranges.items():
            low, high = self.bounds(name)
            least, most = known[name].least, known[name].most
            if not least <= low <= high <= most:
                raise ValueError(
                    f"randomization {name} is {shown(value)}: from low to high within {least:g} "
                    f"and "
                    f"{most:g} is needed"
                )
        # Parameters that stay at their defaults draw no random numbers
        usual = {name: (one.usual, one.usual) for name, one in known.items()}
        self.active = tuple(name for name in known if self.bounds(name) != usual[name])

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the lowest and the highest value of a parameter.

        Raises:
            ValueError: If the given value is neither a number nor two numbers.
        """
        value = self.ranges.get(name, self.known[name].usual)
        label = f"randomization {name}"
        if not isinstance(value, bool) and isinstance(value, numbers.Real):
            value = (value, value)
        low, high = as_sequence(label, value, 2)
        if low == high == np.inf == self.known[name].most:
            return low, high
        return finite(label, low), finite(label, high)

    def __eq__(self, other: object) -> bool:
        """Return True if the same ranges were given."""
        return isinstance(other, Randomization) and self.ranges == other.ranges

    def __hash__(self) -> int:
        """Return a hash of the names, independent of their order."""
        return hash(frozenset(self.ranges))

    def __repr__(self) -> str:
        """Return the given ranges as text."""
        return f"Randomization({self.ranges})"


def _require_ratio(parameter: str, ratio: np.ndarray) -> None:
    """Raise ValueError for a mass or inertia far from that of the airframe."""
    if not ((ratio >= MIN_MASS_RATIO) & (ratio <= MAX_MASS_RATIO)).all():
        raise ValueError(
            f"added_{parameter} would make a drone's {parameter} {float(ratio.flat[0]):.3g} times "
            f"that of its airframe: from {MIN_MASS_RATIO:g} to {MAX_MASS_RATIO:g} times is possible"
        )


class Uncertainty:
    """Applies a `Randomization` to W worlds of N drones.

    Attributes:
        drawn: Drawn values by name, (W, N); (W, 1) if per world, (W, 3) for the axes of the wind.
            Sensors read these arrays in place.
    """

    def __init__(
        self, spec: Randomization, engine: Engine, parameters: np.ndarray, wind: Wind
    ) -> None:
        """Allocate the drawn values.

        Args:
            spec: Randomized parameters.
            engine: The engine, which has the drones' masses.
            parameters: (W, N) rows that the dynamics uses; modified in place.
            wind: The wind, whose steady part is modified.
        """
        self._engine, self._wind = engine, wind
        self._parameters, self._nominal = parameters, parameters.copy()
        # Worlds in which masses may differ from the nominal ones
        self._loaded = np.zeros(len(parameters), dtype=bool)
        worlds, drones = parameters.shape
        widths = {name: drones if spec.known[name].per == "drone" else 1 for name in spec.active}
        widths |= {"wind": 3} if "wind" in widths else {}
        self.drawn = {name: np.zeros((worlds, width)) for name, width in widths.items()}
        self._bounds = {name: spec.bounds(name) for name in self.drawn}
        self._info: dict[str, np.ndarray] | None = None

    def reset(self, world: int, rng: np.random.Generator) -> None:
        """Draw the parameters of a world for a new episode, and update drones and wind."""
        self._info = None
        for name, values in self.drawn.items():
            values[world] = rng.uniform(*self._bounds[name], values.shape[1])
            for parameter in FACTORS.get(name, ()):
                nominal = self._nominal[parameter][world]
                self._parameters[parameter][world] = (nominal.T * values[world]).T
        if self._loaded[world]:
            self._loaded[world] = False
            for parameter in FACTORS["mass"]:
                self._parameters[parameter][world] = self._drawn_mass(parameter, world)
            self._set_masses(world)
        elif "mass" in self.drawn:
            self._set_masses(world)
        if "wind" in self.drawn:
            self._wind.steady[world] = self._wind.given + self.drawn["wind"][world]

    def _drawn_mass(self, parameter: str, world: int) -> np.ndarray:
        """Return the masses (N,) or inertias (N, 3) of the drones without added ones."""
        nominal: np.ndarray = self._nominal[parameter][world]
        factor = self.drawn["mass"][world] if "mass" in self.drawn else 1.0
        drawn: np.ndarray = (nominal.T * factor).T
        return drawn

    def _set_masses(self, world: int) -> None:
        row = self._parameters[world]
        self._engine.set_masses(world, row["mass"], row["inertia"])

    def load_drones(
        self, world: int, rows: Any, mass: np.ndarray | None, inertia: np.ndarray | None
    ) -> None:
        """Set what drones carry in addition to their drawn masses and inertias.

        Args:
            world: Index of the world.
            rows: Drones, as an index into an axis of N.
            mass: Added mass, kg, or one for each of the drones; None for no change.
            inertia: (3,) added moments of inertia, kg m^2, or rows; None for no change.

        Raises:
            ValueError: If a mass or moment would be below `MIN_MASS_RATIO` of the airframe's, or
                above `MAX_MASS_RATIO` of it; nothing is changed.
        """
        given = {"mass": mass, "inertia": inertia}
        wanted = {
            parameter: self._drawn_mass(parameter, world)[rows] + added
            for parameter, added in given.items()
            if added is not None
        }
        for parameter, values in wanted.items():
            _require_ratio(parameter, values / self._nominal[parameter][world, rows])
        for parameter, values in wanted.items():
            self._parameters[parameter][world, rows] = values
        self._loaded[world] = True
        self._set_masses(world)

    def require_load(self, rows: Any, mass: np.ndarray | None, inertia: np.ndarray | None) -> None:
        """Raise the errors of `load_drones` that any draw of an episode may lead to."""
        for parameter, added in {"mass": mass, "inertia": inertia}.items():
            if added is not None:
                own = self._nominal[parameter][0, rows]
                for factor in self._bounds.get("mass", (1.0,)):
                    _require_ratio(parameter, (factor * own + added) / own)

    def restore(self, worlds: np.ndarray) -> None:
        """Update the engine after `drawn` and parameters were written in worlds (S,)."""
        self._info = None
        for w in worlds.tolist():
            row, nominal = self._parameters[w], self._nominal[w]
            is_loaded = any((row[name] != nominal[name]).any() for name in FACTORS["mass"])
            # A world that had added masses before has to lose them
            if is_loaded or self._loaded[w] or "mass" in self.drawn:
                self._loaded[w] = is_loaded
                self._set_masses(w)

    @property
    def drains(self) -> bool:
        """Whether thrust decreases with time."""
        return "battery" in self.drawn

    def drain(self, time: np.ndarray) -> None:
        """Reduce the thrust by what the batteries lost after `time` (W,) s of flight."""
        lost = self.drawn["battery"] * time[:, None] / 60
        left = np.maximum(1 - lost, MIN_THRUST_FRACTION) * self.drawn.get("thrust", 1.0)
        for parameter in FACTORS["thrust"]:
            self._parameters[parameter][:] = left * self._nominal[parameter]

    def info(self) -> dict[str, np.ndarray]:
        """Return the drawn values, (W, N) by name; read-only, the same arrays during an episode."""
        if self._info is None:
            self._info = self._make_info()
        return self._info

    def _make_info(self) -> dict[str, np.ndarray]:
        infos: dict[str, np.ndarray] = {}
        for name, values in self.drawn.items():
            columns = {name: values}
            if name == "wind":
                columns = {f"wind_{axis}": values[:, [k]] for k, axis in enumerate("xyz")}
            for key, column in columns.items():
                array = np.empty(self._parameters.shape)
                array[:] = column
                array.flags.writeable = False
                infos[f"random/{key}"] = array
        return infos


CERTAIN = Randomization(None, {**DRONES, **WIND})
"""No randomization"""
