"""Totals of episodes of drones, which trainers log next to the return."""

import numpy as np

from bulletuav.envs.step import Step


class EpisodeTotals:
    """Success, collision, conflicts and returns by reward term, for W worlds of N drones.

    Attributes:
        by_name: (W, N) arrays: "success" and "collision" (0 or 1), "conflicts", and the return of
            each reward term ("reward/goal", ...).
    """

    def __init__(self) -> None:
        """Make empty totals; the first step allocates the arrays."""
        self.by_name: dict[str, np.ndarray] = {}
        self._members: np.ndarray | None = None

    def forget(self, worlds: np.ndarray) -> None:
        """Reset the totals of the worlds of a mask (W,)."""
        for total in self.by_name.values():
            total[worlds] = 0
        if self._members is not None:
            self._members[worlds] = False

    def add(self, step: Step, flown: np.ndarray) -> None:
        """Add a step.

        Args:
            step: The results of the step.
            flown: (W, N) bool, drones that were active in the step.
        """
        info = step.info
        # Absent drones never fly
        self._members = flown.copy() if self._members is None else self._members | flown
        for name in info:
            if name.startswith("reward/") or name == "conflicts":
                self._of(name, flown)[flown] += info[name][flown]
        self._of("success", flown)[flown] = info["success"][flown]
        self._of("collision", flown)[flown] += info["collision"][flown]
        np.minimum(self.by_name["collision"], 1.0, out=self.by_name["collision"])

    def _of(self, name: str, flown: np.ndarray) -> np.ndarray:
        if name not in self.by_name:
            self.by_name[name] = np.zeros(flown.shape)
        return self.by_name[name]

    def of_drone(self, world: int, drone: int) -> dict[str, float]:
        """Return the totals of one drone."""
        return {name: float(total[world, drone]) for name, total in self.by_name.items()}

    def of_world(self, world: int) -> dict[str, float]:
        """Return the means over all drones of a world's episode."""
        own = slice(None) if self._members is None else self._members[world]
        return {name: float(total[world][own].mean()) for name, total in self.by_name.items()}
