"""Measurement of the episodes that an aviary's worlds fly at once."""

from collections.abc import Mapping, Sequence

import numpy as np

from bulletuav.analysis.infos import is_scalar, own_infos
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
    """Measures one episode in each of an aviary's W worlds, decision by decision."""

    def __init__(self, aviary: Aviary, metrics: Sequence[MetricSpec] = ()) -> None:
        """Begin to measure, right after the aviary's reset.

        Args:
            aviary: The worlds.
            metrics: What is measured beside the standard metrics.
        """
        worlds = aviary.num_worlds
        shape = (worlds, aviary.num_drones)
        self._aviary = aviary
        self._d_safe = aviary.task.config.d_safe
        self._period = 1 / aviary.options.decision_hz
        # Outcome and reward of each drone.
        self._collided = np.zeros(shape, dtype=bool)
        self._succeeded = np.zeros(shape, dtype=bool)
        self._return = np.zeros(shape)
        # Metres of each drone: flown, to its goal at first (with what the goal moved), and left.
        self._goal = aviary.scene.goal.copy()
        self._ideal = paired_distances(aviary.swarm.position, self._goal)
        self._flown = np.zeros(shape)
        self._left = np.zeros(shape)
        # Effort: the state before the decision, and how the velocity changed in the one before it.
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
        # Service to users.
        self._served = np.zeros(worlds)
        self._completed = np.full(worlds, np.nan)
        self._latency = np.full(worlds, np.nan)
        # What users and tasks measure beside.
        self._custom = [CustomMetric(spec, aviary) for spec in metrics]
        self._infos: dict[str, np.ndarray] = {}

    def record(self, step: Step, flown: np.ndarray) -> None:
        """Take one decision.

        Args:
            step: What the decision gave.
            flown: Drones that flew it, (W, N) bool.

        Raises:
            ValueError: A metric of a user gave something else than one number for each world.
        """
        before = self._before
        after = self._aviary.swarm.copy()
        info = step.info
        flying = np.any(flown, axis=1)
        # Of drones that have left, what they told last stays.
        self._collided |= info["collision"] & flown
        self._succeeded = np.where(flown, info["success"], self._succeeded)
        if self._aviary.task.has_goals:
            self._left = np.where(flown, info["goal_distance"], self._left)
        self._return += np.where(flown, step.rewards, 0.0)
        self._record_conflicts(info, before, after, flown)
        self._record_way(before, after, flown)
        self._record_effort(before, after, flown)
        # Time of drones and of worlds.
        self._decisions += flown
        self._steps += flying
        if "messages" in info:
            self._messages += (info["messages"] * flown).sum(axis=1)
        self._record_service(info, flying)
        self._record_infos(info, flying)
        # Metrics of users see the worlds as they are after the decision.
        for metric in self._custom:
            metric.record(step, self._aviary, flying)
        self._before = after

    def _record_conflicts(
        self,
        info: Mapping[str, np.ndarray],
        before: Swarm,
        after: Swarm,
        flown: np.ndarray,
    ) -> None:
        """Count conflicts and near misses; each is told by both of its drones."""
        self._conflicts += (info["conflicts"] * flown).sum(axis=1) / 2
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

    def _record_way(
        self,
        before: Swarm,
        after: Swarm,
        flown: np.ndarray,
    ) -> None:
        """Add the metres flown, and those that the goal moved."""
        goal = self._aviary.scene.goal
        self._flown += flown * paired_distances(before.position, after.position)
        self._ideal += flown * paired_distances(self._goal, goal)
        self._goal = goal.copy()

    def _record_effort(
        self,
        before: Swarm,
        after: Swarm,
        flown: np.ndarray,
    ) -> None:
        """Add jerk, by second differences of the velocity, and the rotors' work.

        The work is that against the rotors' torque, by the trapezium rule.
        """
        change = after.velocity - before.velocity
        jerk = np.linalg.norm(change - self._change, axis=-1) / self._period**2
        # The first decision has no jerk: no change of velocity came before it.
        known = flown & np.isfinite(jerk)
        self._jerk[known] += jerk[known]
        self._jerks += known
        self._change = np.where(flown[..., None], change, np.nan)
        power = actuator_power(before.rotor_speed, after.rotor_speed, self._aviary.parameters)
        self._energy += flown * power * self._period

    def _record_service(self, info: Mapping[str, np.ndarray], flying: np.ndarray) -> None:
        """Take what drones do for users together, which infos tell each of them."""
        if "served" in info:
            self._served += info["served"][:, 0] * flying
        if "completed" in info:
            self._completed = np.where(flying, info["completed"][:, 0], self._completed)
            self._latency = np.where(flying, info["latency"][:, 0], self._latency)

    def _record_infos(self, info: Mapping[str, np.ndarray], flying: np.ndarray) -> None:
        """Keep the task's own infos, mean of the drones, of each world's last decision."""
        taken = {
            *METRICS,
            *ROW_LABELS,
            *(metric.name for metric in self._custom),
        }
        for name, values in own_infos(info).items():
            if name not in taken and is_scalar(values, self._succeeded.shape):
                known = self._infos.get(name, np.nan)
                self._infos[name] = np.where(flying, values.mean(axis=1), known)

    def row(self, w: int) -> dict[str, float]:
        """Return the metrics of the episode of a world.

        Args:
            w: Number of the world.

        Returns:
            The standard metrics, those of users and the task's own infos by name; NaN for what the
            episode has not.
        """
        row = self._standard(w)
        if not self._aviary.task.has_goals:
            # Its drones are to be anywhere.
            row |= dict.fromkeys(
                ("goal_distance", "path_efficiency", "fairness", "throughput"),
                np.nan,
            )
        if not self._aviary.task.num_targets:
            row["served"] = np.nan
        # What is infinite, such as the separation of one drone, is none.
        row |= {metric.name: metric.values[w] for metric in self._custom}
        row |= {name: values[w] for name, values in self._infos.items()}
        return {name: float(value) if np.isfinite(value) else np.nan for name, value in row.items()}

    def _standard(self, w: int) -> dict[str, float]:
        """Compute the standard metrics of the episode of world w."""
        aviary = self._aviary
        length = self._steps[w] * self._period
        arrived = self._succeeded[w]
        # Metres made good are those that the drone is nearer to its goal, as the goal moved.
        made_good = np.maximum(self._ideal[w] - self._left[w], 0.0)
        share_of_way = made_good / np.maximum(self._flown[w], 1e-9)
        efficiency = np.minimum(share_of_way, 1.0)[arrived]
        has_rotors = aviary.setpoint_level == SetpointLevel.ROTOR
        return {
            "collision": self._collided[w].any(),
            "conflict": self._separation[w] < self._d_safe,
            "success": arrived.all(),
            "drone_success": arrived.mean(),
            "return": self._return[w].mean(),
            "conflicts": self._conflicts[w],
            "near_misses": self._near_misses[w],
            "min_separation": self._separation[w],
            "min_time_to_conflict": self._time_to_conflict[w],
            "length": length,
            "goal_distance": self._left[w].mean(),
            "path_efficiency": efficiency.mean() if len(efficiency) else np.nan,
            "jerk": self._jerk[w].sum() / max(self._jerks[w].sum(), 1.0),
            "energy": self._energy[w].mean() if has_rotors else np.nan,
            "messages": self._messages[w] if aviary.communicates else np.nan,
            "fairness": jain(made_good / (self._decisions[w] * self._period)),
            "throughput": arrived.sum() / (length / 60),
            "served": self._served[w] / aviary.options.horizon,
            "completed": self._completed[w],
            "latency": self._latency[w],
        }
