"""Messages that drones choose as part of their actions, and broadcast by radio."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.compiled.functions import power
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.control.actions.messages import read_message
from bulletuav.engine.engine import Engine
from bulletuav.errors import as_bool, as_instance, as_int, finite, points_of, shown
from bulletuav.geometry.closest_approach import insert_nearest
from bulletuav.geometry.grid import (
    MIN_POINTS,
    WIDENING,
    Grid,
    cells_around,
    fill_grid,
    is_whole,
    make_point_grid,
    num_rows,
    row_items,
)
from bulletuav.geometry.rotation import dot, minus, point
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup
from bulletuav.sensors.sight import line_of_sight
from bulletuav.vehicle.swarm import Swarm

MAX_SIZE = 256
"""Maximum number of numbers or tokens in a message"""
MAX_TOKENS = 1024
"""Maximum number of different tokens"""
MAX_DELAY = 10.0
"""Maximum delay, s"""
MAX_PLACE = 1e5
"""Maximum coordinate of a jammer, m"""
MAX_CHANCES = 2**22
"""Maximum number of random numbers that are drawn in one array"""
NUMBER_BITS = 32
"""Bits of a number that is no token: single precision, as in observations"""


@dataclass(frozen=True)
class Jammer:
    """Source of interference that flies along a closed path at constant speed.

    A message arrives if its power at the receiver exceeds that of the jammer by `min_ratio`. Both
    powers fall with the square of the distance, as in free space (Friis 1946, "A note on a simple
    transmission formula"). A message over the distance d thus arrives where the receiver is
    farther from the jammer than d 10^((power + min_ratio) / 20).

    Attributes:
        path: (P, 3) points of the path, m; a single point for a jammer at rest. After the last
            point it returns to the first.
        speed: Speed along the path, m/s.
        power: Radiated power relative to that of a drone, dB.
        min_ratio: Minimum ratio of signal to interference, dB.
    """

    path: Sequence[Sequence[float]]
    speed: float = 0.0
    power: float = 0.0
    min_ratio: float = 10.0

    def __post_init__(self) -> None:
        points = points_of("path of a jammer", self.path)
        if not len(points) or np.abs(points).max() > MAX_PLACE:
            raise ValueError(
                f"path of a jammer is {shown(self.path)}: points (x, y, z) from {-MAX_PLACE:g} to "
                f"{MAX_PLACE:g} m are needed"
            )
        object.__setattr__(self, "path", tuple(map(tuple, points.tolist())))
        object.__setattr__(self, "speed", finite("speed of a jammer", self.speed, 0.0, 1e3))
        for name in ("power", "min_ratio"):
            value = finite(f"{name} of a jammer", getattr(self, name), -100.0, 100.0)
            object.__setattr__(self, name, value)
        different = len(np.unique(points, axis=0))
        if (len(points) > 1) != (self.speed > 0) or (different == 1 and len(points) > 1):
            raise ValueError(
                f"speed of a jammer is {self.speed:g} m/s, and its path has {different} different "
                f"points: a moving jammer needs a speed above 0 and two of them or more"
            )

    @property
    def reach_ratio(self) -> float:
        """Maximum distance of a message over the receiver's distance from the jammer."""
        return float(power(10.0, -(self.power + self.min_ratio) / 20.0))

    def position(self, time: float) -> np.ndarray:
        """Return the position (3,) at a time in s, m."""
        points = np.array(self.path)
        steps = np.roll(points, -1, axis=0) - points
        lengths = np.sqrt((steps**2).sum(axis=1))
        total = float(lengths.sum())
        if total == 0.0:
            start: np.ndarray = points[0]
            return start
        along = math.fmod(self.speed * time, total)
        ends = np.cumsum(lengths)
        leg = min(int(np.searchsorted(ends, along, side="right")), len(points) - 1)
        done = (along - (ends[leg] - lengths[leg])) / lengths[leg]
        place: np.ndarray = points[leg] + done * steps[leg]
        return place


@dataclass(frozen=True)
class Channel:
    """Radio channel for messages that are part of each drone's action.

    In each decision of the world a drone broadcasts a message to all others, which observe it as
    "messages" after its delay. A drone that holds its action (`decision_every`) sends its message
    again, so that those hear it that decide later. A message is lost beyond the range, with the
    probability `loss`, without line of sight if that is required, or if a jammer is too near.

    Attributes:
        size: Number of numbers, or of tokens, in a message.
        tokens: Number of different tokens; None for numbers from -1 to 1.
        range: Range, m.
        loss: Probability that a receiver does not get a message.
        delay: Delay, s, rounded up to whole decisions.
        bandwidth: Bits that a drone can send per second. A message has 32 bits for each number, or
            log2(tokens), rounded up, for each token. If that is too much, drones send in every k-th
            decision, with the smallest possible k.
        line_of_sight: Whether buildings and obstacles block messages.
        jammer: Source of interference, or a dict of its attributes.
    """

    size: int = 8
    tokens: int | None = None
    range: float = math.inf
    loss: float = 0.0
    delay: float = 0.0
    bandwidth: float = math.inf
    line_of_sight: bool = False
    jammer: Jammer | None = None

    def __post_init__(self) -> None:
        self._keep("size", as_int("size of communication", self.size, 1, MAX_SIZE))
        if self.tokens is not None:
            tokens = as_int("tokens of communication", self.tokens, 2, MAX_TOKENS)
            self._keep("tokens", tokens)
        for name in ("range", "bandwidth"):
            value = getattr(self, name)
            if value != math.inf:
                value = finite(f"{name} of communication", value)
                self._keep(name, value)
            if not value > 0:
                raise ValueError(f"{name} of communication is {value:g}: it must be above 0")
        self._keep("loss", finite("loss of communication", self.loss, 0.0, 1.0))
        if self.loss == 1:
            raise ValueError("loss of communication is 1, and no message arrives: lower it")
        self._keep("delay", finite("delay of communication", self.delay, 0.0, MAX_DELAY))
        as_bool("line_of_sight of communication", self.line_of_sight)
        if self.jammer is not None:
            self._keep("jammer", as_instance("jammer of communication", Jammer, self.jammer))

    def _keep(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    @property
    def message_bits(self) -> int:
        """Bits of a message."""
        return self.size * (NUMBER_BITS if self.tokens is None else (self.tokens - 1).bit_length())

    @property
    def observed_size(self) -> int:
        """Numbers of an observed message: those of a continuous one, or one for each token."""
        return self.size * (self.tokens or 1)

    def decisions_between(self, period: float) -> int:
        """Return the number of decisions from one message of a drone to its next.

        Args:
            period: Time between decisions, s.
        """
        return max(1, _ceil(self.message_bits / (self.bandwidth * period)))

    def described(self) -> dict[str, Any]:
        """Return the attributes that differ from the defaults, as values that JSON can store."""
        changed = {
            one.name: getattr(self, one.name)
            for one in dataclasses.fields(self)
            if getattr(self, one.name) != one.default
        }
        if self.jammer is not None:
            changed["jammer"] = dataclasses.asdict(self.jammer)
        return {"size": self.size, **changed}


def as_channel(given: Any) -> Channel | None:
    """Check and convert the option `communication`.

    Args:
        given: A channel, a dict of its attributes, or None.

    Returns:
        The channel; None for None.

    Raises:
        ValueError: If the value is no channel, or an attribute is unknown or invalid.
    """
    return None if given is None else as_instance("communication", Channel, given)


def _ceil(number: float) -> int:
    """Round up to a whole number, except for rounding errors."""
    return math.ceil(number - 1e-9)


@allocating
def _deliver(
    position: np.ndarray,
    known: np.ndarray,
    flying: np.ndarray,
    sent: np.ndarray,
    reach: tuple[float, float, float],
    jammer: np.ndarray,
    first_receiver: int,
    chance: np.ndarray,
    lists_pairs: bool,
    near: np.ndarray,
    heard: np.ndarray,
    received: np.ndarray,
) -> np.ndarray:
    """Write which messages of one world arrive, and the nearest other drones.

    Large swarms are searched by grids.

    Args:
        position: (N, 3) positions, m.
        known: (N, 3) positions as the drones know them, m.
        flying: (N,) bool.
        sent: (N,) bool, drones whose messages arrive now.
        reach: Range, m; probability of a loss; maximum distance over that from the jammer.
        jammer: (J, 3) positions of the jammers, m.
        first_receiver: Index of the first of R drones that receive; all others are unchanged.
        chance: (R, N) random numbers from 0 to 1, a row for each receiver; (R, 0) without
            losses.
        lists_pairs: Whether to return the pairs.
        near: (N, K) written: the nearest other drones by `known`; -1 for none.
        heard: (N, K) bool, written: whether a message of that drone arrives.
        received: (N,) written: number of messages that arrive.

    Returns:
        (M, 2) receiver and sender of each message that arrives, if asked for.
    """
    drones = near.shape[0]
    farthest, loss, ratio = reach
    least = np.empty(near.shape[1])
    pairs, total = np.empty((0, 2), dtype=np.int64), 0
    grids = (make_point_grid(drones), make_point_grid(drones))
    by_grid = drones >= MIN_POINTS
    if by_grid:
        grids[0].place[:], grids[1].place[:] = known, position
        by_grid = fill_grid(grids[0], flying[None], 0) and fill_grid(grids[1], flying[None], 0)
    for k in range(chance.shape[0]):
        i = first_receiver + k
        near[i] = -1
        heard[i] = False
        received[i] = 0
        if not flying[i]:
            continue
        _find_nearest(known, flying, i, by_grid, grids[0], near[i], least)
        limit = farthest
        for source in range(jammer.shape[0]):
            limit = min(limit, ratio * _distance(jammer, source, position, i))
        # All drones in one row, or rows of the grid's cells
        box, rows = cells_around(grids[1], (0.0, 0.0, 0.0), 0.0), 1
        is_limited = by_grid and limit < np.inf
        if is_limited:
            box = cells_around(grids[1], point(position, i), limit + grids[1].sizes[1])
            rows = num_rows(box)
        for row in range(rows):
            first, last = row_items(grids[1], box, row) if is_limited else (0, drones)
            for m in range(first, last):
                j = grids[1].item[m] if is_limited else m
                if i == j or not (flying[j] and sent[j]):
                    continue
                is_lost = loss > 0.0 and chance[k, j] < loss
                if is_lost or _distance(position, j, position, i) > limit:
                    continue
                received[i] += 1
                for slot in range(near.shape[1]):
                    heard[i, slot] = heard[i, slot] or near[i, slot] == j
                if lists_pairs:
                    if total == pairs.shape[0]:
                        wider = np.empty((2 * total + drones, 2), dtype=np.int64)
                        wider[:total] = pairs
                        pairs = wider
                    pairs[total, 0], pairs[total, 1] = i, j
                    total += 1
    return pairs[:total]


@func
def _distance(one: np.ndarray, k: int, two: np.ndarray, i: int) -> float:
    """Return the distance from point i of `two` to point k of `one`, m."""
    between = minus(point(one, k), point(two, i))
    return math.sqrt(dot(between, between))


@kernel
def _find_nearest(
    known: np.ndarray,
    flying: np.ndarray,
    i: int,
    by_grid: bool,
    grid: Grid,
    near: np.ndarray,
    least: np.ndarray,
) -> None:
    """Write the flying drones nearest to drone i, by squared distance; `least` is a work array."""
    here = point(known, i)
    radius = grid.sizes[0]
    is_complete = False
    while not is_complete:
        found, rows = 0, 1
        box = cells_around(grid, here, radius)
        if by_grid:
            rows = num_rows(box)
        for row in range(rows):
            first, last = row_items(grid, box, row) if by_grid else (0, flying.size)
            for m in range(first, last):
                j = grid.item[m] if by_grid else m
                if j != i and flying[j]:
                    between = minus(point(known, j), here)
                    square = dot(between, between)
                    found = insert_nearest(near, least, found, j, square)
        within = radius - grid.sizes[1]
        is_complete = not by_grid or is_whole(grid, box) or near.size == 0
        if found == near.size and found > 0 and within > 0.0:
            is_complete = is_complete or least[found - 1] < within * within
        # A grid of a single point, or of coincident ones, has cells without an edge
        radius = WIDENING * max(radius, grid.sizes[1])


class Messages(Sensor):
    """Messages of the nearest other drones; the sensor of the option `communication`.

    The reading "messages" has a slot for each of the `num_neighbours` nearest other drones by
    their measured positions: 1 if a message of that drone arrived in this decision, else 0, and the
    message. A token is a vector of zeros with 1 at its index. Slots without a message are zeros.

    Attributes:
        channel: The channel.
    """

    name = "messages"

    def __init__(self, channel: Channel, is_discrete: bool) -> None:
        """Store the channel, and whether actions are discrete choices."""
        self.channel, self._is_discrete = channel, is_discrete

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the labels of all slots."""
        channel, labels = self.channel, []
        low = -1.0 if channel.tokens is None else 0.0
        for slot in range(1, setup.num_neighbours + 1):
            labels.append(Label(f"message from neighbour {slot}", "1", 0.0, 1.0))
            for k in range(channel.observed_size):
                number = f"message {k + 1}"
                if channel.tokens is not None:
                    number = f"token {k // channel.tokens + 1} is {k % channel.tokens}"
                labels.append(Label(f"neighbour {slot} {number}", "1", low, 1.0))
        return {self.name: tuple(labels)}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate messages in transit and received messages."""
        super().attach(setup, engine)
        (worlds, drones), channel = setup.shape, self.channel
        self._late = _ceil(channel.delay / setup.period)
        self._every = channel.decisions_between(setup.period)
        # In transit, latest first
        self._message = np.zeros((self._late + 1, worlds, drones, channel.size))
        self._sent = np.zeros((self._late + 1, worlds, drones), dtype=bool)
        # The nearest other drones, and whether a message of each arrived
        self._near = np.full((worlds, drones, setup.num_neighbours), -1)
        self._heard = np.zeros(self._near.shape, dtype=bool)
        self._num_sent, self._num_heard = np.zeros((2, worlds, drones), dtype=np.int64)
        self._received = np.zeros(drones, dtype=np.int64)
        jammer = channel.jammer
        self._ratio = 1.0 if jammer is None else jammer.reach_ratio

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Clear the messages of one world."""
        self._message[:, world], self._sent[:, world] = 0.0, False
        self._heard[world], self._near[world] = False, -1
        self._num_sent[world] = self._num_heard[world] = 0

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Send and receive messages in the worlds that executed a decision."""
        channel, worlds = self.channel, np.flatnonzero(moment.flying).tolist()
        given = read_message(moment.action, channel.size, channel.tokens, self._is_discrete)
        for w in worlds:
            self._message[1:, w], self._sent[1:, w] = self._message[:-1, w], self._sent[:-1, w]
            self._message[0, w] = given[w]
            is_due = (moment.steps[w] - 1) % self._every == 0
            self._sent[0, w] = moment.mask[w] & is_due
            self._receive(w, moment)
        self._num_sent[worlds] += self._sent[0, worlds]
        return {self.name: self._observe()}

    def _receive(self, w: int, moment: Moment) -> None:
        """Write which messages arrive in a world."""
        channel = self.channel
        jammers = np.zeros((0, 3))
        if channel.jammer is not None:
            jammers = channel.jammer.position(moment.steps[w] * self.setup.period)[None]
        position, near, heard = moment.after.position[w], self._near[w], self._heard[w]
        drones = len(position)
        # Blocks of receivers, so that random numbers of all pairs need little memory
        block = max(MAX_CHANCES // drones, 1) if channel.loss else drones
        for first in range(0, drones, block):
            shape = (min(block, drones - first), drones if channel.loss else 0)
            chance = moment.rngs[w].random(shape)
            pairs = _deliver(
                position,
                moment.position[w],
                moment.mask[w],
                self._sent[-1, w],
                (channel.range, channel.loss, self._ratio),
                jammers,
                first,
                chance,
                channel.line_of_sight,
                near,
                heard,
                self._received,
            )
            if len(pairs):
                # Drop messages between drones that do not see each other
                i, j = pairs.T
                worlds = np.full(len(pairs), w)
                is_blocked = ~line_of_sight(self.engine, position[i], position[j], worlds)
                i, j = i[is_blocked], j[is_blocked]
                np.subtract.at(self._received, i, 1)
                row, slot = np.nonzero(near[i] == j[:, None])
                heard[i[row], slot] = False
        self._num_heard[w] += self._received

    def _observe(self) -> np.ndarray:
        """Return the slots of all drones, (W, N, K (1 + numbers))."""
        channel, near = self.channel, self._near
        worlds, drones, count = near.shape
        arrived = (near >= 0) & self._heard
        message = self._message[-1][np.arange(worlds)[:, None, None], near]
        if channel.tokens is not None:
            message = message[..., None] == np.arange(channel.tokens)
        message = message.reshape(worlds, drones, count, -1) * arrived[..., None]
        slots = np.concatenate([arrived[..., None], message], axis=-1)
        seen: np.ndarray = slots.reshape(worlds, drones, -1).astype(float)
        return seen

    def info(self) -> Mapping[str, np.ndarray]:
        """Return the numbers of bits sent and of messages received since the reset."""
        bits = self._num_sent * self.channel.message_bits
        return {"message_bits": bits, "messages_heard": self._num_heard.copy()}

    def kept(self) -> Mapping[str, np.ndarray]:
        """Return messages in transit and received messages; see the base class."""
        return {
            "message": self._message.swapaxes(0, 1),
            "sent": self._sent.swapaxes(0, 1),
            "heard": self._heard,
            "near": self._near,
            "num_sent": self._num_sent,
            "num_heard": self._num_heard,
        }

    def kept_bounds(self) -> Mapping[str, tuple[float, float]]:
        """Return the bounds of messages and of indices; see the base class."""
        most = 1.0 if self.channel.tokens is None else self.channel.tokens - 1.0
        return {
            "message": (-1.0, most),
            "near": (-1, self.setup.shape[1] - 1),
            "num_sent": (0, np.inf),
            "num_heard": (0, np.inf),
        }
