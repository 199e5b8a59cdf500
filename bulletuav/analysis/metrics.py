"""Metrics of an episode, and their estimates over many with 95 % confidence intervals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.conflict.separation import conflict
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.step import Step
from bulletuav.geometry.closest_approach import distances, offset
from bulletuav.geometry.rotation import dot
from bulletuav.kernel import kernel
from bulletuav.vehicle.power import actuator_power
from bulletuav.vehicle.swarm import Swarm

RATES = ("collision", "conflict", "success")
METRICS = {
    "collision": "share of episodes with a contact of collision shapes",
    "conflict": "share of episodes with a separation below d_safe",
    "success": "share of episodes in which all drones succeeded, as the task means it",
    "drone_success": "share of drones that succeeded",
    "return": "sum of the rewards of the episode, mean of the drones",
    "conflicts": "conflicts of two drones that began",
    "near_misses": "times that two came closer than half of d_safe",
    "min_separation": "least separation, m",
    "min_time_to_conflict": "shortest time until two that fly straight on would conflict, s, where there was one",
    "length": "duration of the episode, s",
    "goal_distance": "distance to the goal at the end, m, mean of the drones",
    "path_efficiency": "metres made good over metres flown, mean of the drones that succeeded",
    "jerk": "m/s^3, mean of drones and decisions",
    "energy": "mechanical energy of the rotors, J, mean of the drones; none where dynamics have no rotors",
    "messages": "messages that drones received, where communication is simulated",
    "fairness": "Jain's index of the drones' metres made good a second",
    "throughput": "drones that succeeded a minute",
    "served": "share of the task's targets in sight of a drone, mean of the episode as planned: 0 once all have left",
    "completed": "share of the tasks of the episode as planned that were computed in time",
    "latency": "from a task's arrival to its result, s, mean of those that arrived; the deadline for those that were lost",
}
"""What each metric is, as an episode's number and, over episodes, its mean"""
RESAMPLES = 2000


def jain(values: np.ndarray) -> float:
    """(sum x)^2 / (n sum x^2) of numbers (n,) that are not negative: 1 when all are equal, 1/n when one has all.

    R. Jain, D. Chiu, W. Hawe, A quantitative measure of fairness and discrimination, DEC TR-301, 1984.
    """
    square = len(values) * float((values**2).sum())
    return float(values.sum()) ** 2 / square if square > 0 else 1.0


@kernel
def soonest_conflict(position, velocity, alive, d_safe):
    """(W,) shortest time until two living drones that fly straight on are closer than d_safe (m), s; inf for none."""
    result = np.full(alive.shape[0], np.inf)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            for j in range(i + 1, alive.shape[1]):
                if not (alive[w, i] and alive[w, j]):
                    continue
                gap, speed = offset(position, w, i, j), offset(velocity, w, i, j)
                along, outside = dot(gap, speed), dot(gap, gap) - d_safe * d_safe
                root = along * along - dot(speed, speed) * outside
                if outside < 0.0:
                    result[w] = 0.0
                elif along < 0.0 and root > 0.0:
                    result[w] = min(result[w], outside / (np.sqrt(root) - along))
    return result


