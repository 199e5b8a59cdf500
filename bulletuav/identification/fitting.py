"""What is fitted and what is kept back, and fits one after the other."""

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
"""Windows of one log that are fitted or kept together, by turns"""
MIN_WINDOWS = 12
"""Fewest windows to fit"""
ROUNDS = 3
"""Fits, each with the errors of the one before as its weights"""
DELAYS = np.arange(-0.1, 0.2001, 0.01)
"""Delays of commands that are tried first, behind the gyroscope's clock, s"""
FALSE_ALARM_RATE = 0.01
"""Chance that a log whose turns have nothing to do with its commands is refused"""


def ignore_progress(_: float) -> None:
    """Show no progress."""


def split_flights(flights: Sequence[LoggedFlight]) -> tuple[list[FlightPart], list[FlightPart]]:
    """Choose what is fitted and what is kept back.

    Args:
        flights: The flights, in order.

    Returns:
        Of several flights every other one, the first to be fitted. Of one flight every other block
        of `BLOCK` windows.

    Raises:
        ValueError: There are too few windows.
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
    """Return every other block of a flight's windows, and the others."""
    index = np.arange(len(flight.windows))
    first = index // BLOCK % 2 == 0
    return FlightPart(flight, index[first]), FlightPart(flight, index[~first])


class StepwiseFit:
    """Fits of the same parts, one after the other."""

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
        """Fit, leave out what the logs do not tell, and fit the rest."""
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
        """Fit some constants in rounds, from where another fit ended or from the airframe's."""
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
    """Return numbers with the delay of commands, of each log, that predicts best.

    Args:
        problem: The problem; its weights are made anew.
        numbers: Where to start.
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
    """Refuse logs whose drone turns against what its commands ask for.

    With rotors out of order commands and turns correlate as they do in order, with the other sign.
    But the delay that predicts best is then one at which they hardly correlate. So all delays are
    tried, and the strongest correlation tells.

    Args:
        problem: The problem.
        numbers: Where the fit starts.

    Raises:
        ValueError: Turns are opposite; the rotors have another order.
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
    """Return the correlation (3,) of rates' changes with those that commands ask for.

    They are those to the first state of each leg, before feedback turns the drone back.

    Args:
        part: Windows.
        errors: Errors of predictions in them.
    """
    naive = compute_naive_errors(part.flight, part.windows).rotation
    first = slice(0, None, STATES_PER_LEG)
    commanded = (errors.rotation - naive)[:, first, 3:].reshape(-1, 3)
    measured = -naive[:, first, 3:].reshape(-1, 3)
    return np.array([np.corrcoef(commanded[:, k], measured[:, k])[0, 1] for k in range(3)])


def correlation_threshold(count: int) -> float:
    """Return the correlation from which on turns are opposite to what commands ask for.

    That of unrelated numbers is below it in a share `FALSE_ALARM_RATE` of all logs, by Fisher's transformation
    (R. Fisher, Metron 1, 1921), for three axes and all delays that are tried.

    Args:
        count: Turns that are compared.
    """
    trials = 3 * len(DELAYS)
    return -math.tanh(float(norm.ppf(1 - FALSE_ALARM_RATE / trials)) / math.sqrt(count - 3))


def fit_log_parameters(
    parts: Sequence[FlightPart], drone: Airframe, free: np.ndarray
) -> np.ndarray:
    """Fit the logs' own numbers alone, with the constants of an airframe; (L, 7)."""
    problem = FitProblem(parts, drone, [], free, ignore_progress)
    theta = align_commands(problem, problem.initial_theta())
    for _ in range(ROUNDS - 1):
        problem.weights = compute_weights(problem.errors(theta))
        theta = problem.solve(theta)
    return problem.unpack(theta)[1]
