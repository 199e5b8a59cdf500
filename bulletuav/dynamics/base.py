"""The interface of the dynamics ladder: every level moves the same swarm through one decision."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bulletuav.control.cascade import Cascade
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.engine.engine import Engine
from bulletuav.geometry.rotation import dot, vec3
from bulletuav.kernel import kernel
from bulletuav.vehicle.swarm import Contacts, Motion, Swarm


class Air(NamedTuple):
    """What surrounds the drones: wind (W, N, 3) m/s, height of the surface below (W, N) m, gravity m/s^2."""

    wind: np.ndarray
    surface: np.ndarray
    gravity: float


@dataclass(frozen=True)
class Flight:
    """What a dynamics is built from: world, rows of `PARAMETERS` (W, N), controller, substep (s), substeps a decision."""

    engine: Engine
    parameters: np.ndarray
    cascade: Cascade
    dt: float
    substeps: int
    gravity: float


FASTEST = FASTEST_SPIN = 9.9e3  # m/s, rad/s; the engine clamps at 1e4


@kernel
def _first_lost(swarm, alive):
    """World and drone of the first living drone whose speed or spin left all bounds (or is NaN), -1 where there is none."""
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            velocity, rates = vec3(swarm.velocity, w, i), vec3(swarm.rates, w, i)
            sane = dot(velocity, velocity) < FASTEST**2 and dot(rates, rates) < FASTEST_SPIN**2
            if alive[w, i] and not sane:
                return w, i
    return -1, -1


def require_sane(swarm: Swarm, alive: np.ndarray, first_world: int) -> None:
    """Raise RuntimeError naming the first living drone (W, N) whose state left all bounds; a reset brings it back.

    `first_world`: number of the first of these worlds.
    """
    w, i = _first_lost(swarm, alive)
    if w >= 0:
        speed, spin = np.linalg.norm(swarm.velocity[w, i]), np.linalg.norm(swarm.rates[w, i])
        raise RuntimeError(
            f"the flight of drone {i} in world {first_world + w} diverged ({speed:.3g} m/s, {spin:.3g} rad/s): raise "
            f"physics_hz or check the inertia of its airframe; reset() starts the world anew"
        )


class Dynamics(ABC):
    """One rung of the ladder, driven by setpoints of the level that it `consumes`; higher ones go through the cascade."""

    def __init__(self, flight: Flight):
        self.flight = flight
        self._near_ground = bool((flight.parameters["ground_effect_gain"] > 0).any())

    @property
    @abstractmethod
    def consumes(self) -> SetpointLevel:
        """The setpoint level that drives it."""

    def place(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Start the drones of `mask` (W, N) from the state in `swarm`, as if nothing had been before."""
        self.flight.engine.set_states(swarm, mask)

    def show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Have the engine's bodies of `mask` (W, N) stand where `swarm` is, for pictures; changes nothing in flight."""
        self.flight.engine.set_poses(swarm, mask)

    def _surface(self, swarm: Swarm, alive: np.ndarray) -> np.ndarray:
        """(W, N) height of the surface below living drones, m; -inf where the ground effect is off."""
        if self._near_ground:
            return self.flight.engine.surface_below(swarm.position, alive)
        return np.full(alive.shape, -np.inf)

    @abstractmethod
    def fly(
        self,
        swarm: Swarm,
        alive: np.ndarray,
        level: SetpointLevel,
        setpoint: np.ndarray,
        wind: np.ndarray,
        motion: Motion,
    ) -> Contacts:
        """Move the living drones (W, N) through one decision, in place, and tell what they touched.

        `setpoint` (W, N, S) at `level` is held; `wind` (W, N, 3) m/s too; `motion` is where obstacles
        go meanwhile. Drones that are not alive neither move nor act.
        """
