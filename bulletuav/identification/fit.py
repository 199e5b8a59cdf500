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
from bulletuav.identification.errors import (
    LOG_PARAMETER_STD,
    NUM_LOG_PARAMETERS,
    PredictionErrors,
    compute_errors,
    with_constants,
)
from bulletuav.identification.flight import LoggedFlight
from bulletuav.identification.intervals import MAX_HALF_WIDTH, Information, quantile
from bulletuav.identification.weights import Weights, whiten
from bulletuav.vehicle.airframe import Airframe

SOFT_L1_SCALE = 2.0
"""Error in standard deviations from which on errors count less"""
PRIOR_STD = 1.0
"""Standard deviation with which constants stay at the airframe's own, in their logarithm"""
DIFFERENCE_STEP = 1e-4
"""Step of numbers for derivatives"""
MAX_ITERATIONS = 25
"""Most iterations of a fit"""
MAX_HALF_WIDTH_SIGNED = 0.2
"""The same for constants of either sign, in their scale"""
MAX_CHANGE = 3.0
"""Bound of the logarithms of constants, about the start"""
Progress = Callable[[float], None]


@dataclass(frozen=True)
class FlightPart:
    """Windows of a flight that are fitted, or kept.

    Attributes:
        flight: The flight.
        windows: (K,) indices of its windows, in order.
    """

    flight: LoggedFlight
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
    theta: np.ndarray
    deviation: np.ndarray
    quantile: float
    log_parameters: np.ndarray
    log_parameter_deviation: np.ndarray


