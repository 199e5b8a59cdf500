"""Steady flight of an aircraft with wings: trim, glide, climb, turn, stall speed, and its limits.

In steady flight airspeed, attitude to the horizon and angular velocity are constant, so force and
torque balance gravity and the acceleration of the turn. Newton's method solves these equations with
the forces of `wings.winged_wrench`, at sea level, in still air, with lift rotors off.

References:
    R. Beard, T. McLain, Small Unmanned Aircraft, Princeton 2012, chapter 5: trim.
    B. Stevens, F. Lewis, Aircraft Control and Simulation, Wiley 2003, section 3.6: rate of climb
    constraint and steady turns.
    B. Etkin, L. Reid, Dynamics of Flight, Wiley 1996, chapter 2: static stability and control.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin, tan
from bulletuav.compiled.kernel import kernel
from bulletuav.errors import finite
from bulletuav.geometry.rotation import Vec3, cross, dot
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.parameters import ParameterRow, parameter_rows
from bulletuav.vehicle.wings import MAX_SURFACES, WingRow, wing_rows, winged_wrench

MIN_SPEED_FACTOR = 1.2
"""Minimum commanded airspeed in stall speeds, as usual for the approach of aeroplanes."""
MIN_SPEED_RANGE = 1.05
"""Minimum ratio of maximum and minimum commanded airspeed (our choice)."""
MIN_CLIMB_ANGLE = 0.01
"""Minimum climb angle at full throttle at the lowest speeds, rad: excess thrust per weight (our
choice)."""
CARSON_FACTOR = math.sqrt(math.sqrt(3.0))
"""Cruise speed in speeds of least drag: most speed per fuel burnt along the way (B. Carson, Fuel
Efficiency of Small Aircraft, AIAA 80-1847)."""
MAX_BANK = math.radians(45.0)
"""Maximum commanded bank angle, rad."""
TURN_STALL_MARGIN = 1.05
"""Minimum ratio of airspeed and stall speed in a turn."""
MAX_TRIM_BANK = math.radians(80.0)
"""Maximum bank angle of a trim, rad."""
MAX_CLIMB_ANGLE = math.radians(80.0)
"""Maximum flight path angle of a trim, rad."""
MAX_ALPHA = math.radians(30.0)
"""End of the search for the maximum lift, rad."""
MINOR_MOMENT = 0.1
"""Moment of a control surface about an axis, as a fraction of its largest about any axis, below
which it is not used for this axis."""
_MAX_ITERATIONS = 60
_TOLERANCE = 1e-9
"""Remaining accelerations, in multiples of gravity and in those of a moment of weight times 1 m."""
_ALPHA_STEP = 0.05
"""Largest change of the angle of attack in an iteration, rad, within the range without stall."""
_SMALL = 1e-6
"""Step of central differences, rad; a rotor's is this fraction of its maximum speed."""
_LEVEL = (0.0, 0.0, 0.0, 1.0)
_STILL = ((0.0, 0.0, 0.0), 0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Surroundings without wind, gravity and external forces."""
_ROUNDING = 1e-6
"""Excess of rotor speeds at full throttle by rounding, relative to their maximum."""
_LIMITS = 48
"""Bisections of a limit, below which a double has no more digits."""


@dataclass(frozen=True)
class Envelope:
    """Limits of steady flight of an aircraft with wings at sea level.

    Attributes:
        stall_speed: Airspeed at which the maximum lift in a glide equals the weight, m/s.
        min_speed: Minimum commanded airspeed, `MIN_SPEED_FACTOR` stall speeds, m/s.
        cruise_speed: `CARSON_FACTOR` times the speed of least drag, and at most halfway from
            `min_speed` to `max_speed`, m/s, where weak aircraft can still climb.
        max_speed: Fastest level flight, or the airframe's `max_speed` if it is lower, m/s.
        max_bank: Maximum bank angle in a level turn at `min_speed`, rad: at most `MAX_BANK`, and
            with `TURN_STALL_MARGIN` to the stall.
        max_climb: Climb at full throttle at `cruise_speed`, m/s.
        max_sink: Sink with stopped rotors at `cruise_speed`, m/s.
    """

    stall_speed: float
    min_speed: float
    cruise_speed: float
    max_speed: float
    max_bank: float
    max_climb: float
    max_sink: float


@dataclass(frozen=True)
class Trim:
    """A steady flight: straight, or in a turn of constant bank and climb.

    Attributes:
        airspeed: V, m/s.
        climb: Flight path angle, rad; negative in a descent.
        bank: Roll angle, right side down, rad; a turn to the right if it is positive.
        alpha: Angle of attack of the body's x axis, rad.
        sideslip: Angle of sideslip, rad; positive if the air comes from the right.
        pitch: Angle of the body's x axis above the horizon, rad.
        turn_rate: Rate of the heading to the right, g tan(bank) / V, rad/s.
        speed: (R,) rotor speeds, rad/s; 0 for lift rotors.
        deflection: (S,) deflections of the control surfaces, rad.
    """

    airspeed: float
    climb: float
    bank: float
    alpha: float
    sideslip: float
    pitch: float
    turn_rate: float
    speed: tuple[float, ...]
    deflection: tuple[float, ...]


@kernel
def air_wrench(
    velocity: Vec3,
    rates: Vec3,
    speed: np.ndarray,
    deflection: np.ndarray,
    row: ParameterRow,
    wing: WingRow,
) -> tuple[Vec3, Vec3]:
    """Compute the force (N) and torque (N m) of air and rotors on one aircraft, body axes.

    Args:
        velocity: Velocity relative to the air, body axes, m/s.
        rates: Angular velocity, body axes, rad/s.
        speed: (R,) rotor speeds, rad/s.
        deflection: (MAX_SURFACES,) deflections of the control surfaces, rad.
        row: Constants of the drone.
        wing: Row of `wings.WINGS`.
    """
    return winged_wrench(_LEVEL, velocity, rates, speed, deflection, _STILL, row, wing)


class _Aircraft:
    """Forces on one aircraft in steady flight, and the mix of its control surfaces.

    Attributes:
        airframe: The airframe.
        weight: Weight, N.
        axes: Indices of the axes (0 roll, 1 pitch, 2 yaw) that control surfaces control.
        mix: (S, 3) deflections per unit of control about each axis; the largest is 1.
    """

    def __init__(self, airframe: Airframe) -> None:
        """Read the constants and find the mix.

        Raises:
            ValueError: If the airframe has no wings, or no control of pitch.
        """
        self.of = f"airframe {airframe.name!r}"
        if not airframe.wings:
            raise ValueError(
                f"{self.of} has no wings: envelope and trim are those of aircraft with wings, such "
                f"as 'trainer'"
            )
        self.airframe = airframe
        self.weight = airframe.mass * STANDARD_GRAVITY
        self._row = parameter_rows([airframe])[0]
        rows = wing_rows([airframe])
        assert rows is not None
        self._wing = rows[0]
        self._speed = np.zeros(len(airframe.rotors))
        self._deflection = np.zeros(MAX_SURFACES)
        self.axes, self.mix = self._find_mix()
        if 1 not in self.axes or len(self.axes) < 2:
            raise ValueError(
                f"{self.of} has no control surfaces for pitch and for roll or yaw: add them to its "
                f"wings, such as an elevator and a rudder"
            )

    def wrench(
        self, velocity: Vec3, rates: Vec3, rotor: float, deflection: tuple[float, ...]
    ) -> tuple[Vec3, Vec3]:
        """Return force and torque at a speed of the forward rotors, rad/s; lift rotors are off."""
        self._speed[list(self.airframe.forward_rotors)] = rotor
        self._deflection[: len(deflection)] = deflection
        given = (self._speed, self._deflection, self._row, self._wing)
        return air_wrench(velocity, rates, *given)

    def deflections(self, controls: Vec3) -> tuple[float, ...]:
        """Return the deflections (S,) of controls about the three axes, rad."""
        return tuple(dot(one, controls) for one in self.mix)

    def _find_mix(self) -> tuple[tuple[int, ...], tuple[Vec3, ...]]:
        """Find the axes that are controlled, and the mix: the least squares of the deflections.

        Each surface is used for the axes about which it has a moment that is not minor.
        """
        count = len(self.airframe.surfaces)
        moments = []
        for k in range(count):
            one = [0.0] * count
            torques = []
            for turned in (_SMALL, -_SMALL):
                one[k] = turned
                torques.append(self.wrench((1.0, 0.0, 0.0), (0.0,) * 3, 0.0, tuple(one))[1])
            slope = [a - b for a, b in zip(*torques, strict=True)]
            least = MINOR_MOMENT * max(map(abs, slope))
            moments.append([a if abs(a) > least else 0.0 for a in slope])
        axes = self._independent_axes(moments)
        # Minimum-norm deflections B^T (B B^T)^-1 for a unit moment about each axis
        gram = [[sum(one[i] * one[j] for one in moments) for j in axes] for i in axes]
        mix = [[0.0] * 3 for _ in moments]
        for j, axis in enumerate(axes):
            unit = [1.0 if i == j else 0.0 for i in range(len(axes))]
            weights = solve_linear(gram, unit)
            assert weights is not None
            column = [
                sum(w * one[i] for w, i in zip(weights, axes, strict=True)) for one in moments
            ]
            largest = max(map(abs, column))
            for entry, value in zip(mix, column, strict=True):
                entry[axis] = value / largest
        return axes, tuple((roll, pitch, yaw) for roll, pitch, yaw in mix)

    @staticmethod
    def _independent_axes(moments: list[list[float]]) -> tuple[int, ...]:
        """Return the axes that the surfaces control independently: pitch, then the strongest.

        Args:
            moments: Moments about the three axes per deflection of each surface.
        """
        columns = [[one[i] for one in moments] for i in range(3)]
        sizes = [math.sqrt(sum(value * value for value in column)) for column in columns]
        found: list[int] = []
        units: list[list[float]] = []
        for axis in (1, *sorted((0, 2), key=lambda i: -sizes[i])):
            # What is left of the column after projection on those of the axes found so far
            rest = columns[axis]
            for unit in units:
                along = sum(a * b for a, b in zip(rest, unit, strict=True))
                rest = [a - along * b for a, b in zip(rest, unit, strict=True)]
            size = math.sqrt(sum(value * value for value in rest))
            if size > MINOR_MOMENT * sizes[axis]:
                found.append(axis)
                units.append([value / size for value in rest])
        return tuple(sorted(found))


def solve_linear(matrix: list[list[float]], right: list[float]) -> list[float] | None:
    """Solve a system of linear equations by Gaussian elimination with partial pivoting.

    Args:
        matrix: Square matrix, as rows.
        right: Right-hand side.

    Returns:
        The solution, or None if the matrix is singular. The bits are the same on all processors,
        unlike those of LAPACK.
    """
    table = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    size = len(table)
    for k in range(size):
        pivot = max(range(k, size), key=lambda i: abs(table[i][k]))
        if table[pivot][k] == 0.0:
            return None
        table[k], table[pivot] = table[pivot], table[k]
        for i in range(k + 1, size):
            factor = table[i][k] / table[k][k]
            for j in range(k, size + 1):
                table[i][j] -= factor * table[k][j]
    for k in reversed(range(size)):
        known = sum(table[k][j] * table[j][size] for j in range(k + 1, size))
        table[k][size] = (table[k][size] - known) / table[k][k]
    return [row[size] for row in table]


class _Steady:
    """Equations of a steady flight at a given airspeed and bank.

    The unknowns are the angle of attack, the sideslip, the throttle or the climb, and the controls.
    The throttle is the speed of the forward rotors divided by their maximum.
    """

    def __init__(
        self, aircraft: _Aircraft, airspeed: float, bank: float, given: float, finds_climb: bool
    ) -> None:
        self.aircraft = aircraft
        self.airspeed = airspeed
        self.bank = bank
        self.given = given
        self.finds_climb = finds_climb
        self.turn_rate = STANDARD_GRAVITY * tan(bank) / airspeed
        self.bank_sine, self.bank_cosine = sin(bank), cos(bank)
        # Without control of all axes, the sideslip balances a moment instead of the side force
        self.equations = [0, 1, 2, 3, 4, 5] if len(aircraft.axes) == 3 else [0, 2, 3, 4, 5]

    def _split(self, x: list[float]) -> tuple[float, float, tuple[float, ...]]:
        """Return climb, throttle and deflections of the unknowns."""
        climb, throttle = (x[2], self.given) if self.finds_climb else (self.given, x[2])
        controls = [0.0, 0.0, 0.0]
        for axis, value in zip(self.aircraft.axes, x[3:], strict=True):
            controls[axis] = value
        return climb, throttle, self.aircraft.deflections((controls[0], controls[1], controls[2]))

    def _attitude(self, x: list[float], climb: float) -> tuple[Vec3, float, float, Vec3]:
        """Return velocity (body axes), sine and cosine of the pitch, and the vertical (body axes).

        The pitch follows from the rate of climb constraint of Stevens and Lewis.
        """
        flat, aside = cos(x[1]), sin(x[1])
        ahead, below = cos(x[0]) * flat, sin(x[0]) * flat
        across = aside * self.bank_sine + below * self.bank_cosine
        rise, total = sin(climb), ahead * ahead + across * across
        root = math.sqrt(max(total - rise * rise, 0.0))
        sine, cosine = (
            (ahead * rise + across * root) / total,
            (ahead * root - across * rise) / total,
        )
        v = self.airspeed
        up = (sine, self.bank_sine * cosine, self.bank_cosine * cosine)
        return (v * ahead, -v * aside, -v * below), sine, cosine, up

    def residual(self, x: list[float]) -> list[float]:
        """Return the unbalanced force, in weights, and torque, in weights times 1 m."""
        aircraft = self.aircraft
        climb, throttle, deflection = self._split(x)
        velocity, _, _, up = self._attitude(x, climb)
        # A turn to the right is about the downward vertical
        rates = (-self.turn_rate * up[0], -self.turn_rate * up[1], -self.turn_rate * up[2])
        rotor = throttle * aircraft.airframe.max_rotor_speed
        force, torque = aircraft.wrench(velocity, rates, rotor, deflection)
        mass, inertia = aircraft.airframe.mass, aircraft.airframe.inertia
        curved = cross(rates, velocity)
        spun = cross(rates, (inertia[0] * rates[0], inertia[1] * rates[1], inertia[2] * rates[2]))
        forces = [force[i] - aircraft.weight * up[i] - mass * curved[i] for i in range(3)]
        torques = [torque[i] - spun[i] for i in range(3)]
        return [value / aircraft.weight for value in (*forces, *torques)]

    def solve(self) -> list[float] | None:
        """Solve the equations by Newton's method; None if it does not converge."""
        x = [0.05, 0.0, 0.0 if self.finds_climb else 0.7, *(0.0 for _ in self.aircraft.axes)]
        for _ in range(_MAX_ITERATIONS):
            now = self.residual(x)
            left = [now[i] for i in self.equations]
            if max(map(abs, left)) < _TOLERANCE:
                return x
            columns = []
            for k in range(len(x)):
                ends = []
                for step in (_SMALL, -_SMALL):
                    moved = list(x)
                    moved[k] += step
                    ends.append(self.residual(moved))
                columns.append([(ends[0][i] - ends[1][i]) / (2 * _SMALL) for i in self.equations])
            rows = [list(one) for one in zip(*columns, strict=True)]
            change = solve_linear(rows, [-value for value in left])
            if change is None or not all(map(math.isfinite, change)):
                return None
            scale = min(1.0, _ALPHA_STEP / max(abs(change[0]), abs(change[1]), 1e-300))
            x = [value + scale * more for value, more in zip(x, change, strict=True)]
            if abs(x[0]) > MAX_ALPHA or abs(x[1]) > MAX_ALPHA:
                return None
        return None

    def trim(self, x: list[float]) -> Trim:
        """Return the steady flight of the solution."""
        climb, throttle, deflection = self._split(x)
        _, sine, cosine, _ = self._attitude(x, climb)
        airframe = self.aircraft.airframe
        rotor = throttle * airframe.max_rotor_speed
        count = len(airframe.rotors)
        return Trim(
            airspeed=float(self.airspeed),
            climb=float(climb),
            bank=float(self.bank),
            alpha=float(x[0]),
            sideslip=float(x[1]),
            pitch=float(atan2(sine, cosine)),
            turn_rate=float(self.turn_rate),
            speed=tuple(
                float(rotor) if k in airframe.forward_rotors else 0.0 for k in range(count)
            ),
            deflection=tuple(map(float, deflection)),
        )


@lru_cache(256)
def _aircraft(airframe: Airframe) -> _Aircraft:
    """Return the forces of an airframe, prepared once."""
    return _Aircraft(airframe)


@lru_cache(4096)
def find_trim(airframe: Airframe, airspeed: float, climb: float = 0.0, bank: float = 0.0) -> Trim:
    """Find the steady flight at an airspeed, a climb and a bank angle.

    Args:
        airframe: An aircraft with wings and forward rotors.
        airspeed: Airspeed, m/s.
        climb: Flight path angle, rad; negative in a descent.
        bank: Roll angle, rad, positive for a turn to the right. The turn rate is g tan(bank) / V.

    Returns:
        Angle of attack, rotor speeds and deflections. Without a rudder or ailerons the sideslip
        balances the moment about the axis that is not controlled, and a small side force remains.

    Raises:
        ValueError: If the aircraft stalls there, or a rotor or control surface would be beyond its
            limits.

    References:
        B. Stevens, F. Lewis, Aircraft Control and Simulation, Wiley 2003, section 3.6.
    """
    aircraft = _aircraft(airframe)
    _require_forward_rotors(aircraft)
    flown = f"{_require_flight(aircraft, airspeed, bank)} and a climb of {climb:g} rad"
    finite("climb", climb, -MAX_CLIMB_ANGLE, MAX_CLIMB_ANGLE)
    equations = _Steady(aircraft, airspeed, bank, climb, finds_climb=False)
    trim = _require_solution(aircraft, equations, flown)
    rotor, most = max(trim.speed), airframe.max_rotor_speed
    if rotor > (1.0 + _ROUNDING) * most:
        raise ValueError(
            f"{aircraft.of} cannot trim at {flown}: its forward rotors would need {rotor:.4g} "
            f"rad/s, and at most {most:g} are possible; climb less or fly slower"
        )
    return replace(trim, speed=tuple(min(one, most) for one in trim.speed))


def find_climb(
    airframe: Airframe, airspeed: float, throttle: float = 1.0, bank: float = 0.0
) -> Trim:
    """Find the steady climb or descent at an airspeed, for a given throttle.

    Args:
        airframe: An aircraft with wings.
        airspeed: Airspeed, m/s.
        throttle: Speed of the forward rotors divided by their maximum: 0 for a glide with stopped
            rotors, 1 for the steepest climb.
        bank: Roll angle, rad, positive for a turn to the right.

    Returns:
        The steady flight; its `climb` is negative in a glide.

    Raises:
        ValueError: If the aircraft stalls there, or a control surface would be beyond its limits.
    """
    aircraft = _aircraft(airframe)
    flown = _require_flight(aircraft, airspeed, bank)
    finite("throttle", throttle, 0.0, 1.0)
    equations = _Steady(aircraft, airspeed, bank, throttle, finds_climb=True)
    return _require_solution(aircraft, equations, f"{flown} and a throttle of {throttle:g}")


def find_stall(airframe: Airframe) -> tuple[float, float]:
    """Find the stall speed, and the angle of attack at which the aircraft stalls.

    The elevator balances the moment, rotors are stopped, and the lift equals the weight.

    Args:
        airframe: An aircraft with wings.

    Returns:
        Stall speed, m/s, and angle of attack, rad.

    Raises:
        ValueError: If the aircraft has no lift.
    """
    aircraft = _aircraft(airframe)
    angles = [math.radians(0.5 * k) for k in range(-20, 61)]
    lifts = [_trimmed_lift(aircraft, angle) for angle in angles]
    best = max(range(len(angles)), key=lambda k: lifts[k])
    low, high = angles[max(best - 1, 0)], angles[min(best + 1, len(angles) - 1)]
    alpha = maximize(lambda angle: _trimmed_lift(aircraft, angle), low, high)
    lift = _trimmed_lift(aircraft, alpha)
    if lift <= 0.0:
        raise ValueError(
            f"{aircraft.of} has no lift at which its control surfaces balance the pitching moment: "
            f"move its wings forward or make its elevator larger"
        )
    return math.sqrt(aircraft.weight / lift), alpha


@lru_cache(256)
def find_envelope(airframe: Airframe) -> Envelope:
    """Find the limits of steady flight of an aircraft with wings at sea level.

    Args:
        airframe: An aircraft with wings and forward rotors.

    Returns:
        The limits.

    Raises:
        ValueError: If the airframe has no wings, or cannot fly level at its minimum speed and a
            little above it.
    """
    aircraft = _aircraft(airframe)
    _require_forward_rotors(aircraft)
    stall, _ = find_stall(airframe)
    slowest = MIN_SPEED_FACTOR * stall
    faster = MIN_SPEED_RANGE * slowest
    if airframe.max_speed < faster:
        raise ValueError(
            f"{aircraft.of} has a max_speed of {airframe.max_speed:g} m/s, and its minimum speed "
            f"is {slowest:.4g} m/s, {MIN_SPEED_FACTOR} stall speeds: raise max_speed to "
            f"{faster:.4g} m/s or more"
        )
    for speed in (slowest, faster):
        rise = find_climb(airframe, speed).climb
        if rise < MIN_CLIMB_ANGLE:
            raise ValueError(
                f"{aircraft.of} cannot fly level: at {speed:.4g} m/s and full throttle its climb "
                f"is {speed * sin(rise):.4g} m/s, and at least "
                f"{speed * sin(MIN_CLIMB_ANGLE):.4g} m/s is needed; raise max_rotor_speed or "
                f"thrust_coefficient, or reduce its drag"
            )

    def climb(speed: float, throttle: float) -> float:
        found = _Steady(aircraft, speed, 0.0, throttle, finds_climb=True).solve()
        return -math.inf if found is None else speed * sin(found[2])

    # The glide angle is drag / weight
    least_drag = maximize(lambda v: climb(v, 0.0) / v, stall, max(2.0 * stall, airframe.max_speed))
    fastest = airframe.max_speed
    if climb(fastest, 1.0) < 0.0:
        low, high = faster, fastest
        for _ in range(_LIMITS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if climb(middle, 1.0) >= 0.0 else (low, middle)
        fastest = low
    # Controllers and power models follow from these trims
    for speed in (slowest, fastest):
        find_trim(airframe, speed)
    cruise = min(max(CARSON_FACTOR * least_drag, slowest), 0.5 * (slowest + fastest))
    # Load factor 1 / cos(bank) at which the stall speed reaches the margin
    margin = MIN_SPEED_FACTOR / TURN_STALL_MARGIN
    load = margin * margin
    return Envelope(
        stall_speed=stall,
        min_speed=slowest,
        cruise_speed=cruise,
        max_speed=fastest,
        max_bank=min(MAX_BANK, float(atan2(math.sqrt(load * load - 1.0), 1.0))),
        max_climb=float(cruise * sin(find_climb(airframe, cruise).climb)),
        max_sink=float(-cruise * sin(find_climb(airframe, cruise, 0.0).climb)),
    )


def maximize(function: Callable[[float], float], low: float, high: float) -> float:
    """Find the maximum of a function with one peak between two numbers, by golden section.

    Args:
        function: The function; it may be -inf in places.
        low: Lower end.
        high: Upper end.

    Returns:
        The argument at the maximum, to about 1e-8 of its size.
    """
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    inner = [high - golden * (high - low), low + golden * (high - low)]
    values = [function(x) for x in inner]
    for _ in range(_LIMITS):
        if values[0] >= values[1]:
            high, inner[1], values[1] = inner[1], inner[0], values[0]
            inner[0] = high - golden * (high - low)
            values[0] = function(inner[0])
        else:
            low, inner[0], values[0] = inner[0], inner[1], values[1]
            inner[1] = low + golden * (high - low)
            values[1] = function(inner[1])
    return inner[0] if values[0] >= values[1] else inner[1]


def _trimmed_lift(aircraft: _Aircraft, alpha: float) -> float:
    """Return the lift at 1 m/s whose moment the elevator balances, N; -inf if it cannot."""
    velocity = (cos(alpha), 0.0, -sin(alpha))

    def moment(control: float) -> float:
        deflection = aircraft.deflections((0.0, control, 0.0))
        return aircraft.wrench(velocity, (0.0,) * 3, 0.0, deflection)[1][1]

    control = 0.0
    for _ in range(_MAX_ITERATIONS):
        slope = (moment(control + _SMALL) - moment(control - _SMALL)) / (2.0 * _SMALL)
        if slope == 0.0:
            return -math.inf
        change = moment(control) / slope
        control -= change
        if abs(change) < _TOLERANCE:
            break
    deflection = aircraft.deflections((0.0, control, 0.0))
    if _beyond_range(aircraft.airframe, deflection) is not None:
        return -math.inf
    force, _ = aircraft.wrench(velocity, (0.0,) * 3, 0.0, deflection)
    return force[0] * sin(alpha) + force[2] * cos(alpha)


def _beyond_range(airframe: Airframe, deflection: tuple[float, ...]) -> int | None:
    """Return the index of the first control surface that is out of its range; None if none is."""
    for k, (surface, turned) in enumerate(zip(airframe.surfaces, deflection, strict=True)):
        if not surface.low <= turned <= surface.high:
            return k
    return None


def _require_forward_rotors(aircraft: _Aircraft) -> None:
    """Raise ValueError for an airframe without a rotor along x."""
    if not aircraft.airframe.forward_rotors:
        raise ValueError(
            f"{aircraft.of} has no forward rotor, and cannot fly level on its wings: add a rotor "
            f'with axis="x"'
        )


def _require_flight(aircraft: _Aircraft, airspeed: float, bank: float) -> str:
    """Check airspeed and bank; return them as text for messages."""
    if finite("airspeed", airspeed, 0.0) == 0.0:
        raise ValueError("airspeed is 0: a number above 0 is needed")
    finite("bank", bank, -MAX_TRIM_BANK, MAX_TRIM_BANK)
    return f"{airspeed:.4g} m/s, a bank of {bank:g} rad"


def _require_solution(aircraft: _Aircraft, equations: _Steady, flown: str) -> Trim:
    """Solve the equations.

    Raises:
        ValueError: If there is no steady flight, or a control surface would be out of its range.
    """
    found = equations.solve()
    if found is None:
        glide = _Steady(aircraft, equations.airspeed, equations.bank, 0.0, finds_climb=True).solve()
        if glide is not None:
            raise ValueError(
                f"{aircraft.of} cannot trim at {flown}: with stopped rotors it descends at "
                f"{-glide[2]:.4g} rad; descend less steeply or fly faster"
            )
        stall, _ = find_stall(aircraft.airframe)
        raise ValueError(
            f"{aircraft.of} cannot trim at {flown}: its stall speed is {stall:.4g} m/s in level "
            f"flight and grows by sqrt(1 / cos bank) in turns; fly faster"
        )
    trim = equations.trim(found)
    k = _beyond_range(aircraft.airframe, trim.deflection)
    if k is not None:
        surface = aircraft.airframe.surfaces[k]
        raise ValueError(
            f"{aircraft.of} cannot trim at {flown}: {surface.name} would need "
            f"{trim.deflection[k]:.4g} rad, and its range is from {surface.low:g} to "
            f"{surface.high:g}; enlarge its chord or range, or fly at another speed"
        )
    return trim
