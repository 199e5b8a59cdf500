"""Queries of the worlds of an engine: contacts, rays, distances and camera images."""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bulletuav.engine.body_table import Contents
from bulletuav.engine.calls import (
    BODY_A,
    BODY_B,
    DISTANCE,
    NORMAL_FORCE,
    NORMAL_ON_B,
    ON_B,
    VISIBLE,
    bullet,
)
from bulletuav.engine.in_bullet import InBullet
from bulletuav.engine.pictures import Look, PictureMaker
from bulletuav.engine.tiles import cover, vertical_rays, within_tile, write_surface
from bulletuav.engine.visual_scene import ScenePoses, VisualScene
from bulletuav.geometry.city_grid import make_city_grid
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.raster import Cameras, Earlier, Images
from bulletuav.geometry.raycast import cast_drone_rays, cast_scenery_rays
from bulletuav.geometry.rotation import cross, to_world
from bulletuav.geometry.scenery import Scenery, make_scenery
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import FAR, CameraMatrices, Picture
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND, Contacts, Swarm


class LoadPoses(NamedTuple):
    """Poses of the L loads of a task in each world, whose shapes follow those of its N drones.

    Attributes:
        position: (W, L, 3) m.
        quaternion: (W, L, 4) body to world.
        before: (W, L, 3) positions before the last decision, m.
        quaternion_before: (W, L, 4) attitudes before it.
    """

    position: np.ndarray
    quaternion: np.ndarray
    before: np.ndarray
    quaternion_before: np.ndarray

    def join(self, poses: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (W, N, 3) and quaternions (W, N, 4) of drones with those of loads."""
        return _append(poses[0], self.position), _append(poses[1], self.quaternion)

    def join_before(self, poses: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return poses of drones before the last decision with those of loads."""
        return _append(poses[0], self.before), _append(poses[1], self.quaternion_before)


def _append(drones: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Return an array (W, N + L, ...) of drones and loads."""
    return np.concatenate([drones, loads], axis=1)


PlacedShape = tuple[int, np.ndarray | None, np.ndarray | None]
"""Owner of a collision shape (as `other` in `Contacts`), position (3,) in m, quaternion (4,)"""


class EngineQueries(ABC):
    """Base class of `Engine` with the queries of its worlds.

    Attributes:
        shape: Number of worlds W and of drones N.
        obstacle_radius: (K,) radii of the obstacles' bounding spheres, m.
        city_grid: Pieces of the city layouts, and the present layout of each world.
        loads: Poses of the loads of a task, which rays and pictures show; None without loads, and
            in an airspace, in which they are rows of the swarm.
    """

    loads: LoadPoses | None = None

    def __init__(
        self,
        airframes: Sequence[Airframe],
        obstacles: Sequence[Obstacle],
        layouts: Sequence[Solids],
        offset: np.ndarray,
        compiled: bool,
    ) -> None:
        """Build the scenery of the worlds.

        Args:
            airframes: Airframe of each of the N drones of a world.
            obstacles: The K obstacles of each world.
            layouts: The city layouts, one of which can be present in a world at a time.
            offset: (W, 3) origins of the tiles, m.
            compiled: False to cast rays in Bullet.
        """
        self.shape = (len(offset), len(airframes))
        self._is_load = np.array([airframe.is_load for airframe in airframes], dtype=bool)
        self.obstacle_radius = np.array([obstacle.radius for obstacle in obstacles])
        self.city_grid = make_city_grid(layouts, len(offset))
        self._offset = offset[:, None, :]
        self._compiled = compiled
        # The same shapes for compiled code, which does not call Bullet
        self._scenery = make_scenery(
            drones=[airframe.shape for airframe in airframes],
            obstacles=obstacles,
            others=[FIRST_OBSTACLE - k for k in range(len(obstacles))],
            layouts=layouts,
            city_grid=self.city_grid,
        )
        self._layouts = layouts
        # By whether drones are shown by their collision shapes
        self._visual_scenes: dict[bool, VisualScene] = {}

    @property
    @abstractmethod
    def _bullet(self) -> InBullet:
        """The only group of worlds in Bullet of an engine that `asks_bodies`."""

    @abstractmethod
    def _group_of(self, world: int) -> InBullet:
        """Return the group of a world in Bullet."""

    @property
    @abstractmethod
    def contents(self) -> Contents:
        """Drones, obstacles and city layouts of the worlds, without added bodies."""

    @abstractmethod
    def scene_poses(self, swarm: Swarm) -> ScenePoses:
        """Return a copy of the poses of all bodies in pictures, with the drones' from a swarm."""

    @property
    def scenery(self) -> Scenery:
        """Collision shapes of the worlds; a new object after each `Engine.add_body`."""
        return self._scenery

    def contacts(self, swarm: Swarm, dt: float) -> Contacts:
        """Return the contacts of Bullet's last step, if Bullet resolves contacts.

        Args:
            swarm: State of all drones after the step.
            dt: Duration of the step, s.

        Returns:
            A row for each contact point and drone. The velocity is that of the drone's surface
            after the step.
        """
        points = bullet.getContactPoints(physicsClientId=self._bullet.client)
        rows = []
        for one in points:
            # Bullet also lists points of shapes that are near each other without touching.
            if one[NORMAL_FORCE] <= 0 and one[DISTANCE] >= 0:
                continue
            for mine, theirs, sign in ((BODY_A, BODY_B, 1), (BODY_B, BODY_A, -1)):
                drone = self._bullet.bodies.drone_of(one[mine])
                if drone is not None:
                    w, i = drone
                    place = np.array(one[ON_B]) - self._offset[w, 0]
                    spin = to_world(swarm.quaternion[w, i], swarm.rates[w, i])
                    speed = swarm.velocity[w, i] + cross(spin, place - swarm.position[w, i])
                    normal = sign * np.array(one[NORMAL_ON_B])
                    other = self._bullet.bodies.other(one[theirs])
                    impulse, depth = one[NORMAL_FORCE] * dt, max(0.0, -one[DISTANCE])
                    rows.append((w, i, other, impulse, place, normal, speed, depth))
        if not rows:
            return Contacts.none()
        return Contacts(*(np.array(column) for column in zip(*rows, strict=True)))

    def cast_rays(
        self,
        start: np.ndarray,
        end: np.ndarray,
        world: np.ndarray,
        drones: tuple[Swarm, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Cast rays against ground, bodies, buildings, loads and, optionally, drones.

        An engine with `rays="bullet"` casts them by Bullet's `rayTestBatch`, except against drones,
        whose poses in Bullet are those before its last step.

        Args:
            start: (M, 3) starts, m.
            end: (M, 3) ends, m.
            world: (M,) world of each ray.
            drones: A swarm, and a mask (W, N) of its drones that rays can hit. A ray does not hit
                a drone in which it starts.

        Returns:
            (M,) fraction of each ray before its hit, 1 without a hit.
        """
        fraction = self._cast_scenery_rays(start, end, world)
        drones = self.with_loads(drones)
        if drones is not None:
            swarm, mask = drones
            cast_drone_rays(fraction, start, end, world, swarm, mask, self._scenery.table)
        return fraction

    def with_loads(
        self, drones: tuple[Swarm, np.ndarray] | None
    ) -> tuple[Swarm, np.ndarray] | None:
        """Return the poses of drones and the mask (W, N) of those that are seen with the loads."""
        if self.loads is None:
            return drones
        worlds, count = self.loads.position.shape[:2]
        if drones is None:
            shape = worlds, self.shape[1] - count
            drones = Swarm.zeros(*shape, 1), np.zeros(shape, dtype=bool)
        swarm, mask = drones
        both = Swarm.zeros(*self.shape, 1)
        position, quaternion = self.loads.join((swarm.position, swarm.quaternion))
        both = both._replace(position=position, quaternion=quaternion)
        return both, _append(mask, np.ones((worlds, count), dtype=bool))

    def _cast_scenery_rays(
        self, start: np.ndarray, end: np.ndarray, world: np.ndarray
    ) -> np.ndarray:
        """Cast rays against ground, bodies and buildings; see `cast_rays`."""
        if self._compiled:
            return cast_scenery_rays(self._scenery, start, end, world)
        # Clipped to the world's tile
        last, share = within_tile(start, end)
        offset = self._offset[world, 0]
        met = self._bullet.calls.rays(start + offset, last + offset, VISIBLE)
        fraction: np.ndarray = np.where(met < 1, met * share, 1.0)
        return fraction

    @cached_property
    def _picture_maker(self) -> PictureMaker:
        """Rasteriser of the worlds, made when the first pictures are taken."""
        return PictureMaker(self._scenery, self._layouts, is_load=self._is_load)

    def pictures(
        self,
        cameras: Cameras,
        images: Images,
        drones: tuple[Swarm, np.ndarray] | None = None,
        earlier: Earlier | None = None,
    ) -> None:
        """Draw the pictures of cameras in any worlds, without Bullet.

        Depths are those by `cast_rays` through each pixel, except for rays exactly through edges.

        Args:
            cameras: Poses and fields of view of the cameras.
            images: Pictures to draw; written. Those that are not drawn have no rows, but the same
                height and width.
            drones: A swarm, and a mask (W, N) of its drones that are shown, by their collision
                shapes.
            earlier: Poses from which flow is measured; None for the present ones.
        """
        drones = self.with_loads(drones)
        if drones is None:
            drones = Swarm.zeros(*self.shape, 1), np.zeros(self.shape, dtype=bool)
        if earlier is not None and self.loads is not None:
            earlier = earlier._replace(drones=self.loads.join_before(earlier.drones))
        self._picture_maker.draw(self._scenery, cameras, images, *drones, earlier)

    def set_look(self, world: int, look: Look) -> None:
        """Set the colours of `pictures` of a world: the default ones, or random ones.

        Args:
            world: Index of the world.
            look: Strength and seed of the colours.
        """
        self._picture_maker.set_look(world, look)

    def surface_below(self, position: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Find the height of the surface below drones: ground, roof or body.

        Args:
            position: (W, N, 3) positions of the drones, m.
            mask: (W, N) bool, drones to find the surface for.

        Returns:
            (W, N) height z, m; -inf outside `mask`.
        """
        # Most drones have only the ground below, which needs no ray.
        surface = np.empty(self.shape)
        worlds = (0, self.shape[0])
        count = cover(position, mask, self._scenery, surface, *worlds)
        if count:
            drone, start, end = vertical_rays(position, surface, count, *worlds)
            fraction = self._cast_scenery_rays(start, end, drone[:, 0])
            write_surface(surface, drone, start, fraction)
        return surface

    def separation(self, world: int, one: PlacedShape, two: PlacedShape, within: float) -> float:
        """Measure the signed distance of two collision shapes in a world.

        The bodies of shapes with a position are moved there. Other bodies stay in place.

        Args:
            world: Index of the world.
            one: The first shape.
            two: The second shape.
            within: Largest distance to measure, m.

        Returns:
            Distance, m; negative if the shapes overlap, inf beyond `within`.
        """
        of_one = self._bodies_at(world, *one)
        of_two = self._bodies_at(world, *two)
        return min(
            (
                point[DISTANCE]
                for a, b in itertools.product(of_one, of_two)
                for point in bullet.getClosestPoints(
                    a, b, within, physicsClientId=self._group_of(world).client
                )
            ),
            default=np.inf,
        )

    def _bodies_at(
        self, world: int, owner: int, position: np.ndarray | None, quaternion: np.ndarray | None
    ) -> list[int]:
        """Return the bodies of an owner in a world, moved to the pose if they can move."""
        group = self._group_of(world)
        bodies = group.bodies.bodies_of(world - group.worlds.start, owner)
        if position is not None and owner not in (GROUND, CITY):
            place = position + self._offset[world, 0]
            for body in bodies:
                bullet.resetBasePositionAndOrientation(body, place, quaternion, group.client)
        return bodies

    def picture(
        self,
        world: int,
        shot: CameraMatrices,
        drones: tuple[Swarm, np.ndarray] | None = None,
        collision: bool = False,
        far: float = FAR,
    ) -> Picture:
        """Draw a picture of a world for people, with visual shapes and smooth edges.

        Neither Bullet nor a screen is needed.

        Args:
            world: Index of the world.
            shot: View, projection and size of the picture.
            drones: A swarm, and a mask (W, N) of its drones that are shown; None to show none.
            collision: Whether drones are shown by their collision shapes.
            far: Depth that the picture reaches at least, m. That of the sky is not less.

        Returns:
            Colours, depth and labels of the pixels.
        """
        if drones is None:
            drones = Swarm.zeros(*self.shape, 1), np.zeros(self.shape, dtype=bool)
        picture, _ = self.draw(world, shot, drones, collision=collision, far=far)
        return picture

    def draw(
        self,
        world: int,
        shot: CameraMatrices,
        drones: tuple[Swarm, np.ndarray],
        *,
        with_bodies: bool = False,
        collision: bool = False,
        far: float = FAR,
    ) -> tuple[Picture, np.ndarray | None]:
        """Draw a picture of a world as `picture` does, and find the bodies in it.

        Args:
            world: Index of the world.
            shot: View, projection and size of the picture.
            drones: A swarm, and a mask (W, N) of its drones that are shown.
            with_bodies: Whether to find the body at each pixel.
            collision: Whether drones are shown by their collision shapes.
            far: Depth that the picture reaches at least, m.

        Returns:
            The picture, and the bodies; see `VisualScene.draw`.
        """
        swarm, mask = drones
        if collision not in self._visual_scenes:
            self._visual_scenes[collision] = VisualScene(self.contents, collision)
        scene = self._visual_scenes[collision]
        return scene.draw(world, self.scene_poses(swarm), shot, mask[world], far, with_bodies)

    def picture_by_bullet(self, world: int, shot: CameraMatrices) -> Picture:
        """Render a picture of a world by TinyRenderer, with the drones at their poses in Bullet."""
        group = self._group_of(world)
        return group.renderer.picture(world - group.worlds.start, *shot)

    def look_at(self, world: int, target: np.ndarray, distance: float) -> None:
        """Point the camera of the live window at a position.

        Args:
            world: Index of the world.
            target: (3,) position in the world's own frame, m.
            distance: Distance of the camera from it, m.
        """
        self._bullet.renderer.look_at(world, target, distance)
