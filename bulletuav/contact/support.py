"""Support: what forces a drone that rests on one surface can bear without moving.

A rigid body on a flat surface stays at rest where the line of its load meets the surface within its
base, and friction can hold what pulls it along (Coulomb). Here half of both must do, so that how
the load spreads over the points of contact does not matter.
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.plain import record_type
from bulletuav.contact.motion import pose_at, put_vector, vector
from bulletuav.contact.points import Workspace, World, coefficients
from bulletuav.geometry.contact_points import contact_points
from bulletuav.geometry.gjk import gjk_distance
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus, plus, point, quat4, vec3
from bulletuav.vehicle.swarm import Swarm

SHARE = 0.5
"""Share of what a support can bear that counts as safe"""
BENEATH = 1e-3
"""Distance of the surface up to which a point is part of the base, m"""
FEWEST = 3
"""Fewest points of contact that make a base"""
DIRECTIONS = 16
"""Directions in which the base is measured"""

SUPPORT = record_type([("normal", "f8", 3), ("height", "f8"), ("span", "f8"), ("friction", "f8")])
"""What a drone rests on.

Attributes:
    normal: Unit vector out of the surface.
    height: Of the centre of mass above it, m.
    span: Radius of a circle about the foot of the centre of mass that its points enclose, m; 0
        where they do not, or where it rests on several surfaces.
    friction: Coefficient of friction.
"""


@kernel
def find_support(
    support: np.record,
    space: Workspace,
    world: World,
    swarm: Swarm,
    i: int,
    other: int,
) -> None:
    """Measure how a drone rests on something that does not move.

    Args:
        support: Row of `SUPPORT`, written.
        space: Arrays to work on.
        world: The world.
        swarm: State of all drones.
        i: The drone.
        other: Number of the shape of what it rests on.
    """
    scenery = world.scenery
    table = scenery.table
    support.span = 0.0
    if other < scenery.first_body:
        return
    place, turned = pose_at(scenery, space.motions, world.w, other, 0.0, world.dt)
    turn = axes(turned)
    own = axes(quat4(swarm.quaternion, world.w, i))
    offset = minus(place, vec3(swarm.position, world.w, i))
    nowhere = (0.0, 0.0, 0.0)
    _, normal, on_a, on_b = gjk_distance(table, i, own, other, turn, offset, nowhere, space.room)
    found = contact_points(
        table, i, own, other, turn, offset, normal, on_a, on_b, BENEATH, space.found, space.room
    )
    if found < FEWEST:
        return
    put_vector(support.normal, normal)
    support.height = -dot(normal, point(space.found, 0))
    rough, _ = coefficients(world, i)
    rough_other, _ = coefficients(world, other)
    support.friction = math.sqrt(rough * rough_other)
    support.span = max(0.0, _inner_radius(space.found, found, normal))


@func
def _inner_radius(
    points: np.ndarray,
    count: int,
    normal: Vec3,
) -> float:
    """Return how far points (M, 3) reach about the origin, across a normal, where least, m."""
    first = cross(normal, (1.0, 0.0, 0.0) if abs(normal[0]) < 0.8 else (0.0, 1.0, 0.0))
    scale = 1.0 / math.sqrt(dot(first, first))
    first = (scale * first[0], scale * first[1], scale * first[2])
    second = cross(normal, first)
    least = np.inf
    for k in range(DIRECTIONS):
        angle = 2.0 * math.pi * k / DIRECTIONS
        east = cos(angle)
        north = sin(angle)
        most = -np.inf
        for m in range(count):
            place = point(points, m)
            most = max(most, east * dot(place, first) + north * dot(place, second))
        least = min(least, most)
    return least


@func
def pressing(
    support: np.record,
    mass: float,
    acceleration: Vec3,
    torque: Vec3,
) -> tuple[float, bool]:
    """Return with which force a load presses a drone on its support, N, and whether that bears it.

    Args:
        support: Row of `SUPPORT`.
        mass: Of the drone, kg.
        acceleration: By forces without contacts, m/s^2.
        torque: Without contacts, world axes, N m.
    """
    normal = vector(support.normal)
    pressed = -mass * dot(acceleration, normal)
    if support.span <= 0.0 or pressed <= 0.0:
        return 0.0, False
    force = (mass * acceleration[0], mass * acceleration[1], mass * acceleration[2])
    along = plus(force, pressed, normal)
    about = dot(torque, normal)
    # Where the surface has to press: the foot of the load
    tipping = plus(plus(torque, -about, normal), support.height, cross(normal, along))
    if dot(tipping, tipping) > (SHARE * support.span * pressed) ** 2:
        return pressed, False
    pull = math.sqrt(dot(along, along)) + abs(about) / support.span
    return pressed, pull <= SHARE * support.friction * pressed


@func
def holds(
    support: np.record,
    row: np.record,
    acceleration: Vec3,
    torque: Vec3,
    load: np.ndarray,
    dt: float,
) -> bool:
    """Tell whether a drone that rests stays at rest under those who lie on it.

    On several surfaces it does under what friction could hold on one across its own load.

    Args:
        support: Row of `SUPPORT`.
        row: Row of `PARAMETERS` of the drone.
        acceleration: By forces without contacts, m/s^2.
        torque: Without contacts, world axes, N m.
        load: (2, 3) impulse (N s) and angular impulse (N m s) of the others in a substep.
        dt: Its length, s.
    """
    total = plus(acceleration, 1.0 / (row.mass * dt), point(load, 0))
    if support.span > 0.0:
        _, borne = pressing(support, row.mass, total, plus(torque, 1.0 / dt, point(load, 1)))
        return borne
    weight = dot(acceleration, acceleration)
    down = dot(total, acceleration)
    across = dot(total, total) * weight - down * down
    held: bool = down > 0.0 and across <= (row.friction * down) ** 2
    return held
