"""Copies of an engine's worlds in a separate Bullet client, for rendering in another process."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.engine.bodies import Colour, Pose
from bulletuav.engine.body_table import Contents
from bulletuav.engine.c_extension import Extension
from bulletuav.engine.client import disconnect
from bulletuav.engine.in_bullet import make_in_bullet
from bulletuav.geometry.shapes import Shape
from bulletuav.geometry.view import CameraMatrices, Picture

WITHOUT_EXTENSION = Extension(None, "", "a copy never flies")


class AddedPiece(NamedTuple):
    """A piece of a body that was added to an engine.

    Attributes:
        shape: Shape of the piece.
        colour: Red, green, blue and opacity, from 0 to 1.
        poses: Position (3,) in Bullet's frame, m, and quaternion (4,) of each copy.
        other: Index of the body in contacts, as `other` in `Contacts`.
    """

    shape: Shape
    colour: Colour
    poses: Sequence[Pose]
    other: int


class ScenePoses(NamedTuple):
    """Poses of all bodies that images of W worlds can show.

    Attributes:
        position: (W, N, 3) of the drones, m.
        quaternion: (W, N, 4) of the drones, body to world.
        obstacle_position: (W, K, 3) of the obstacles, m.
        obstacle_quaternion: (W, K, 4) of the obstacles.
        layout: (W,) present city layout of each world, or `NO_LAYOUT`.
        added: Pieces of all bodies that were added so far, in order.
    """

    position: np.ndarray
    quaternion: np.ndarray
    obstacle_position: np.ndarray
    obstacle_quaternion: np.ndarray
    layout: np.ndarray
    added: Sequence[AddedPiece]


class SceneCopy:
    """Copy of the bodies of an engine's worlds, whose images equal the engine's to the bit."""

    def __init__(self, contents: Contents, at_once: bool) -> None:
        """Open a Bullet client and create the bodies, in the order in which the engine does.

        Args:
            contents: Drones, obstacles and city layouts of the worlds; `picture` writes the array
                of layouts.
            at_once: Whether the engine created obstacles and cities first, see `BodyTable`.
        """
        self._clients: list[int] = []
        # The copy never steps, so that any duration is valid.
        how = (1.0, False, at_once)
        self._bullet = make_in_bullet(contents, *how, self._clients, WITHOUT_EXTENSION)
        self._contents = contents

    def picture(self, world: int, poses: ScenePoses, shot: CameraMatrices) -> Picture:
        """Move the bodies to poses, and render a camera image.

        Args:
            world: Index of the world.
            poses: Poses of all bodies; `added` has only pieces that the copy does not have yet.
            shot: View, projection and size of the image.

        Returns:
            Colours, depths and labels of the pixels.
        """
        calls, bodies, offset = self._bullet.calls, self._bullet.bodies, self._contents.offset
        before = self._contents.layout.copy()
        self._contents.layout[:] = poses.layout
        bodies.layouts.follow(before, calls)
        for one, position, quaternion in (
            (bodies.drone, poses.position, poses.quaternion),
            (bodies.obstacle, poses.obstacle_position, poses.obstacle_quaternion),
        ):
            place = (position + offset[:, None]).reshape(-1, 3)
            calls.pose(one.ravel(), place, quaternion.reshape(-1, 4))
        for piece in poses.added:
            bodies.add(*piece)
        return self._bullet.renderer.picture(world, *shot)

    def close(self) -> None:
        """Close Bullet's client."""
        disconnect(self._clients)
