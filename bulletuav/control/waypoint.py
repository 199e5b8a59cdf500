"""Flight of an aeroplane to a target position: through the position, and then around it.

An aeroplane that turns towards a point inside the circle of its tightest turn flies around the
point forever. Therefore the flight has three phases:

- HOMING: it turns towards the target as tightly as it can, and flies straight to it: the shortest
  path of a Dubins car to a point outside its turn circles.
- EXTENDING: the target is inside a turn circle, to the left or to the right. The aeroplane flies
  straight on until the target is outside, with a margin.
- LOITERING: the aeroplane has passed the target and circles it. A pass is within a tenth of the
  radius of the tightest turn plus the distance flown in one step of the controller; after a wider
  one the aeroplane returns.

A target may move. A step of more than half of the radius of the tightest turn is a new target,
which the aeroplane passes before it circles it. Smaller steps, such as those of another aircraft
that is followed, do not change the phase. Only horizontal positions count.

References:
    L. Dubins, On curves of minimal length with a constraint on average curvature, American Journal
    of Mathematics 79 (3), 1957.
    R. Beard, T. McLain, Small Unmanned Aircraft, Princeton 2012: the vector field of an orbit.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.geometry.rotation import Vec3Like

HOMING, EXTENDING, LOITERING = range(3)
"""Phases, for compiled code; a flight starts with HOMING"""
PASS_DISTANCE = 0.1
"""Largest distance of a pass, in radii of the tightest turn; the distance of a step is added"""
NEW_TARGET = 0.5
"""Smallest step to a new target, in radii of the tightest turn"""
EXTENSION_RADIUS = 1.3
"""Radius of the circle that a target has left at the end of an extension, in radii of the tightest
turn: rolling into a turn takes time"""


@func
def update_phase(
    position: Vec3Like,
    velocity: Vec3Like,
    target: Vec3Like,
    airspeed: float,
    max_lateral: float,
    dt: float,
    memory: np.ndarray,
    first: int,
) -> int:
    """Return the phase of the flight to a target position, and store it.

    Args:
        position: Position, m, world.
        velocity: Velocity over ground, m/s, world.
        target: Target position, m, world.
        airspeed: Airspeed, m/s.
        max_lateral: Lateral acceleration of the tightest turn, m/s^2.
        dt: Time between calls, s.
        memory: (M,) state of the controllers; the phase is updated, and after it the last target's
            coordinates x and y, m.
        first: Index of the phase in it.

    Returns:
        HOMING, EXTENDING or LOITERING.
    """
    radius = airspeed * airspeed / max_lateral
    phase = int(memory[first])
    east, north = target[0] - memory[first + 1], target[1] - memory[first + 2]
    step = NEW_TARGET * radius
    # Also if one of the targets is NaN
    if not (east * east + north * north <= step * step):
        phase = HOMING
    if phase != LOITERING:
        x, y = target[0] - position[0], target[1] - position[1]
        square = x * x + y * y
        speed = math.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
        ahead = velocity[0] * x + velocity[1] * y
        aside = abs(velocity[0] * y - velocity[1] * x)
        # A pass is detected up to one call late
        near = PASS_DISTANCE * radius + speed * dt
        # A point at a distance d is inside a circle of radius r, which touches the course, if its
        # distance from the course is above d^2 / (2 r)
        reach = EXTENSION_RADIUS * radius if phase == EXTENDING else radius
        if ahead <= 0.0 and square <= near * near:
            phase = LOITERING
        elif 2.0 * reach * aside > speed * square:
            phase = EXTENDING
        else:
            phase = HOMING
    memory[first] = phase
    memory[first + 1] = target[0]
    memory[first + 2] = target[1]
    return phase


@func
def orbit_course(x: float, y: float, radius: float) -> tuple[float, float]:
    """Return the course of the vector field that leads to a circle around a point, to the left.

    Far away it points to the centre, and on the circle along it: equation 10.13 of Beard and
    McLain, with k_orbit = 1.

    Args:
        x: East offset from the aircraft to the centre, m.
        y: North offset, m.
        radius: Radius of the circle, m.

    Returns:
        East and north component, of any length; 0 at the centre.
    """
    beyond = math.sqrt(x * x + y * y) - radius
    return beyond * x + radius * y, beyond * y - radius * x
