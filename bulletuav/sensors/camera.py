"""A camera on every drone, looking forward: pictures by the engine's renderer, or depths by its rays."""

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.geometry.rotation import axes
from bulletuav.geometry.view import FAR, projection_matrix, view_matrix
from bulletuav.vehicle.swarm import Swarm

FIELD_OF_VIEW = 90.0  # degrees, vertical
RENDERED = ("rgb", "depth", "segmentation")


class DroneCameras:
    """Forward cameras at the front of each drone, fixed to the body; pictures are held between exposures.

    pictures: those asked for of "rgb" (W, N, H, W, 3) uint8, "segmentation" (W, N, H, W) uint8 (see `view.SKY`), "depth" and
    "ray_depth" (W, N, H, W) float32, m along the view axis. The latter two differ by what the renderer rounds, and in that
    rays meet the collision shapes of drones; by rays it takes a tenth of the time.
    """

    def __init__(
        self,
        engine: Engine,
        names: list[str],
        radius: np.ndarray,
        size: tuple[int, int],
        every: int,
    ):
        """`radius` (N,) m ahead of the centre sits the lens; `size` (width, height) pixels; exposed every so many steps."""
        self._engine, self._radius, self._size, self._every = engine, radius, size, every
        width, height = size
        shape = (*engine.shape, height, width)
        blank: dict[str, np.ndarray] = {
            "rgb": np.zeros((*shape, 3), dtype=np.uint8),
            "segmentation": np.zeros(shape, dtype=np.uint8),
            "depth": np.full(shape, FAR, dtype=np.float32),
            "ray_depth": np.full(shape, FAR, dtype=np.float32),
        }
        self.pictures = {name: blank[name] for name in names}
        half = np.tan(np.radians(FIELD_OF_VIEW) / 2)
        # Through the corners at which the renderer looks into pixels, to the plane FAR ahead: shares of them are depths.
        left = half * width / height * (1 - 2 * np.arange(width) / width)
        up = half * (1 - 2 * (np.arange(height) + 1) / height)
        self._rays = FAR * np.stack(
            np.broadcast_arrays(1.0, left[None, :], up[:, None]), axis=-1
        ).reshape(-1, 3)

    def expose(self, swarm: Swarm, mask: np.ndarray, steps: np.ndarray) -> None:
        """Take new pictures of the drones of `mask` (W, N) in worlds whose step count (W,) says so."""
        due = np.argwhere(mask & (steps % self._every == 0)[:, None])
        if not self.pictures.keys().isdisjoint(RENDERED):
            self._render(swarm, due)
        if "ray_depth" in self.pictures and len(due):
            self._cast(swarm, mask, due)

    def _render(self, swarm: Swarm, due: np.ndarray) -> None:
        projection = projection_matrix(self._size[0] / self._size[1], FIELD_OF_VIEW)
        for w, i in due.tolist():
            forward, _, up = (np.array(axis) for axis in axes(swarm.quaternion[w, i]))
            eye = swarm.position[w, i] + self._radius[i] * forward
            seen = self._engine.picture(
                w, view_matrix(eye, eye + forward, up.tolist()), projection, self._size
            )
            for name, picture in zip(RENDERED, (seen.pixels, seen.depth, seen.labels), strict=True):
                if name in self.pictures:
                    self.pictures[name][w, i] = picture

    def _cast(self, swarm: Swarm, mask: np.ndarray, due: np.ndarray) -> None:
        """One batch of rays for all cameras."""
        where, who = due.T
        frames = np.array(
            [np.stack(axes(quaternion)) for quaternion in swarm.quaternion[where, who]]
        )
        eye = swarm.position[where, who] + self._radius[who, None] * frames[:, 0]
        start = np.repeat(eye, len(self._rays), axis=0)
        end = start + (self._rays @ frames).reshape(-1, 3)
        share = self._engine.cast_rays(start, end, np.repeat(where, len(self._rays)), (swarm, mask))
        self.pictures["ray_depth"][where, who] = FAR * share.reshape(-1, *self._size[::-1])
