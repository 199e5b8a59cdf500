"""Least squares over windows of flights: constants, the logs' own numbers, and their intervals.

Errors of a window are whitened by the covariance of all windows' errors, so that those of one axis
count together as much as they tell. Large ones count less (soft L1). Intervals are robust: they
hold for errors of any distribution, correlated within a window and with the windows near it (W.
Newey, K. West, A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent
covariance matrix, Econometrica 1987).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from bulletuav.identification.constants import Constant
from bulletuav.identification.errors import NUM_OFFSETS, SPREAD, Errors, errors_of, with_constants
from bulletuav.identification.flight import Flight
from bulletuav.identification.intervals import UNSURE, Information, quantile
from bulletuav.identification.weights import Weights, whiten
from bulletuav.vehicle.airframe import Airframe

MILD = 2.0
"""Error in standard deviations from which on errors count less"""
WEAK = 1.0
"""Standard deviation with which constants stay at the airframe's own, in their logarithm"""
STEP = 1e-4
"""Step of numbers for derivatives"""
MOST_STEPS = 25
"""Most iterations of a fit"""
UNSURE_STEP = 0.2
"""The same for constants of either sign, in their scale"""
FARTHEST = 3.0
"""Bound of the logarithms of constants, about the start"""
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Part:
    """Windows of a flight that are fitted, or kept.

    Attributes:
        flight: The flight.
        windows: (K,) indices of its windows, in order.
    """

    flight: Flight
    windows: np.ndarray


@dataclass(frozen=True)
class Fit:
    """What a fit found.

    Attributes:
        airframe: The airframe with what was fitted.
        constants: What was fitted.
        numbers: (P,) constants as they are fitted.
        deviation: (P,) their standard deviations.
        quantile: Standard deviations from the middle to the ends of intervals.
        offsets: (L, 7) the logs' own numbers.
        offset_deviation: (L, F) standard deviations of those that were fitted.
    """

    airframe: Airframe
    constants: list[Constant]
    numbers: np.ndarray
    deviation: np.ndarray
    quantile: float
    offsets: np.ndarray
    offset_deviation: np.ndarray


