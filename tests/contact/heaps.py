"""Heaps, stacks and slopes."""

from typing import NamedTuple

import numpy as np
from contact.rig import Rig, random_attitudes

from bulletuav.geometry.obstacle import Obstacle
from bulletuav.vehicle.airframes import load_airframe


class Heap(NamedTuple):
    """How a heap of N drones ended.

    Attributes:
        speed: (N,) m/s.
        spin: (N,) rad/s.
        height: (N,) of the lowest point of each above the ground, m.
        depth: Greatest overlap of two of them, or with the ground, m.
        seconds: Simulated time, s.
        gained: Greatest gain of their energy over its least so far, as a height of one, m.
    """

    speed: np.ndarray
    spin: np.ndarray
    height: np.ndarray
    depth: float
    seconds: float
    gained: float


def drop_heap(
    drones: int = 100, airframe: str = "cf2x", *, hz: int = 240, seconds: float = 6.0, seed: int = 0
) -> Heap:
    """Drop drones in random attitudes, one above the other in a narrow column."""
    rng = np.random.default_rng(seed)
    with Rig([airframe] * drones, hz=hz, substeps=hz // 20) as rig:
        swarm = rig.swarm
        wide = 2.2 * rig.airframes[0].collision_radius
        layer, place = np.divmod(np.arange(drones), 4)
        swarm.position[0, :, 0] = wide * (place % 2)
        swarm.position[0, :, 1] = wide * (place // 2)
        swarm.position[0, :, 2] = wide * (1 + layer)
        swarm.quaternion[:] = random_attitudes(rng, 1, drones)
        return _watch(rig.place(), seconds)


def stack(drones: int = 10, airframe: str = "cf2x", *, hz: int = 240, seconds: float = 2.0) -> Heap:
    """Set drones one on top of the other."""
    with Rig([airframe] * drones, hz=hz, substeps=hz // 20) as rig:
        high = 2 * rig.airframes[0].shape.half[2] + 1e-4
        rig.swarm.position[0, :, :2] = 0
        rig.swarm.position[0, :, 2] = high * (0.5 + np.arange(drones))
        return _watch(rig.place(), seconds)


def watch_energy(rig: Rig, seconds: float) -> np.ndarray:
    """Fly a rig freely for a time; returns how far energy rose above its least (W,), J."""
    least = rig.energy().sum(axis=1)
    gained = np.zeros_like(least)
    while rig.time < seconds - 1e-9:
        rig.fly()
        now = rig.energy().sum(axis=1)
        gained = np.maximum(gained, now - least)
        least = np.minimum(least, now)
    return gained


def _watch(rig: Rig, seconds: float) -> Heap:
    """Fly the only world of a rig freely for a time, then measure its drones."""
    gained = watch_energy(rig, seconds)[0]
    swarm = rig.swarm
    drones = len(rig.airframes)
    lowest = np.array([rig.lowest(i)[0] for i in range(drones)])
    near = [
        rig.gaps(i, j)[0]
        for i in range(drones)
        for j in range(i)
        if np.linalg.norm(swarm.position[0, i] - swarm.position[0, j])
        < 2 * rig.airframes[0].collision_radius
    ]
    return Heap(
        speed=np.linalg.norm(swarm.velocity[0], axis=-1),
        spin=np.linalg.norm(swarm.rates[0], axis=-1),
        height=lowest,
        depth=-min([*near, *lowest]),
        seconds=rig.time,
        gained=gained / (rig.rows["mass"][0, 0] * rig.gravity),
    )


def slide(
    friction: float,
    tangents: np.ndarray,
    *,
    airframe: str = "cf2x",
    hz: int = 240,
    seconds: float = 1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Set a drone on a slope in each world.

    Args:
        friction: Of drone and slope.
        tangents: (W,) of the slopes' angles.
        airframe: Its name.
        hz: Substeps a second.
        seconds: How long to wait.

    Returns:
        (W,) how far each slid, and how far it should have, m: that of a body on a slope,
        t^2 g (sin a - friction cos a) / 2 where this is above 0.
    """
    angle = np.arctan(tangents)
    half = load_airframe(airframe).shape.half[2]
    ramp = Obstacle("box", (8.0, 4.0, 1.0), friction=friction)
    with Rig([airframe], worlds=len(angle), hz=hz, obstacles=[ramp], friction=friction) as rig:
        swarm = rig.swarm
        turn = np.zeros((len(angle), 4))
        turn[:, 1] = np.sin(angle / 2)
        turn[:, 3] = np.cos(angle / 2)
        normal = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
        rig.obstacle[:, 0] = (0, 0, 20)
        rig.turn[:, 0] = turn
        swarm.position[:, 0] = rig.obstacle[:, 0] + (0.5 + half + 5e-5) * normal
        swarm.quaternion[:, 0] = turn
        start = swarm.position[:, 0].copy()
        rig.place().fly_for(seconds)
        slid = np.linalg.norm(swarm.position[:, 0] - start, axis=-1)
        pull = rig.gravity * (np.sin(angle) - friction * np.cos(angle))
        return slid, np.maximum(0.0, 0.5 * pull * rig.time**2)
