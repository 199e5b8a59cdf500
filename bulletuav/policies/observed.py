"""Avoidance policies that use observations only.

Each policy is a state-based policy whose `Traffic` comes from observation blocks. Its results
therefore include the effects of noise, losses and the number of observed neighbours.
"""

from typing import ClassVar

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.mvp import ModifiedVoltagePotential
from bulletuav.policies.orca import Orca
from bulletuav.policies.readings import decode_goal_offset, require_blocks, unpack_blocks
from bulletuav.policies.traffic import Traffic, find_surfaces, tabulate_buildings
from bulletuav.policies.voronoi import Voronoi
from bulletuav.registry import register
from bulletuav.tasks.observations.neighbours import PER_NEIGHBOUR, PER_OBSTACLE
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

NO_BUILDINGS = tabulate_buildings(())
"""Empty table of buildings, which are not observed"""


class Observed(Avoidance):
    """Collision avoidance based on observations only.

    The observation must contain one block of each group in `needed`. It may also contain
    "goal_velocity" (otherwise goals are assumed to be static) and "position" (otherwise the ground
    and the bounds of the arena are not avoided).

    Attributes:
        needed: Groups of equivalent observation blocks.
        avoids_obstacles: Whether the obstacles of the task are avoided, so that their block is
            needed.
    """

    reads_swarm = False
    avoids_obstacles: ClassVar[bool] = True
    needed: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("velocity",),
        ("goal_offset", "goal"),
        ("all_neighbours", "neighbours"),
    )

    def __init__(self, aviary: Aviary) -> None:
        """Check that the required blocks are observed; see `Policy`.

        Raises:
            ValueError: If the observation lacks a block.
        """
        super().__init__(aviary)
        is_blocked = self.avoids_obstacles and bool(aviary.task.obstacles())
        obstacles = (("obstacles",),) if is_blocked else ()
        require_blocks(self.name, aviary, (*self.needed, *obstacles))

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the traffic around each drone as observed."""
        seen = self.blocks(observations)
        shape = self.aviary.alive.shape
        # Unobserved quantities are zero or empty
        zeros = np.zeros((*shape, 3))
        surface = np.zeros((*shape, 0, 4))
        # The box of the arena only: buildings are not observed
        if "position" in seen:
            nowhere = np.full(len(zeros), -1)
            surface = find_surfaces(
                seen["position"], self.box, nowhere, NO_BUILDINGS, self.clearance
            )
        # Other drones are observed relative to the own drone
        own = seen.get("velocity", zeros)
        offset, relative = _others(seen, shape)
        sphere = seen.get("obstacles", zeros[..., :0]).reshape(*shape, -1, PER_OBSTACLE)
        # Unused slots have radius 0
        radius = sphere[..., 7]
        keep = radius + self.clearance.body + self.clearance.margin
        return Traffic(
            velocity=own,
            goal=_goal(seen),
            goal_velocity=seen.get("goal_velocity", zeros),
            offset=offset,
            other_velocity=relative + own[:, :, None],
            known=np.any(offset != 0, axis=-1),
            sphere=sphere[..., 1:4].copy(),
            sphere_velocity=sphere[..., 4:7] + own[:, :, None],
            sphere_radius=np.where(radius > 0, keep, 0.0),
            surface=surface,
        )

    def goal_height(self, observations: Observation, traffic: Traffic) -> np.ndarray:
        """Return goal heights (W, N), m; infinite if the position is not observed."""
        seen = self.blocks(observations)
        if "position" not in seen:
            return np.full(self.aviary.alive.shape, np.inf)
        height: np.ndarray = seen["position"][..., 2] + traffic.goal[..., 2]
        return height

    def blocks(self, observations: Observation) -> dict[str, np.ndarray]:
        """Split observations into blocks, and undo their normalisation.

        Returns:
            (W, N, width of the block) arrays by name.
        """
        return unpack_blocks(self.aviary, observations)


def _goal(seen: dict[str, np.ndarray]) -> np.ndarray:
    """Return the offsets to the goals, (W, N, 3) m, from the observed block."""
    if "goal_offset" in seen:
        return seen["goal_offset"]
    return decode_goal_offset(seen["goal"])


def _others(seen: dict[str, np.ndarray], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets to other drones, m, and their relative velocities, m/s, (W, N, M, 3) each.

    Rows without a drone are zeros.
    """
    if "all_neighbours" in seen:
        others = seen["all_neighbours"].reshape(*shape, -1, 6)
    else:
        rows = seen.get("neighbours", np.zeros((*shape, 0)))
        # Skip the distance in the first column.
        others = rows.reshape(*shape, -1, PER_NEIGHBOUR)[..., 1:]
    return others[..., :3].copy(), others[..., 3:].copy()


@register("policy")
class StraightObserved(Observed):
    """Flight to the observed goal without collision avoidance."""

    name = "straight_observed"
    needed = (("goal_offset", "goal"),)

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Return the preferred velocities."""
        return preferred


@register("policy")
class OrcaObserved(Observed, Orca):
    """Policy `orca` based on observations."""

    name = "orca_observed"


@register("policy")
class MvpObserved(Observed, ModifiedVoltagePotential):
    """Policy `mvp` based on observations."""

    name = "mvp_observed"


@register("policy")
class VoronoiObserved(Observed, Voronoi):
    """Policy `voronoi` based on observations."""

    name = "voronoi_observed"
