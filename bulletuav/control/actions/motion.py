"""Action types that command motion: a velocity, an acceleration, or a target position."""

import math

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.compiled.kernel import kernel
from bulletuav.control.actions.base import (
    Action,
    ActionContext,
    Compiled,
    limit_drone,
    limit_norm,
    normalised,
    with_yaw,
    within_climb,
)
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.registry import register
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.envelope import find_envelope

UP, YAW = 2, 3
"""Columns of a setpoint"""
MAX_TURN_RATE = np.pi
"""Maximum turn rate of action `turn_speed`, rad/s"""
MIN_SPEED = 0.01
"""Minimum horizontal speed of action `turn_speed`, m/s; a heading needs one"""


@kernel
def _decode_limited(
    action: np.ndarray, commanded: np.ndarray, setpoint: np.ndarray, most: float, climb: float
) -> None:
    """Write velocities or accelerations of norm at most `most`, scaled vertically by `climb`."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for k in range(3):
                # Scale each axis, then limit the norm
                setpoint[w, i, k] = action[w, i, k] * (climb if k == UP else most)
            limit_drone(setpoint, 3, most, w, i)
            setpoint[w, i, YAW] = 0.0


@kernel
def _decode_increment(
    action: np.ndarray,
    commanded: np.ndarray,
    setpoint: np.ndarray,
    speed: float,
    climb: float,
    step: float,
) -> None:
    """Write the velocities of action `velocity_increment`."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for k in range(3):
                # Relative to the last commanded velocity, not to the drone's velocity
                setpoint[w, i, k] = commanded[w, i, k] + step * action[w, i, k]
            limit_drone(setpoint, 3, speed, w, i)
            # The vertical velocity has its own limit
            setpoint[w, i, UP] = min(max(setpoint[w, i, UP], -climb), climb)
            setpoint[w, i, YAW] = 0.0


@kernel
def _decode_turn(
    action: np.ndarray,
    commanded: np.ndarray,
    setpoint: np.ndarray,
    most: float,
    climb: float,
    turn: float,
) -> None:
    """Write the velocities and headings of action `turn_speed`."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            heading = atan2(commanded[w, i, 1], commanded[w, i, 0]) + turn * action[w, i, 0]
            speed = max(MIN_SPEED, most * (action[w, i, 1] + 1) / 2)
            setpoint[w, i, 0] = speed * cos(heading)
            setpoint[w, i, 1] = speed * sin(heading)
            setpoint[w, i, UP] = climb * action[w, i, 2]
            limit_drone(setpoint, 3, most, w, i)
            setpoint[w, i, YAW] = heading


@kernel
def _decode_position(
    action: np.ndarray,
    commanded: np.ndarray,
    setpoint: np.ndarray,
    centre: np.ndarray,
    half: np.ndarray,
) -> None:
    """Write the positions of action `target_position`."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for k in range(3):
                setpoint[w, i, k] = centre[k] + half[k] * action[w, i, k]
            setpoint[w, i, YAW] = 0.0