class Problem:
    """A least-squares problem: constants of an airframe over parts of flights."""

    def __init__(
        self,
        parts: Sequence[Part],
        airframe: Airframe,
        constants: list[Constant],
        free: np.ndarray,
        progress: Progress,
    ) -> None:
        """Keep what the problem is made of.

        Args:
            parts: What is fitted.
            airframe: Where the fit starts.
            constants: Constants that are fitted; none to fit the logs' own numbers alone.
            free: (7,) bool, which of those.
            progress: Called with the evaluations so far.
        """
        self.parts = parts
        self.airframe = airframe
        self.constants = constants
        self.free = np.flatnonzero(free)
        self.progress = progress
        self.start = np.array([constant.encode(airframe) for constant in constants])
        self.weights: Weights | None = None
        self.evaluations = 0

    def begin(self) -> np.ndarray:
        """Return the numbers at the airframe's own constants, and no offsets."""
        return np.concatenate([self.start, np.zeros(len(self.parts) * len(self.free))])

    def own(self, numbers: np.ndarray) -> np.ndarray:
        """Return the logs' own numbers of all numbers, as a view (L, free)."""
        return numbers[len(self.constants) :].reshape(len(self.parts), -1)

    def split(self, numbers: np.ndarray) -> tuple[Airframe, np.ndarray]:
        """Return the airframe and the offsets (L, 7) of all numbers that are fitted."""
        offsets = np.zeros((len(self.parts), NUM_OFFSETS))
        offsets[:, self.free] = self.own(numbers)
        count = len(self.constants)
        return with_constants(self.airframe, self.constants, numbers[:count]), offsets

    def errors(self, numbers: np.ndarray) -> list[Errors]:
        """Return the errors in all parts."""
        airframe, offsets = self.split(numbers)
        self.evaluations += 1
        self.progress(self.evaluations)
        return [
            errors_of(part.flight, part.windows, airframe, own)
            for part, own in zip(self.parts, offsets, strict=True)
        ]

    def whitened(self, numbers: np.ndarray) -> list[np.ndarray]:
        """Return the whitened errors of all parts, (K, E) each."""
        assert self.weights is not None
        return [whiten(errors, self.weights) for errors in self.errors(numbers)]

    def priors(self, numbers: np.ndarray) -> np.ndarray:
        """Return how far numbers are from where they usually are, in standard deviations."""
        count = len(self.constants)
        own = self.own(numbers).ravel() / SPREAD
        return np.concatenate([(numbers[:count] - self.start) / WEAK, own])

    def residuals(self, numbers: np.ndarray) -> np.ndarray:
        """Return all whitened errors, then the priors."""
        found = [part.ravel() for part in self.whitened(numbers)]
        return np.concatenate([*found, self.priors(numbers)])

    def slopes(self, numbers: np.ndarray) -> list[np.ndarray]:
        """Return the derivatives of whitened errors, (K, E, P) of each part, by all numbers."""
        count = len(self.constants)
        own = len(self.free)
        base = self.whitened(numbers)
        slopes = [np.zeros((*part.shape, len(numbers))) for part in base]
        for k in range(count + own):
            moved = numbers.copy()
            if k < count:
                moved[k] += STEP
            else:
                # One kind of the logs' own numbers at once: each matters to its log alone
                self.own(moved)[:, k - count] += STEP
            for i, part in enumerate(self.whitened(moved)):
                column = k if k < count else count + i * own + k - count
                slopes[i][..., column] = (part - base[i]) / STEP
        return slopes

    def jacobian(self, numbers: np.ndarray) -> np.ndarray:
        """Return the derivatives of `residuals`."""
        found = [part.reshape(-1, len(numbers)) for part in self.slopes(numbers)]
        return np.concatenate([*found, np.diag(1 / self._scale(len(numbers)))])

    def _scale(self, size: int) -> np.ndarray:
        """Return the standard deviations of the priors."""
        return np.where(np.arange(size) < len(self.constants), WEAK, SPREAD)

    def solve(self, numbers: np.ndarray) -> np.ndarray:
        """Return the numbers of the least squares from a start on."""
        reach = np.full(len(numbers), np.inf)
        reach[: len(self.constants)] = FARTHEST
        middle = np.concatenate([self.start, np.zeros(len(numbers) - len(self.start))])
        solution = least_squares(
            self.residuals,
            np.clip(numbers, middle - 0.99 * reach, middle + 0.99 * reach),
            jac=self.jacobian,
            bounds=(middle - reach, middle + reach),
            loss="soft_l1",
            f_scale=MILD,
            x_scale="jac",
            ftol=1e-6,
            xtol=1e-6,
            max_nfev=MOST_STEPS,
        )
        found: np.ndarray = solution.x
        return found

    def information(self, numbers: np.ndarray) -> "Information":
        """Return what the windows tell about the numbers."""
        scale = self._scale(len(numbers))
        curves = []
        scores = []
        for errors, slopes in zip(self.whitened(numbers), self.slopes(numbers), strict=True):
            stretch = 1.0 + (errors / MILD) ** 2
            weighted = np.swapaxes(stretch[..., None] ** -1.5 * slopes, 1, 2)
            curves.append(weighted @ slopes)
            scores.append(np.einsum("ke,kep->kp", stretch**-0.5 * errors, slopes))
        # Priors: the logs' own numbers scatter; a constant that nothing tells is as unsure as that
        drawn = self.priors(numbers) / scale
        drawn[: len(self.constants)] = 1 / WEAK
        return Information(curves, scores, 1 / scale**2, drawn**2)

    def told(self, numbers: np.ndarray) -> np.ndarray:
        """Tell which constants the windows tell, (C,) bool: the least sure one goes first."""
        known = self.information(numbers)
        limit = np.array([UNSURE_STEP if one.scale else UNSURE for one in self.constants])
        keep = np.ones(len(numbers), bool)
        while True:
            rest = np.flatnonzero(keep)
            size = int((rest < len(limit)).sum())
            if not size:
                return keep[: len(limit)]
            deviation = np.sqrt(np.diag(known.covariance(rest)))[:size]
            reach = quantile(sum(map(len, known.scores)), size + len(self.free))
            excess = reach * deviation / limit[rest[:size]]
            if excess.max() < 1:
                return keep[: len(limit)]
            keep[rest[int(np.argmax(excess))]] = False

    def found(self, numbers: np.ndarray) -> Fit:
        """Return what the numbers mean, with their deviations."""
        known = self.information(numbers)
        deviation = np.sqrt(np.diag(known.covariance(np.arange(len(numbers)))))
        airframe, offsets = self.split(numbers)
        count = len(self.constants)
        return Fit(
            airframe=airframe,
            constants=self.constants,
            numbers=numbers[:count],
            deviation=np.hypot(deviation[:count], [one.resolution for one in self.constants]),
            quantile=quantile(sum(map(len, known.scores)), count + len(self.free)),
            offsets=offsets,
            offset_deviation=self.own(deviation),
        )
