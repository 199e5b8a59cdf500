"""Points of contact: who hangs together at a touch, where, and where they will be next."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.impulses import eased, prepare, slip
from bulletuav.contact.memory import Memory
from bulletuav.contact.motion import (
    MOTION,
    change_rates,
    pose_at,
    put_vector,
    quaternion_of,
    vector,
)
from bulletuav.contact.pairs import PAIR
from bulletuav.contact.touch import IN_TOUCH, TOUCH, gap_at
from bulletuav.geometry.contact_points import MAX_POINTS, contact_points
from bulletuav.geometry.gjk import make_scratch
from bulletuav.geometry.normal_refinement import refine_normal
from bulletuav.geometry.rotation import Vec3, axes, dot, minus
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import CYLINDER, SPHERE
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.swarm import Swarm

ROOM = 16
"""Pairs that there is room for at first"""
MIDDLE = 0.5 * TOUCH
"""Distance that a touch leaves, m"""
NEARBY = 5 * TOUCH
"""Points of a pair in touch that are farther apart play no part, m"""
SLIP = 2e-6
"""How much closer shapes may come that are too close already, m"""
LIFT = 2e-3
"""Fastest that shapes which are too close are moved apart, m/s"""
ROLLING = 0.4
"""Resistance of cylinders and spheres to rolling about their z axis, as share of their radius.

They stand for airframes with arms and rotors, which do not roll like wheels.
"""
MOST_OF_LINE = 3
"""Most points of a pair that touches along a line: its ends, and the nearest one"""
PIVOTING = 0.05
"""Resistance to turning about the normal on a single point, as share of the radius"""
TIPPING = 0.7
"""Damping of tipping, as share of the radius, at a spin of sqrt(g / radius).

A rigid disc would wobble on for long; what it stands for gives way.
"""


class Workspace(NamedTuple):
    """Arrays that a substep of one world works on.

    Attributes:
        motions: (N,) rows of `MOTION`, how the drones move.
        island: (N,) drones that are solved together.
        order: (N,) drones in the order of their places.
        pairs: Rows of `PAIR`, as many as there mostly are.
        room: Scratch of `gap`.
        found: Scratch of `contact_points`.
    """

    motions: np.ndarray
    island: np.ndarray
    order: np.ndarray
    pairs: np.ndarray
    room: np.ndarray
    found: np.ndarray


def make_workspace(num_drones: int) -> Workspace:
    """Make room for the substep of a world of N drones."""
    return Workspace(
        motions=np.zeros(num_drones, dtype=MOTION),
        island=np.zeros(num_drones, dtype=np.int64),
        order=np.zeros(num_drones, dtype=np.int64),
        pairs=np.zeros(ROOM, dtype=PAIR),
        room=make_scratch(),
        found=np.zeros((MAX_POINTS, 4)),
    )


class World(NamedTuple):
    """One world in a substep.

    Attributes:
        w: Its index.
        dt: Length of the substep, s.
        speed: How far the fastest obstacle gets in the substep, m.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Their coefficient of restitution.
        stops: Whether drones stop where they touch, instead of being pushed.
        scenery: What stands.
        start: State of all drones at the beginning.
        alive: (W, N) bool, drones that can be touched.
        asleep: (W, N) bool, those that rest until something touches them.
        parameters: (W, N) rows of `PARAMETERS`.
        memory: Impulses of the last substep.
    """

    w: int
    dt: float
    speed: float
    friction: float
    restitution: float
    stops: bool
    scenery: Scenery
    start: Swarm
    alive: np.ndarray
    asleep: np.ndarray
    parameters: np.ndarray
    memory: Memory


@func
def measure(
    space: Workspace,
    world: World,
    pair: np.record,
    time: float,
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Measure a pair at a time, keeping the direction."""
    guess = vector(pair.normal)
    distance, normal, on_a, on_b = gap_at(
        world.scenery,
        space.motions,
        world.w,
        pair.a,
        pair.b,
        time,
        world.dt,
        guess,
        space.room,
        world.stops,
    )
    if world.stops and pair.b != world.scenery.ground and distance > 0.0:
        position_a, turn_a = pose_at(world.scenery, space.motions, world.w, pair.a, time, world.dt)
        position_b, turn_b = pose_at(world.scenery, space.motions, world.w, pair.b, time, world.dt)
        normal, on_a, on_b = refine_normal(
            world.scenery.table,
            pair.a,
            axes(turn_a),
            pair.b,
            axes(turn_b),
            minus(position_b, position_a),
            normal,
            on_a,
            on_b,
        )
    put_vector(pair.normal, normal)
    return distance, normal, on_a, on_b


@func
def coefficients(world: World, who: int) -> tuple[float, float]:
    """Return the coefficients of friction and restitution of someone."""
    scenery = world.scenery
    if who < scenery.first_body:
        row = world.parameters[world.w, who]
        return row.friction, row.restitution
    if who < scenery.first_piece:
        k = who - scenery.first_body
        return scenery.friction[k], scenery.restitution[k]
    return world.friction, world.restitution


