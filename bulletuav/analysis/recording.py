"""Recording of an episode: fly it, keep everything, write it to files."""

import csv
import dataclasses
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.city.model import City
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.step import Step
from bulletuav.files import replace_file, whole_file
from bulletuav.network.mobility import Mobility
from bulletuav.policies.base import Policy
from bulletuav.vehicle.swarm import Swarm
from bulletuav.version import __version__


@dataclass(frozen=True)
class Recording:
    """One episode of one world: T decisions of N drones. States have T + 1 rows, the first at the start.

    time (T+1,) s; position (T+1, N, 3) m; quaternion (T+1, N, 4); velocity (T+1, N, 3) m/s; rates (T+1, N, 3) rad/s;
    alive (T+1, N) bool; action (T, N, A); reward (T, N); separation (T, N) m, least within the decision, inf when alone;
    conflicts (T, N) begun; collision, success (T, N) bool; goal (T + 1, N, 3) m; obstacle (T + 1, K, 3) m, and the radii of
    their bounding spheres (K,) m; building (P, 2, 3) m, corners of the pieces' bounding boxes; target (T + 1, U, 3) m, of
    those of the task that count, and seen (T + 1, U), whether some drone sees them. A drone that left keeps its last state.
    """

    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    alive: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    separation: np.ndarray
    conflicts: np.ndarray
    collision: np.ndarray
    success: np.ndarray
    goal: np.ndarray
    obstacle: np.ndarray
    obstacle_radius: np.ndarray
    building: np.ndarray
    target: np.ndarray
    seen: np.ndarray


class Outcome(NamedTuple):
    """How one drone's episode went; distances in m, time of its last decision in s."""

    drone: int
    reached: bool
    min_separation: float
    conflicts: int
    collisions: int
    final_distance: float
    time: float


def fly_episode(
    aviary: Aviary, policy: Policy, seed: int, progress: Callable[[], None] = lambda: None
) -> Recording:
    """Fly one episode in world 0 from `seed`; `progress` is called after every decision."""
    observations = aviary.reset(seeds=seed)
    policy.reset(np.ones(aviary.num_worlds, dtype=bool))
    states, alive, actions, steps = [aviary.swarm.copy()], [aviary.alive.copy()], [], []
    scenes = [_scene(aviary)]
    while aviary.alive[0].any():
        actions.append(policy.act(observations, aviary.swarm))
        steps.append(aviary.step(actions[-1]))
        observations = steps[-1].observations
        states.append(aviary.swarm.copy())
        alive.append(aviary.alive.copy())
        scenes.append(_scene(aviary))
        progress()
    return _recording(aviary, states, alive, scenes, actions, steps)


def _scene(aviary: Aviary) -> tuple[np.ndarray, ...]:
    """Of world 0 goals, obstacles, targets that count, and which of them are seen."""
    scene, active_targets = aviary.scene, aviary.task.active_targets(aviary.scene)[0]
    target, seen = (
        aviary.task.targets(scene)[0, active_targets],
        np.any(aviary.sight[0], axis=0)[active_targets],
    )
    return scene.goal[0].copy(), scene.obstacle[0].copy(), target, seen


def _recording(
    aviary: Aviary,
    states: list[Swarm],
    alive: list[np.ndarray],
    scenes: list[tuple[np.ndarray, ...]],
    actions: list[np.ndarray],
    steps: list[Step],
) -> Recording:
    def column(name: str) -> np.ndarray:
        return np.array([step.info[name][0] for step in steps])

    goal, obstacle, target, seen = (np.array(values) for values in zip(*scenes, strict=True))
    return Recording(
        time=np.arange(len(states)) / aviary.options.decision_hz,
        position=np.array([state.position[0] for state in states]),
        quaternion=np.array([state.quaternion[0] for state in states]),
        velocity=np.array([state.velocity[0] for state in states]),
        rates=np.array([state.rates[0] for state in states]),
        alive=np.array([mask[0] for mask in alive]),
        action=np.array([action[0] for action in actions]),
        reward=np.array([step.rewards[0] for step in steps]),
        separation=column("separation"),
        conflicts=column("conflicts"),
        collision=column("collision"),
        success=column("success"),
        goal=goal,
        obstacle=obstacle,
        obstacle_radius=np.array([obstacle.radius for obstacle in aviary.task.obstacles()]),
        building=aviary.solids().bounds,
        target=target,
        seen=seen,
    )


def outcomes(recording: Recording) -> list[Outcome]:
    """One row a drone. `reached` is success in the last decision that it flew."""
    rows = []
    for drone in range(recording.position.shape[1]):
        last = int(recording.alive[:-1, drone].sum()) - 1
        flown = slice(0, last + 1)
        distance = np.linalg.norm(
            recording.goal[last + 1, drone] - recording.position[last + 1, drone]
        )
        rows.append(
            Outcome(
                drone=drone,
                reached=bool(recording.success[last, drone]),
                min_separation=float(recording.separation[flown, drone].min()),
                conflicts=int(recording.conflicts[flown, drone].sum()),
                collisions=int(recording.collision[flown, drone].sum()),
                final_distance=float(distance),
                time=float(recording.time[last + 1]),
            )
        )
    return rows


def save(recording: Recording, aviary: Aviary, policy: str, seed: int, folder: Path) -> list[Path]:
    """Write `trajectory.npz` (all arrays), `trajectory.csv` (a row a drone and time), `run.json` (options and outcomes)."""
    arrays, table, run = (
        folder / name for name in ("trajectory.npz", "trajectory.csv", "run.json")
    )
    with whole_file(arrays) as part:
        np.savez_compressed(part, **asdict(recording))
    header = [
        "time",
        "drone",
        "alive",
        "x",
        "y",
        "z",
        "qx",
        "qy",
        "qz",
        "qw",
        "vx",
        "vy",
        "vz",
        "p",
        "q",
        "r",
    ]
    with whole_file(table) as part, part.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for t, time in enumerate(recording.time):
            for drone in range(recording.position.shape[1]):
                state = (
                    recording.position,
                    recording.quaternion,
                    recording.velocity,
                    recording.rates,
                )
                numbers = np.concatenate([array[t, drone] for array in state])
                writer.writerow(
                    [
                        f"{time:.6g}",
                        drone,
                        int(recording.alive[t, drone]),
                        *(f"{x:.9g}" for x in numbers),
                    ]
                )
    options = described(aviary.options, aviary.task.config)
    about = {
        "bulletuav": __version__,
        "task": aviary.task.name,
        "policy": policy,
        "seed": seed,
        "options": options,
    }
    about["outcomes"] = [
        {name: value if value != np.inf else None for name, value in row._asdict().items()}
        for row in outcomes(recording)
    ]
    replace_file(run, json.dumps(about, indent=2) + "\n")
    return [arrays, table, run]


def described(options: EnvOptions, config: Any) -> dict[str, Any]:
    """All options of an environment by name, as a json file can hold them."""
    names = [airframe.name for airframe in options.airframe]
    wind = "function" if callable(options.wind) else options.wind
    random = {name: getattr(options.randomization, name) for name in options.randomization.active}
    own = {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}
    if isinstance(own.get("city"), City | Path):
        own["city"] = getattr(own["city"], "name", "")
    if isinstance(own.get("mobility"), Mobility):
        own["mobility"] = {"model": own["mobility"].name, **dataclasses.asdict(own["mobility"])}
    return {**vars(options), "airframe": names, "wind": wind, "randomization": random, **own}
