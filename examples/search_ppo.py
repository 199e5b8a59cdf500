"""Learn to search hills for victims by a depth camera, from `sweep` on, with PPO of `fast_ppo.py`.

Three drones observe as much as the baseline `sweep`, but a downward depth camera replaces the range
finder. The block `unsearched` is a map of the squares that are left, in sectors and rings around
the drone. A network is first cloned from `sweep`, together with the returns that it gets, and then
trained by PPO in `point_mass` with 5 decisions a second. It has no memory, so it flies at the 10
decisions a second of the task as well.

Run it:

    python examples/search_ppo.py

Takes 18 minutes on one core, and then evaluates at medium in `bullet`. Needs the extras `sb3` and
`onnx`. In 20 episodes from seed 1000 (`sweep`: 1.00, 1.00, 19.8 s) safe_success was 0.90, found
1.00 and find_time 17.2 s: the network finds victims faster, but drones that hover above the same
victim conflict. The output folder can be flown: `--policy FOLDER`, in this folder and with
`--trust`.
"""

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from depth_ppo import Views
from fast_ppo import Agent, save, train
from torch import nn

import bulletuav
from bulletuav.compiled.functions import atan2
from bulletuav.compiled.kernel import kernel
from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig
from bulletuav.sensors import Label
from bulletuav.tasks import block

SIDE = 16  # pixels of a side of pictures
SECTORS, RINGS = 12, (0.0, 8.0, 20.0, 40.0, 80.0)  # directions, and distances (m) of the map
FAR = 200.0  # m, bound of observed distances
KINDS = ("all", "own")
LABELS = [
    Label(f"{kind} {ring:g} m {sector}", "1", 0.0, 100.0)
    for kind in KINDS
    for ring in RINGS
    for sector in range(SECTORS)
]
LABELS += [Label(f"nearest {kind} {axis}", "m", -FAR, FAR) for kind in KINDS for axis in "xy"]
LABELS += [Label("victim is nearer to another drone", "1", 0.0, 1.0)]


@kernel
def add_to_map(out, start, x, y):
    """Add a square at an offset to the map, shared by the nearest sectors and rings."""
    distance = math.sqrt(x * x + y * y)
    ring = 0
    while ring < len(RINGS) - 2 and distance > RINGS[ring + 1]:
        ring += 1
    outer = min((distance - RINGS[ring]) / (RINGS[ring + 1] - RINGS[ring]), 1.0)
    turn = (atan2(y, x) / (2 * math.pi) % 1.0) * SECTORS
    sector = int(turn) % SECTORS
    later = turn - int(turn)
    following = (sector + 1) % SECTORS
    for k, weight in ((ring, 1.0 - outer), (ring + 1, outer)):
        out[start + k * SECTORS + sector] += weight * (1.0 - later)
        out[start + k * SECTORS + following] += weight * later


