"""What is fitted and what is kept back, and fits one after the other."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from bulletuav.identification.constants import Constant
from bulletuav.identification.errors import DELAY, PICKS, TURNS, Errors, naive_errors
from bulletuav.identification.fit import Fit, Part, Problem, Progress
from bulletuav.identification.flight import Flight
from bulletuav.identification.logs import RATES
from bulletuav.identification.weights import weights_of
from bulletuav.vehicle.airframe import Airframe

BLOCK = 4
"""Windows of one log that are fitted or kept together, by turns"""
FEWEST = 12
"""Fewest windows to fit"""
ROUNDS = 3
"""Fits, each with the errors of the one before as its weights"""
DELAYS = np.arange(-0.1, 0.2001, 0.01)
"""Delays of commands that are tried first, behind the gyroscope's clock, s"""
ALARM = 0.01
"""Chance that a log whose turns have nothing to do with its commands is refused"""


def silent(_: float) -> None:
    """Show no progress."""


def split(flights: Sequence[Flight]) -> tuple[list[Part], list[Part]]:
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
        parts = [Part(flight, np.arange(len(flight.windows))) for flight in flights]
        fitted, kept = parts[::2], parts[1::2]
    else:
        fitted, kept = ([part] for part in halves(flights[0]))
    count = sum(len(part.windows) for part in fitted)
    if count < FEWEST:
        raise ValueError(
            f"there are {count} windows of flight to fit (of {flights[0].dt * flights[0].steps:g} "
            f"s each): at least {FEWEST} are needed; fly longer, or pass more logs"
        )
    return fitted, kept


def halves(flight: Flight) -> tuple[Part, Part]:
    """Return every other block of a flight's windows, and the others."""
    index = np.arange(len(flight.windows))
    first = index // BLOCK % 2 == 0
    return Part(flight, index[first]), Part(flight, index[~first])


class Fitting:
    """Fits of the same parts, one after the other."""

    def __init__(
        self, parts: list[Part], drone: Airframe, free: np.ndarray, asked: bool, progress: Progress
    ) -> None:
        self.parts = parts
        self.drone = drone
        self.free = free
        self.asked = asked
        self.progress = progress

    def run(self, constants: list[Constant]) -> Fit:
        """Fit, leave out what the logs do not tell, and fit the rest."""
        problem, numbers = self._solve(constants, 0.1, ROUNDS)
        while not self.asked:
            keep = problem.told(numbers)
            if keep.all():
                break
            start = np.concatenate([numbers[: len(keep)][keep], numbers[len(keep) :]])
            rest = [one for one, is_kept in zip(problem.constants, keep, strict=True) if is_kept]
            problem, numbers = self._solve(rest, 0.6, 2, start)
        return problem.found(numbers)

    def _solve(
        self, constants: list[Constant], done: float, rounds: int, start: np.ndarray | None = None
    ) -> tuple[Problem, np.ndarray]:
        """Fit some constants in rounds, from where another fit ended or from the airframe's."""
        expected = rounds * 6 * (2 + len(constants) + int(self.free.sum()))

        def advance(evaluations: float) -> None:
            self.progress(done + 0.3 * min(evaluations / expected, 1.0))

        problem = Problem(self.parts, self.drone, constants, self.free, advance)
        numbers = problem.begin() if start is None else start
        if start is None:
            numbers = aligned(problem, numbers)
            require_order(problem, numbers)
        for _ in range(rounds):
            problem.weights = weights_of(problem.errors(numbers))
            numbers = problem.solve(numbers)
        problem.weights = weights_of(problem.errors(numbers))
        return problem, problem.solve(numbers)


def aligned(problem: Problem, numbers: np.ndarray) -> np.ndarray:
    """Return numbers with the delay of commands, of each log, that predicts best.

    Args:
        problem: The problem; its weights are made anew.
        numbers: Where to start.
    """
    problem.weights = weights_of(problem.errors(numbers))
    clocks = np.array([part.flight.gyro_delay for part in problem.parts])
    trials = []
    costs = []
    for delay in DELAYS:
        trial = numbers.copy()
        problem.own(trial)[:, 0] = (clocks + delay) / DELAY
        trials.append(trial)
        costs.append([np.minimum(np.abs(part), 5.0).mean() for part in problem.whitened(trial)])
    best = np.argmin(costs, axis=0)
    found = numbers.copy()
    problem.own(found)[:, 0] = (clocks + DELAYS[best]) / DELAY
    return found


def require_order(problem: Problem, numbers: np.ndarray) -> None:
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
        trial = numbers.copy()
        problem.own(trial)[:, 0] = (clocks + delay) / DELAY
        found.append(
            [
                correlations(part, errors)
                for part, errors in zip(problem.parts, problem.errors(trial), strict=True)
            ]
        )
    lowest, highest = np.min(found, axis=0), np.max(found, axis=0)
    for part, low, high in zip(problem.parts, lowest, highest, strict=True):
        axis = int(np.argmin(low + high))
        count = TURNS * len(part.windows)
        if low[axis] + high[axis] < 0 and low[axis] < opposite(count):
            places = "; ".join(
                f"{k + 1} at x {x:g}, y {y:g} m"
                for k, (x, y, _) in enumerate(problem.airframe.rotors)
            )
            raise ValueError(
                f"{part.flight.log.path}: {RATES[axis]} changes against what the commands ask "
                f"for (correlation {low[axis]:.2f}): the order of rotors is {places}; map commands "
                f"to it, and check the signs of body axes"
            )


def correlations(part: Part, errors: Errors) -> np.ndarray:
    """Return the correlation (3,) of rates' changes with those that commands ask for.

    They are those to the first state of each leg, before feedback turns the drone back.

    Args:
        part: Windows.
        errors: Errors of predictions in them.
    """
    naive = naive_errors(part.flight, part.windows).turned
    first = slice(0, None, PICKS)
    asked = (errors.turned - naive)[:, first, 3:].reshape(-1, 3)
    turned = -naive[:, first, 3:].reshape(-1, 3)
    return np.array([np.corrcoef(asked[:, k], turned[:, k])[0, 1] for k in range(3)])


def opposite(count: int) -> float:
    """Return the correlation from which on turns are opposite to what commands ask for.

    That of unrelated numbers is below it in a share `ALARM` of all logs, by Fisher's transformation
    (R. Fisher, Metron 1, 1921), for three axes and all delays that are tried.

    Args:
        count: Turns that are compared.
    """
    trials = 3 * len(DELAYS)
    return -math.tanh(float(norm.ppf(1 - ALARM / trials)) / math.sqrt(count - 3))


def own_numbers(parts: Sequence[Part], drone: Airframe, free: np.ndarray) -> np.ndarray:
    """Fit the logs' own numbers alone, with the constants of an airframe; (L, 7)."""
    problem = Problem(parts, drone, [], free, silent)
    numbers = aligned(problem, problem.begin())
    for _ in range(ROUNDS - 1):
        problem.weights = weights_of(problem.errors(numbers))
        numbers = problem.solve(numbers)
    return problem.split(numbers)[1]
