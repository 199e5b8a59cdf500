"""Tasks that users generate: Poisson arrivals, decision by decision.

Times are in s since the decision began, and a decision takes `dt` s.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import log1p
from bulletuav.compiled.kernel import allocating, func
from bulletuav.errors import as_sequence, finite, numbers_of


class Tasks(NamedTuple):
    """Tasks of one decision, K in all of W worlds.

    Attributes:
        first: Bounds (W + 1,): the tasks of world w are first[w] up to first[w + 1].
        user: User (K,) who generated each task, 0 up to U - 1.
        time: Time (K,) of its generation, s since the decision began; ascending in each world.
        bits: Size (K,) of each task, bit.
    """

    first: np.ndarray
    user: np.ndarray
    time: np.ndarray
    bits: np.ndarray


class Arrivals:
    """Poisson arrivals of tasks, decision by decision, with uniform sizes.

    The users' processes are merged: a task is a user's with the chance of its share of the rate.

    Attributes:
        cumulative: Cumulative rates (U,), which tell whose a task is, 1/s.
        decision: Length of a decision, s, and least and greatest size of a task, bit.
    """

    def __init__(self, rates: np.ndarray, dt: float, bits: tuple[float, float]) -> None:
        """Set up the arrivals.

        Args:
            rates: Tasks (U,) that each user generates, 1/s.
            dt: Length of a decision, s.
            bits: Least and greatest size of a task, bit.

        Raises:
            ValueError: A rate is below 0, dt is not above 0, or sizes are not above 0 in
                ascending order.
        """
        rates = numbers_of("rates are", rates)
        low, high = (finite("bits", value) for value in as_sequence("bits", bits, 2))
        if not 0 < low <= high:
            raise ValueError(
                f"bits are {bits!r}: (low, high) above 0 in ascending order are needed"
            )
        if not finite("dt", dt) > 0:
            raise ValueError(f"dt is {dt!r}: seconds above 0 are needed")
        if rates.ndim != 1 or not rates.size:
            raise ValueError(f"rates have shape {rates.shape}: (users,) is needed")
        if not (np.isfinite(rates) & (rates >= 0)).all():
            raise ValueError(
                f"rates are {rates!r}: finite numbers of tasks per second, at least 0, are needed"
            )
        self.cumulative = np.cumsum(rates)
        self.decision = (float(dt), float(low), float(high))
        self._mean = float(self.cumulative[-1] * dt)

    def draw(
        self,
        rng: Sequence[np.random.Generator | None],
        flying: np.ndarray,
        first: np.ndarray,
        room: np.ndarray,
    ) -> np.ndarray:
        """Draw the numbers of which `spread` makes the tasks of one decision.

        Args:
            rng: Generator of each of the W worlds; None is possible where a world does not fly.
            flying: Whether (W,) each world has tasks: an episode is under way. Every such world
                draws from its own generator.
            first: Bounds (W + 1,) of the worlds' tasks, written.
            room: Array for the numbers, written.

        Returns:
            The room, or a larger one where the numbers are more.
        """
        counts, used = [0] * len(first), 0
        for w in flying.nonzero()[0].tolist():
            generator = rng[w]
            assert generator is not None  # a world that flies was reset
            counts[w + 1] = count = generator.poisson(self._mean)
            if count:
                # Three numbers a task, and one for the gap after the last
                begin, used = used, used + 3 * count + 1
                if used > len(room):
                    room = np.concatenate([room[:begin], np.empty(2 * used - begin)])
                room[begin:used] = generator.random(used - begin)
        first[:] = list(itertools.accumulate(counts))
        return room


@func
def _first_above(ascending: np.ndarray, value: float) -> int:
    """Find the first of ascending numbers that is greater; as `np.searchsorted` from the right.

    Stored machine code of that one imports SciPy where it is loaded.
    """
    low, high = 0, len(ascending)
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] > value:
            high = middle
        else:
            low = middle + 1
    return low


@allocating
def spread(
    first: np.ndarray,
    uniform: np.ndarray,
    cumulative: np.ndarray,
    dt: float,
    low: float,
    high: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make user, time and bits (K,) of tasks from uniform numbers, 3 n + 1 of a world with n > 0.

    Times are sums of n + 1 exponential gaps, scaled to `dt`: n uniform times in ascending order
    without sorting (L. Devroye, Non-uniform random variate generation, 1986, chapter V).
    """
    user = np.empty(first[-1], dtype=np.int64)
    time = np.empty(first[-1])
    bits = np.empty(first[-1])
    offset = 0
    for w in range(len(first) - 1):
        begin = first[w]
        count = first[w + 1] - first[w]
        if count == 0:
            continue
        passed = 0.0
        # Gap, user and size of every task
        for k in range(count):
            passed -= log1p(-uniform[offset + k])
            time[begin + k] = passed
            share = uniform[offset + count + k] * cumulative[-1]
            user[begin + k] = _first_above(cumulative, share)
            bits[begin + k] = low + (high - low) * uniform[offset + 2 * count + k]
        offset += 3 * count + 1
        # The last gap lies between the last task and the end of the decision
        passed -= log1p(-uniform[offset - 1])
        time[begin : begin + count] *= dt / passed
    return user, time, bits
