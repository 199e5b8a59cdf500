"""Flights of the reference table of airborne edge computing: metrics, policies, and their training.

`bulletuav.reproduction.tables.mec_reference` has the table of these flights.
"""

import dataclasses
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.analysis.evaluation import Evaluation, evaluate
from bulletuav.analysis.metrics import Estimate
from bulletuav.analysis.metrics.estimates import RESAMPLES, TAIL
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.step import Step
from bulletuav.policies.run import FAST
from bulletuav.reproduction.table import Settings
from bulletuav.training.schedules import default_run
from bulletuav.training.trainer import train

EDGE_EPISODES = 100
"""Number of episodes of each policy at full size"""
MIN_EDGE_EPISODES = 10
"""Number of episodes at small sizes: fewer would have no useful intervals"""
EDGE_SEED = 11_000_000
"""Seed of the first episode; no training and no other table of the package flies these seeds"""
EDGE_CITIES: Mapping[str, Any] = {"num_layouts": 32, "city_seed": 1000}
"""Cities of the episodes; no training of the package flies over them"""
LEARNED: Mapping[str, Mapping[str, Any]] = {"fast_ppo": {}, "mappo": {"critic": "state"}}
"""Policies that are trained here, by name in the table: settings in addition to the defaults"""
TRAINING_SEED = 0
"""Seed of their training"""


class EdgeScene(NamedTuple):
    """Conditions under which policies are compared.

    Attributes:
        task: Name of the task.
        difficulty: Its difficulty.
        policies: Policies that fly; those of `LEARNED` are trained first.
        steps: Number of decisions of all drones in each training, at full size.
    """

    task: str
    difficulty: str
    policies: tuple[str, ...]
    steps: int = 0

    @property
    def name(self) -> str:
        """Name of the scene in the table."""
        return f"{self.task} {self.difficulty}"


class EdgeFlight(NamedTuple):
    """Result of one policy in one scene.

    Attributes:
        scene: The scene.
        policy: Name of the policy.
        dynamics: Name of the dynamics.
        estimates: Mean and interval of each metric by name.
        hash: Hash of all episodes, see `Evaluation.hash`.
    """

    scene: EdgeScene
    policy: str
    dynamics: str
    estimates: dict[str, Estimate]
    hash: str


class SwarmEnergy:
    """Electrical energy of all drones for flight and computing, J."""

    name = "swarm_energy"

    def __init__(self, aviary: Aviary) -> None:
        """Start at 0 J."""
        self._energy = np.zeros(aviary.num_worlds)
        self._period = 1 / aviary.options.decision_hz

    def __call__(self, step: Step, aviary: Aviary) -> np.ndarray:
        """Add the energy of a decision.

        Returns:
            (W,) energy since the reset, J.
        """
        # Drones that do not fly have a power of 0
        self._energy = self._energy + step.info["power"].sum(axis=1) * self._period
        return self._energy


class DronePower:
    """Electrical power for flight and computing, W, mean over the flight time of all drones."""

    name = "drone_power"

    def __init__(self, aviary: Aviary) -> None:
        """Start without flight time."""
        self._power, self._decisions = np.zeros((2, aviary.num_worlds))

    def __call__(self, step: Step, aviary: Aviary) -> np.ndarray:
        """Add the power of a decision.

        Returns:
            (W,) mean power since the reset, W.
        """
        flown = aviary.alive | step.terminated | step.truncated
        self._power = self._power + step.info["power"].sum(axis=1)
        self._decisions = self._decisions + flown.sum(axis=1)
        mean: np.ndarray = self._power / np.maximum(self._decisions, 1)
        return mean


def finished_tasks(step: Step, aviary: Aviary) -> np.ndarray:
    """Count the tasks of the episode that were computed in time.

    Returns:
        (W,) number of tasks since the reset.
    """
    finished: np.ndarray = aviary.scene.memory["finished"].copy()
    return finished


EDGE_METRICS = (SwarmEnergy, DronePower, finished_tasks)
"""Metrics in addition to the standard ones"""


