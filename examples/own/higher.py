"""A custom policy: straight to the goal, and higher on eastbound than on northbound flights.

Aircraft use a similar rule: by the semicircular rule the altitude depends on the heading.

Run it:

    python examples/own/higher.py
    cd examples/own && bulletuav fly crossing --policy higher:Higher --out out
"""

import numpy as np

import bulletuav
from bulletuav.policies import Policy
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

RISE = 12.0
"""Additional altitude of eastbound drones, until they are near their goals, m"""


class Higher(Policy):
    """Fly straight to the goal, and higher if the goal is to the east."""

    name = "higher"
    actions = ("velocity",)
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy has no memory."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Return velocities (W, N, 3) towards the goals, proportional to the distance."""
        scene = self.aviary.scene
        way = np.abs(scene.goal - scene.start)
        towards = scene.goal - swarm.position
        is_far = np.linalg.norm(towards[..., :2], axis=-1) > 3 * RISE
        towards[..., 2] += np.where(is_far & (way[..., 0] > way[..., 1]), RISE, 0.0)
        return self.encoded(towards)


def main() -> None:
    """Check the policy, then compare it with straight flight."""
    bulletuav.check_policy(Higher)
    for policy in ("straight", Higher):
        result = bulletuav.evaluate("crossing", policy, 10, dynamics="point_mass", num_drones=8)
        figures = result.estimates()
        conflicts, success = figures["conflicts"].mean, figures["drone_success"].mean
        name = result.about["policy"]
        print(f"{name}: {conflicts:.1f} conflicts, {success:.0%} of the drones succeed")


if __name__ == "__main__":
    main()
