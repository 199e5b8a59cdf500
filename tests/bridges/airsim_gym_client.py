"""Fly environments of AirSim's client, as people write them for training.

    python airsim_gym_client.py airsim 41451 docs/howto/bridges/airsim.md

Needs a server of three vehicles. The first environment is that of the page, in lockstep; the second
one flies all vehicles, and lets time run between decisions. Prints the decisions per second of the
first.
"""

import functools
import importlib
import re
import sys
import time
from pathlib import Path

import numpy as np

name, port, page = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
airsim = sys.modules["airsim"] = importlib.import_module(name)
airsim.MultirotorClient = functools.partial(airsim.MultirotorClient, port=port)
(code,) = re.findall(r"```py\n([^`]*class ReachEnv[^`]*)```", page.read_text())
exec(code)


def fly_episode(env, seed, choose):
    """Returns the sum of rewards, whether the goal was reached, and the number of decisions."""
    observation, _ = env.reset(seed=seed)
    total, decisions = 0.0, 0
    while True:
        observation, reward, terminated, truncated, _ = env.step(choose(observation))
        total, decisions = total + reward, decisions + 1
        if terminated or truncated:
            return total, terminated, decisions


def to_goal(observation):
    return np.clip(observation[:3] / 3, -1, 1).astype(np.float32)


def anywhere(observation):
    return random.uniform(-1, 1, 3).astype(np.float32)


random = np.random.default_rng(0)
env = ReachEnv()  # noqa: F821  # the page defines it
begin = time.perf_counter()
flights = [fly_episode(env, seed, to_goal) for seed in range(3)]
decisions = sum(flight[2] for flight in flights)
print(f"{decisions / (time.perf_counter() - begin):.0f} decisions/s, with resets")
assert all(reached for _, reached, _ in flights), flights
assert flights == [fly_episode(env, seed, to_goal) for seed in range(3)]
assert sum(fly_episode(env, seed, anywhere)[0] for seed in range(3)) < sum(
    total for total, _, _ in flights
)

client = airsim.MultirotorClient()
client.simPause(False)
vehicles = client.listVehicles()
for k, vehicle in enumerate(vehicles):
    client.enableApiControl(True, vehicle)
    client.armDisarm(True, vehicle)
    pose = airsim.Pose(airsim.Vector3r(5.0 * k, 0.0, -20.0), airsim.Quaternionr())
    client.simSetVehiclePose(pose, True, vehicle)
for _ in range(20):
    for k, vehicle in enumerate(vehicles):
        client.moveByVelocityAsync(1.0 - k, 0.0, 0.0, 0.1, vehicle_name=vehicle)
    client.simPause(True)
    client.simContinueForTime(0.1)
    client.simPause(False)
speeds = [
    client.getMultirotorState(vehicle).kinematics_estimated.linear_velocity.x_val
    for vehicle in vehicles
]
assert speeds[0] > 0.2, speeds
assert speeds[2] < -0.2, speeds
