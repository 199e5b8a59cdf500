"""Least-squares fit of airframe constants and per-log parameters over windows of flights.

The errors of a window are whitened by the covariance of all windows' errors, so that each error
counts according to its information. Large errors count less (soft L1 loss). Intervals are robust:
they hold for errors of any distribution that are correlated within a window and with neighbouring
windows.

References:
    W. Newey, K. West, A simple, positive semi-definite, heteroskedasticity and autocorrelation
    consistent covariance matrix, Econometrica 1987.
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
from bulletuav.identification.motor_gains import center_gains
from bulletuav.identification.weights import Weights, whiten
from bulletuav.vehicle.airframe import Airframe

SOFT_L1_SCALE = 2.0
"""Whitened error above which the loss grows less than quadratically, in standard deviations"""
PRIOR_STD = 1.0
"""Prior standard deviation of the constants' parameters about the airframe's own values"""
DIFFERENCE_STEP = 1e-4
"""Step of finite differences"""
MAX_ITERATIONS = 25
"""Maximum number of function evaluations of a fit"""
MAX_HALF_WIDTH_SIGNED = 0.2
"""Half width, in its scale, above which a signed constant counts as not identified"""
MAX_CHANGE = 3.0
"""Bound of the change of a parameter from its initial value"""
Progress = Callable[[float], None]


@dataclass(frozen=True)
class FlightPart:
    """Windows of a flight that are fitted or held out.

    Attributes:
        flight: The flight.
        windows: Indices of the windows, (K,), ascending.
    """

    flight: LoggedFlight
    windows: np.ndarray


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes:
        airframe: The airframe with the fitted constants.
        constants: The constants that were fitted.
        theta: Fitted parameters of the constants, (P,).
        deviation: Standard deviations of the parameters, (P,).
        quantile: Half width of the intervals, in standard deviations.
        log_parameters: Per-log parameters, (L, 9).
        log_parameter_deviation: Standard deviations of the free per-log parameters, (L, F).
    """

    airframe: Airframe
    constants: list[Constant]
    theta: np.ndarray
    deviation: np.ndarray
    quantile: float
    log_parameters: np.ndarray
    log_parameter_deviation: np.ndarray


class FitProblem:
    """Least-squares problem: constants of an airframe over windows of flights.

    The parameter vector theta holds the parameters of the C constants, followed by the free per-log
    parameters of each of the L parts.
    """

    def __init__(
        self,
        parts: Sequence[FlightPart],
        airframe: Airframe,
        constants: list[Constant],
        free: np.ndarray,
        progress: Progress,
    ) -> None:
        """Define the problem.

        Args:
            parts: The L parts of flights to fit.
            airframe: The airframe with the initial values.
            constants: The constants to fit; empty to fit the per-log parameters only.
            free: Mask of the per-log parameters to fit, (9,) bool.
            progress: Callback that receives the number of evaluations.
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
        """Return the parameters of the airframe's own constants and zero per-log parameters."""
        return np.concatenate([self.start, np.zeros(len(self.parts) * len(self.free))])

    def log_part(self, theta: np.ndarray) -> np.ndarray:
        """Return a view (L, free) of the per-log parameters in a parameter vector."""
        return theta[len(self.constants) :].reshape(len(self.parts), -1)

    def unpack(self, theta: np.ndarray) -> tuple[Airframe, np.ndarray]:
        """Return the airframe and the per-log parameters (L, 9) of a parameter vector."""
        log_parameters = np.zeros((len(self.parts), NUM_LOG_PARAMETERS))
        log_parameters[:, self.free] = self.log_part(theta)
        count = len(self.constants)
        return with_constants(self.airframe, self.constants, theta[:count]), log_parameters

    def errors(self, theta: np.ndarray) -> list[PredictionErrors]:
        """Compute the prediction errors of each part."""
        airframe, log_parameters = self.unpack(theta)
        self.evaluations += 1
        self.progress(self.evaluations)
        return [
            compute_errors(part.flight, part.windows, airframe, own)
            for part, own in zip(self.parts, log_parameters, strict=True)
        ]

    def whitened(self, theta: np.ndarray) -> list[np.ndarray]:
        """Compute the whitened errors of each part, (K, E)."""
        assert self.weights is not None
        return [whiten(errors, self.weights) for errors in self.errors(theta)]

    def priors(self, theta: np.ndarray) -> np.ndarray:
        """Return the parameters' deviations from their prior means, in standard deviations."""
        count = len(self.constants)
        own = self.log_part(theta).ravel() / LOG_PARAMETER_STD
        return np.concatenate([(theta[:count] - self.start) / PRIOR_STD, own])

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Return all whitened errors, followed by the prior residuals."""
        found = [part.ravel() for part in self.whitened(theta)]
        return np.concatenate([*found, self.priors(theta)])

    def slopes(self, theta: np.ndarray) -> list[np.ndarray]:
        """Return the derivatives of the whitened errors by theta, (K, E, P) for each part."""
        count = len(self.constants)
        own = len(self.free)
        base = self.whitened(theta)
        slopes = [np.zeros((*part.shape, len(theta))) for part in base]
        for k in range(count + own):
            moved = theta.copy()
            if k < count:
                moved[k] += DIFFERENCE_STEP
            else:
                # One step changes a per-log parameter of all logs: it affects the errors of its own
                # log only
                self.log_part(moved)[:, k - count] += DIFFERENCE_STEP
            for i, part in enumerate(self.whitened(moved)):
                column = k if k < count else count + i * own + k - count
                slopes[i][..., column] = (part - base[i]) / DIFFERENCE_STEP
        return slopes

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Return the Jacobian of `residuals`."""
        found = [part.reshape(-1, len(theta)) for part in self.slopes(theta)]
        return np.concatenate([*found, np.diag(1 / self._scale(len(theta)))])

    def _scale(self, size: int) -> np.ndarray:
        return np.where(np.arange(size) < len(self.constants), PRIOR_STD, LOG_PARAMETER_STD)

    def solve(self, theta: np.ndarray) -> np.ndarray:
        """Solve the least-squares problem from an initial parameter vector."""
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
        """Compute the information of the windows about the parameters."""
        scale = self._scale(len(theta))
        curves = []
        scores = []
        for errors, slopes in zip(self.whitened(theta), self.slopes(theta), strict=True):
            stretch = 1.0 + (errors / SOFT_L1_SCALE) ** 2
            weighted = np.swapaxes(stretch[..., None] ** -1.5 * slopes, 1, 2)
            curves.append(weighted @ slopes)
            scores.append(np.einsum("ke,kep->kp", stretch**-0.5 * errors, slopes))
        # Per-log parameters contribute their actual prior score; constants contribute the expected
        # one, so that the interval of an unobservable constant is as wide as its prior
        drawn = self.priors(theta) / scale
        drawn[: len(self.constants)] = 1 / PRIOR_STD
        return Information(curves, scores, 1 / scale**2, drawn**2)

    def find_identified(self, theta: np.ndarray) -> np.ndarray:
        """Find the constants that the windows determine, by backward elimination.

        Returns:
            Mask of the constants, (C,) bool.
        """
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
        """Return the result for a parameter vector, with standard deviations."""
        known = self.information(theta)
        covariance = known.covariance(np.arange(len(theta)))
        theta, covariance = center_gains(self.constants, theta, covariance)
        deviation = np.sqrt(np.diag(covariance))
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