Surface = tuple[int, int, Vec3, float, float, float, Vec3, Vec3]
"""Of a pair: a, b or -1, drift of b, friction, restitution, damping, resistance to rolling of both
and to turning about the normal, and the axis about which b resists."""


@func
def _rolls(kind: int) -> bool:
    """Tell whether a shape resists rolling about its axis."""
    return kind in (SPHERE, CYLINDER)


@func
def surface_of(
    space: Workspace,
    world: World,
    a: int,
    b: int,
    count: int,
) -> Surface:
    """Collect what the points of a pair have in common, and how many there are.

    On a face friction alone resists turning: only fewer points do so by themselves.
    """
    scenery = world.scenery
    table = scenery.table
    drift = (0.0, 0.0, 0.0)
    other = -1
    resist_b = 0.0
    axis_b = (0.0, 0.0, 0.0)
    if b < scenery.first_body:
        # A sleeper does not yield, but resists rolling about its own axis
        other = -1 if space.motions[b].bears else b
        axis_b = axes(quaternion_of(space.motions[b]))[2]
        resist_b = ROLLING * table.half[b, 0] if _rolls(table.kind[b]) else 0.0
    else:
        move, _ = change_rates(scenery, space.motions, world.w, b, world.dt)
        drift = (move[0] / world.dt, move[1] / world.dt, move[2] / world.dt)
    resist_a = ROLLING * table.half[a, 0] if _rolls(table.kind[a]) else 0.0
    # Of two surfaces the geometric mean counts
    rough, lively = coefficients(world, a)
    rough_b, lively_b = coefficients(world, b)
    radius = table.radius[a]
    pivoting = PIVOTING * radius
    if count > MOST_OF_LINE:
        resist_a = resist_b = pivoting = 0.0
    return (
        a,
        other,
        drift,
        math.sqrt(rough * rough_b),
        math.sqrt(lively * lively_b),
        TIPPING * radius * math.sqrt(radius / STANDARD_GRAVITY),
        (resist_a, resist_b, pivoting),
        axis_b,
    )


@func
def _set_axis(
    motions: np.ndarray,
    point: np.record,
    side: int,
    axis: Vec3,
) -> None:
    """Set an axis about which a point resists turning."""
    turning = eased(motions[point.a], axis)
    put_vector(point.turning_a[side], turning)
    yields = dot(axis, turning)
    if point.b >= 0:
        turning = eased(motions[point.b], axis)
        put_vector(point.turning_b[side], turning)
        yields += dot(axis, turning)
    put_vector(point.axis[side], axis)
    point.stiff[side] = 1.0 / yields


@func
def fill(
    motions: np.ndarray,
    point: np.record,
    surface: Surface,
) -> None:
    """Fill in whose a point of contact is, its surfaces and masses; normal and arms are there."""
    a, b, drift, friction, restitution, damping, resist, axis_b = surface
    point.a = a
    point.b = b
    put_vector(point.drift, drift)
    point.friction = friction
    point.restitution = restitution
    point.damping = damping
    put_vector(point.resist, resist)
    prepare(point, motions)
    if resist[0] > 0.0:
        _set_axis(motions, point, 0, axes(quaternion_of(motions[a]))[2])
    if resist[1] > 0.0:
        _set_axis(motions, point, 1, axis_b)
    if resist[2] > 0.0:
        _set_axis(motions, point, 2, vector(point.normal))


@kernel
def add_points(
    space: Workspace,
    world: World,
    pair: np.record,
    time: float,
    points: np.ndarray,
    size: int,
) -> int:
    """Add the points of contact of a pair in touch; returns how many there are now."""
    a = pair.a
    b = pair.b
    scenery = world.scenery
    distance, normal, on_a, on_b = measure(space, world, pair, time)
    if distance > IN_TOUCH:
        return size
    # From now on it counts as a touch anew only when it gets closer than now
    pair.held = True
    pair.floor = 0.25 * min(distance, TOUCH) if distance > 0.5 * SLIP else distance - SLIP
    position_a, quaternion_a = pose_at(scenery, space.motions, world.w, a, time, world.dt)
    position_b, quaternion_b = pose_at(scenery, space.motions, world.w, b, time, world.dt)
    offset = minus(position_b, position_a)
    found = contact_points(
        scenery.table,
        a,
        axes(quaternion_a),
        b,
        axes(quaternion_b),
        offset,
        normal,
        on_a,
        on_b,
        NEARBY,
        space.found,
        space.room,
    )
    surface = surface_of(space, world, a, b, found)
    motions = space.motions
    for m in range(found):
        point = points[size + m]
        for k in range(3):
            point.normal[k] = normal[k]
            point.arm_a[k] = space.found[m, k]
            point.arm_b[k] = space.found[m, k] - offset[k]
        fill(motions, point, surface)
        point.distance = space.found[m, 3]
        moving = slip(point, motions)
        put_vector(point.slip, moving)
        point.approach = dot(moving, normal)
    return size + found
