"""Measure how a policy laps, and how far it is from the fastest line, at every difficulty.

    python benchmarks/laps.py --out docs/results/race
    python benchmarks/laps.py --policy docs/results/race/racer --difficulties easy --seed 5000000

Of each difficulty: share of drones that finished, gates missed and contacts of a drone, overtakes;
and of the first drone to start, if it finished, its race time over that of the fastest line. That
line is found by scipy, see `bulletuav.policies.race_pilot.RacePilot.fastest`. Writes laps.md and
laps.csv. `python tools/results.py fetch racer` restores the trained policy of the second command.
"""

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich import progress

import bulletuav
from bulletuav.analysis.metrics import mean_estimate
from bulletuav.files import replace_file
from bulletuav.policies import find_policy
from bulletuav.policies.race_pilot import RacePilot
from bulletuav.tasks import find_task

NAMES = ("success", "missed", "contacts", "overtakes", "race_time")
COLUMNS = ("case", "finished", "missed", "contacts", "overtakes", "ratio", "low", "high", "worst")


def races(worlds: int, first: int, policy: str, **options: object) -> dict[str, np.ndarray]:
    """Fly a race in each of some worlds; give what drones told last, and the reference times."""
    found = find_policy(policy, "race")
    # What a network observes goes with it
    aviary = bulletuav.Aviary("race", worlds, **found.complete("race", options))
    pilot, planner = found(aviary), RacePilot(aviary)
    observations = aviary.reset(seeds=first)
    told = {"reference": np.array([planner.fastest(w, aviary.swarm) for w in range(worlds)])}
    pilot.reset(np.ones(worlds, dtype=bool))
    while aviary.alive.any():
        flown = aviary.alive.copy()
        step = aviary.step(pilot.act(observations, aviary.swarm))
        observations = step.observations
        for name in NAMES:
            told[name] = np.where(flown, step.info[name], told.get(name, step.info[name]))
    aviary.close()
    return told


def measure(case: dict[str, object], arguments: argparse.Namespace) -> list[float]:
    """Fly the races of a case; give the numbers of a row."""
    parts: list[dict[str, np.ndarray]] = []
    for first in progress.track(range(0, arguments.episodes, arguments.worlds), str(case)):
        worlds = min(arguments.worlds, arguments.episodes - first)
        seed, how = arguments.seed + first, {"dynamics": arguments.dynamics, **case}
        parts.append(races(worlds, seed, arguments.policy, **how))
    told = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    finished = told["success"][:, 0]
    ratio = (told["race_time"][:, 0] / told["reference"])[finished]
    every = mean_estimate(ratio.tolist())
    means = [float(told[name].mean()) for name in NAMES[:-1]]
    return [*means, every.mean, every.low, every.high, float(ratio.max())]


def cases(arguments: argparse.Namespace) -> Iterator[tuple[str, dict[str, object]]]:
    """List what is flown: the difficulties, and the tracks that come with the package."""
    yield from ((one, {"difficulty": one}) for one in arguments.difficulties.split(","))
    for track in filter(None, arguments.tracks.split(",")):
        yield f"{track}, easy", {"difficulty": "easy", "track": track}


def main() -> None:
    """Measure all cases and write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--policy", default="race_pilot", help="name or folder")
    known = ",".join(find_task("race").difficulties)
    parser.add_argument("--difficulties", default=known, help=f"such as {known}")
    parser.add_argument("--tracks", default="oval,figure_eight,split_s")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="that of the first race (0)")
    parser.add_argument("--worlds", type=int, default=20, help="that fly at once")
    parser.add_argument("--dynamics", default="bullet")
    parser.add_argument("--out", type=Path, default=Path("out/race"))
    arguments = parser.parse_args()
    rows = [(name, *measure(case, arguments)) for name, case in cases(arguments)]
    other = "" if arguments.policy == "race_pilot" else f"--policy {arguments.policy} "
    other += f"--seed {arguments.seed} " if arguments.seed else ""
    lines = [
        "# Race: laps",
        "",
        f"`{arguments.policy}`, {arguments.episodes} races of each row, seeds {arguments.seed} to "
        f"{arguments.seed + arguments.episodes - 1}, `{arguments.dynamics}`. "
        "Missed, contacts, overtakes: means over drones. Lap: race time of the first drone to "
        "start, divided by that of the fastest line, mean with 95 % interval, and the worst. "
        "Command:",
        "",
        "```sh",
        f"python benchmarks/laps.py {other}--episodes {arguments.episodes} --dynamics "
        f"{arguments.dynamics} --out docs/results/race",
        "```",
        "",
        "| | finished | missed | contacts | overtakes | lap | worst lap |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, done, missed, contacts, overtakes, ratio, low, high, worst in rows:
        counts = f"{done:.2f} | {missed:.2f} | {contacts:.2f} | {overtakes:.2f}"
        lines.append(f"| {name} | {counts} | {ratio:.3f} [{low:.3f}, {high:.3f}] | {worst:.3f} |")
    arguments.out.mkdir(parents=True, exist_ok=True)
    replace_file(arguments.out / "laps.md", "\n".join(lines) + "\n")
    with (arguments.out / "laps.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows([[row[0], *(f"{one:.4g}" for one in row[1:])] for row in rows])


if __name__ == "__main__":
    main()
