"""Check for flights that diverge."""

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.rotation import dot, vec3
from bulletuav.vehicle.swarm import Swarm

# Below the limit of 1e4 at which the engine clamps both
FASTEST = 9.9e3  # m/s
FASTEST_SPIN = 9.9e3  # rad/s


@kernel
def any_lost(swarm: Swarm, alive: np.ndarray, lost: np.ndarray) -> bool:
    """Return True if the speed or spin of an active drone is NaN or exceeds its limit.

    The world and index of the first such drone are written to `lost` (2,).
    """
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            velocity = vec3(swarm.velocity, w, i)
            rates = vec3(swarm.rates, w, i)
            # Comparisons with NaN are false, so a drone with NaN counts as lost
            slow = dot(velocity, velocity) < FASTEST**2
            calm = dot(rates, rates) < FASTEST_SPIN**2
            if alive[w, i] and not (slow and calm):
                lost[0] = w
                lost[1] = i
                return True
    return False
