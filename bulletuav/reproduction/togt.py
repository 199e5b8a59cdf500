"""Tracks and drone of TOGT-Planner, and flights along plans in `rigid_body`.

References:
    C. Qin, M. Michet, J. Chen, H. Liu, Time-optimal gate-traversing planner for autonomous drone
    racing, ICRA 2024; constants from parameters/cpc/cpc_quad.yaml and cpc_planning.yaml of its
    repository at the commit of the table.
    T. Lee, M. Leok, N. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3) (2010).
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.control.gains import DAMPING, FASTEST_ATTITUDE
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.airspace import Airspace
from bulletuav.errors import as_sequence, find_choice, finite, points_of, shown, suggest_names
from bulletuav.geometry.rotation import axes, from_euler
from bulletuav.parsing import read_yaml
from bulletuav.reproduction.time_optimal import (
    Opening,
    PolynomialFlight,
    QuadrotorLimits,
    flat_attitude,
)

TOGT_MASS, TOGT_GRAVITY = 0.85, 9.8066
"""Mass, kg, and gravitational acceleration, m/s^2"""
TOGT_INERTIA = (0.001, 0.001, 0.0017)
"""Moments of inertia about x, y and z, kg m^2"""
TOGT_ARM, TOGT_TORQUE_RATIO = 0.15, 0.05
"""Distance of the rotors from the centre, m, and torque per thrust, m"""
TOGT_THRUST = (0.1, 6.879)
"""Minimum thrust in plans and maximum thrust of a rotor, N"""
TOGT_RATE, TOGT_HEIGHT = 15.0, 0.3
"""Maximum body rate about horizontal axes, rad/s, and minimum height, m"""
TOGT_LIMITS = QuadrotorLimits(
    TOGT_MASS,
    TOGT_INERTIA[0],
    TOGT_ARM * math.sqrt(0.5),
    *TOGT_THRUST,
    TOGT_RATE,
    TOGT_HEIGHT,
    TOGT_GRAVITY,
)
"""Limits of its drone in plans"""
THRUST_COEFFICIENT = 1e-6
"""Thrust per squared speed, N s^2; with rotors without lag and inertia its value has no effect"""
MAX_TRACK_GATES = 100
"""Maximum number of gates of a track"""
FLIGHT_HZ = 1000
"""Physics steps and decisions, 1/s"""
TRACKING_FREQUENCY, TILT_FREQUENCY = 8.0, 25.0
"""Frequencies of the position loop and of the attitude loop, rad/s; both critically damped"""
ARRIVAL, ARRIVAL_SPEED, OVERTIME = 0.05, 0.05, 1.0
"""Distance from the end, m, and speed, m/s, at which a flight has arrived; and time after the end
of the plan at which it is given up, s"""
PASSAGE_WINDOW = 0.2
"""Time before and after the planned one in which the passage of a gate is looked for, s"""


class TogtTrack(NamedTuple):
    """A track.

    Attributes:
        openings: Openings in order; a gate with a length has several.
        ends: (2, 3) start and end, m.
    """

    openings: list[Opening]
    ends: np.ndarray


class TogtFlight(NamedTuple):
    """A flight along a plan.

    Attributes:
        time: Duration of the plan, and the delay with which the drone arrives near the end, or at
            least the time until it is given up, s. Plans arrive softly: the last centimetres do
            not count.
        excess: (G,) distance from each opening, m.
        error: Largest distance from the plan, m.
        position: (T, 3) positions, m.
        speed: (T,) speeds, m/s.
    """

    time: float
    excess: np.ndarray
    error: float
    position: np.ndarray
    speed: np.ndarray


def read_togt_track(path: Path) -> TogtTrack:
    """Read a track of TOGT-Planner, with the exact shapes of its gates.

    Raises:
        ValueError: If the file is damaged; the message names the gate and the field.
    """
    track = read_yaml(path)
    if not isinstance(track, dict):
        raise ValueError(f"track {path} is {shown(track)}: gates and orders are needed")
    orders = as_sequence(f"orders of track {path}", track.get("orders"), most=MAX_TRACK_GATES)
    openings: list[Opening] = []
    for name in map(str, orders):
        table = track.get(name)
        if not isinstance(table, dict):
            raise ValueError(f"orders of track {path} has {name!r}: {suggest_names(name, track)}")
        openings += _read_openings(f"gate {name!r} of track {path}", table)
    ends = []
    for name in ("initState", "endState"):
        state = track.get(name)
        if not isinstance(state, dict):
            raise ValueError(
                f"{name} of track {path} is {shown(state)}: a table with pos is needed"
            )
        ends.append(points_of(f"pos in {name} of track {path}", state.get("pos"))[0])
    return TogtTrack(openings, np.array(ends))


def _regular(count: int, radius: float, first: float) -> np.ndarray:
    """Return the corners (count, 2) of a regular polygon, of which one is at angle `first`."""
    angle = first + 2.0 * math.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _rectangle(height: float, width: float) -> np.ndarray:
    return 0.5 * np.array([[-height, -width], [height, -width], [height, width], [-height, width]])


def _triangle(height: float, width: float) -> np.ndarray:
    return 0.5 * np.array([[-height, -width], [height, 0.0], [-height, width]])


SHAPES: dict[str, tuple[dict[str, str], Any]] = {
    "RectanglePrisma": ({"height": "marginH", "width": "marginW"}, _rectangle),
    "TrianglePrisma": ({"height": "margin", "width": "margin"}, _triangle),
    "PentagonPrisma": ({"radius": "margin"}, lambda radius: _regular(5, radius, 0.0)),
    "HexagonPrisma": ({"side": "margin"}, lambda side: _regular(6, side, math.pi / 2)),
    "SingleBall": ({"radius": "margin"}, None),
}
"""Shapes: fields with the margins that reduce them, and corners, anticlockwise, by the fields"""


def _read_openings(label: str, table: dict[str, Any]) -> list[Opening]:
    """Return the openings of a gate: more than one if it has a length."""
    fields, corners_of = find_choice(f"type of {label}", table.get("type"), SHAPES)
    sizes = [
        finite(f"{field} of {label}", table.get(field), 0, 100)
        - finite(f"{margin} of {label}", table.get(margin, 0.0), 0, 100)
        for field, margin in fields.items()
    ]
    if min(sizes) <= 0.0:
        raise ValueError(f"{label} is {min(sizes):g} m wide without its margin: widen it")
    (centre,) = points_of(f"position of {label}", table.get("position"))
    if corners_of is None:
        return [Opening(centre, np.zeros((0, 3)), np.zeros(0), sizes[0])]
    (angles,) = points_of(f"rpy of {label}", table.get("rpy"))
    x, y, z = np.array(axes(from_euler(*np.radians(angles).tolist())))
    corners = corners_of(*sizes)
    edges = np.roll(corners, -1, axis=0) - corners
    flat = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    flat /= np.sqrt((flat**2).sum(axis=1, keepdims=True))
    normals = np.concatenate([flat @ np.array([x, y]), [z, -z]])
    inside = (flat * corners).sum(axis=1)
    length = finite(f"length of {label}", table.get("length", 0.0), 0, 1000)
    between = int(finite(f"midpoints of {label}", table.get("midpoints", 0), 0, 100))
    if length <= 1e-3:
        return [Opening(centre, normals, np.append(inside, (0.0, 0.0)), math.inf)]
    half = 0.5 * length
    faces = [np.append(inside, (size, size)) for size in (0.0, half, 0.0)]
    first = Opening(centre + half * z, normals, faces[0], math.inf)
    last = Opening(centre - half * z, normals, faces[2], math.inf)
    return [first, *[Opening(centre, normals, faces[1], math.inf)] * between, last]


def write_togt_urdf(path: Path) -> None:
    """Write the drone of TOGT-Planner as an airframe without drag, damping and motor lag."""
    place = f"{TOGT_ARM * math.sqrt(0.5):.6f}"
    rotors = "".join(
        f'<rotor x="{x}{place}" y="{y}{place}" spin="{spin}"/>'
        for x, y, spin in (("", "-", "ccw"), ("-", "-", "cw"), ("-", "", "ccw"), ("", "", "cw"))
    )
    inertia = " ".join(
        f'{name}="{value}"' for name, value in zip(("ixx", "iyy", "izz"), TOGT_INERTIA, strict=True)
    )
    path.write_text(
        f"""<robot name="togt">