@kernel
def _decode_climb(
    action: np.ndarray,
    commanded: np.ndarray,
    setpoint: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    climb: np.ndarray,
    sink: np.ndarray,
) -> None:
    """Write the velocities and headings of action `heading_speed_climb`; bounds are (N,)."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            heading = np.pi * action[w, i, 0]
            rise = action[w, i, 2] * (climb[i] if action[w, i, 2] > 0.0 else sink[i])
            speed = low[i] + (high[i] - low[i]) * (0.5 * (action[w, i, 1] + 1.0))
            # The climb has priority over the speed, but not over the minimum speed
            left = math.sqrt(max(high[i] * high[i] - rise * rise, 0.0))
            speed = max(min(speed, left), low[i])
            setpoint[w, i, 0] = speed * cos(heading)
            setpoint[w, i, 1] = speed * sin(heading)
            setpoint[w, i, UP] = rise
            setpoint[w, i, YAW] = heading


def _limited(
    context: ActionContext,
    name: str,
    level: SetpointLevel,
    symbol: str,
    unit: str,
    most: float,
    climb: float,
) -> Action:
    """Create an action of vectors scaled by `most`, which also limits their norm.

    The vertical part is scaled by `climb`.
    """
    scale = np.array([most, most, climb])
    labels = tuple(
        f"{symbol}{axis} / {one:g} {unit}" for axis, one in zip("xyz", scale, strict=True)
    )

    def encode(vector: np.ndarray, commanded: np.ndarray | None = None) -> np.ndarray:
        share: np.ndarray = within_climb(vector, climb) / scale
        return share

    return normalised(
        context,
        name=name,
        level=level,
        labels=labels,
        decode=Compiled(_decode_limited, 4, most, climb),
        encode=encode,
    )


@register("action")
def velocity(context: ActionContext) -> Action:
    """Fly at a velocity east, north and up: the first two over max_speed, the last over max_climb.

    The speed is limited to max_speed, and the direction kept. Yaw is held at 0.
    """
    limits = (context.max_speed, context.max_climb)
    return _limited(context, "velocity", SetpointLevel.VELOCITY, "v", "m/s", *limits)


@register("action")
def acceleration(context: ActionContext) -> Action:
    """Accelerate east, north and up, over half of gravity.

    The acceleration is limited to half of gravity, and the direction kept. Yaw is held at 0.
    """
    most = context.gravity / 2
    limits = (most, most)
    return _limited(context, "acceleration", SetpointLevel.ACCELERATION, "a", "m/s^2", *limits)


@register("action")
def velocity_increment(context: ActionContext) -> Action:
    """Change the commanded velocity, on each axis by up to max_speed times the decision period.

    The speed is limited to max_speed, then the vertical velocity to max_climb. An episode begins
    with the velocity that the drone starts with.
    """
    speed, climb = context.max_speed, context.max_climb
    step = speed * context.period
    labels = tuple(f"change of v{axis} / {step:g} m/s" for axis in "xyz")

    def encode(velocity: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        change = (within_climb(velocity, climb) - commanded) / step
        # What is too far for one step is shortened, and keeps its direction.
        largest = np.abs(change).max(axis=-1, keepdims=True)
        share: np.ndarray = change / np.maximum(largest, 1.0)
        return share

    return normalised(
        context,
        name="velocity_increment",
        level=SetpointLevel.VELOCITY,
        labels=labels,
        decode=Compiled(_decode_increment, 4, speed, climb, step),
        encode=encode,
    )


@register("action")
def heading_speed(context: ActionContext) -> Action:
    """Fly towards a heading at a speed, with a climb.

    The heading is from -1 to 1 for -180 to 180 degrees from east, to the left. The speed is from
    -1 to 1 for 0 to max_speed. The climb is over max_climb. The nose points along the heading.
    The speed with climb is limited to max_speed.
    """
    speed, most_climb = context.max_speed, context.max_climb
    labels = (
        "heading / 180 degrees",
        f"2 speed / {speed:g} m/s - 1",
        f"climb / {most_climb:g} m/s",
    )

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        # Shares become an angle, a speed and a climb
        heading = np.pi * action[..., 0]
        forward = speed * (action[..., 1] + 1) / 2
        climb = most_climb * action[..., 2]
        east = forward * cos(heading)
        north = forward * sin(heading)
        wanted = np.stack([east, north, climb], axis=-1)
        return with_yaw(limit_norm(wanted, speed), heading)

    return normalised(
        context,
        name="heading_speed",
        level=SetpointLevel.VELOCITY,
        labels=labels,
        decode=decode,
    )


@register("action")
def heading_speed_climb(context: ActionContext) -> Action:
    """Fly towards a heading at a speed, with a climb, within the limits of each airframe.

    The heading is from -1 to 1 for -180 to 180 degrees from east, to the left. The speed is from -1
    to 1 for the airframe's minimum to its maximum speed; the minimum is 0 for drones that hover.
    The climb is from -1 to 1 for the airframe's largest sink to its largest climb, and has priority
    over the speed. The nose points along the heading.

    In `heading_speed`, all speeds are from 0 to max_speed, and too slow an aeroplane would loiter.
    """
    limits = np.array([_flight_limits(airframe, context) for airframe in context.airframes])
    low, high, climb, sink = limits.T.copy()
    ones = np.ones((len(limits), 3))

    def encode(velocity: np.ndarray, commanded: np.ndarray | None = None) -> np.ndarray:
        east, north, up = (velocity[..., k] for k in range(3))
        share = (np.sqrt(east * east + north * north) - low) / np.maximum(high - low, 1e-12)
        rise = up / np.where(up > 0.0, climb, sink)
        columns = [atan2(north, east) / np.pi, 2.0 * share - 1.0, rise]
        return np.stack([np.clip(column, -1.0, 1.0) for column in columns], axis=-1)

    return Action(
        name="heading_speed_climb",
        level=SetpointLevel.VELOCITY,
        labels=tuple(
            (
                "heading / 180 degrees",
                f"speed: -1 to 1 for {least:g} to {most:g} m/s",
                f"climb: -1 to 1 for {-down:g} to {up:g} m/s",
            )
            for least, most, up, down in limits.round(3).tolist()
        ),
        low=-ones,
        high=ones,
        decode=Compiled(_decode_climb, 4, low, high, climb, sink),
        encode=encode,
    )


def _flight_limits(airframe: Airframe, context: ActionContext) -> tuple[float, float, float, float]:
    """Return the minimum and maximum speed of an airframe, and its largest climb and sink, m/s."""
    fastest, climb = min(context.max_speed, airframe.max_speed), context.max_climb
    if not airframe.needs_airspeed:
        climb = min(climb, fastest)
        return 0.0, fastest, climb, climb
    envelope = find_envelope(airframe)
    slowest, fastest = envelope.min_speed, min(fastest, envelope.max_speed)
    climbs = (min(climb, envelope.max_climb), min(climb, envelope.max_sink))
    return slowest, max(slowest, fastest), *climbs


@register("action")
def turn_speed(context: ActionContext) -> Action:
    """Turn the nose, and fly along it at a speed, with a climb: for cameras that look forward.

    The turn is from -1 to 1 for 180 degrees per second to the right and to the left, from the
    heading of the last commanded velocity. The speed is from -1 to 1 for 0.01 m/s to max_speed. The
    climb is over max_climb. The speed with climb is limited to max_speed. An episode begins with
    the heading of the velocity that the drone starts with, east if it is at rest.
    """
    speed, climb, turn = context.max_speed, context.max_climb, MAX_TURN_RATE * context.period
    labels = (
        f"turn / {np.rad2deg(turn):g} degrees",
        f"2 speed / {speed:g} m/s - 1",
        f"climb / {climb:g} m/s",
    )
    return normalised(
        context,
        name="turn_speed",
        level=SetpointLevel.VELOCITY,
        labels=labels,
        decode=Compiled(_decode_turn, 4, speed, climb, turn),
    )


@register("action")
def target_position(context: ActionContext) -> Action:
    """Fly to a position and stop there.

    On each axis, -1 and 1 are the lower and upper bounds of the arena. Yaw is held at 0. Aircraft
    that cannot hover fly through the position, and then circle it.
    """
    # The arena from -1 to 1 on each axis
    centre = (context.arena_low + context.arena_high) / 2
    half = (context.arena_high - context.arena_low) / 2
    labels = tuple(
        f"{axis} = {middle:g} + {extent:g} a m"
        for axis, middle, extent in zip("xyz", centre, half, strict=True)
    )

    def encode(position: np.ndarray, commanded: np.ndarray | None = None) -> np.ndarray:
        share: np.ndarray = (position - centre) / half
        return share

    return normalised(
        context,
        name="target_position",
        level=SetpointLevel.POSITION,
        labels=labels,
        decode=Compiled(_decode_position, 4, centre, half),
        encode=encode,
    )
