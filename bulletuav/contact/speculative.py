"""Speculative contacts: points of a touching pair that would overlap later in the substep."""

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.constraint import compute_relative_velocity
from bulletuav.contact.manifold import (
    MAX_EXTRA_PENETRATION,
    TARGET_SEPARATION,
    ContactWorkspace,
    ContactWorld,
    compute_pair_surface,
    fill_constraint,
)
from bulletuav.contact.motion import get_segment_end, interpolate_pose, read_vec3, write_vec3
from bulletuav.contact.separating_planes import measure_along_direction
from bulletuav.contact.time_of_impact import measure_distance
from bulletuav.geometry.rotation import Vec3, dot, minus, plus, to_body, to_world
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import HALF_SPACE

MAX_CHECKS = 4
"""Times at which a pair with repeated contacts is checked, each a quarter as far as the last"""
MAX_TRUSTED_DEPTH = 5e-4
"""Penetration depth up to which the direction of an overlap is used as the contact normal, m"""


@func
def _transform_back(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    shape: int,
    time: float,
    end: float,
    dt: float,
    arm: Vec3,
) -> Vec3:
    """Return the position at `time` of the point of a shape that is at `arm` at `end`, m."""
    position, before = interpolate_pose(scenery, motions, w, shape, time, dt)
    _, after = interpolate_pose(scenery, motions, w, shape, end, dt)
    return plus(position, 1.0, to_world(before, to_body(after, arm)))


@kernel
def find_speculative_point(
    space: ContactWorkspace, world: ContactWorld, pair: np.record, time: float, point: np.record
) -> bool:
    """Find the point at which a pair would be too close at the end of its path segment.

    Velocities must be those at the end of the substep, and `start_segment` must have been called.
    As a pair rotates, other points than the present ones may come into contact. Without a
    speculative point the pair would sink in, and need many impacts to stop.

    Args:
        space: Arrays to work on.
        world: The world.
        pair: Row of `PAIR`.
        time: Time of the impact, as a fraction of the substep.
        point: Row of `CONTACT_POINT`; written if there is such a point.

    Returns:
        True if there is such a point.
    """
    a = pair.a
    b = pair.b
    scenery = world.scenery
    motions = space.motions
    w = world.w
    dt = world.dt
    end = min(get_segment_end(scenery, motions, a), get_segment_end(scenery, motions, b))
    touched = read_vec3(pair.normal)
    now, _, _ = measure_along_direction(scenery, motions, w, a, b, time, dt, touched)
    wanted = min(now, TARGET_SEPARATION)
    enough = 0.5 * wanted if wanted > 0.0 else wanted - MAX_EXTRA_PENETRATION
    # Repeated contacts may happen long before the end
    looks = MAX_CHECKS if motions[a].impacts > 1 else 1
    later = enough
    for look in range(looks):
        normal = touched
        if look > 0:
            end = time + 0.25 * (end - time)
        later, on_a, on_b = measure_along_direction(scenery, motions, w, a, b, end, dt, normal)
        if later < enough and scenery.table.kind[b] != HALF_SPACE:
            # The bodies may miss each other, for example beyond an edge
            later, new, on_a, on_b = measure_distance(
                scenery, motions, w, a, b, end, dt, normal, space.scratch
            )
            # The direction of a deep overlap is unreliable: keep the contact normal
            if later > -MAX_TRUSTED_DEPTH:
                normal = new
        if later < enough:
            break
    if later >= enough:
        return False
    place = _transform_back(scenery, motions, w, a, time, end, dt, on_a)
    position_b, _ = interpolate_pose(scenery, motions, w, b, time, dt)
    if b < scenery.first_body:
        other = _transform_back(scenery, motions, w, b, time, end, dt, on_b)
        place = plus(place, 0.5, minus(other, place))
    for k in range(3):
        point.normal[k] = normal[k]
        point.arm_a[k] = place[k] - motions[a].position[k]
        point.arm_b[k] = place[k] - position_b[k]
    fill_constraint(motions, point, compute_pair_surface(space, world, a, b, 1))
    closing = dot(compute_relative_velocity(point, motions), normal)
    point.distance = now
    point.normal_velocity = 0.0
    write_vec3(point.relative_velocity, (0.0, 0.0, 0.0))
    point.target_velocity = closing + (wanted - later) / ((end - time) * dt)
    return True