<airframe>
<thrust_coefficient value="{THRUST_COEFFICIENT}"/>
<torque_ratio value="{TOGT_TORQUE_RATIO}"/>
<max_rotor_speed value="{math.sqrt(TOGT_THRUST[1] / THRUST_COEFFICIENT)}"/>
<motor_lag up="0" down="0"/>
<rotor_drag xy="0" z="0"/>
<propeller_radius value="0.0635"/>
<rate_damping x="0" y="0" z="0"/>
<body_drag xy="0" z="0"/>
<max_speed value="60"/>
{rotors}
</airframe>
<link name="base">
<inertial><mass value="{TOGT_MASS}"/><inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><cylinder radius="0.17" length="0.07"/></geometry></collision>
</link>
</robot>
""",
        encoding="utf-8",
    )


def fly_plan(plan: PolynomialFlight, track: TogtTrack, urdf: Path) -> TogtFlight:
    """Fly along a plan with body rates and thrust, of the loops of position and attitude here.

    Below are the rate loop and the mixer of this package. The rates are commanded ahead of its
    lag, so that the angular acceleration is the wanted one.

    Args:
        plan: The plan.
        track: Its track.
        urdf: File of `write_togt_urdf`.
    """
    count = math.ceil((plan.duration + OVERTIME) * FLIGHT_HZ)
    motion = plan.motion(np.arange(count) / FLIGHT_HZ)
    _, along, turn, bend = flat_attitude(motion, TOGT_GRAVITY)
    spin, spun = np.cross(along, turn), np.cross(along, bend)
    airspace = Airspace(
        track.ends[:1],
        urdf,
        physics_hz=FLIGHT_HZ,
        decision_hz=FLIGHT_HZ,
        dynamics="rigid_body",
        effects=(),
        gravity=TOGT_GRAVITY,
        rotor_speed="hover",
        max_speed=60.0,
    )
    weight = np.array((0.0, 0.0, TOGT_GRAVITY))
    swarm, lag = airspace.swarm, 2.0 * DAMPING * FASTEST_ATTITUDE
    position, speed = np.zeros((count, 3)), np.zeros(count)
    for k in range(count):
        here, velocity = swarm.position[0], swarm.velocity[0]
        position[k], speed[k] = here, math.sqrt(float(velocity @ velocity))
        body, rates = np.array(axes(tuple(swarm.quaternion[0]))), swarm.rates[0]
        w = TRACKING_FREQUENCY
        wanted = motion[k, 2] + w * w * (motion[k, 0] - here) + 2.0 * w * (motion[k, 1] - velocity)
        force = wanted + weight
        thrust = TOGT_MASS * float(np.clip(force @ body[2], 0.0, 4.0 * TOGT_THRUST[1] / TOGT_MASS))
        tilt = np.cross(body[2], force / max(math.sqrt(float(force @ force)), 1e-9))
        w = TILT_FREQUENCY
        faster = body @ spun[k] + w * w * (body @ tilt) + 2.0 * w * (body @ spin[k] - rates)
        faster[2] = -2.0 * w * rates[2]
        target = rates + faster / (lag, lag, 0.5 * lag)
        airspace.command(0, SetpointLevel.RATES, (*target, thrust))
        airspace.step()
    airspace.close()
    planned = np.cumsum(plan.durations)[plan.gates]
    first = round(float(planned[-1]) * FLIGHT_HZ)
    arrived = _find_arrival(position, speed, track.ends[1], first)
    plan_speed = np.sqrt((motion[:, 1] ** 2).sum(axis=1))
    due = _find_arrival(motion[:, 0], plan_speed, track.ends[1], first)
    time = plan.duration + (arrived - due) / FLIGHT_HZ
    window = round(PASSAGE_WINDOW * FLIGHT_HZ)
    excess = []
    for opening, moment in zip(track.openings, planned, strict=True):
        middle = round(float(moment) * FLIGHT_HZ)
        near = position[max(middle - window, 0) : middle + window]
        excess.append(min(float(opening.excess(place).max()) for place in near))
    error = float(np.sqrt(((position - motion[:, 0]) ** 2).sum(axis=1)).max())
    return TogtFlight(time, np.array(excess), error, position, speed)


def _find_arrival(position: np.ndarray, speed: np.ndarray, end: np.ndarray, first: int) -> int:
    """Return the first step from `first` near the end and slow; the number of steps without one."""
    away = np.sqrt(((position - end) ** 2).sum(axis=1))
    near = (away < ARRIVAL) & (speed < ARRIVAL_SPEED)
    near[:first] = False
    return int(np.argmax(near)) if near.any() else len(near)
