"""Actions: what an agent's numbers mean, and their decoding into setpoints."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bulletuav.control.gains import MAX_TILT
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.errors import choose
from bulletuav.kernel import kernel
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.rotors import RPM

MAX_RATES = np.array((2 * math.pi, 2 * math.pi, math.pi))  # rad/s, of action `rates`


@dataclass(frozen=True)
class ActionContext:
    """What a decoder may know, SI: airframes of the drones, speed limit, arena corners (3,), decision period, gravity."""

    airframes: Sequence[Airframe]
    max_speed: float
    arena_low: np.ndarray
    arena_high: np.ndarray
    period: float
    gravity: float


@dataclass(frozen=True)
class Action:
    """A kind of action: (W, N, A) numbers within [low, high] (N, A) become (W, N, S) setpoints at one level.

    `labels` name and scale each number of each drone; drones with fewer numbers (rotors) than A do not read the last ones.
    `decode` takes actions already clipped to the bounds and the velocities commanded last (W, N, 3); `encode` is its inverse
    on the setpoint's first three numbers, for policies that think in metres, and takes the same velocities where the action
    is relative to them. `choices` is how many discrete actions there
    are: then A = 1 and the number is the choice.
    """

    name: str
    level: SetpointLevel
    labels: tuple[tuple[str, ...], ...]
    low: np.ndarray
    high: np.ndarray
    decode: Callable[[np.ndarray, np.ndarray], np.ndarray]
    encode: Callable[..., np.ndarray] | None = None
    choices: int | None = None

    def size(self, drone: int) -> int:
        """How many numbers this drone reads."""
        return len(self.labels[drone])


@kernel
def limit_norm(vector, limit):
    """(W, N, 3) vectors, those longer than `limit` shortened to it."""
    result = np.empty(vector.shape)
    for w in range(vector.shape[0]):
        for i in range(vector.shape[1]):
            square = 0.0
            for k in range(3):
                square += vector[w, i, k] ** 2
            share = limit / max(math.sqrt(square), limit)
            for k in range(3):
                result[w, i, k] = share * vector[w, i, k]
    return result


def _with_yaw(vector: np.ndarray, yaw: np.ndarray | float = 0.0) -> np.ndarray:
    """(W, N, 3) to (W, N, 4)."""
    out = np.zeros((*vector.shape[:-1], 4))
    out[..., :3], out[..., 3] = vector, yaw
    return out


def _uniform(
    flyable: ActionContext,
    name: str,
    level: SetpointLevel,
    labels: tuple[str, ...],
    decode,
    encode=None,
) -> Action:
    """An action normalised to [-1, 1], with the same numbers for every drone."""
    drones = len(flyable.airframes)
    ones = np.ones((drones, len(labels)))
    return Action(name, level, (labels,) * drones, -ones, ones, decode, encode)


def velocity(flyable: ActionContext) -> Action:
    """Velocity east, north, up over max_speed; the speed is limited to max_speed, direction kept. Yaw is held at 0."""
    speed = flyable.max_speed
    labels = tuple(f"v{axis} / {speed:g} m/s" for axis in "xyz")

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return _with_yaw(limit_norm(action * speed, speed))

    return _uniform(
        flyable,
        "velocity",
        SetpointLevel.VELOCITY,
        labels,
        decode,
        lambda velocity, commanded=None: velocity / speed,
    )


def velocity_increment(flyable: ActionContext) -> Action:
    """Change of the commanded velocity, by up to max_speed times the decision period on each axis; limited as `velocity`.

    An episode begins with the velocity that the drone starts with.
    """
    speed = flyable.max_speed
    step = speed * flyable.period
    labels = tuple(f"change of v{axis} / {step:g} m/s" for axis in "xyz")

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return _with_yaw(limit_norm(commanded + step * action, speed))

    def encode(velocity: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        change = (velocity - commanded) / step
        return change / np.maximum(np.abs(change).max(axis=-1, keepdims=True), 1.0)

    return _uniform(flyable, "velocity_increment", SetpointLevel.VELOCITY, labels, decode, encode)


def heading_speed(flyable: ActionContext) -> Action:
    """Heading (-1 to 1: -180 to 180 degrees from east, to the left), speed (-1 to 1: 0 to max_speed), climb over max_speed.

    The nose points along the heading; the speed with climb is limited to max_speed.
    """
    speed = flyable.max_speed
    labels = ("heading / 180 degrees", f"2 speed / {speed:g} m/s - 1", f"climb / {speed:g} m/s")

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        heading, forward = np.pi * action[..., 0], speed * (action[..., 1] + 1) / 2
        wanted = np.stack(
            [forward * np.cos(heading), forward * np.sin(heading), speed * action[..., 2]], axis=-1
        )
        return _with_yaw(limit_norm(wanted, speed), heading)

    return _uniform(flyable, "heading_speed", SetpointLevel.VELOCITY, labels, decode)


def target_position(flyable: ActionContext) -> Action:
    """Position to fly to and stop at: -1 and 1 are the arena's lower and upper bounds of each axis. Yaw is held at 0."""
    centre, half = (
        (flyable.arena_low + flyable.arena_high) / 2,
        (flyable.arena_high - flyable.arena_low) / 2,
    )
    labels = tuple(
        f"{axis} = {c:g} + {h:g} a m" for axis, c, h in zip("xyz", centre, half, strict=True)
    )

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return _with_yaw(centre + half * action)

    def encode(position: np.ndarray, commanded: object = None) -> np.ndarray:
        return (position - centre) / half

    return _uniform(flyable, "target_position", SetpointLevel.POSITION, labels, decode, encode)


