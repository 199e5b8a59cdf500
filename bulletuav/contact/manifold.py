"""Contact manifold: the contact points of a pair, with their normal and surface properties."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.broad_phase import PAIR
from bulletuav.contact.constraint import (
    apply_inverse_inertia,
    compute_relative_velocity,
    prepare_constraint,
)
from bulletuav.contact.motion import (
    MOTION,
    compute_path_rates,
    interpolate_pose,
    read_quaternion,
    read_vec3,
    write_vec3,
)
from bulletuav.contact.time_of_impact import (
    CONTACT_DISTANCE,
    MAX_CONTACT_DISTANCE,
    measure_distance,
)
from bulletuav.contact.warm_start import ContactCache
from bulletuav.geometry.contact_points import MAX_POINTS, contact_points
from bulletuav.geometry.gjk import make_scratch
from bulletuav.geometry.grid import MIN_POINTS as GRID_DRONES
from bulletuav.geometry.grid import Grid, new_point_grid
from bulletuav.geometry.normal_refinement import refine_normal
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus, plus
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import CYLINDER, SPHERE
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.swarm import Swarm

INITIAL_PAIR_CAPACITY = 16
"""Number of pairs that are allocated at first"""
TARGET_SEPARATION = 0.5 * CONTACT_DISTANCE
"""Distance that contacts keep, m"""
MAX_POINT_DISTANCE = 5 * CONTACT_DISTANCE
"""Distance beyond which points of a touching pair are left out of the manifold, m"""
MAX_EXTRA_PENETRATION = 2e-6
"""Further approach that is allowed to shapes which are too close already, m"""
MAX_PUSH_OUT_SPEED = 2e-3
"""Maximum speed at which shapes that are too close are pushed apart, m/s"""
ROLLING_RESISTANCE = 0.4
"""Rolling resistance of cylinders and spheres about their z axis, as a fraction of their radius.

These shapes stand for airframes with arms and rotors, which do not roll like wheels.
"""
MAX_LINE_POINTS = 3
"""Maximum number of points of a line contact: its ends, and the closest point"""
TORSIONAL_RESISTANCE = 0.05
"""Resistance to rotation about the normal on a single point, as a fraction of the radius"""
TIPPING_DAMPING = 0.7
"""Damping of tipping, as a fraction of the radius, at a spin of sqrt(g / radius).

A rigid disc would wobble for a long time; the airframe that it stands for is compliant.
"""


class ContactWorkspace(NamedTuple):
    """Arrays that a substep of one world works on.

    Attributes:
        motions: (N,) rows of `MOTION`, the motion of each drone.
        island: (N,) indices of the drones of the present island.
        order: (N,) indices of the drones, sorted by position.
        pairs: Rows of `PAIR`, allocated for a typical number of pairs.
        scratch: Work array of `gjk_distance`, see `make_scratch`.
        found: Work array of `contact_points`.
        grid: Grid of the drones; in small worlds it has no points and is never filled.
        rank: (N,) place of each drone in `order`; written together with the grid.
        near: (N,) places in `order` of drones that are near to another.
    """

    motions: np.ndarray
    island: np.ndarray
    order: np.ndarray
    pairs: np.ndarray
    scratch: np.ndarray
    found: np.ndarray
    grid: Grid
    rank: np.ndarray
    near: np.ndarray


def make_contact_workspace(num_drones: int) -> ContactWorkspace:
    """Allocate the arrays for a substep of a world of N drones."""
    return ContactWorkspace(
        motions=np.zeros(num_drones, dtype=MOTION),
        island=np.zeros(num_drones, dtype=np.int64),
        order=np.arange(num_drones),
        pairs=np.zeros(INITIAL_PAIR_CAPACITY, dtype=PAIR),
        scratch=make_scratch(),
        found=np.zeros((MAX_POINTS, 4)),
        grid=new_point_grid(num_drones if num_drones >= GRID_DRONES else 0),
        rank=np.zeros(num_drones, dtype=np.int64),
        near=np.zeros(num_drones, dtype=np.int64),
    )


class ContactWorld(NamedTuple):
    """One world in a substep.

    Attributes:
        w: Index of the world.
        dt: Length of the substep, s.
        obstacle_displacement: Displacement of the fastest obstacle in the substep, m.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Coefficient of restitution of the ground and of buildings.
        stops: True if drones stop at a contact instead of receiving an impulse.
        scenery: All shapes.
        start: State of all drones at the beginning of the substep.
        alive: (W, N) bool, drones that can be touched.
        asleep: (W, N) bool, sleeping drones.
        parameters: (W, N) rows of `PARAMETERS`.
        memory: Contact cache: impulses of the last substep.
    """

    w: int
    dt: float
    obstacle_displacement: float
    friction: float
    restitution: float
    stops: bool
    scenery: Scenery
    start: Swarm
    alive: np.ndarray
    asleep: np.ndarray
    parameters: np.ndarray
    memory: ContactCache


@func
def measure_pair(
    space: ContactWorkspace, world: ContactWorld, pair: np.record, time: float
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Measure the distance of a pair at a time, and store the direction as its normal.

    Returns:
        The same as `measure_distance`. If drones stop at a contact, the normal and the points of a
        pair that is apart are refined.
    """
    guess = read_vec3(pair.normal)
    distance, normal, on_a, on_b = measure_distance(
        world.scenery,
        space.motions,
        world.w,
        pair.a,
        pair.b,
        time,
        world.dt,
        guess,
        space.scratch,
        world.stops,
    )
    if world.stops and pair.b != world.scenery.ground and distance > 0.0:
        position_a, turn_a = interpolate_pose(
            world.scenery, space.motions, world.w, pair.a, time, world.dt
        )
        position_b, turn_b = interpolate_pose(
            world.scenery, space.motions, world.w, pair.b, time, world.dt
        )
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
    write_vec3(pair.normal, normal)
    return distance, normal, on_a, on_b


