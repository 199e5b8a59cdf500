"""Trajectories in space and time, and a tracking controller that outputs accelerations.

Splines and piecewise polynomials are SciPy's.
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
"""Number of coordinates of a trajectory: x, y, z (m) and yaw (rad)"""
DEGREE = 5
"""Degree of the spline through waypoints; its acceleration is smooth"""
MOST_POINTS = 100_000


class TrajectoryPoint(NamedTuple):
    """State of a trajectory at one time.

    Attributes:
        position: (3,) position, world axes, m.
        velocity: (3,) velocity, world axes, m/s.
        acceleration: (3,) acceleration, world axes, m/s^2.
        yaw: Yaw, rad.
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    yaw: float


class Trajectory:
    """A curve in space and time; before its begin and after its end it rests at that end.

    Attributes:
        begin: Time of its begin, s.
        end: Time of its end, s.
        has_yaw: Whether it has a yaw; otherwise the yaw is 0.
    """

    def __init__(self, times: Sequence[float] | np.ndarray, points: Any) -> None:
        """Interpolate points by a smooth curve that is at rest at both ends.

        The curve is a spline of degree 5. Velocity, acceleration, jerk and snap are continuous.

        Args:
            times: (P,) times of the points, s, increasing.
            points: (P, 3) x, y, z, m, or (P, 4) with the yaw, rad. The yaw is interpolated without
                wrapping, so that 3.2 follows 3.1.

        Raises:
            ValueError: If times do not increase, if there are fewer than two points, or if shapes
                or numbers are invalid.
        """
        knots, places, self.has_yaw = _checked(times, points)
        still = [(1, np.zeros(AXES)), (2, np.zeros(AXES))]
        self._keep(make_interp_spline(knots, places, DEGREE, bc_type=(still,) * 2), *knots[[0, -1]])

    @classmethod
    def along(cls, points: Any, speed: float) -> "Trajectory":
        """Interpolate points by a smooth curve with nearly constant speed, from time 0 on.

        The duration of a segment is its length over the speed; the first and the last segment, from
        and to rest, take twice that.

        Args:
            points: (P, 3) or (P, 4), as in `Trajectory`; consecutive points must differ.
            speed: Speed, m/s.

        Returns:
            The trajectory.

        Raises:
            ValueError: If the speed is not above 0, if consecutive points coincide, or if shapes or
                numbers are invalid.
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
        """Join polynomials, as a Crazyflie uses (there of degree 7).

        Args:
            durations: (P,) duration of each piece, s; the first piece begins at time 0.
            coefficients: (P, 4, D) coefficients of x, y, z and yaw, in powers of the time since the
                piece began, lowest power first.

        Returns:
            The trajectory.

        Raises:
            ValueError: If a duration is not above 0, or if shapes or numbers are invalid.
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
            raise ValueError(
                f"durations are {durations}: a number above 0 is needed for each piece"
            )
        if terms.ndim != 3 or terms.shape[:2] != (len(lasting), AXES) or not terms.shape[2]:
            raise ValueError(
                f"coefficients have shape {terms.shape}: (pieces, x y z yaw, powers) = "
                f"({len(lasting)}, {AXES}, D) is needed"
            )
        if not np.isfinite(terms).all():
            raise ValueError("coefficients have numbers that are not finite")
        self = cls.__new__(cls)
        self.has_yaw = True
        # SciPy takes the highest power first
        ends = np.concatenate([[0.0], np.cumsum(lasting)])
        self._keep(PPoly(terms.transpose(2, 0, 1)[::-1], ends), *ends[[0, -1]])
        return self

    def _keep(self, curve: BSpline | PPoly, begin: float, end: float) -> None:
        """Store the curve and its derivatives."""
        self._place, self._velocity = curve, curve.derivative(1)
        self._acceleration = curve.derivative(2)
        self.begin, self.end = float(begin), float(end)

    def at(self, time: float) -> TrajectoryPoint:
        """Evaluate the trajectory at a time.

        Args:
            time: Time, s.

        Returns:
            Position, velocity, acceleration and yaw; at rest before the begin and after the end.

        Raises:
            ValueError: If the time is not finite.
        """
        time = finite("time", time)
        place = self._place(min(max(time, self.begin), self.end))
        velocity = self._moving(self._velocity, time)
        return TrajectoryPoint(place[:3], velocity, self.acceleration(time), float(place[3]))

    def acceleration(self, time: float) -> np.ndarray:
        """Return only the acceleration (3,) at a time, m/s^2; see `at`."""
        return self._moving(self._acceleration, time)

    def _moving(self, curve: BSpline | PPoly, time: float) -> np.ndarray:
        """Evaluate a derivative (3,): zeros before the begin and after the end."""
        moves = self.begin <= time <= self.end
        value: np.ndarray = curve(time)[:3] if moves else np.zeros(3)
        return value


class Tracker:
    """Tracking controller of a trajectory, with setpoints of `SetpointLevel.ACCELERATION`.

    a = a_ref(t + lead) + 2 z w (v_ref - v) + w^2 (x_ref - x), with the frequency w and damping z of
    the position loop of the airframe. The feed-forward leads: sideways by the delay of the attitude
    loop, 2 z / w_R (the linear phase of a second-order loop), upwards by the rotors' lag. The drag
    k v changes by k lead a_ref within the lead, which is added.
    """

    def __init__(self, airframe: str | Airframe, trajectory: Trajectory) -> None:
        """Compute the gains from the airframe.

        Args:
            airframe: Airframe of the drone, or its name.
            trajectory: Trajectory to follow.

        Raises:
            ValueError: If there is no airframe of that name.
        """
        self.trajectory = trajectory
        frame = load_airframe(airframe)
        gains = gain_rows([frame], frame.max_speed)[0]
        frequency, damping = float(gains["position_frequency"]), float(gains["damping"])
        self._rate, self._stiffness = 2 * damping * frequency, frequency**2
        self._sideways = 2 * damping / float(gains["attitude_frequency"][0])
        self._upwards = max(frame.lag_up, frame.lag_down)
        # The controller compensates the present drag; its change within the lead is added here.
        hover = len(frame.rotors) * frame.hover_speed() / frame.mass
        self._ahead = 1 + hover * np.array(
            (frame.drag_xy * self._sideways,) * 2 + (frame.drag_z * self._upwards,)
        )

    def setpoint(self, time: float, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Compute the acceleration setpoint at a time.

        Args:
            time: Time, s.
            position: (3,) position of the drone, m.
            velocity: (3,) velocity of the drone, m/s.

        Returns:
            (3,) acceleration, world axes, m/s^2; (4,) with the yaw, rad, if the trajectory has one.

        Raises:
            ValueError: If a number is not finite, or a shape is wrong.
        """
        (place,), (speed,) = points_of("position", position), points_of("velocity", velocity)
        now = self.trajectory.at(time)
        x, y, _ = self.trajectory.acceleration(time + self._sideways)
        z = self.trajectory.acceleration(time + self._upwards)[2]
        back = self._rate * (now.velocity - speed) + self._stiffness * (now.position - place)
        wanted = self._ahead * (x, y, z) + back
        return np.append(wanted, now.yaw) if self.trajectory.has_yaw else wanted


def _checked(times: Any, points: Any) -> tuple[np.ndarray, np.ndarray, bool]:
    """Check times and points; return times (P,), points (P, 4), and whether they have a yaw."""
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
    # Points without a yaw get a yaw of 0, which is not used
    rows = np.zeros((len(knots), AXES))
    rows[:, : places.shape[1]] = places
    return knots, rows, places.shape[1] == AXES
