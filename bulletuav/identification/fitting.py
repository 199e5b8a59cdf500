"""Split into fitted and held-out windows, and the sequence of fits."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from bulletuav.identification.constants import Constant
from bulletuav.identification.errors import (
    DELAY_UNIT,
    FREE_LEGS_PER_WINDOW,
    STATES_PER_LEG,
    PredictionErrors,
    compute_naive_errors,
)
from bulletuav.identification.fit import Fit, FitProblem, FlightPart, Progress
from bulletuav.identification.flight import LoggedFlight
from bulletuav.identification.logs import RATES
from bulletuav.identification.weights import compute_weights
from bulletuav.vehicle.airframe import Airframe

BLOCK = 4
"""Number of consecutive windows of a single log that are fitted or held out together"""
MIN_WINDOWS = 12
"""Minimum number of windows of a fit"""
ROUNDS = 3
"""Number of fits, each of which reweights the errors by the residuals of the previous one"""
DELAYS = np.arange(-0.1, 0.2001, 0.01)
"""Delays of the commands against the gyroscope's clock that the initial search tries, s"""
FALSE_ALARM_RATE = 0.01
"""Probability that a log whose motion is unrelated to its commands is rejected"""


def ignore_progress(_: float) -> None:
    """Ignore the progress (the default callback)."""


def split_flights(flights: Sequence[LoggedFlight]) -> tuple[list[FlightPart], list[FlightPart]]:
    """Split flights into fitted and held-out parts.

    Args:
        flights: The flights, in order.

    Returns:
        The fitted and the held-out parts. Several flights alternate, and the first one is fitted.
        Of a single flight, blocks of `BLOCK` windows alternate.

    Raises:
        ValueError: If there are fewer than `MIN_WINDOWS` windows to fit.
    """
    if len(flights) > 1:
        parts = [FlightPart(flight, np.arange(len(flight.windows))) for flight in flights]
        fitted, kept = parts[::2], parts[1::2]
    else:
        fitted, kept = ([part] for part in split_blocks(flights[0]))
    count = sum(len(part.windows) for part in fitted)
    if count < MIN_WINDOWS:
        raise ValueError(
            f"there are {count} windows of flight to fit (of {flights[0].dt * flights[0].steps:g} "
            f"s each): at least {MIN_WINDOWS} are needed; fly longer, or pass more logs"
        )
    return fitted, kept


def split_blocks(flight: LoggedFlight) -> tuple[FlightPart, FlightPart]:
    """Split a flight's windows into even and odd blocks of `BLOCK` windows."""
    index = np.arange(len(flight.windows))
    first = index // BLOCK % 2 == 0
    return FlightPart(flight, index[first]), FlightPart(flight, index[~first])


class StepwiseFit:
    """Fit that removes the constants that the logs do not determine, and fits the others again."""

    def __init__(
        self,
        parts: list[FlightPart],
        drone: Airframe,
        free: np.ndarray,
        is_explicit: bool,
        progress: Progress,
    ) -> None:
        self.parts = parts
        self.drone = drone
        self.free = free
        self.is_explicit = is_explicit
        self.progress = progress

    def run(self, constants: list[Constant]) -> Fit:
        """Fit the constants; unless they were requested, remove the unidentified ones and refit."""
        problem, theta = self._solve(constants, 0.1, ROUNDS)
        while not self.is_explicit:
            keep = problem.find_identified(theta)
            if keep.all():
                break
            start = np.concatenate([theta[: len(keep)][keep], theta[len(keep) :]])
            rest = [one for one, is_kept in zip(problem.constants, keep, strict=True) if is_kept]
            problem, theta = self._solve(rest, 0.6, 2, start)
        return problem.make_fit(theta)

    def _solve(
        self, constants: list[Constant], done: float, rounds: int, start: np.ndarray | None = None
    ) -> tuple[FitProblem, np.ndarray]:
        """Fit the constants in several rounds, from `start` or from the airframe's own values."""
        expected = rounds * 6 * (2 + len(constants) + int(self.free.sum()))

        def advance(evaluations: float) -> None:
            self.progress(done + 0.3 * min(evaluations / expected, 1.0))

        problem = FitProblem(self.parts, self.drone, constants, self.free, advance)
        theta = problem.initial_theta() if start is None else start
        if start is None:
            theta = align_commands(problem, theta)
            check_rotor_order(problem, theta)
        for _ in range(rounds):
            problem.weights = compute_weights(problem.errors(theta))
            theta = problem.solve(theta)
        problem.weights = compute_weights(problem.errors(theta))
        return problem, problem.solve(theta)


