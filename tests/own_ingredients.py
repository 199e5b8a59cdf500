"""Ingredients that are right in every way, and how to make them wrong, for tests of mistakes."""

from typing import ClassVar

import numpy as np

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Dynamics
from bulletuav.policies import Policy
from bulletuav.sensors import Label, Sensor, Uncertain
from bulletuav.tasks import Spawn, Task, TaskConfig, reward

WORLDS, DRONES = 2, 3
GLOBAL = np.random.default_rng(0)
"""A generator that nobody seeds again"""


@reward
def near(distance):
    return 1.0 / (1.0 + distance)


class Perch(Task[TaskConfig]):
    """Come to a point 10 m up."""

    name = "perch"
    defaults: ClassVar = {"num_drones": DRONES, "dynamics": "point_mass", "horizon": 20}
    observation = ("velocity", "goal_offset")
    reward: ClassVar = {"near": (near, 1.0)}

    def spawn(self, rng):
        start = rng.uniform(-1.0, 1.0, (DRONES, 3)) + [(4.0 * i, 0.0, 10.0) for i in range(DRONES)]
        return Spawn(position=start, goal=np.array((0.0, 0.0, 10.0)))

    def memory(self):
        return {"idle": (2,)}


class Uwb(Sensor):
    """How high a drone is."""

    name = "uwb"
    numbers = (Label("distance", "m", 0.0, 500.0),)
    uncertain: ClassVar = {"noise": Uncertain(0.0, 1.0)}

    def measure(self, moment):
        return {"uwb": moment.after.position[..., 2]}


class Still(Policy):
    """Ask for no velocity."""

    name = "still"
    actions = ("velocity",)
    reads_swarm = False

    def reset(self, mask): ...

    def act(self, observations, swarm):
        return np.zeros(swarm.position.shape)


class Drift(Dynamics):
    """Move as told."""

    consumes = SetpointLevel.VELOCITY

    def advance_substep(self, swarm, alive, setpoint, air):
        swarm.position[:] += self.flight.dt * setpoint[..., :3]


def wrong(kind, **attributes):
    """Derive a class that is wrong in something."""
    return type(kind)(kind.__name__, (kind,), {"name": kind.name, **attributes})


def fly(task=Perch, **options):
    """Fly some decisions as a user does, without any check of theirs."""
    aviary = bulletuav.Aviary(task, WORLDS, **options)
    try:
        aviary.reset(seeds=0)
        for _ in range(3):
            aviary.step(np.zeros((WORLDS, aviary.num_drones, 3)))
    finally:
        aviary.close()
