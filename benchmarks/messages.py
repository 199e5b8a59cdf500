"""Measure whether messages help: MAPPO in `search`, where one of three drones knows the clue.

    python benchmarks/messages.py
    python benchmarks/messages.py --seeds 0 1 --steps 1e5 --out out/messages

Three drones search flat ground for three victims near a clue, which one drone observes. The others
observe neither the clue nor other drones: only a message can carry it. Three cases have the same
networks, budget and seeds, and a reward with the progress towards the nearest victim:

- lost: no message arrives.
- learned: messages arrive, and are learned as part of the actions.
- written: messages arrive, and are the clue as the sender observes it.

Writes messages.md, messages.csv and messages.png. A repeated call continues, and trains no finished
run again.
"""

import argparse
import contextlib
import csv
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

import bulletuav
from bulletuav.adapters.slots import DroneSlots
from bulletuav.files import replace_file
from bulletuav.policies.neural_network import Network, read_weights
from bulletuav.policies.run import FAST, POLICY, RunConfig
from bulletuav.report.figures import blank_figure, save_figure
from bulletuav.sensors import Label
from bulletuav.tasks import reward
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.base import Block
from bulletuav.training.fast.learner import FastPPO
from bulletuav.training.segments import make_slots

ROOT = Path(__file__).parents[1]
CASES = ("lost", "learned", "written")
RANGES = {"lost": 0.001, "learned": 1000.0, "written": 1000.0}
"""Range of messages, m: on a channel that loses all messages it would be an error"""
SIZE = 2
"""Numbers of a message"""
METRICS = {"found": "fraction of victims found", "find_time": "time of a find (s)"}
EVALUATION_SEED = 1_000_000
MODEL = {
    "features": "swarm",
    "n_steps": 64,
    "gamma": 0.98,
    "learning_rate": [1e-3, 0.0],
    "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -1.2},
}
OPTIONS = {
    "dynamics": "single_integrator",
    "decision_hz": 2,
    "horizon": 80,
    "num_drones": 3,
    "num_neighbours": 2,
    "num_victims": 3,
    "max_speed": 5.0,
    "max_climb": 0.2,
    "area": 100,
    "height": [10.0, 30.0],
    "clue_radius": 12,
    "victim_spacing": 8,
    "start_distance": [25, 60],
    "hover_time": 8,
    "hover_radius": 4,
    "hover_height": [1.0, 39.0],
    "sight_noise": 0.0,
    "radio_range": 15,
    "d_safe": 1.0,
    "num_beams": 1,
    "lidar_elevations": [0.0],
    "observation": ["messages:place_and_clue", "velocity", "sighting"],
    "reward": {"progress_to_victim": ["messages:progress_to_victim", 0.1]},
    "weights": {
        "found": 8.0,
        "searched": 0.0,
        "approach": 0.0,
        "conflict": -0.2,
        "collision": -2.0,
        "out_of_bounds": -2.0,
        "time": -0.02,
    },
}


def place_and_clue(task: Any) -> Block:
    """Observe the own place; the first drone also observes the clue, and others zeros.

    Both are horizontal positions divided by half of the ground's side.
    """
    half = task.config.area / 2
    names = [f"{what} {axis}" for what in ("place", "clue") for axis in "xy"]
    labels = (*(Label(name, "1", -1.0, 1.0) for name in names), Label("informed", "1", 0.0, 1.0))

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        observed = np.zeros((*present.shape, len(labels)))
        observed[..., :2] = frame.known_position[..., :2] / half
        observed[:, 0, 2:4] = frame.scene.memory["clue"][:, :2] / half
        observed[:, 0, 4] = 1.0
        return observed

    return Block(labels, compute)


