"""Foresight: where a pair that touches will be too close next, although it is not now."""

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.impulses import slip
from bulletuav.contact.motion import pose_at, put_vector, valid_until, vector
from bulletuav.contact.planes import separation_along
from bulletuav.contact.points import MIDDLE, SLIP, Workspace, World, fill, surface_of
from bulletuav.contact.touch import gap_at
from bulletuav.geometry.rotation import Vec3, dot, minus, plus, to_body, to_world
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import HALF_SPACE

LOOKS = 4
"""Times at which points of a pair that touches repeatedly are foreseen, each a quarter as far"""
TRUSTED = 5e-4
"""Depth of an overlap up to which its direction is that of the contact, m"""


@func
def _as_now(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    who: int,
    time: float,
    end: float,
    dt: float,
    arm: Vec3,
) -> Vec3:
    """Return where a point of someone is at a time that is at `arm` at a later time, m."""
    position, before = pose_at(scenery, motions, w, who, time, dt)
    _, after = pose_at(scenery, motions, w, who, end, dt)
    return plus(position, 1.0, to_world(before, to_body(after, arm)))


@kernel
def foresee(space: Workspace, world: World, pair: np.record, time: float, point: np.record) -> bool:
    """Fill in the point at which a pair would be too close at the end of its way, if there is one.

    Velocities are those at the end of the substep, and `aim` was called. Of a pair that turns,
    other points than those of now may come together: without them it would sink, and take many
    impacts to stop.

    Returns:
        Whether there is one.
    """
    a = pair.a
    b = pair.b
    scenery = world.scenery
    motions = space.motions
    w = world.w
    dt = world.dt
    end = min(valid_until(scenery, motions, a), valid_until(scenery, motions, b))
    touched = vector(pair.normal)
    now, _, _ = separation_along(scenery, motions, w, a, b, time, dt, touched)
    wanted = min(now, MIDDLE)
    enough = 0.5 * wanted if wanted > 0.0 else wanted - SLIP
    # Who touches again and again may do so long before the end
    looks = LOOKS if motions[a].impacts > 1 else 1
    later = enough
    for look in range(looks):
        normal = touched
        if look > 0:
            end = time + 0.25 * (end - time)
        later, on_a, on_b = separation_along(scenery, motions, w, a, b, end, dt, normal)
        if later < enough and scenery.table.kind[b] != HALF_SPACE:
            # They may pass each other, for example over an edge
            later, new, on_a, on_b = gap_at(scenery, motions, w, a, b, end, dt, normal, space.room)
            # The direction of a deep overlap misleads: keep that of the touch
            if later > -TRUSTED:
                normal = new
        if later < enough:
            break
    if later >= enough:
        return False
    place = _as_now(scenery, motions, w, a, time, end, dt, on_a)
    position_b, _ = pose_at(scenery, motions, w, b, time, dt)
    if b < scenery.first_body:
        other = _as_now(scenery, motions, w, b, time, end, dt, on_b)
        place = plus(place, 0.5, minus(other, place))
    for k in range(3):
        point.normal[k] = normal[k]
        point.arm_a[k] = place[k] - motions[a].position[k]
        point.arm_b[k] = place[k] - position_b[k]
    fill(motions, point, surface_of(space, world, a, b, 1))
    closing = dot(slip(point, motions), normal)
    point.distance = now
    point.approach = 0.0
    put_vector(point.slip, (0.0, 0.0, 0.0))
    point.least = closing + (wanted - later) / ((end - time) * dt)
    return True
