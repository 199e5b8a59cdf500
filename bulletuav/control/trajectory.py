"""Trajectories: where to be and when; and the accelerations with which a drone follows one.

Splines and piecewise polynomials are scipy's.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline, PPoly, make_interp_spline

from bulletuav.control.gains import gain_rows
from bulletuav.errors import finite, numbers_of, points_of
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.airframes import load_airframe

AXES = 4
"""Numbers along a trajectory: x, y, z (m) and yaw (rad)"""
DEGREE = 5
"""Degree of the spline through waypoints; its acceleration has no kinks"""
MOST_POINTS = 100_000


class TrajectoryPoint(NamedTuple):
    """Where a trajectory is at one time.

    Attributes:
        position: (3,) m, world axes.
        velocity: (3,) m/s.
        acceleration: (3,) m/s^2.
        yaw: rad.
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    yaw: float


class Trajectory:
    """A path in space and time; before it begins and after it ends it stands still at that end.

    Attributes:
        begin: When it begins, s.
        end: When it ends, s.
        has_yaw: Whether it tells a yaw; else that is 0.
    """

    def __init__(self, times: Sequence[float] | np.ndarray, points: Any) -> None:
        """Lay a smooth curve through points, at rest at both ends.

        The curve is a spline of degree 5. Velocity, acceleration, jerk and its rate are continuous.

        Args:
            times: (P,) when to be there, s, growing.
            points: (P, 3) x, y, z, m, or (P, 4) with the yaw, rad. A yaw goes the way that the
                numbers tell, so 3.2 comes after 3.1.

        Raises:
            ValueError: Times do not grow, fewer than two points, wrong shapes or numbers.
        """
        knots, places, self.has_yaw = _checked(times, points)
        still = [(1, np.zeros(AXES)), (2, np.zeros(AXES))]
        self._keep(make_interp_spline(knots, places, DEGREE, bc_type=(still,) * 2), *knots[[0, -1]])

    @classmethod
    def along(cls, points: Any, speed: float) -> "Trajectory":
        """Lay a smooth curve through points, at about one speed, from time 0 on.

        Each piece takes its length over the speed; the first and the last, from and to rest, take
        twice that.

        Args:
            points: (P, 3) or (P, 4), as above; no two neighbours at one place.
            speed: m/s.

        Returns:
            The trajectory.

        Raises:
            ValueError: The speed is not above 0, points coincide, wrong shapes or numbers.
        """
        places = numbers_of("points are", points)
        if places.ndim != 2 or len(places) < 2:
            raise ValueError(f"points have shape {places.shape}: two rows or more are needed")
        if finite("speed", speed) <= 0:
            raise ValueError(f"speed is {speed:g} m/s: it must be above 0")
        steps = np.diff(places[:, :3], axis=0)
        pieces = np.sqrt((steps * steps).sum(axis=1)) / speed
        pieces[0] *= 2
        pieces[-1] *= 2 if len(pieces) > 1 else 1
        return cls(np.concatenate([[0.0], np.cumsum(pieces)]), places)

    @classmethod
    def polynomial(cls, durations: Sequence[float], coefficients: Any) -> "Trajectory":
        """Join polynomials, as a Crazyflie takes them (7th degree there).

        Args:
            durations: (P,) how long each piece takes, s; the first begins at 0.
            coefficients: (P, 4, D) of x, y, z and yaw by the time since the piece began, lowest
                power first.

        Returns:
            The trajectory.

        Raises:
            ValueError: A duration is not above 0, or wrong shapes or numbers.
        """
        # Numbers first, then their shapes and ranges
        lasting, terms = (
            numbers_of("durations are", durations),
            numbers_of("coefficients are", coefficients),
        )
        if (
            lasting.ndim != 1
            or not lasting.size
            or not (np.isfinite(lasting) & (lasting > 0)).all()
        ):
            raise ValueError(f"durations are {durations}: numbers above 0 are needed, one a piece")
        if terms.ndim != 3 or terms.shape[:2] != (len(lasting), AXES) or not terms.shape[2]:
            raise ValueError(
                f"coefficients have shape {terms.shape}: (pieces, x y z yaw, powers) = "
                f"({len(lasting)}, {AXES}, D) is needed"
            )
        if not np.isfinite(terms).all():
            raise ValueError("coefficients have numbers that are not finite")
        self = cls.__new__(cls)
        self.has_yaw = True
        # SciPy wants the highest power first
        ends = np.concatenate([[0.0], np.cumsum(lasting)])
        self._keep(PPoly(terms.transpose(2, 0, 1)[::-1], ends), *ends[[0, -1]])
        return self

    def _keep(self, curve: BSpline | PPoly, begin: float, end: float) -> None:
        """Keep the curve and its derivatives."""
        self._place, self._velocity = curve, curve.derivative(1)
        self._acceleration = curve.derivative(2)
        self.begin, self.end = float(begin), float(end)

    def at(self, time: float) -> TrajectoryPoint:
        """Tell where the trajectory is.

        Args:
            time: s.

        Returns:
            Position, velocity, acceleration and yaw; of an end without motion beyond it.

        Raises:
            ValueError: The time is not finite.
        """
        time = finite("time", time)
        place = self._place(min(max(time, self.begin), self.end))
        velocity = self._moving(self._velocity, time)
        return TrajectoryPoint(place[:3], velocity, self.acceleration(time), float(place[3]))

    def acceleration(self, time: float) -> np.ndarray:
        """Tell the acceleration alone, (3,) m/s^2; see `at`."""
        return self._moving(self._acceleration, time)

    def _moving(self, curve: BSpline | PPoly, time: float) -> np.ndarray:
        """Evaluate a derivative: (3,), zeros before the begin and after the end."""
        moves = self.begin <= time <= self.end
        value: np.ndarray = curve(time)[:3] if moves else np.zeros(3)
        return value


