"""Avoiding policies that know what drones observe, and nothing else.

Each is a policy of the true state, with `Traffic` from the blocks of its observation. So noise,
losses and the number of neighbours that are observed tell.
"""

from typing import ClassVar

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import Rules
from bulletuav.policies.mvp import ModifiedVoltagePotential
from bulletuav.policies.orca import Orca
from bulletuav.policies.traffic import Traffic, buildings, surfaces
from bulletuav.policies.voronoi import Voronoi
from bulletuav.registry import register
from bulletuav.tasks.observations.neighbours import PER_NEIGHBOUR, PER_OBSTACLE
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

NOTHING_STANDS = buildings(())
"""Buildings are not observed"""


class Observed(Avoidance):
    """Avoidance by observations alone.

    Of the blocks `needed`, the observation has one of each group. It may also have "goal_velocity"
    (else goals are taken to stand still) and "position" (else nobody avoids the ground and the
    arena's bounds).

    Attributes:
        needed: Groups of blocks that tell the same.
    """

    reads_swarm = False
    needed: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("velocity",),
        ("goal_offset", "goal"),
        ("all_neighbours", "neighbours"),
    )

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly; see `Policy`.

        Raises:
            ValueError: The observation lacks a block.
        """
        super().__init__(aviary)
        there = aviary.observer.slices
        obstacles = (("obstacles",),) if aviary.task.obstacles() else ()
        for group in (*self.needed, *obstacles):
            if not there.keys() & set(group):
                raise ValueError(
                    f"policy {self.name!r} needs the observation block "
                    f"{' or '.join(map(repr, group))}, and there are only {', '.join(there)}: "
                    f"add it by the option observation"
                )

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Tell what the observations tell of the traffic around drones."""
        seen = self.blocks(observations)
        shape = self.aviary.alive.shape
        # What is not observed is zero, or not there
        zeros = np.zeros((*shape, 3))
        surface = np.zeros((*shape, 0, 4))
        # Only the arena's box: buildings are not among the observations
        if "position" in seen:
            nowhere = np.full(len(zeros), -1)
            surface = surfaces(seen["position"], self.box, nowhere, NOTHING_STANDS, self.clear)
        # Others are observed relative to the drone
        own = seen.get("velocity", zeros)
        gap, relative = _others(seen, shape)
        ball = seen.get("obstacles", zeros[..., :0]).reshape(*shape, -1, PER_OBSTACLE)
        # Slots without an obstacle have the radius 0
        radius = ball[..., 7]
        keep = radius + self.clear.body + self.clear.margin
        return Traffic(
            velocity=own,
            goal=_goal(seen),
            goal_velocity=seen.get("goal_velocity", zeros),
            gap=gap,
            other=relative + own[:, :, None],
            known=np.any(gap != 0, axis=-1),
            ball=ball[..., 1:4].copy(),
            ball_velocity=ball[..., 4:7] + own[:, :, None],
            ball_radius=np.where(radius > 0, keep, 0.0),
            surface=surface,
        )

    def goal_height(self, observations: Observation, traffic: Traffic) -> np.ndarray:
        """Tell how high goals are; infinitely where the position is not observed, (W, N) m."""
        seen = self.blocks(observations)
        if "position" not in seen:
            return np.full(self.aviary.alive.shape, np.inf)
        height: np.ndarray = seen["position"][..., 2] + traffic.goal[..., 2]
        return height

    def blocks(self, observations: Observation) -> dict[str, np.ndarray]:
        """Split observations into their blocks of numbers, in their units also where normalised.

        Returns:
            (W, N, numbers of the block) by name.
        """
        observer = self.aviary.observer
        seen: dict[str, np.ndarray] = {}
        parts = observer.split(observations)
        for name, part in observer.slices.items():
            seen[name] = np.array(parts[name], dtype=float)
            if self.aviary.options.normalise:
                low, high = np.array([(one.low, one.high) for one in observer.labels[part]]).T
                seen[name] = (low + high) / 2 + (high - low) / 2 * seen[name]
        return seen


def _goal(seen: dict[str, np.ndarray]) -> np.ndarray:
    """Give the ways to the goals, (W, N, 3) m, from the block that there is."""
    if "goal_offset" in seen:
        return seen["goal_offset"]
    goal = seen["goal"]
    way: np.ndarray = goal[..., :3] * goal[..., 3:]
    return way


def _others(seen: dict[str, np.ndarray], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Give ways to other drones, m, and their relative velocities, m/s, (W, N, M, 3) each.

    Rows without a drone are zeros.
    """
    if "all_neighbours" in seen:
        others = seen["all_neighbours"].reshape(*shape, -1, 6)
    else:
        rows = seen.get("neighbours", np.zeros((*shape, 0)))
        # Without the distance, which stands first.
        others = rows.reshape(*shape, -1, PER_NEIGHBOUR)[..., 1:]
    return others[..., :3].copy(), others[..., 3:].copy()


@register("policy")
class StraightObserved(Observed):
    """Flight towards the observed goal, which avoids nobody."""

    name = "straight_observed"
    needed = (("goal_offset", "goal"),)

    def avoid(self, traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
        """Give the wish itself."""
        return wish


@register("policy")
class OrcaObserved(Observed, Orca):
    """Policy `orca`, by observations."""

    name = "orca_observed"


@register("policy")
class MvpObserved(Observed, ModifiedVoltagePotential):
    """Policy `mvp`, by observations."""

    name = "mvp_observed"


@register("policy")
class VoronoiObserved(Observed, Voronoi):
    """Policy `voronoi`, by observations."""

    name = "voronoi_observed"
