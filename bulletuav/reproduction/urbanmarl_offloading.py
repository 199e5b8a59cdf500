"""Rewards and observations of UrbanMARL's edge computing, built from parts of this package.

The reward term and the observation block are those of scenarios/uavmec_offloading.py of
https://github.com/yemenlinux/vUrbanMARL, commit 451cc28: each user has one task in each decision.
The task `mec` of this package draws tasks at random instead.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.network.access import ACCESS, uplink_rates
from bulletuav.network.dwell_time import DWELL_TIME_SCALE
from bulletuav.network.link import noise_power
from bulletuav.network.queueing import mean_response, utilisation
from bulletuav.reproduction.hand_made import compare_number
from bulletuav.reproduction.table import Row
from bulletuav.reproduction.urban_states import USERS, WALL, fly_over, steer_to
from bulletuav.sensors import Label
from bulletuav.tasks import Frame, block

CORES, CORE_RATE = 4, 4.0
"""Cores of a drone, and tasks that each computes in a second"""
ARRIVALS = 5.0
"""Tasks of all users in a second"""
DEADLINE = 1.0
"""Deadline, s"""
MEAN_BITS = 1.25e6
"""Mean size of a task, bit"""
TOP_SPEED = 49.0
"""Speed by which the energy term is divided, m/s"""
BANDWIDTH = 10e6
"""Bandwidth, Hz"""


class Offloading(NamedTuple):
    """Service of the drones in a decision, (W, N) each.

    Attributes:
        assigned: Fraction of users that the drone serves and sees.
        completed: Fraction of users whose task of mean size meets the deadline.
        load: Utilisation of the cores.
        response: Mean response time of the cores, s.
    """

    assigned: np.ndarray
    completed: np.ndarray
    load: np.ndarray
    response: np.ndarray


def measure_offloading(frame: Frame) -> Offloading:
    """Compute the service of drones, with all users sending at the same time in one band."""
    memory, users = frame.scene.memory, frame.readings["sight"].shape[-1]
    serves = memory["serves"] > 0
    noise = float(noise_power(BANDWIDTH, 7.0))
    serving = serves.argmax(axis=1)
    rates = uplink_rates(memory["received"], serving, BANDWIDTH, noise, ACCESS["shared"], 1.0)
    linked = serves & frame.readings["sight"]
    count = linked.sum(axis=-1)
    tasks = count * ARRIVALS / users
    response = mean_response(CORES, tasks, CORE_RATE)
    delay = MEAN_BITS / np.maximum(rates, 1e3)[:, None] + response[..., None]
    completed = (linked & (delay <= DEADLINE)).sum(axis=-1)
    return Offloading(
        count / users, completed / users, utilisation(CORES, tasks, CORE_RATE), response
    )


def offloading(frame: Frame) -> np.ndarray:
    """Compute the reward of uavmec_offloading, (W, N)."""
    service = measure_offloading(frame)
    speed = np.linalg.norm(frame.after.velocity, axis=-1)
    sojourn = np.tanh(DWELL_TIME_SCALE * frame.scene.memory["mean_dwell_time"])
    late = np.minimum(service.response / DEADLINE, 2.0)
    flight = 0.1 * speed / TOP_SPEED + 2.0 * frame.collision
    reward: np.ndarray = service.completed - 0.5 * late - flight + 0.3 * sojourn
    return reward


@block([Label(name, "1", 0.0, 10.0) for name in ("load", "response", "assigned", "in sight")])
def server_of_users(frame: Frame) -> np.ndarray:
    """Return utilisation, response (s), fraction of users assigned and in sight, (W, N, 4)."""
    service = measure_offloading(frame)
    seen = frame.readings["sight"].mean(axis=-1)
    late = np.clip(service.response, 0.0, 10.0)
    return np.stack([service.load, late, service.assigned, seen], axis=-1)


def compare_offloading() -> list[Row]:
    """Compare a decision of two drones, of which one sees three users and one the other two."""
    flown = fly_over(
        "mec",
        [WALL],
        [(0, 0, 100), (-150, 60, 100)],
        USERS,
        actions=[steer_to(12.0, 0.0, 0.0), steer_to(0.0, 0.0, 5.0)],
        reward={"offloading": (offloading, 1.0)},
        observation=("position", "battery", server_of_users),
    )
    paid, seen = flown.term("offloading"), flown.after
    # Mean responses of four cores of 4/s to 3/s and 2/s
    first, second = 0.250589365232, 0.250128932439
    rewards = (
        0.6 - 0.5 * first - 0.1 * 12 / 49 + 0.3 * math.tanh(0.06),
        0.4 - 0.5 * second - 0.1 * 5 / 49 + 0.3 * math.tanh(0.04),
    )
    return [
        compare_number("uavmec_offloading: drone with 3 of 5 users", paid[0], rewards[0]),
        compare_number("uavmec_offloading: drone with 2 of 5 users", paid[1], rewards[1]),
        compare_number("uavmec_offloading: utilisation, 3 users", seen[0, 4], 0.1875),
        compare_number("uavmec_offloading: response, 3 users", seen[0, 5], first, "s"),
        compare_number("uavmec_offloading: fraction assigned, 3 users", seen[0, 6], 0.6),
        compare_number("uavmec_offloading: utilisation, 2 users", seen[1, 4], 0.125),
        compare_number("uavmec_offloading: response, 2 users", seen[1, 5], second, "s"),
        compare_number("uavmec_offloading: fraction in sight, 2 users", seen[1, 7], 0.4),
    ]