def align_commands(problem: FitProblem, theta: np.ndarray) -> np.ndarray:
    """Return the parameter vector with the command delay of each log that predicts best.

    Args:
        problem: The problem, whose weights are recomputed.
        theta: Initial parameter vector.

    Returns:
        The parameter vector with the new delays.
    """
    problem.weights = compute_weights(problem.errors(theta))
    clocks = np.array([part.flight.gyro_delay for part in problem.parts])
    trials = []
    costs = []
    for delay in DELAYS:
        trial = theta.copy()
        problem.log_part(trial)[:, 0] = (clocks + delay) / DELAY_UNIT
        trials.append(trial)
        costs.append([np.minimum(np.abs(part), 5.0).mean() for part in problem.whitened(trial)])
    best = np.argmin(costs, axis=0)
    found = theta.copy()
    problem.log_part(found)[:, 0] = (clocks + DELAYS[best]) / DELAY_UNIT
    return found


def check_rotor_order(problem: FitProblem, theta: np.ndarray) -> None:
    """Raise ValueError if a drone rotates opposite to its commands.

    With permuted rotors, commands and angular accelerations correlate as strongly as in the right
    order, but with the opposite sign. The delay that predicts best would then be one at which they
    hardly correlate. So all delays are evaluated, and the strongest correlation decides.

    Args:
        problem: The problem.
        theta: Initial parameter vector of the fit.

    Raises:
        ValueError: If the correlation is significantly negative: the rotors are in another order.
    """
    clocks = np.array([part.flight.gyro_delay for part in problem.parts])
    found = []
    for delay in DELAYS:
        trial = theta.copy()
        problem.log_part(trial)[:, 0] = (clocks + delay) / DELAY_UNIT
        found.append(
            [
                compute_correlations(part, errors)
                for part, errors in zip(problem.parts, problem.errors(trial), strict=True)
            ]
        )
    lowest, highest = np.min(found, axis=0), np.max(found, axis=0)
    for part, low, high in zip(problem.parts, lowest, highest, strict=True):
        axis = int(np.argmin(low + high))
        count = FREE_LEGS_PER_WINDOW * len(part.windows)
        if low[axis] + high[axis] < 0 and low[axis] < correlation_threshold(count):
            places = "; ".join(
                f"{k + 1} at x {x:g}, y {y:g} m"
                for k, (x, y, _) in enumerate(problem.airframe.rotors)
            )
            raise ValueError(
                f"{part.flight.log.path}: {RATES[axis]} changes against what the commands ask "
                f"for (correlation {low[axis]:.2f}): the order of rotors is {places}; map commands "
                f"to it, and check the signs of body axes"
            )


def compute_correlations(part: FlightPart, errors: PredictionErrors) -> np.ndarray:
    """Compute the correlation of measured with commanded rate changes for each body axis.

    The changes are those up to the first state of each leg, before feedback turns the drone back.

    Args:
        part: The windows.
        errors: Errors of predictions in these windows.

    Returns:
        Correlations, (3,).
    """
    naive = compute_naive_errors(part.flight, part.windows).rotation
    first = slice(0, None, STATES_PER_LEG)
    commanded = (errors.rotation - naive)[:, first, 3:].reshape(-1, 3)
    measured = -naive[:, first, 3:].reshape(-1, 3)
    return np.array([np.corrcoef(commanded[:, k], measured[:, k])[0, 1] for k in range(3)])


def correlation_threshold(count: int) -> float:
    """Return the correlation below which rotations count as opposite to the commands.

    The correlation of unrelated samples falls below this value in a fraction `FALSE_ALARM_RATE` of
    all logs, by Fisher's transformation, for three axes and all delays that are tried.

    Args:
        count: Number of samples.

    References:
        R. Fisher, On the "probable error" of a coefficient of correlation, Metron 1, 1921.
    """
    trials = 3 * len(DELAYS)
    return -math.tanh(float(norm.ppf(1 - FALSE_ALARM_RATE / trials)) / math.sqrt(count - 3))


def fit_log_parameters(
    parts: Sequence[FlightPart], drone: Airframe, free: np.ndarray
) -> np.ndarray:
    """Fit the per-log parameters (L, 7) only, with fixed constants of an airframe."""
    problem = FitProblem(parts, drone, [], free, ignore_progress)
    theta = align_commands(problem, problem.initial_theta())
    for _ in range(ROUNDS - 1):
        problem.weights = compute_weights(problem.errors(theta))
        theta = problem.solve(theta)
    return problem.unpack(theta)[1]
