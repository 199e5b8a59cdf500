"""Bodies that move through worlds: their validated motion, and functions of time."""

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from bulletuav.contact.spin import compute_rotation_between
from bulletuav.engine.body_source import BodySource, check_pose
from bulletuav.engine.engine import Engine
from bulletuav.errors import as_sequence, finite, shown, unknown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.scenery import NOWHERE

Motion = Callable[[float], tuple[Sequence[float], Sequence[float]]]
"""Function from a time, s, to a position (3,), m, and a quaternion (4,)"""
Pair = tuple[np.ndarray, np.ndarray]
"""A position (3,) and a quaternion (4,), or a velocity (3,) and an angular velocity (3,)"""
STILL, UPRIGHT = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
Made = TypeVar("Made")
MAX_BODIES = 1024
"""Maximum number of bodies in a world"""
MAX_SPEED = 100.0
"""Maximum speed of a body on each axis, m/s"""
MAX_SPIN = 100.0
"""Maximum angular velocity of a body about each axis, rad/s"""


@dataclass(frozen=True)
class Body:
    """A body in a world: its shape, and how it moves.

    Drones do not move a body, whatever they weigh. It passes through all that is no drone.

    Attributes:
        source: Path of a URDF (.urdf) or of a mesh (.obj), corners (V, 3) of a hull in m, or an
            `Obstacle`, which has its own colour, friction and restitution; or a dict of its
            attributes.
        position: (3,) position of the body's origin at the start, m.
        quaternion: (4,) attitude at the start, body to world.
        velocity: (3,) velocity of the origin, m/s.
        angular_velocity: (3,) angular velocity about the origin, world axes, rad/s.
        motion: Function from the time since the start, s, to the position, m, and the quaternion,
            instead of these values. Between two decisions the body moves and turns evenly.

    Raises:
        ValueError: If a number is invalid, there is neither a position nor a motion, or both.
    """

    source: BodySource
    position: Sequence[float] | None = None
    quaternion: Sequence[float] = UPRIGHT
    velocity: Sequence[float] = STILL
    angular_velocity: Sequence[float] = STILL
    motion: Motion | None = None

    def __post_init__(self) -> None:
        if isinstance(self.source, Mapping):
            object.__setattr__(self, "source", _from_dict(Obstacle, self.source))
        velocities = check_velocities(self.velocity, self.angular_velocity)
        if self.motion is None:
            if self.position is None:
                raise ValueError("a body has no position: give position, or motion")
            check_pose(self.position, self.quaternion)
            return
        if not callable(self.motion):
            raise ValueError(
                f"motion of a body is {shown(self.motion)}: a function from time to position and "
                f"quaternion is needed"
            )
        turned = as_sequence("quaternion", self.quaternion, 4) != UPRIGHT
        if self.position is not None or turned or any(one.any() for one in velocities):
            raise ValueError(
                "motion of a body gives its poses: leave out position, quaternion, velocity and "
                "angular_velocity"
            )

    def start(self, time: float) -> tuple[Pair, Pair]:
        """Return the pose at a time, s, if the body follows a function, and the velocities."""
        velocities = check_velocities(self.velocity, self.angular_velocity)
        if self.motion is not None:
            return pose_at(self.motion, time), velocities
        position = STILL if self.position is None else self.position
        return check_pose(position, self.quaternion), velocities


@dataclass(frozen=True)
class DrawnBodies:
    """Bodies that are drawn in each episode.

    Attributes:
        draw: Function from the random generator of a world to its bodies in this episode.
        pool: Sources of the bodies that can be in a world at the same time, such as two equal
            obstacles for at most two of them. They are made once; an episode uses some of them.

    Raises:
        ValueError: If `draw` is not a function, or the pool is empty.
    """

    draw: Callable[[np.random.Generator], Sequence[Body]]
    pool: Sequence[BodySource]

    def __post_init__(self) -> None:
        if not callable(self.draw):
            raise ValueError(
                f"draw of bodies is {shown(self.draw)}: a function from a random generator to a "
                f"list of bodies is needed"
            )
        pool = as_sequence("pool of bodies", self.pool, most=MAX_BODIES)
        if not pool:
            raise ValueError("pool of bodies is empty: list the sources that may be drawn")
        sources = (_from_dict(Obstacle, one) if isinstance(one, Mapping) else one for one in pool)
        object.__setattr__(self, "pool", tuple(sources))


BodiesOption = tuple[Body, ...] | DrawnBodies
"""Bodies of all episodes, or bodies that are drawn"""


def as_bodies(given: Any) -> BodiesOption:
    """Convert the option `bodies`.

    Args:
        given: Bodies, each a `Body` or a dict of its attributes; a `DrawnBodies`; or only its
            function, which then has to draw the same shapes in each episode.

    Raises:
        ValueError: If the option is something else.
    """
    if isinstance(given, DrawnBodies):
        return given
    if callable(given):
        drawn = draw_bodies(given, np.random.default_rng(0))
        return DrawnBodies(given, [one.source for one in drawn])
    if isinstance(given, Body | Mapping):
        given = (given,)
    return _as_bodies("bodies", given)