@func
def get_surface_coefficients(world: ContactWorld, shape: int) -> tuple[float, float]:
    """Return the coefficients of friction and restitution of a shape."""
    scenery = world.scenery
    if shape < scenery.first_body:
        row = world.parameters[world.w, shape]
        return row.friction, row.restitution
    if shape < scenery.first_piece:
        k = shape - scenery.first_body
        return scenery.friction[k], scenery.restitution[k]
    return world.friction, world.restitution


PairSurface = tuple[int, int, Vec3, Vec3, float, float, float, Vec3, Vec3]
"""Surface properties of a pair: a; b or -1; velocity and spin of b if no drone; friction;
restitution; tipping damping; resistance to rolling of a and b and to rotation about the normal;
rolling axis of b.
"""


@func
def _has_rolling_resistance(kind: int) -> bool:
    return kind in (SPHERE, CYLINDER)


@func
def compute_pair_surface(
    space: ContactWorkspace, world: ContactWorld, a: int, b: int, num_points: int
) -> PairSurface:
    """Compute the surface properties that the `num_points` points of a pair have in common.

    On a face, friction alone resists rotation: rolling and torsional resistance apply to fewer
    points.
    """
    scenery = world.scenery
    table = scenery.table
    velocity_b = (0.0, 0.0, 0.0)
    spin_b = (0.0, 0.0, 0.0)
    other = -1
    resist_b = 0.0
    axis_b = (0.0, 0.0, 0.0)
    if b < scenery.first_body:
        # A sleeping drone is static, but resists rolling about its own axis
        other = -1 if space.motions[b].is_static else b
        axis_b = axes(read_quaternion(space.motions[b]))[2]
        resist_b = (
            ROLLING_RESISTANCE * table.half[b, 0] if _has_rolling_resistance(table.kind[b]) else 0.0
        )
    else:
        move, turn = compute_path_rates(scenery, space.motions, world.w, b, world.dt)
        velocity_b = (move[0] / world.dt, move[1] / world.dt, move[2] / world.dt)
        spin_b = (turn[0] / world.dt, turn[1] / world.dt, turn[2] / world.dt)
    resist_a = (
        ROLLING_RESISTANCE * table.half[a, 0] if _has_rolling_resistance(table.kind[a]) else 0.0
    )
    # Combine both surfaces by the geometric mean
    friction_a, restitution_a = get_surface_coefficients(world, a)
    friction_b, restitution_b = get_surface_coefficients(world, b)
    radius = table.radius[a]
    pivoting = TORSIONAL_RESISTANCE * radius
    if num_points > MAX_LINE_POINTS:
        resist_a = resist_b = pivoting = 0.0
    return (
        a,
        other,
        velocity_b,
        spin_b,
        math.sqrt(friction_a * friction_b),
        math.sqrt(restitution_a * restitution_b),
        TIPPING_DAMPING * radius * math.sqrt(radius / STANDARD_GRAVITY),
        (resist_a, resist_b, pivoting),
        axis_b,
    )


