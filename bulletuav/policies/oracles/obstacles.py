"""Policy `reflecting_orca`: ORCA that knows how moving obstacles are reflected at their bounds."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.orca import Orca
from bulletuav.registry import register
from bulletuav.tasks.parts.obstacle_field import find_obstacle_box


@register("policy")
class ReflectingOrca(Orca):
    """Flight to the goal by ORCA, which also avoids the paths of obstacles after reflections.

    An obstacle and its mirror images (`mirror_images`) are spheres with constant velocities. The
    obstacle follows its own line until it reaches a bound, and then that of an image, which until
    then is beyond the bound.
    """

    name = "reflecting_orca"

    def __init__(self, aviary: Aviary) -> None:
        """Find the bounds of the obstacles; see `Policy`."""
        super().__init__(aviary)
        self._bounds = find_obstacle_box(aviary.task)

    def spheres(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the obstacles, and their images that matter; see `Avoidance.spheres`."""
        place, velocity, radius = super().spheres()
        if self._bounds is None:
            return place, velocity, radius
        images, speeds = mirror_images(place, velocity, *self._bounds, self.parameters.horizon)
        # The number of spheres is the same in all worlds, so unused images are at their obstacles
        shape = (len(place), -1, 3)
        spheres = np.concatenate([place, images.reshape(shape)], axis=1)
        velocities = np.concatenate([velocity, speeds.reshape(shape)], axis=1)
        return spheres, velocities, np.concatenate([radius, np.repeat(radius, 3)])


def mirror_images(
    position: np.ndarray, velocity: np.ndarray, low: np.ndarray, high: np.ndarray, horizon: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return mirror images of obstacles, one for each bound that they reach within a horizon.

    An obstacle that is reflected at the plane x = b moves like an image that started at 2 b - x
    with the opposite velocity along x. Bounds are reached in order of time, each axis once, and
    each image is that of the one before it.

    Args:
        position: (W, K, 3) centres of obstacles between the bounds, m.
        velocity: (W, K, 3) their velocities, m/s.
        low: (3,) lower bounds of the centres, m.
        high: (3,) upper bounds of the centres, m.
        horizon: Time until which bounds are to be reached, s.

    Returns:
        (W, K, 3, 3) positions of the first, second and third image, m, and their velocities, m/s.
        Images of bounds that are not reached are like the last one that is, or like the obstacle.
    """
    bound = np.where(velocity < 0, low, high)
    is_moving = velocity != 0
    time = np.full(velocity.shape, np.inf)
    np.divide(bound - position, velocity, out=time, where=is_moving)
    order = np.argsort(time, axis=-1, kind="stable")
    image, mirrored = position.copy(), velocity.copy()
    images, velocities = [], []
    for k in range(3):
        axis = order[..., k, None]
        is_reached = np.take_along_axis(time, axis, axis=-1) <= horizon
        is_flipped = is_reached & (np.arange(3) == axis)
        image = np.where(is_flipped, 2 * bound - image, image)
        mirrored = np.where(is_flipped, -mirrored, mirrored)
        images.append(image)
        velocities.append(mirrored)
    return np.stack(images, axis=2), np.stack(velocities, axis=2)