def estimate_ratio(above: Sequence[float], below: Sequence[float]) -> Estimate:
    """Estimate the ratio of two totals over episodes, with the percentile bootstrap over episodes.

    A mean of the episodes' ratios would be infinite if an episode has a denominator of 0.

    Args:
        above: Numerator of each episode.
        below: Denominator of each episode, at least 0, with a sum above 0.

    Returns:
        The ratio with its 95 % interval.
    """
    pairs = np.array([above, below], dtype=float)
    count = pairs.shape[1]
    chosen = np.random.default_rng(0).integers(0, count, (RESAMPLES, count))
    numerators, denominators = pairs[:, chosen].sum(axis=-1)
    with np.errstate(divide="ignore"):
        low, high = np.quantile(numerators / denominators, (TAIL, 1 - TAIL))
    total = pairs.sum(axis=1)
    return Estimate(float(total[0] / total[1]), float(low), float(high), count)


def edge_estimates(flown: Evaluation) -> dict[str, Estimate]:
    """Return the estimates of an evaluation with `EDGE_METRICS`, and "task_energy", J."""
    energy, tasks = (
        [row[name] for row in flown.rows] for name in (SwarmEnergy.name, finished_tasks.__name__)
    )
    return {**flown.estimates(), "task_energy": estimate_ratio(energy, tasks)}


def train_edge_policy(
    scene: EdgeScene, policy: str, steps: int, folder: Path, progress: Callable[[int], None]
) -> None:
    """Train a policy by `fast_ppo`.

    Args:
        scene: The scene.
        policy: Name of the policy, one of `LEARNED`, whose settings replace defaults of the task.
        steps: Number of decisions of all drones.
        folder: Folder of the run.
        progress: Called with the number of finished steps.
    """
    usual = default_run(scene.task, FAST)
    options = {**usual.options, "difficulty": scene.difficulty, "dynamics": "point_mass"}
    model = {**usual.model, **LEARNED[policy]}
    run = dataclasses.replace(usual, seed=TRAINING_SEED, steps=steps, options=options, model=model)
    # One evaluation of one episode, as the learning curve is not used
    run = dataclasses.replace(run, evaluations=1, episodes=1)
    train(run, folder, progress)


def fly_edge_scenes(
    scenes: Sequence[EdgeScene], dynamics: Sequence[str], settings: Settings
) -> Iterator[EdgeFlight]:
    """Fly all policies of all scenes.

    Args:
        scenes: The scenes.
        dynamics: Names of the dynamics.
        settings: Size, number of processes, and callback for progress.

    Yields:
        The result of each policy in each of the dynamics.
    """
    episodes = settings.count(EDGE_EPISODES, least=MIN_EDGE_EPISODES)
    cases = [(scene, policy) for scene in scenes for policy in scene.policies]
    parts = len(cases) * len(dynamics) + sum(policy in LEARNED for _, policy in cases)
    done = 0
    with tempfile.TemporaryDirectory() as folder:
        for scene, policy in cases:
            source = policy
            if policy in LEARNED:
                run, steps = Path(folder, f"{scene.name} {policy}"), settings.count(scene.steps)
                report = partial(_report, settings, done, parts, steps)
                train_edge_policy(scene, policy, steps, run, report)
                source = str(run)
                done += 1
            for name in dynamics:
                flown = evaluate(
                    scene.task,
                    source,
                    episodes,
                    EDGE_SEED,
                    workers=settings.workers,
                    metrics=EDGE_METRICS,
                    difficulty=scene.difficulty,
                    dynamics=name,
                    action="velocity",
                    **EDGE_CITIES,
                )
                done += 1
                _report(settings, done, parts, 1, 0)
                yield EdgeFlight(scene, policy, name, edge_estimates(flown), flown.hash)


def _report(settings: Settings, done: int, parts: int, steps: int, finished: int) -> None:
    """Report finished parts of the work, and finished steps of the next part."""
    settings.progress((done + min(finished / steps, 1.0)) / parts)