@func
def _set_rolling_axis(motions: np.ndarray, point: np.record, side: int, axis: Vec3) -> None:
    """Set an axis about which a point resists rotation, and its effective inertia."""
    turning = apply_inverse_inertia(motions[point.a], axis)
    write_vec3(point.rolling_response_a[side], turning)
    inverse_inertia = dot(axis, turning)
    if point.b >= 0:
        turning = apply_inverse_inertia(motions[point.b], axis)
        write_vec3(point.rolling_response_b[side], turning)
        inverse_inertia += dot(axis, turning)
    write_vec3(point.rolling_axis[side], axis)
    point.rolling_mass[side] = 1.0 / inverse_inertia


@func
def fill_constraint(motions: np.ndarray, point: np.record, surface: PairSurface) -> None:
    """Set the bodies, surface and effective masses of a contact point.

    The normal and the arms must be set.
    """
    a, b, velocity_b, spin_b, friction, restitution, damping, resist, axis_b = surface
    if spin_b != (0.0, 0.0, 0.0):
        velocity_b = plus(velocity_b, 1.0, cross(spin_b, read_vec3(point.arm_b)))
    point.a = a
    point.b = b
    write_vec3(point.obstacle_velocity, velocity_b)
    point.friction = friction
    point.restitution = restitution
    point.tipping_damping = damping
    write_vec3(point.rolling_limit, resist)
    prepare_constraint(point, motions)
    if resist[0] > 0.0:
        _set_rolling_axis(motions, point, 0, axes(read_quaternion(motions[a]))[2])
    if resist[1] > 0.0:
        _set_rolling_axis(motions, point, 1, axis_b)
    if resist[2] > 0.0:
        _set_rolling_axis(motions, point, 2, read_vec3(point.normal))


@kernel
def add_contact_points(
    space: ContactWorkspace,
    world: ContactWorld,
    pair: np.record,
    time: float,
    points: np.ndarray,
    num_points: int,
) -> int:
    """Add the contact points of a pair if it is in contact.

    Args:
        space: Arrays to work on.
        world: The world.
        pair: Row of `PAIR`; its target distance is set.
        time: Time of the impact, as a fraction of the substep.
        points: Rows of `CONTACT_POINT`, added to.
        num_points: Number of points so far.

    Returns:
        Number of points in use.
    """
    a = pair.a
    b = pair.b
    scenery = world.scenery
    distance, normal, on_a, on_b = measure_pair(space, world, pair, time)
    if distance > MAX_CONTACT_DISTANCE:
        return num_points
    # The next impact of the pair is when it gets closer than it is now
    pair.has_touched = True
    pair.target_distance = (
        0.25 * min(distance, CONTACT_DISTANCE)
        if distance > 0.5 * MAX_EXTRA_PENETRATION
        else distance - MAX_EXTRA_PENETRATION
    )
    position_a, quaternion_a = interpolate_pose(scenery, space.motions, world.w, a, time, world.dt)
    position_b, quaternion_b = interpolate_pose(scenery, space.motions, world.w, b, time, world.dt)
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
        MAX_POINT_DISTANCE,
        space.found,
        space.scratch,
    )
    surface = compute_pair_surface(space, world, a, b, found)
    motions = space.motions
    for m in range(found):
        point = points[num_points + m]
        for k in range(3):
            point.normal[k] = normal[k]
            point.arm_a[k] = space.found[m, k]
            point.arm_b[k] = space.found[m, k] - offset[k]
        fill_constraint(motions, point, surface)
        point.distance = space.found[m, 3]
        moving = compute_relative_velocity(point, motions)
        write_vec3(point.relative_velocity, moving)
        point.normal_velocity = dot(moving, normal)
    return num_points + found
