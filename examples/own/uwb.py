"""A custom sensor: distances to four radio anchors, with noise and dropouts.

A policy estimates its position from these distances alone, and flies to its goal.

Run it:

    python examples/own/uwb.py
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

import bulletuav
from bulletuav.policies import Policy
from bulletuav.sensors import Label, Moment, Sensor, Uncertain
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

ANCHORS = 30.0 * np.array([[1, 1, 0], [-1, 1, 0.7], [-1, -1, 0], [1, -1, 0.7]])
"""(4, 3) m; not in one plane, so that heights are observable"""


class Uwb(Sensor):
    """Distances to all anchors; when a measurement fails, the last one is repeated.

    Attributes:
        noise: (W, N) standard deviation of each distance, m.
        dropout: (W, N) probability that the measurement of a drone fails.
    """

    name = "uwb"
    numbers = tuple(Label(f"distance to anchor {k}", "m", 0.0, 200.0) for k in range(len(ANCHORS)))
    uncertain: ClassVar = {"noise": Uncertain(0.0, 10.0), "dropout": Uncertain(0.0, 1.0)}

    noise: np.ndarray
    dropout: np.ndarray
    _last: np.ndarray | float = 0.0

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Return the distances; the first measurement of an episode never fails."""
        normal, luck = moment.draw(width=len(ANCHORS))
        offset = moment.after.position[:, :, None] - ANCHORS
        distance = np.linalg.norm(offset, axis=-1) + self.noise[..., None] * normal
        comes = moment.mask & ((luck >= self.dropout) | (moment.steps == 0)[:, None])
        self._last = np.where(comes[..., None], distance, self._last)
        return {"uwb": self._last}


class Homing(Policy):
    """Fly to the goal from the position that the distances imply."""

    name = "homing"
    actions = ("velocity",)
    reads_swarm = False

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy has no memory."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Return velocities that reach the goal in two seconds, damped by the present velocity."""
        seen = self.aviary.observer.split(observations)
        velocity = seen["velocity"].astype(float)
        towards = self.aviary.scene.goal - position_from(seen["uwb"].astype(float))
        return self.encoded(towards / 2.0 - 0.2 * velocity)


def position_from(distance: np.ndarray) -> np.ndarray:
    """Return positions (..., 3), m, from distances to all anchors (..., 4), m.

    The square of each distance, less the mean of these squares, is linear in the position.
    """
    linear = np.sum(ANCHORS**2, axis=1) - distance**2
    linear -= linear.mean(axis=-1, keepdims=True)
    position: np.ndarray = linear @ np.linalg.pinv(2 * (ANCHORS - ANCHORS.mean(axis=0))).T
    return position


def main() -> None:
    """Check the sensor, then fly with different noise and dropout."""
    bulletuav.check_sensor(Uwb())
    options: dict[str, Any] = {
        "sensors": (Uwb(),),
        "observation": ("velocity", "uwb"),
        "action": "velocity",
        "num_drones": 4,
        "height": 8.0,
        "spacing": 12.0,
        "start_offset": 5.0,
    }
    for noise, dropout in ((0.0, 0.0), (1.0, 0.0), (1.0, 0.9)):
        uncertain = {"uwb_noise": noise, "uwb_dropout": dropout}
        result = bulletuav.evaluate("hover", Homing, 5, randomization=uncertain, **options)
        distance = result.estimates()["goal_distance"].mean
        print(f"noise {noise} m, dropout {dropout}: {distance:.3f} m from the goal at the end")


if __name__ == "__main__":
    main()
