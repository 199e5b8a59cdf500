"""Generation of computing tasks by users: Poisson arrivals.

Times are in s since the start of the decision, and a decision takes `dt` s.
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
        first: Offsets (W + 1,): the tasks of world w are first[w] to first[w + 1] - 1.
        user: User (K,) that generated each task, 0 to U - 1.
        time: Generation time (K,), s since the start of the decision; ascending in each world.
        bits: Size (K,) of each task, bit.
    """

    first: np.ndarray
    user: np.ndarray
    time: np.ndarray
    bits: np.ndarray


class Arrivals:
    """Poisson arrivals of tasks with uniformly distributed sizes.

    The processes of the users are merged; a task is assigned to a user with probability
    proportional to the user's arrival rate.

    Attributes:
        cumulative: Cumulative arrival rates (U,) of the users, 1/s.
        decision: Length of a decision, s, and minimum and maximum size of a task, bit.
    """

    def __init__(self, rates: np.ndarray, dt: float, bits: tuple[float, float]) -> None:
        """Validate and store the parameters.

        Args:
            rates: Arrival rates (U,) of the users, 1/s.
            dt: Length of a decision, s.
            bits: Minimum and maximum size of a task, bit.

        Raises:
            ValueError: If a rate is negative, dt is not positive, or the sizes are not positive and
                ascending.
        """
        rates = numbers_of("rates are", rates)
        low, high = (finite("bits", value) for value in as_sequence("bits", bits, 2))
        if not 0 < low <= high:
            raise ValueError(f"bits are {bits!r}: (low, high) above 0 with low <= high is needed")
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
        buffer: np.ndarray,
    ) -> np.ndarray:
        """Draw the random numbers of the tasks of one decision, see `make_tasks`.

        Args:
            rng: Generator of each of the W worlds; may be None for worlds that do not fly.
            flying: Whether (W,) an episode of each world is running. Each such world draws from its
                own generator.
            first: Offsets (W + 1,) of the tasks of each world, written.
            buffer: Buffer for the numbers, written.

        Returns:
            The buffer, or a larger one if there are more numbers.
        """
        counts, used = [0] * len(first), 0
        for w in flying.nonzero()[0].tolist():
            generator = rng[w]
            assert generator is not None  # set by the reset of the world
            counts[w + 1] = count = generator.poisson(self._mean)
            if count:
                # Three numbers per task, and one for the interval after the last task
                begin, used = used, used + 3 * count + 1
                if used > len(buffer):
                    buffer = np.concatenate([buffer[:begin], np.empty(2 * used - begin)])
                buffer[begin:used] = generator.random(used - begin)
        first[:] = list(itertools.accumulate(counts))
        return buffer


@func
def _first_above(ascending: np.ndarray, value: float) -> int:
    """Return the index of the first element above a value, as `np.searchsorted(side="right")`.

    Cached compiled code of `np.searchsorted` imports SciPy when it is loaded.
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
def make_tasks(
    first: np.ndarray,
    uniform: np.ndarray,
    cumulative: np.ndarray,
    dt: float,
    low: float,
    high: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute user, time and bits (K,) of tasks from uniform numbers, 3 n + 1 per world with n > 0.

    Times are cumulative sums of n + 1 exponential intervals, scaled to `dt`. They are distributed
    as n sorted uniform times.

    References:
        L. Devroye, Non-uniform random variate generation (1986), chapter V.
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
        # Interval, user and size of each task
        for k in range(count):
            passed -= log1p(-uniform[offset + k])
            time[begin + k] = passed
            share = uniform[offset + count + k] * cumulative[-1]
            user[begin + k] = _first_above(cumulative, share)
            bits[begin + k] = low + (high - low) * uniform[offset + 2 * count + k]
        offset += 3 * count + 1
        # The last interval ends at the end of the decision
        passed -= log1p(-uniform[offset - 1])
        time[begin : begin + count] *= dt / passed
    return user, time, bits
