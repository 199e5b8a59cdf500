"""Custom dynamics: commanded accelerations, and linear drag.

Run it:

    python examples/own/glide.py
    cd examples/own && bulletuav fly crossing --dynamics glide:Glide --out out
"""

from typing import Any

import numpy as np

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Air, Dynamics
from bulletuav.vehicle.swarm import Swarm

DRAG = 0.2
"""1/s"""


class Glide(Dynamics):
    """Dynamics with the commanded acceleration, and drag proportional to airspeed.

    Both are constant during a substep.
    """

    consumes = SetpointLevel.ACCELERATION

    def advance_substep(
        self, swarm: Swarm, alive: np.ndarray, setpoint: np.ndarray, air: Air
    ) -> None:
        """Advance all drones by one substep; the base class restores drones that do not fly."""
        dt = self.flight.dt
        acceleration = setpoint[..., :3] - DRAG * (swarm.velocity - air.wind)
        swarm.position[:] += dt * swarm.velocity + dt**2 / 2 * acceleration
        swarm.velocity[:] += dt * acceleration


def main() -> None:
    """Check the dynamics, then fly without and with wind."""
    bulletuav.check_dynamics(Glide)
    for wind in (0.0, 3.0):
        options: dict[str, Any] = {"dynamics": Glide, "wind": (0.0, wind, 0.0), "num_drones": 2}
        result = bulletuav.evaluate("crossing", "straight", 5, **options)
        success = result.estimates()["drone_success"].mean
        print(f"wind {wind} m/s: {success:.0%} of the drones reached their goals")


if __name__ == "__main__":
    main()