def count_bodies(bodies: BodiesOption) -> int:
    """Return the maximum number of bodies in a world."""
    return len(bodies.pool if isinstance(bodies, DrawnBodies) else bodies)


def describe_bodies(bodies: BodiesOption) -> Any:
    """Return bodies as values that JSON can store: dicts of their attributes, or "function"."""
    if isinstance(bodies, DrawnBodies):
        return "function"
    described = []
    for body in bodies:
        values = {one.name: getattr(body, one.name) for one in dataclasses.fields(body)}
        source = body.source
        if isinstance(source, Obstacle):
            values["source"] = dataclasses.asdict(source)
        else:
            is_path = isinstance(source, str | Path)
            values["source"] = str(source) if is_path else np.asarray(source).tolist()
        for name in ("position", "quaternion", "velocity", "angular_velocity"):
            values[name] = None if values[name] is None else np.asarray(values[name]).tolist()
        values["motion"] = "function" if body.motion is not None else None
        described.append(values)
    return described


def _as_bodies(name: str, given: Any) -> tuple[Body, ...]:
    """Convert a sequence of bodies."""
    bodies = []
    for one in as_sequence(name, given, most=MAX_BODIES):
        if not isinstance(one, Body | Mapping):
            raise ValueError(
                f"{name} has {shown(one)}: a Body, or a dict of its attributes, is needed"
            )
        bodies.append(one if isinstance(one, Body) else _from_dict(Body, one))
    return tuple(bodies)


def draw_bodies(
    draw: Callable[[np.random.Generator], Sequence[Body]], rng: np.random.Generator
) -> tuple[Body, ...]:
    """Draw bodies, and check them.

    Raises:
        ValueError: If the function takes no generator or returns something else, or a body is
            invalid.
    """
    try:
        inspect.signature(draw).bind(rng)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"bodies: the function {shown(draw)} has to take one argument, the random generator "
            f"({error})"
        ) from None
    return _as_bodies("the function of bodies returned a list that", draw(rng))


def _from_dict(kind: type[Made], given: Mapping[str, Any]) -> Made:
    """Make an object from a dict of its attributes.

    Raises:
        ValueError: If an attribute is unknown or invalid.
    """
    known = {one.name for one in dataclasses.fields(cast(Any, kind))}
    for name in given:
        if name not in known:
            raise ValueError(f"bodies: {unknown('attribute', name, known)}")
    try:
        return kind(**given)
    except TypeError as error:
        raise ValueError(f"bodies has {shown(given)}: {error}") from None


def check_velocities(velocity: Any, angular_velocity: Any) -> tuple[np.ndarray, np.ndarray]:
    """Check the velocity and the angular velocity of a body.

    Raises:
        ValueError: If one is not three numbers within `MAX_SPEED` and `MAX_SPIN`.
    """
    moved = as_sequence("velocity", velocity, 3)
    turned = as_sequence("angular_velocity", angular_velocity, 3)
    return (
        np.array([finite("velocity", one, -MAX_SPEED, MAX_SPEED) for one in moved]),
        np.array([finite("angular_velocity", one, -MAX_SPIN, MAX_SPIN) for one in turned]),
    )


def pose_at(motion: Motion, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of a body by its function of time.

    Raises:
        ValueError: If the function returns no pose.
    """
    given = motion(time)
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise ValueError(
            f"motion of a body returned {shown(given)} at {time:g} s: a position (3,) in m and a "
            f"quaternion (4,) are needed"
        )
    try:
        return check_pose(*given)
    except ValueError as error:
        raise ValueError(f"motion of a body at {time:g} s: {error}") from None


def follow_motion(engine: Engine, w: int, b: int, motion: Motion, time: float, dt: float) -> None:
    """Set the velocities that take body b of world w to its pose at `time`, in `dt`, s.

    Raises:
        ValueError: If the function returns no pose, or the body would be too fast.
    """
    bodies = engine.scenery.bodies
    place, turn = pose_at(motion, time)
    before = tuple(bodies.quaternion[w, b].tolist())
    turned = compute_rotation_between(before, tuple(turn.tolist()))
    velocity, spin = (place - bodies.position[w, b]) / dt, np.array(turned) / dt
    try:
        bodies.velocity[w, b], bodies.spin[w, b] = check_velocities(velocity, spin)
    except ValueError as error:
        raise ValueError(f"motion of a body up to {time:g} s: {error}") from None


def set_body(
    engine: Engine,
    w: int,
    b: int,
    pose: tuple[np.ndarray, np.ndarray],
    velocities: tuple[np.ndarray, np.ndarray],
) -> None:
    """Set the pose and the velocities of body b of world w."""
    bodies = engine.scenery.bodies
    bodies.position[w, b], bodies.quaternion[w, b] = pose
    bodies.velocity[w, b], bodies.spin[w, b] = velocities
    engine.place_bodies([w])


def park_body(engine: Engine, w: int, b: int) -> None:
    """Remove body b from world w; its shape remains for a later pose."""
    nowhere = np.full(3, NOWHERE), np.array(UPRIGHT)
    set_body(engine, w, b, nowhere, (np.zeros(3), np.zeros(3)))
