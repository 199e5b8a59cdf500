"""Measurement of the standard and custom metrics while episodes are flown."""

from collections.abc import Mapping, Sequence

import numpy as np

from bulletuav.analysis.infos import is_scalar, select_task_infos
from bulletuav.analysis.metrics.custom import (
    ROW_LABELS,
    CustomMetric,
    MetricSpec,
)
from bulletuav.analysis.metrics.formulas import jain, soonest_conflict
from bulletuav.analysis.metrics.standard import METRICS
from bulletuav.conflict.separation import measure_conflict
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.step import Step
from bulletuav.geometry.closest_approach import paired_distances
from bulletuav.vehicle.power import actuator_power
from bulletuav.vehicle.swarm import Swarm


class Meter:
    """Measures the metrics of one episode in each of an aviary's W worlds, decision by decision."""

    def __init__(self, aviary: Aviary, metrics: Sequence[MetricSpec] = ()) -> None:
        """Start to measure, right after the aviary's reset.

        Args:
            aviary: The worlds.
            metrics: Custom metrics in addition to the standard ones.
        """
        worlds = aviary.num_worlds
        shape = (worlds, aviary.num_drones)
        self._members = aviary.members.copy()
        self._aviary = aviary
        self._d_safe = aviary.task.config.d_safe
        self._period = 1 / aviary.options.decision_hz
        # Outcome and reward of each drone.
        self._collided = np.zeros(shape, dtype=bool)
        self._succeeded = np.zeros(shape, dtype=bool)
        self._in_conflict = np.zeros(shape, dtype=bool)
        self._return = np.zeros(shape)
        # Of each drone, m: path length; initial distance to its goal plus the path length of the
        # goal; distance to its goal now.
        self._goal = aviary.scene.goal.copy()
        self._initial_distance = paired_distances(aviary.swarm.position, self._goal)
        self._path_length = np.zeros(shape)
        self._goal_distance = np.zeros(shape)
        # Effort: the state before the decision, and the change of velocity in the previous
        # decision.
        self._before = aviary.swarm.copy()
        self._change = np.full((*shape, 3), np.nan)
        self._jerk = np.zeros(shape)
        self._jerks = np.zeros(shape)
        self._energy = np.zeros(shape)
        self._decisions = np.zeros(shape)
        # Sums and minima over each world.
        self._steps = np.zeros(worlds)
        self._conflicts = np.zeros(worlds)
        self._near_misses = np.zeros(worlds)
        self._messages = np.zeros(worlds)
        self._separation = np.full(worlds, np.inf)
        self._time_to_conflict = np.full(worlds, np.inf)
        # Service to users on the ground.
        self._served = np.zeros(worlds)
        self._completed = np.full(worlds, np.nan)
        self._latency = np.full(worlds, np.nan)
        # Custom metrics, and infos of the task.
        self._custom = [CustomMetric(spec, aviary) for spec in metrics]
        self._infos: dict[str, np.ndarray] = {}

    def record(self, step: Step, flown: np.ndarray) -> None:
        """Record one decision.

        Args:
            step: Result of the decision.
            flown: Mask of the drones that flew the decision, (W, N) bool.

        Raises:
            ValueError: If a custom metric does not return one number for each world.
        """
        before = self._before
        after = self._aviary.swarm.copy()
        info = step.info
        flying = np.any(flown, axis=1)
        # Drones that have finished keep their last values.
        self._collided |= info["collision"] & flown
        self._succeeded = np.where(flown, info["success"], self._succeeded)
        if self._aviary.task.has_goals:
            self._goal_distance = np.where(flown, info["goal_distance"], self._goal_distance)
        self._return += np.where(flown, step.rewards, 0.0)
        self._record_conflicts(info, before, after, flown)
        self._record_path_length(before, after, flown)
        self._record_effort(before, after, flown)
        # Time of drones and of worlds.
        self._decisions += flown
        self._steps += flying
        if "messages" in info:
            self._messages += (info["messages"] * flown).sum(axis=1)
        self._record_service(info, flying)
        self._record_infos(info, flying)
        # Custom metrics observe the worlds after the decision.
        for metric in self._custom:
            metric.record(step, self._aviary, flying)
        self._before = after

    def _record_conflicts(
        self, info: Mapping[str, np.ndarray], before: Swarm, after: Swarm, flown: np.ndarray
    ) -> None:
        """Count conflicts and near misses, each of which both drones of a pair report."""
        self._conflicts += (info["conflicts"] * flown).sum(axis=1) / 2
        self._in_conflict |= (info["conflicts"] > 0) & flown
        # A near miss is a conflict at half the distance.
        close = measure_conflict(
            before.position,
            after.position,
            flown,
            self._d_safe / 2,
            self._d_safe,
        )
        self._near_misses += close.onsets.sum(axis=1) / 2
        self._separation = np.minimum(self._separation, close.separation.min(axis=1))
        soonest = soonest_conflict(after.position, after.velocity, flown, self._d_safe)
        self._time_to_conflict = np.minimum(self._time_to_conflict, soonest)

    def _record_path_length(self, before: Swarm, after: Swarm, flown: np.ndarray) -> None:
        """Add the path lengths of the drones and of their goals."""
        goal = self._aviary.scene.goal
        self._path_length += flown * paired_distances(before.position, after.position)
        self._initial_distance += flown * paired_distances(self._goal, goal)
        self._goal = goal.copy()

    def _record_effort(self, before: Swarm, after: Swarm, flown: np.ndarray) -> None:
        """Add jerk, by second differences of the velocity, and the work of the rotors.

        The work is done against the rotors' drag torque, and integrated by the trapezoidal rule.
        """
        change = after.velocity - before.velocity
        jerk = np.linalg.norm(change - self._change, axis=-1) / self._period**2
        # The first decision has no jerk: there is no previous change of velocity.
        known = flown & np.isfinite(jerk)
        self._jerk[known] += jerk[known]
        self._jerks += known
        self._change = np.where(flown[..., None], change, np.nan)
        power = actuator_power(before.rotor_speed, after.rotor_speed, self._aviary.parameters)
        self._energy += flown * power * self._period

    def _record_service(self, info: Mapping[str, np.ndarray], flying: np.ndarray) -> None:
        """Record the service to users, which is a joint result that each drone's infos repeat."""
        if "served" in info:
            self._served += info["served"][:, 0] * flying
        if "completed" in info:
            self._completed = np.where(flying, info["completed"][:, 0], self._completed)
            self._latency = np.where(flying, info["latency"][:, 0], self._latency)

    def _record_infos(self, info: Mapping[str, np.ndarray], flying: np.ndarray) -> None:
        """Record the task's own infos of each world's last decision, mean over drones."""
        taken = {
            *METRICS,
            *ROW_LABELS,
            *(metric.name for metric in self._custom),
        }
        for name, values in select_task_infos(info).items():
            if name not in taken and is_scalar(values, self._succeeded.shape):
                known = self._infos.get(name, np.nan)
                self._infos[name] = np.where(flying, self._mean(values), known)

    def _mean(self, values: np.ndarray) -> np.ndarray:
        return self._aviary.mean_of_members(values, self._members)

    def row(self, w: int) -> dict[str, float]:
        """Return the metrics of the episode of a world.

        Args:
            w: Index of the world.

        Returns:
            The standard metrics, the custom metrics and the task's own infos by name; NaN for
            values that the episode does not have.
        """
        row = self._standard(w)
        if not self._aviary.task.has_goals:
            # A task without goals has no distances to goals.
            row |= dict.fromkeys(
                (
                    "goal_distance",
                    "path_efficiency",
                    "extra_path",
                    "extra_time",
                    "fairness",
                    "throughput",
                ),
                np.nan,
            )
        if not self._aviary.task.num_targets:
            row["served"] = np.nan
        # Infinite values, such as the separation of a single drone, count as missing.
        row |= {metric.name: metric.values[w] for metric in self._custom}
        row |= {name: values[w] for name, values in self._infos.items()}
        return {name: float(value) if np.isfinite(value) else np.nan for name, value in row.items()}

    def _standard(self, w: int) -> dict[str, float]:
        aviary = self._aviary
        own = w, self._members[w]
        length = self._steps[w] * self._period
        arrived = self._succeeded[own]
        # Progress is the reduction of the distance to the goal, corrected by the goal's motion.
        made_good = np.maximum(self._initial_distance[own] - self._goal_distance[own], 0.0)
        progress_per_metre = made_good / np.maximum(self._path_length[own], 1e-9)
        efficiency = np.minimum(progress_per_metre, 1.0)[arrived]
        # The shortest possible path and time; a start at the goal has neither
        flown = arrived & (made_good > 0)
        shortest = made_good[flown]
        extra_path = np.maximum(self._path_length[own][flown] / shortest - 1, 0.0)
        times = self._decisions[own][flown] * self._period
        extra_time = times * aviary.options.max_speed / shortest - 1
        # In games between teams the rules of the game say what is safe
        is_game = aviary.task.is_game
        safely = arrived if is_game else arrived & ~self._collided[own] & ~self._in_conflict[own]
        has_rotors = aviary.setpoint_level == SetpointLevel.ROTOR
        return {
            "safe_success": safely.mean(),
            "collision": self._collided[own].any(),
            "conflict": self._separation[w] < self._d_safe,
            "success": arrived.all(),
            "drone_success": arrived.mean(),
            "return": self._return[own].mean(),
            "conflicts": self._conflicts[w],
            "near_misses": self._near_misses[w],
            "min_separation": self._separation[w],
            "min_time_to_conflict": self._time_to_conflict[w],
            "length": length,
            "goal_distance": self._goal_distance[own].mean(),
            "path_efficiency": efficiency.mean() if len(efficiency) else np.nan,
            "extra_path": extra_path.mean() if len(extra_path) else np.nan,
            "extra_time": extra_time.mean() if len(extra_time) else np.nan,
            "jerk": self._jerk[w].sum() / max(self._jerks[w].sum(), 1.0),
            "energy": self._energy[own].mean() if has_rotors else np.nan,
            "messages": self._messages[w] if aviary.communicates else np.nan,
            "fairness": jain(made_good / (self._decisions[own] * self._period)),
            "throughput": arrived.sum() / (length / 60),
            "served": self._served[w] / aviary.options.horizon,
            "completed": self._completed[w],
            "latency": self._latency[w],
        }