@block(LABELS)
def unsearched(
    i,
    known_position,
    known_cells,
    sighting,
    all_known_position,
    all_alive,
    all_has_ground,
    all_clue,
    clue_radius,
    out,
):
    """Observe the squares to search around the drone: all, and those nearest to this drone."""
    for k in range(len(out)):
        out[k] = 0.0
    x, y = known_position[0], known_position[1]
    count = round(math.sqrt(len(known_cells)))
    side = 2 * clue_radius / count
    size = SECTORS * len(RINGS)
    least_all, least_own = math.inf, math.inf
    for c in range(len(known_cells)):
        if known_cells[c] > 0.0 or all_has_ground[c] == 0.0:
            continue
        east = all_clue[0] - clue_radius + side * (c // count + 0.5)
        north = all_clue[1] - clue_radius + side * (c % count + 0.5)
        square = (east - x) ** 2 + (north - y) ** 2
        is_own = True
        for k in range(len(all_alive)):
            if k != i and all_alive[k]:
                other = all_known_position[k]
                is_own = is_own and (east - other[0]) ** 2 + (north - other[1]) ** 2 > square
        add_to_map(out, 0, east - x, north - y)
        if square < least_all:
            least_all = square
            out[2 * size], out[2 * size + 1] = east - x, north - y
        if is_own:
            add_to_map(out, size, east - x, north - y)
            if square < least_own:
                least_own = square
                out[2 * size + 2], out[2 * size + 3] = east - x, north - y
    if sighting[0] > 0.5:
        own = sighting[1] ** 2 + sighting[2] ** 2
        for k in range(len(all_alive)):
            if k != i and all_alive[k]:
                other = all_known_position[k]
                away = (x + sighting[1] - other[0]) ** 2 + (y + sighting[2] - other[1]) ** 2
                if away < own:
                    out[2 * size + 4] = 1.0


BLOCK = "search_ppo:unsearched"
SEEN = ["velocity", "clue_offset", "sighting", "victims_found", "all_neighbours"]
OPTIONS = {
    "observation": [*SEEN, BLOCK, "depth"],
    "camera_size": [SIDE, SIDE],
    "camera_mounts": {"pitch": -90, "stabilized": True},
}
# Slower decisions than those of the task. The range finder is for `sweep` only.
FLIGHT = {"dynamics": "point_mass", "decision_hz": 5, "horizon": 300, "reward": "training"}
BEAM = {"num_beams": 1, "lidar_elevations": [-60.0]}
FLYING = {**FLIGHT, "difficulty": "medium"}
LEARN = {
    "features": "symlog",
    "n_epochs": 3,
    "learning_rate": [4e-4, 0.0],
    # A noise of 1.7 m/s: with more, drones seldom stay above a victim for 2 s
    "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -1.8},
}
CONFIG = RunConfig("search", steps=4_000_000, worlds=64, options=OPTIONS, model=LEARN)
EXTRA = ["position", "searched_cells", "lidar"]  # which `sweep` reads in addition
NOISE = 0.15  # of the actions of `sweep`, to visit states off its path


class Lessons(Views):
    """Worlds that keep observations as the teacher reads them."""

    def rows(self, array: Any) -> torch.Tensor:
        """Reshape an array to rows, and keep observations."""
        if isinstance(array, dict):
            self.raw = array
        return super().rows(array)


@torch.no_grad()
def watch(seed: int, decisions: int) -> list[torch.Tensor]:
    """Fly `sweep`; return observations, its actions, its returns, and 1 where these are known."""
    options = {**OPTIONS, **FLYING, "observation": [*SEEN, BLOCK, *EXTRA, "depth"]}
    worlds = Lessons(replace(CONFIG, options=options, seed=seed))
    env = worlds.env
    own = env.aviary.observer.slices[EXTRA[0]].start
    teacher = find_policy("sweep", CONFIG.task)(env.aviary)
    teacher.reset(np.ones(env.num_envs, dtype=bool))
    seen, taught, results = [], [], []
    for _ in range(decisions):
        action = teacher.act(worlds.raw, env.aviary.swarm)
        right = torch.from_numpy(action.reshape(-1, action.shape[-1]).astype(np.float32))
        seen.append(torch.cat([worlds.seen[:, :own], worlds.seen[:, -SIDE * SIDE :]], 1))
        taught.append(right.clamp(-1, 1))
        fresh = env.ended
        results.append(worlds.step(right + NOISE * torch.randn_like(right)))
        teacher.reset(fresh)
    env.close()
    flown, reward, _, done = torch.stack(results, 1)
    after, known = torch.zeros_like(reward), torch.zeros_like(reward)
    gamma = CONFIG.settings["gamma"]
    total, ends = torch.zeros(reward.shape[1]), torch.zeros(reward.shape[1])
    for t in reversed(range(decisions)):
        total = after[t] = reward[t] + gamma * (1 - done[t]) * total
        # Returns of episodes that end later are not known
        ends = known[t] = torch.maximum(ends, done[t])
    lived = flown.bool()
    return [part[lived] for part in (torch.stack(seen), torch.stack(taught), after, known)]


def clone(agent: Agent, seed: int, decisions: int, epochs: int = 8) -> None:
    """Imitate `sweep`, and learn the returns that it gets."""
    rows = watch(seed + 50_000, decisions)
    optimiser = torch.optim.Adam(agent.parameters(), 1e-3)
    count = len(rows[0])
    for k in range(epochs):
        optimiser.param_groups[0]["lr"] = 1e-3 * (1 - k / epochs)
        for chosen in torch.randperm(count).split(512):
            seen, taught, after, known = (part[chosen] for part in rows)
            choice, value = agent(seen, seen[:, :0])
            wrong = (choice.mean - taught).square().mean()
            loss = wrong + 0.05 * (known * (value - after).square()).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()
    print(f"cloned `sweep` from {count} decisions: squared error {wrong.item():.4f}", flush=True)


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("--steps", type=int, default=CONFIG.steps, help="decisions of all drones")
    parser.add_argument("--episodes", type=int, default=20, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cloned", type=int, default=250, help="decisions of each cloned drone")
    parser.add_argument("--out", type=Path, default=Path("search_ppo"), help="output folder")
    return parser.parse_args()


def main() -> None:
    """Train, save, and evaluate the saved policy."""
    args = parse_arguments()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    config = replace(CONFIG, seed=args.seed, steps=args.steps)
    worlds = Views(replace(config, options={**OPTIONS, **FLYING, **BEAM}))
    agent = Agent(worlds.features, worlds.env.action_space.shape[0], config)
    clone(agent, args.seed, args.cloned)
    train(agent, worlds, config)
    save(agent, config, args.out, "search_ppo")
    result = bulletuav.evaluate(
        "search", args.out, args.episodes, 1000, difficulty="medium", trust=True
    )
    for name in ("safe_success", "found", "find_time", "return"):
        found = result.estimates()[name]
        print(f"{name} {found.mean:.3f} ({found.low:.3f} to {found.high:.3f})")


if __name__ == "__main__":
    main()
