"""Stage: check and clip actions."""

import math

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program
from bulletuav.envs.stages.base import Stage
from bulletuav.envs.worlds import Worlds


class Admit(Stage):
    """Check that actions are finite, clip them, and start the decision."""

    name = "admit"
    reads = ("given", "alive", "steps")
    writes = ("action", "flown", "flying", "time")

    def add_to(self, program: Program, worlds: Worlds) -> None:
        """Add the calls of the stage; see `Stage.add_to`."""
        state, action = worlds.state, worlds.action
        bounds = (action.low, action.high, action.choices is not None)

        def raise_error() -> None:
            worlds.contacts.undo_decision()
            worlds.spec.actions(state.given, state.alive)

        # Invalid actions end the decision before anything has changed
        program.call(admit, state.given, state.alive, *bounds, state.action, otherwise=raise_error)
        clock = (state.steps, float(worlds.options.decision_hz))
        program.call(mark_flying_drones, state.alive, *clock, state.flown, state.flying, state.time)


@kernel
def admit(
    given: np.ndarray,
    alive: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    discrete: bool,
    action: np.ndarray,
) -> bool:
    """Clip actions to their bounds; set those of drones that are not alive to 0.

    Args:
        given: (W, N, A) actions of the caller.
        alive: (W, N) bool.
        low: (N, A) lower bounds.
        high: (N, A) upper bounds.
        discrete: Whether numbers are choices, which must be whole and within the bounds.
        action: (W, N, A), written if all actions are valid.

    Returns:
        Whether any action of an active drone is invalid; nothing is written then.
    """
    # All are checked before any is written
    for w in range(given.shape[0]):
        for i in range(given.shape[1]):
            if alive[w, i]:
                for k in range(given.shape[2]):
                    number = given[w, i, k]
                    if not math.isfinite(number):
                        return True
                    # A choice out of bounds is a mistake, and is not clipped
                    if discrete and not (low[i, k] <= number <= high[i, k] and number % 1 == 0):
                        return True
    for w in range(given.shape[0]):
        for i in range(given.shape[1]):
            for k in range(given.shape[2]):
                number = given[w, i, k] if alive[w, i] else 0.0
                action[w, i, k] = min(max(number, low[i, k]), high[i, k])
    return False


@kernel
def mark_flying_drones(
    alive: np.ndarray,
    steps: np.ndarray,
    hz: float,
    flown: np.ndarray,
    flying: np.ndarray,
    time: np.ndarray,
) -> None:
    """Write which drones fly a decision, and its start time.

    Args:
        alive: (W, N) bool.
        steps: (W,) decisions since the reset.
        hz: Decisions per second.
        flown: (W, N) bool, written: drones active before the decision.
        flying: (W,) bool, written: worlds in which any drone flies.
        time: (W,) time since the reset, s, written.
    """
    for w in range(alive.shape[0]):
        # Divided each time, as a sum of periods would drift
        time[w] = steps[w] / hz
        flying[w] = False
        for i in range(alive.shape[1]):
            flown[w, i] = alive[w, i]
            flying[w] = flying[w] or alive[w, i]