def attitude(flyable: ActionContext) -> Action:
    """Roll and pitch (over 55 degrees), yaw (over 180 degrees), collective thrust (-1 none, 1 the most)."""
    scale = np.array((MAX_TILT, MAX_TILT, np.pi))
    most = np.array([airframe.max_thrust for airframe in flyable.airframes])
    labels = (
        "roll / 55 degrees",
        "pitch / 55 degrees",
        "yaw / 180 degrees",
        "2 thrust / max thrust - 1",
    )

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [scale * action[..., :3], (most * (action[..., 3] + 1) / 2)[..., None]], axis=-1
        )

    return _uniform(flyable, "attitude", SetpointLevel.ATTITUDE, labels, decode)


def rates(flyable: ActionContext) -> Action:
    """Body rates (over 360, 360 and 180 degrees a second), collective thrust (-1 none, 1 the most)."""
    most = np.array([airframe.max_thrust for airframe in flyable.airframes])
    labels = (
        "p / 360 degrees/s",
        "q / 360 degrees/s",
        "r / 180 degrees/s",
        "2 thrust / max thrust - 1",
    )

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [MAX_RATES * action[..., :3], (most * (action[..., 3] + 1) / 2)[..., None]], axis=-1
        )

    return _uniform(flyable, "rates", SetpointLevel.RATES, labels, decode)


def _per_rotor(
    flyable: ActionContext, name: str, label: str, low: float, high: np.ndarray, decode
) -> Action:
    """An action with a number for each rotor; `high` (N,) bounds each drone's."""
    counts = [len(airframe.rotors) for airframe in flyable.airframes]
    exists = np.arange(max(counts)) < np.array(counts)[:, None]
    labels = tuple(tuple(f"rotor {r}{label}" for r in range(count)) for count in counts)
    return Action(
        name,
        SetpointLevel.ROTOR,
        labels,
        np.where(exists, low, 0.0),
        np.where(exists, high[:, None], 0.0),
        decode,
    )


def rotor(flyable: ActionContext) -> Action:
    """Thrust of each rotor: -1 none, 1 the most; the speed is max_rotor_speed sqrt((a + 1) / 2)."""
    most = np.array([airframe.max_rotor_speed for airframe in flyable.airframes])[:, None]

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return most * np.sqrt(0.5 * (action + 1))

    return _per_rotor(
        flyable, "rotor", ": 2 thrust / max thrust - 1", -1.0, np.ones(len(most)), decode
    )


def rpm(flyable: ActionContext) -> Action:
    """Speed of each rotor in revolutions per minute, raw."""
    most = np.array([airframe.max_rotor_speed for airframe in flyable.airframes]) / RPM
    return _per_rotor(flyable, "rpm", ", rpm", 0.0, most, lambda action, commanded: action * RPM)


def hover_rpm(flyable: ActionContext) -> Action:
    """Speed of each rotor about that of hover, +-5 %: the action of gym-pybullet-drones' HoverAviary."""
    hover = np.array([airframe.hover_speed(flyable.gravity) for airframe in flyable.airframes])[
        :, None
    ]
    ones = np.ones(len(hover))
    return _per_rotor(
        flyable,
        "hover_rpm",
        ": 20 (rpm / hover rpm - 1)",
        -1.0,
        ones,
        lambda action, commanded: hover * (1 + 0.05 * action),
    )


def _directions(name: str, flyable: ActionContext, directions: np.ndarray) -> Action:
    """One of some velocities at max_speed; the first is to stay."""
    speed, drones, last = flyable.max_speed, len(flyable.airframes), len(directions) - 1
    sizes = np.linalg.norm(directions, axis=1, keepdims=True)
    table = speed * directions / np.maximum(sizes, 1)
    labels = ((f"0 stay, 1 to {last} a velocity of {speed:g} m/s",),) * drones

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return _with_yaw(table[action[..., 0].astype(int)])

    low, high = np.zeros((drones, 1)), np.full((drones, 1), float(last))
    return Action(name, SetpointLevel.VELOCITY, labels, low, high, decode, choices=last + 1)


def discrete(flyable: ActionContext) -> Action:
    """One of 7 velocities: 0 stay; 1, 2 east, west; 3, 4 north, south; 5, 6 up, down; at max_speed."""
    axes = np.repeat(np.eye(3), 2, axis=0) * np.array([1, -1, 1, -1, 1, -1])[:, None]
    return _directions("discrete", flyable, np.concatenate([np.zeros((1, 3)), axes]))


def discrete_27(flyable: ActionContext) -> Action:
    """One of 27 velocities at max_speed: 0 stay, then every other (x, y, z) of -1, 0, 1, counted up with z the fastest."""
    moves = [move for move in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(move)]
    return _directions("discrete_27", flyable, np.array([(0.0, 0.0, 0.0), *moves]))


ACTIONS: dict[str, Callable[[ActionContext], Action]] = {
    action.__name__: action
    for action in (
        velocity,
        velocity_increment,
        heading_speed,
        target_position,
        attitude,
        rates,
        rotor,
        rpm,
        hover_rpm,
        discrete,
        discrete_27,
    )
}


def make_action(name: str, flyable: ActionContext) -> Action:
    """The action `name` for this swarm. Raises ValueError for an unknown name."""
    return choose("action", name, ACTIONS)(flyable)