class Meter:
    """Takes the metrics of the episodes that an aviary's W worlds fly at once."""

    def __init__(self, aviary: Aviary):
        self._aviary = aviary
        worlds, shape = aviary.num_worlds, (aviary.num_worlds, aviary.num_drones)
        self._d_safe, self._period = aviary.task.config.d_safe, 1 / aviary.options.decision_hz
        self._goal = aviary.scene.goal.copy()
        self._ideal = distances(aviary.swarm.position, self._goal)
        self._before, self._change = aviary.swarm.copy(), np.full((*shape, 3), np.nan)
        self._collided, self._succeeded = np.zeros((2, *shape), dtype=bool)
        self._flown, self._jerk, self._energy, self._decisions, self._jerks, self._left = np.zeros(
            (6, *shape)
        )
        self._conflicts, self._near, self._messages, self._steps = np.zeros((4, worlds))
        self._return = np.zeros(shape)
        self._separation, self._time_to_conflict = np.full((2, worlds), np.inf)
        self._served, (self._completed, self._latency) = (
            np.zeros(worlds),
            np.full((2, worlds), np.nan),
        )

    def record(self, step: Step, flown: np.ndarray) -> None:
        """Take one decision, which the drones of `flown` (W, N) flew."""
        aviary, before, after, info = (
            self._aviary,
            self._before,
            self._aviary.swarm.copy(),
            step.info,
        )
        self._collided |= info["collision"] & flown
        self._succeeded = np.where(flown, info["success"], self._succeeded)
        self._left = np.where(flown, info["goal_distance"], self._left)
        self._return += np.where(flown, step.rewards, 0.0)
        self._conflicts += (info["conflicts"] * flown).sum(axis=1) / 2
        close = conflict(before.position, after.position, flown, self._d_safe / 2, self._d_safe)
        self._near += close.onsets.sum(axis=1) / 2
        self._separation = np.minimum(self._separation, close.separation.min(axis=1))
        soonest = soonest_conflict(after.position, after.velocity, flown, self._d_safe)
        self._time_to_conflict = np.minimum(self._time_to_conflict, soonest)
        self._flown += flown * distances(before.position, after.position)
        self._ideal += flown * distances(self._goal, aviary.scene.goal)
        self._goal = aviary.scene.goal.copy()
        self._take_effort(before, after, flown)
        self._decisions += flown
        self._steps += flown.any(axis=1)
        if "messages" in info:
            self._messages += (info["messages"] * flown).sum(axis=1)
        self._take_service(info, np.any(flown, axis=1))
        self._before = after

    def _take_effort(self, before: Swarm, after: Swarm, flown: np.ndarray) -> None:
        """Jerk by second differences of the velocity; work of the rotors against their torque, by the trapezium rule."""
        change = after.velocity - before.velocity
        jerk = np.linalg.norm(change - self._change, axis=-1) / self._period**2
        known = flown & np.isfinite(jerk)
        self._jerk[known] += jerk[known]
        self._jerks += known
        self._change = np.where(flown[..., None], change, np.nan)
        power = actuator_power(before.rotor_speed, after.rotor_speed, self._aviary.parameters)
        self._energy += flown * power * self._period

    def _take_service(self, info: dict[str, np.ndarray], flying: np.ndarray) -> None:
        """What drones do for users together, which infos tell each of them."""
        if "served" in info:
            self._served += info["served"][:, 0] * flying
        if "completed" in info:
            self._completed = np.where(flying, info["completed"][:, 0], self._completed)
            self._latency = np.where(flying, info["latency"][:, 0], self._latency)

    def row(self, w: int) -> dict[str, float]:
        """The metrics of the episode of world w, NaN for those that it has not."""
        aviary, length = self._aviary, self._steps[w] * self._period
        arrived, made_good = self._succeeded[w], np.maximum(self._ideal[w] - self._left[w], 0.0)
        efficiency = np.minimum(made_good / np.maximum(self._flown[w], 1e-9), 1.0)[arrived]
        row = {
            "collision": self._collided[w].any(),
            "conflict": self._separation[w] < self._d_safe,
            "success": arrived.all(),
            "drone_success": arrived.mean(),
            "return": self._return[w].mean(),
            "conflicts": self._conflicts[w],
            "near_misses": self._near[w],
            "min_separation": self._separation[w],
            "min_time_to_conflict": self._time_to_conflict[w],
            "length": length,
            "goal_distance": self._left[w].mean(),
            "path_efficiency": efficiency.mean() if len(efficiency) else np.nan,
            "jerk": self._jerk[w].sum() / max(self._jerks[w].sum(), 1.0),
            "energy": self._energy[w].mean()
            if aviary.setpoint_level == SetpointLevel.ROTOR
            else np.nan,
            "messages": self._messages[w] if aviary.communicates else np.nan,
            "fairness": jain(made_good / (self._decisions[w] * self._period)),
            "throughput": arrived.sum() / (length / 60),
            "served": self._served[w] / aviary.options.horizon,
            "completed": self._completed[w],
            "latency": self._latency[w],
        }
        if aviary.task.num_targets:  # it has no goals: drones are to be anywhere
            row |= dict.fromkeys(
                ("goal_distance", "path_efficiency", "fairness", "throughput"), np.nan
            )
        else:
            row["served"] = np.nan
        return {name: float(value) if np.isfinite(value) else np.nan for name, value in row.items()}


class Estimate(NamedTuple):
    """Mean of a metric over the `episodes` that have it, with its 95 % confidence interval."""

    mean: float
    low: float
    high: float
    episodes: int


def estimate(metric: str, values: Sequence[float]) -> Estimate:
    """Over episodes: Wilson's interval for rates, `mean_estimate` for means."""
    from scipy import stats  # which takes longer to import than everything else

    if metric not in RATES:
        return mean_estimate(values)
    sample = np.array(values)
    low, high = stats.binomtest(int(sample.sum()), len(sample)).proportion_ci(method="wilson")
    return Estimate(float(sample.mean()), float(low), float(high), len(sample))


def mean_estimate(values: Sequence[float]) -> Estimate:
    """Mean of the values that are not NaN, with the interval of the percentile bootstrap (always the same resamples)."""
    from scipy import stats

    sample = np.array([value for value in values if not np.isnan(value)])
    if not len(sample):
        return Estimate(np.nan, np.nan, np.nan, 0)
    if np.ptp(sample) == 0:
        mean = float(sample[0])
        return Estimate(mean, mean, mean, len(sample))
    interval = stats.bootstrap(
        (sample,), np.mean, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return Estimate(float(sample.mean()), float(interval.low), float(interval.high), len(sample))
