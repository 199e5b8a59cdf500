"""Trajectories: where to be and when; and the accelerations with which a drone follows one.

Splines and piecewise polynomials are scipy's.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline, PPoly, make_interp_spline

from bulletuav.control.gains import gain_rows
from bulletuav.errors import numbers_of
from bulletuav.vehicle.airframe import Airframe

AXES = 4
"""Numbers along a trajectory: x, y, z (m) and yaw (rad)"""
DEGREE = 5
"""Degree of the spline through waypoints; its acceleration has no kinks"""
MOST_POINTS = 100_000


class Target(NamedTuple):
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
    """

    def __init__(self, times: Sequence[float], points: Any) -> None:
        """Lay a smooth curve through points, at rest at both ends.

        The curve is a spline of degree 5. Velocity, acceleration, jerk and its rate are continuous.

        Args:
            times: (P,) when to be there, s, growing.
            points: (P, 3) x, y, z, m, or (P, 4) with the yaw, rad. A yaw goes the way that the
                numbers tell, so 3.2 comes after 3.1.

        Raises:
            ValueError: Times do not grow, fewer than two points, wrong shapes or numbers.
        """
        knots, places = _checked(times, points)
        still = [(1, np.zeros(AXES)), (2, np.zeros(AXES))]
        self._keep(make_interp_spline(knots, places, DEGREE, bc_type=(still,) * 2), *knots[[0, -1]])

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
        ends = np.concatenate([[0.0], np.cumsum(lasting)])
        self._keep(PPoly(terms.transpose(2, 0, 1)[::-1], ends), *ends[[0, -1]])
        return self

    def _keep(self, curve: BSpline | PPoly, begin: float, end: float) -> None:
        """Keep the curve and its derivatives."""
        self._curves = (curve, curve.derivative(1), curve.derivative(2))
        self.begin, self.end = float(begin), float(end)

    def at(self, time: float) -> Target:
        """Tell where the trajectory is.

        Args:
            time: s.

        Returns:
            Position, velocity, acceleration and yaw; of an end without motion beyond it.
        """
        inside = min(max(time, self.begin), self.end)
        place, velocity, acceleration = (curve(inside) for curve in self._curves)
        moves = self.begin <= time <= self.end
        still = np.zeros(3)
        return Target(
            place[:3],
            velocity[:3] if moves else still,
            acceleration[:3] if moves else still,
            float(place[3]),
        )


class Tracker:
    """A controller that follows a trajectory by setpoints of `SetpointLevel.ACCELERATION`.

    a = a_ref(t + lead) + 2 z w (v_ref - v) + w^2 (x_ref - x), with the frequency w and damping z of
    the position loop of the airframe. Feed-forward comes before its time, as the attitude follows
    with a delay of about 2 z / w_R (the linear phase of its second-order loop).
    """

    def __init__(self, airframe: Airframe, trajectory: Trajectory) -> None:
        """Take the gains from the airframe.

        Args:
            airframe: Of the drone.
            trajectory: What to follow.
        """
        self.trajectory = trajectory
        gains = gain_rows([airframe], airframe.max_speed)[0]
        frequency, damping = float(gains["position_frequency"]), float(gains["damping"])
        self._rate, self._stiffness = 2 * damping * frequency, frequency**2
        self._lead = 2 * damping / float(gains["attitude_frequency"][0])

    def setpoint(self, time: float, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Tell how to accelerate now.

        Args:
            time: s.
            position: (3,) of the drone, m.
            velocity: (3,) m/s.

        Returns:
            (4,) acceleration, m/s^2, world axes, and yaw, rad.
        """
        now, ahead = self.trajectory.at(time), self.trajectory.at(time + self._lead)
        error, slip = now.position - position, now.velocity - velocity
        wanted = ahead.acceleration + self._rate * slip + self._stiffness * error
        return np.array([*wanted, now.yaw])


def _checked(times: Any, points: Any) -> tuple[np.ndarray, np.ndarray]:
    """Take times (P,) and points as (P, 4), refusing what no curve goes through."""
    knots, places = numbers_of("times are", times), numbers_of("points are", points)
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
    rows = np.zeros((len(knots), AXES))
    rows[:, : places.shape[1]] = places
    return knots, rows