class Tracker:
    """A controller that follows a trajectory by setpoints of `SetpointLevel.ACCELERATION`.

    a = a_ref(t + lead) + 2 z w (v_ref - v) + w^2 (x_ref - x), with the frequency w and damping z of
    the position loop of the airframe. Feed-forward comes before its time: sideways by the delay of
    the attitude, 2 z / w_R (the linear phase of its second-order loop), upwards by the rotors' lag.
    Meanwhile drag k v grows by k lead a_ref, which is added.
    """

    def __init__(self, airframe: str | Airframe, trajectory: Trajectory) -> None:
        """Take the gains from the airframe.

        Args:
            airframe: Of the drone, or its name.
            trajectory: What to follow.

        Raises:
            ValueError: There is no such airframe.
        """
        self.trajectory = trajectory
        frame = load_airframe(airframe)
        gains = gain_rows([frame], frame.max_speed)[0]
        frequency, damping = float(gains["position_frequency"]), float(gains["damping"])
        self._rate, self._stiffness = 2 * damping * frequency, frequency**2
        self._sideways = 2 * damping / float(gains["attitude_frequency"][0])
        self._upwards = max(frame.lag_up, frame.lag_down)
        # The controller knows the drag of now; what it grows by meanwhile goes with the lead.
        hover = len(frame.rotors) * frame.hover_speed() / frame.mass
        self._ahead = 1 + hover * np.array(
            (frame.drag_xy * self._sideways,) * 2 + (frame.drag_z * self._upwards,)
        )

    def setpoint(self, time: float, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Tell how to accelerate now.

        Args:
            time: s.
            position: (3,) of the drone, m.
            velocity: (3,) m/s.

        Returns:
            Acceleration, m/s^2, world axes, and the yaw, rad, if the trajectory has one: (3,) or
            (4,).

        Raises:
            ValueError: A number is not finite, or a shape is wrong.
        """
        (place,), (speed,) = points_of("position", position), points_of("velocity", velocity)
        now = self.trajectory.at(time)
        x, y, _ = self.trajectory.acceleration(time + self._sideways)
        z = self.trajectory.acceleration(time + self._upwards)[2]
        back = self._rate * (now.velocity - speed) + self._stiffness * (now.position - place)
        wanted = self._ahead * (x, y, z) + back
        return np.append(wanted, now.yaw) if self.trajectory.has_yaw else wanted


def _checked(times: Any, points: Any) -> tuple[np.ndarray, np.ndarray, bool]:
    """Take times (P,), points as (P, 4), and whether they tell a yaw; refuse what is no curve."""
    knots, places = numbers_of("times are", times), numbers_of("points are", points)
    # Times must rise, as pieces of no length have no curve
    if knots.ndim != 1 or not 2 <= len(knots) <= MOST_POINTS:
        raise ValueError(f"times have shape {knots.shape}: from 2 to {MOST_POINTS} are needed")
    if not np.isfinite(knots).all() or (np.diff(knots) <= 0).any():
        raise ValueError(f"times are {times}: each must be finite and above the one before")
    if places.shape not in ((len(knots), 3), (len(knots), AXES)):
        raise ValueError(
            f"points have shape {places.shape}: ({len(knots)}, 3) or, with yaw, ({len(knots)}, 4) "
            f"is needed, one for each time"
        )
    if not np.isfinite(places).all():
        raise ValueError("points have numbers that are not finite")
    # Points without a yaw get one of 0, which nobody flies
    rows = np.zeros((len(knots), AXES))
    rows[:, : places.shape[1]] = places
    return knots, rows, places.shape[1] == AXES
