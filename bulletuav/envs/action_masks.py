"""Masks of discrete actions: which moves of a drone are valid."""

from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.functions import exp
from bulletuav.control.actions import Action
from bulletuav.control.gains import MAX_DECELERATION
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.tasks.base import Task

ACTION_MASK = "action_mask"
"""Name of the info, as PettingZoo has it"""
STAY = 0
"""The move that is always valid"""


class Response(NamedTuple):
    """How drones follow commanded velocities.

    Attributes:
        lag: (N,) time constant of the velocity, s; 0 for drones that follow immediately.
        delay: (N,) time before a drone starts to brake, s.
        deceleration: Deceleration while a drone stops, m/s^2.
    """

    lag: np.ndarray
    delay: np.ndarray
    deceleration: float


def response_of(gains: np.ndarray, consumes: SetpointLevel, name: str, gravity: float) -> Response:
    """Return the response of drones to commanded velocities.

    Args:
        gains: (N,) rows of `GAINS`.
        consumes: Setpoint level that drives the dynamics.
        name: Name of the dynamics.
        gravity: Gravitational acceleration, m/s^2, which limits what a tilt accelerates.
    """
    if name == "single_integrator":
        return Response(np.zeros(len(gains)), np.zeros(len(gains)), np.inf)
    damping = 2.0 * gains["damping"]
    lag = 1.0 / (damping * gains["position_frequency"])
    # Drones with rotors tilt before they brake
    tilt = damping / gains["attitude_frequency"][:, 0]
    delay = tilt if consumes == SetpointLevel.ROTOR else np.zeros(len(gains))
    return Response(lag, delay, min(MAX_DECELERATION, gravity * float(gains["max_tilt"].min())))


class ActionMasks:
    """Valid moves of discrete actions, by a prediction of one decision.

    Staying (choice 0) is always valid. Another move is valid if after one decision of it the drone
    can still stop inside the arena, or if it flies no faster outwards then than after staying. The
    prediction is made for each side of the arena. A drone at velocity v that is commanded the
    velocity u has after the decision of duration T the velocity u + (v - u) exp(-T / lag). With w,
    the larger one of the outward speeds before and after the decision, it stops after

        d = w (T + lag + delay + s / (2 deceleration)),

    where s is the norm of w and of the larger speeds along the other axes. The collision radius is
    subtracted from the distance to the bound. The ground is a bound, unless drones may land.

    Drones whose episode was terminated, or ended before the last decision, can only stay. Drones
    that the horizon truncates keep their mask, so that value estimates can bootstrap.

    Attributes:
        velocity: (N, C, 3) commanded velocity of each move, m/s.
    """

    def __init__(
        self,
        action: Action,
        task: Task[Any],
        radius: np.ndarray,
        response: Response,
        period: np.ndarray,
    ) -> None:
        """Precompute what does not depend on the state.

        Args:
            action: Definition of discrete actions.
            task: The task, which has the arena and speed limits.
            radius: (N,) collision radii, m.
            response: Response of the drones.
            period: (N,) time for which the drones hold a move, s.
        """
        drones = len(action.labels)
        choices = np.arange(action.choices or 0, dtype=float)
        chosen = np.broadcast_to(choices[:, None, None], (len(choices), drones, 1))
        setpoints = action.decode(np.ascontiguousarray(chosen), np.zeros((*chosen.shape[:2], 3)))
        self.velocity = np.swapaxes(setpoints[..., :3], 0, 1).copy()
        if task.speed_limit is not None:
            speed = np.linalg.norm(self.velocity, axis=-1, keepdims=True)
            limit = task.speed_limit[:, None, None]
            self.velocity *= limit / np.maximum(speed, limit)
        low, high = np.array(task.arena_low, dtype=float), np.array(task.arena_high, dtype=float)
        low[2] = -np.inf if task.lands else max(low[2], 0.0)
        self._low = low + radius[:, None]
        self._high = high - radius[:, None]
        self._deceleration = response.deceleration
        self._time = (period + response.lag + response.delay)[:, None, None]
        # Fraction of a velocity error that remains after the decision
        with np.errstate(divide="ignore"):
            self._remaining = exp(-period / response.lag)[:, None, None]

    def compute(
        self, position: np.ndarray, velocity: np.ndarray, present: np.ndarray
    ) -> np.ndarray:
        """Compute the masks.

        Args:
            position: (W, N, 3) m.
            velocity: (W, N, 3) m/s.
            present: (W, N) bool, drones that can do more than stay.

        Returns:
            (W, N, C) int8, 1 for valid moves.
        """
        now = velocity[:, :, None]
        later = self.velocity + self._remaining * (now - self.velocity)
        if np.isinf(self._deceleration):
            # Drones that follow immediately forget their velocity
            now = np.zeros_like(later)
        fastest = np.maximum(np.abs(now), np.abs(later))
        valid = np.ones(later.shape[:3], dtype=bool)
        for outward, margin in ((1.0, self._high - position), (-1.0, position - self._low)):
            ends = outward * later
            speed = np.maximum(np.maximum(outward * now, ends), 0.0)
            for axis in range(3):
                others = fastest.copy()
                others[..., axis] = speed[..., axis]
                total = np.sqrt((others**2).sum(axis=-1, keepdims=True))
                own = speed[..., axis, None]
                with np.errstate(divide="ignore", invalid="ignore"):
                    braking = np.where(own > 0, own * total / (2.0 * self._deceleration), 0.0)
                needed = (own * self._time + braking)[..., 0]
                slows = ends[..., axis] <= ends[..., STAY : STAY + 1, axis]
                valid &= (needed <= margin[..., axis, None]) | slows
        valid[~present] = False
        valid[..., STAY] = True
        return valid.astype(np.int8)