@reward
def progress_to_victim(frame: Frame) -> np.ndarray:
    """Decrease of the horizontal distance to the nearest victim not found, m.

    Half of it is that of the drone itself, half the mean of the drones of its world: a message is
    worth what others do with it.
    """
    victims = frame.scene.obstacle[:, None, :, :2]
    found = frame.scene.memory["found_at"] > 0
    before, after = (
        np.sqrt(((swarm.position[:, :, None, :2] - victims) ** 2).sum(axis=-1))
        for swarm in (frame.before, frame.after)
    )
    nearest = np.where(found[:, None], np.inf, before).argmin(axis=-1)[..., None]
    decrease = np.take_along_axis(before - after, nearest, axis=2)[..., 0]
    decrease = np.where(frame.alive & ~found.all(axis=1)[:, None], decrease, 0.0)
    shared: np.ndarray = (decrease + decrease.mean(axis=1, keepdims=True)) / 2
    return shared


def write_messages(seen: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Return actions (M, A) whose message is the observed clue."""
    return np.concatenate([actions[:, :-SIZE], seen[:, 2 : 2 + SIZE]], 1)


class Written(DroneSlots):
    """Worlds in which messages are the clue as observed, whatever the policy sends."""

    seen: np.ndarray

    def reset(self) -> Any:
        """Start new episodes, and keep the observations."""
        self.seen = super().reset()
        return self.seen

    def step_async(self, actions: np.ndarray) -> None:
        """Set actions with these messages."""
        super().step_async(write_messages(self.seen, actions))

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[Any]]:
        """Step all worlds, and keep the observations."""
        self.seen, *rest = super().step_wait()
        return self.seen, *rest


def measure(case: str, seed: int, given: argparse.Namespace) -> dict[str, float]:
    """Train and evaluate a case, unless its result is in the folder; return the means."""
    channel = {"size": SIZE, "range": RANGES[case]}
    options = {**OPTIONS, "communication": channel}
    model = {**MODEL, "critic": "state"}
    config = RunConfig("search", FAST, seed, given.steps, 85, options, model=model)
    asked = json.loads(json.dumps([config.plain(), given.episodes]))
    folder = given.out / "runs" / f"{case}-{seed}"
    path = folder / "result.json"
    if path.exists() and (result := json.loads(path.read_text()))["asked"] == asked:
        return dict(result["means"])
    begin = time.process_time()
    with contextlib.closing(
        make_slots(config, Written if case == "written" else DroneSlots)
    ) as env:
        learner = FastPPO(config, env)
        learner.begin_segment(seed)
        while learner.num_steps < config.steps:
            learner.collect()
            learner.update()
    learner.save(folder)
    means = {"seconds": time.process_time() - begin}
    means = {**fly(folder, config, case == "written", given.episodes), **means}
    replace_file(path, json.dumps({"asked": asked, "means": means}, indent=1) + "\n")
    return means


def fly(folder: Path, config: RunConfig, written: bool, episodes: int) -> dict[str, float]:
    """Fly the mean actions in worlds of one episode each, and return the means of `METRICS`."""
    env = bulletuav.batch_env("search", episodes, **config.options)
    weights = read_weights(folder / POLICY)
    network = Network(weights, FAST, config.settings, env.observation_labels)
    observed = env.reset(seed=EVALUATION_SEED)[0]
    last = {name: np.full(episodes, np.nan) for name in METRICS}
    for _ in range(config.options["horizon"]):
        seen = observed.reshape(-1, observed.shape[-1])
        actions = network(seen)
        actions = write_messages(seen, actions) if written else actions
        flies = env.alive.any(axis=1)
        observed, *_, infos = env.step(actions.reshape(*env.alive.shape, -1))
        # Worlds that have ended fly further episodes, which do not count
        ended = flies & ~env.alive.any(axis=1) & np.isnan(last["found"])
        for name, values in last.items():
            values[ended] = infos[name][ended, 0]
    env.close()
    return {name: float(values.mean()) for name, values in last.items()}


def t_interval(values: np.ndarray) -> tuple[float, float, float]:
    """Return the mean and its 95 % interval by Student's t distribution."""
    mean = float(np.mean(values))
    half = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
    return mean, mean - half, mean + half


def table(found: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """Return a table of all cases, and of their differences from "lost", paired by seed."""
    lines = ["| | case | mean | difference from lost | p |", "|---|---|---|---|---|"]
    for name, title in METRICS.items():
        values = {case: np.array([one[name] for one in runs]) for case, runs in found.items()}
        for case, ours in values.items():
            cells = [title, case, "{:.3g} [{:.3g}, {:.3g}]".format(*t_interval(ours)), "", ""]
            if case != "lost":
                cells[3] = "{:+.3g} [{:+.3g}, {:+.3g}]".format(*t_interval(ours - values["lost"]))
                cells[4] = f"{stats.ttest_rel(ours, values['lost']).pvalue:.2g}"
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(found: Mapping[str, Sequence[Mapping[str, float]]], path: Path) -> None:
    """Draw the metrics of all cases: a thin line for each seed, a thick one for the mean."""
    figure = blank_figure(3.2 * len(METRICS), 3.0)
    for place, (name, title) in enumerate(METRICS.items(), 1):
        axes = figure.add_subplot(1, len(METRICS), place)
        values = np.array([[one[name] for one in runs] for runs in found.values()])
        axes.plot(list(found), values, "o-", color="0.7", markersize=3, linewidth=1)
        axes.plot(list(found), values.mean(axis=1), "o-", color="#1b6ca8", linewidth=2)
        axes.set_title(title)
    save_figure(figure, path)


def report(found: Mapping[str, Sequence[Mapping[str, float]]], given: argparse.Namespace) -> None:
    """Write the table, the numbers of all runs, and the picture."""
    seconds = np.mean([one["seconds"] for runs in found.values() for one in runs])
    seeds = " ".join(map(str, given.seeds))
    lines = [
        "# Messages in a search of which one drone knows the clue",
        "",
        f"MAPPO, {given.steps:,} decisions of all drones, {len(given.seeds)} seeds; each policy "
        f"flew {given.episodes} episodes, seeds from {EVALUATION_SEED:,} on, in "
        "`single_integrator`. Means of the seeds with 95 % intervals of Student's t; differences "
        f"and p are paired by seed. A run trained for {seconds:.0f} CPU-s. Command:",
        "",
        "```sh",
        f"python benchmarks/messages.py --seeds {seeds} --steps {given.steps} "
        f"--episodes {given.episodes}",
        "```",
        "",
        table(found),
    ]
    replace_file(given.out / "messages.md", "\n".join(lines) + "\n")
    with (given.out / "messages.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["case", "seed", *METRICS, "seconds"])
        for case, runs in found.items():
            for seed, one in zip(given.seeds, runs, strict=True):
                writer.writerow([case, seed, *(f"{value:.4g}" for value in one.values())])
    draw(found, given.out / "messages.png")


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse the arguments."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(5)))
    parser.add_argument("--steps", type=float, default=3e5, help="decisions of a run")
    parser.add_argument("--episodes", type=int, default=200, help="of each evaluation")
    place = ROOT / "docs" / "results" / "learning" / "messages"
    parser.add_argument("--out", type=Path, default=place, metavar="DIR", help="folder")
    given = parser.parse_args(argv)
    if len(given.seeds) < 2:
        parser.error("two seeds or more are needed for an interval")
    given.steps = int(given.steps)
    return given


def main(argv: Sequence[str] | None = None) -> None:
    """Train and evaluate all cases, and write the report."""
    given = parse(argv)
    found: dict[str, list[dict[str, float]]] = {case: [] for case in CASES}
    for seed in given.seeds:
        for case, runs in found.items():
            runs.append(measure(case, seed, given))
    report(found, given)
    sys.stdout.write(table(found) + "\n")


if __name__ == "__main__":
    main()
