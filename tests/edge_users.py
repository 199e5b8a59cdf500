"""Sizes and formulas of edge computing, for tests of its tasks."""

import math

import numpy as np
from placing import fly

import bulletuav
from bulletuav.vehicle.power import airframe_wing, propulsion_power

EDGE = ("mec", "mec_advanced")
DEAF = {"n_nlos": 300.0}  # nothing is heard without a line of sight
EAST, DOWN, STAY = (1.0, 0, 0), (0, 0, -1.0), (0.0, 0, 0)
EQUAL = {"task_bits": (1e6, 1e6)}
COMPUTED = 1e6 * 1000 / 5e9  # s, for such a task on a core
BAND, POWER = 10e6, 0.5  # Hz, W: of `mec`
NOISE = 1.380649e-23 * 290 * BAND * 10**0.7  # W
CORE = 1e-28 * 5e9**3  # W


def hovered(aviary):
    """The last step of an episode in which all hover."""
    while aviary.alive.any():
        step = fly(aviary, STAY)
    return step


def friis(distance):
    """Power received in free space at 29 GHz, W."""
    return POWER * (299792458 / (4 * math.pi * distance * 29e9)) ** 2


def shannon(ratio, band=BAND):
    """Capacity, bit/s."""
    return band * math.log2(1 + ratio)


def alone(aviary, decisions):
    """Latencies (K,), s, of tasks that were the only one of a decision, with all drones idle."""
    memory, found = aviary.scene.memory, []
    for _ in range(decisions):
        before = memory["generated"].copy()
        idle = ~memory["core_free"].any(axis=(1, 2)) & ~memory["link_free"].any(axis=1)
        fly(aviary, STAY)
        found.append(memory["latency"][idle & (memory["generated"] == before + 1)].sum(axis=1))
    return np.concatenate(found)


def hover_power():
    """Of a hummingbird, W."""
    return propulsion_power((0.0, 0.0, 0.0), airframe_wing(bulletuav.load_airframe("hummingbird")))