class FitProblem:
    """A least-squares problem: constants of an airframe over parts of flights."""

    def __init__(
        self,
        parts: Sequence[FlightPart],
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

    def initial_theta(self) -> np.ndarray:
        """Return the numbers at the airframe's own constants, and no offsets."""
        return np.concatenate([self.start, np.zeros(len(self.parts) * len(self.free))])

    def log_part(self, theta: np.ndarray) -> np.ndarray:
        """Return the logs' own numbers of all numbers, as a view (L, free)."""
        return theta[len(self.constants) :].reshape(len(self.parts), -1)

    def unpack(self, theta: np.ndarray) -> tuple[Airframe, np.ndarray]:
        """Return the airframe and the offsets (L, 7) of all numbers that are fitted."""
        log_parameters = np.zeros((len(self.parts), NUM_LOG_PARAMETERS))
        log_parameters[:, self.free] = self.log_part(theta)
        count = len(self.constants)
        return with_constants(self.airframe, self.constants, theta[:count]), log_parameters

    def errors(self, theta: np.ndarray) -> list[PredictionErrors]:
        """Return the errors in all parts."""
        airframe, log_parameters = self.unpack(theta)
        self.evaluations += 1
        self.progress(self.evaluations)
        return [
            compute_errors(part.flight, part.windows, airframe, own)
            for part, own in zip(self.parts, log_parameters, strict=True)
        ]

    def whitened(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return the whitened errors of all parts, (K, E) each."""
        assert self.weights is not None
        return [whiten(errors, self.weights) for errors in self.errors(theta)]

    def priors(self, theta: np.ndarray) -> np.ndarray:
        """Return how far numbers are from where they usually are, in standard deviations."""
        count = len(self.constants)
        own = self.log_part(theta).ravel() / LOG_PARAMETER_STD
        return np.concatenate([(theta[:count] - self.start) / PRIOR_STD, own])

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Return all whitened errors, then the priors."""
        found = [part.ravel() for part in self.whitened(theta)]
        return np.concatenate([*found, self.priors(theta)])

    def slopes(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return the derivatives of whitened errors, (K, E, P) of each part, by all numbers."""
        count = len(self.constants)
        own = len(self.free)
        base = self.whitened(theta)
        slopes = [np.zeros((*part.shape, len(theta))) for part in base]
        for k in range(count + own):
            moved = theta.copy()
            if k < count:
                moved[k] += DIFFERENCE_STEP
            else:
                # One kind of the logs' own numbers at once: each matters to its log alone
                self.log_part(moved)[:, k - count] += DIFFERENCE_STEP
            for i, part in enumerate(self.whitened(moved)):
                column = k if k < count else count + i * own + k - count
                slopes[i][..., column] = (part - base[i]) / DIFFERENCE_STEP
        return slopes

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Return the derivatives of `residuals`."""
        found = [part.reshape(-1, len(theta)) for part in self.slopes(theta)]
        return np.concatenate([*found, np.diag(1 / self._scale(len(theta)))])

    def _scale(self, size: int) -> np.ndarray:
        """Return the standard deviations of the priors."""
        return np.where(np.arange(size) < len(self.constants), PRIOR_STD, LOG_PARAMETER_STD)

    def solve(self, theta: np.ndarray) -> np.ndarray:
        """Return the numbers of the least squares from a start on."""
        half_width = np.full(len(theta), np.inf)
        half_width[: len(self.constants)] = MAX_CHANGE
        middle = np.concatenate([self.start, np.zeros(len(theta) - len(self.start))])
        solution = least_squares(
            self.residuals,
            np.clip(theta, middle - 0.99 * half_width, middle + 0.99 * half_width),
            jac=self.jacobian,
            bounds=(middle - half_width, middle + half_width),
            loss="soft_l1",
            f_scale=SOFT_L1_SCALE,
            x_scale="jac",
            ftol=1e-6,
            xtol=1e-6,
            max_nfev=MAX_ITERATIONS,
        )
        found: np.ndarray = solution.x
        return found

    def information(self, theta: np.ndarray) -> "Information":
        """Return what the windows tell about the numbers."""
        scale = self._scale(len(theta))
        curves = []
        scores = []
        for errors, slopes in zip(self.whitened(theta), self.slopes(theta), strict=True):
            stretch = 1.0 + (errors / SOFT_L1_SCALE) ** 2
            weighted = np.swapaxes(stretch[..., None] ** -1.5 * slopes, 1, 2)
            curves.append(weighted @ slopes)
            scores.append(np.einsum("ke,kep->kp", stretch**-0.5 * errors, slopes))
        # Priors: the logs' own numbers scatter; a constant that nothing tells is as unsure as that
        drawn = self.priors(theta) / scale
        drawn[: len(self.constants)] = 1 / PRIOR_STD
        return Information(curves, scores, 1 / scale**2, drawn**2)

    def find_identified(self, theta: np.ndarray) -> np.ndarray:
        """Tell which constants the windows tell, (C,) bool: the least sure one goes first."""
        known = self.information(theta)
        limit = np.array(
            [MAX_HALF_WIDTH_SIGNED if one.scale else MAX_HALF_WIDTH for one in self.constants]
        )
        keep = np.ones(len(theta), bool)
        while True:
            rest = np.flatnonzero(keep)
            size = int((rest < len(limit)).sum())
            if not size:
                return keep[: len(limit)]
            deviation = np.sqrt(np.diag(known.covariance(rest)))[:size]
            half_width = quantile(sum(map(len, known.scores)), size + len(self.free))
            excess = half_width * deviation / limit[rest[:size]]
            if excess.max() < 1:
                return keep[: len(limit)]
            keep[rest[int(np.argmax(excess))]] = False

    def make_fit(self, theta: np.ndarray) -> Fit:
        """Return what the numbers mean, with their deviations."""
        known = self.information(theta)
        deviation = np.sqrt(np.diag(known.covariance(np.arange(len(theta)))))
        airframe, log_parameters = self.unpack(theta)
        count = len(self.constants)
        return Fit(
            airframe=airframe,
            constants=self.constants,
            theta=theta[:count],
            deviation=np.hypot(deviation[:count], [one.resolution for one in self.constants]),
            quantile=quantile(sum(map(len, known.scores)), count + len(self.free)),
            log_parameters=log_parameters,
            log_parameter_deviation=self.log_part(deviation),
        )
