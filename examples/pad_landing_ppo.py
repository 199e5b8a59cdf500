"""Learn to find landing pads in depth pictures and to land on them, by imitation and PPO.

Drones see as much as the baseline `pad_seeker`: the numbers of the task's observation, and its
downward depth camera. The sensor `HeightMap` reduces each picture to 16 x 16 cells of heights, and
a small convolutional network, `PictureFeatures`, is shared by all drones. They decide 10 times a
second. The network first imitates `pad_pilot`, which knows the pads, by `dagger.py`. It then flies
to pads and hovers above them, without any landing; PPO of `fast_ppo.py` learns to land.

Measured in `point_mass` after 1.2 million decisions of PPO, with imitation in `rigid_body`: safe
landings 0.58 at easy and 0.57 at medium, scores 0.55 and 0.50. The baseline has 1.00 and 0.98,
scores 0.96 and 0.90, so it is not reached. Drones fail that sink back to their start platforms,
stand on claimed pads, or fly past the pads.

Run it:

    python examples/pad_landing_ppo.py

Takes about 12 minutes on one core. Needs the extra `sb3`. The output folder can be flown:
`--policy FOLDER`, in this folder and with `--trust`.
"""

import argparse
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from dagger import Lesson, School
from depth_ppo import Views
from fast_ppo import Agent, collect, learn, save, train
from streets import MODEL, Batches, make_batches

import bulletuav
from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.rotation import axes, product, quat4
from bulletuav.geometry.view import FAR
from bulletuav.policies import find_policy
from bulletuav.policies.run import CHECKPOINTS, RunConfig
from bulletuav.sensors import Image, Moment, Sensor, SensorSetup
from bulletuav.sensors.camera import Camera

TASK = "pad_landing"
SIDE, CELLS, MAPS = 64, 16, 2  # pixels: every second one of the task's 128 x 128
FINE, TALL = 0.1, 15.0  # m, scale of the logarithm of heights, and height of which it is 1
HZ = 10


@kernel
def map_heights(depth, quaternion, mount, mask, height, maps):
    """Write height maps (W, N, 2, C, C) of depth pictures (W, N, S, S) with a view of 90 degrees.

    The first map has the highest point of each cell above the ground, which is the lowest point of
    the picture; the second the mean height relative to the drone. `height` (S, S) is overwritten.
    """
    side, cells = depth.shape[-1], maps.shape[-1]
    factor, full = side // cells, math.log1p(TALL / FINE)
    for w in range(depth.shape[0]):
        for i in range(depth.shape[1]):
            if not mask[w, i]:
                continue
            forward, left, up = axes(product(quat4(quaternion, w, i), mount))
            ground = 0.0
            for r in range(side):
                for c in range(side):
                    across, above = 1 - 2 * c / side, 1 - 2 * (r + 1) / side
                    rise = forward[2] + across * left[2] + above * up[2]
                    height[r, c] = depth[w, i, r, c] * rise
                    if depth[w, i, r, c] < FAR:
                        ground = min(ground, height[r, c])
            for r in range(cells):
                for c in range(cells):
                    top, total, count = ground, 0.0, 0
                    for k in range(r * factor, (r + 1) * factor):
                        for m in range(c * factor, (c + 1) * factor):
                            if depth[w, i, k, m] < FAR:
                                top = max(top, height[k, m])
                                total += height[k, m]
                                count += 1
                    mean = total / max(count, 1)
                    size = min(math.log1p(abs(mean) / FINE) / full, 1.0)
                    maps[w, i, 0, r, c] = min(math.log1p((top - ground) / FINE) / full, 1.0)
                    maps[w, i, 1, r, c] = size if mean > 0 else -size


class HeightMap(Sensor):
    """Heights in the depth picture, in 16 x 16 cells, on a logarithmic scale; see `map_heights`."""

    name = "heights"

    def labels(self, setup: SensorSetup) -> Mapping[str, Any]:
        """Return the bounds of the maps."""
        return {"heights": Image(-1.0, 1.0, np.float32, (), (MAPS,))}

    def attach(self, setup: SensorSetup, engine: Any) -> None:
        """Attach the camera, and allocate the maps."""
        super().attach(setup, engine)
        taken = replace(setup, camera_size=(SIDE, SIDE), wanted=frozenset(("depth",)))
        self.camera = Camera().attached(taken, engine)
        self.maps = np.zeros((*setup.shape, MAPS, CELLS, CELLS), np.float32)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Take pictures, and map their heights."""
        depth = self.camera.measure(moment)["depth"]
        mount = self.setup.camera_mounts.quaternion
        heights = np.zeros((SIDE, SIDE))
        map_heights(depth, moment.after.quaternion, mount, moment.mask, heights, self.maps)
        return {"heights": self.maps}


NUMBERS = ["attitude", "velocity", "rates", "pad_clue", "lidar", "claimed_pads", "neighbours"]
OPTIONS = {
    "dynamics": "point_mass",  # without the ground effect, which would hide landings at first
    "sensors": ["pad_landing_ppo:HeightMap"],
    "observation": [*NUMBERS, "heights"],
    "camera_size": [CELLS, CELLS],
    "decision_hz": HZ,
    "horizon": 60 * HZ,
    "num_drones": 4,
    "num_neighbours": 3,
}
PAID = {"progress": 0.2, "landing": 5.0, "early": 5.0, "touching": 0.5, "waiting": -0.01}
PAID |= {"clear": 0.0, "conflict": -1.0, "collision": -2.0, "out_of_bounds": -2.0}
WORLDS = {"easy": 16, "medium": 32}
POLICY = {"net_arch": [128, 128], "log_std_init": -1.5}
LEARN = {"learning_rate": [6e-4, 0.0], "features": "symlog", "policy_kwargs": POLICY}
PAYING = {**OPTIONS, "weights": PAID}
CONFIG = RunConfig(TASK, steps=3_000_000, options=PAYING, model={**MODEL, **LEARN})
LESSON = Lesson(TASK, OPTIONS, [], "pad_pilot", rounds=25, decisions=40, updates=40)
CRITIC_ROUNDS = 5  # rollouts by which the critic learns before the actor continues


class Maps(Views):
    """Worlds whose rows are prepared numbers and maps."""

    scale = 3.0


def warm_start(worlds: Batches, agent: Agent, lesson: Lesson) -> None:
    """Imitate the teacher, then train the critic alone."""
    if lesson.rounds:
        School(lesson, worlds).train(agent, lesson, 2e-3)
    critic = [*agent.mlp_extractor["value_net"].parameters(), *agent.value_net.parameters()]
    optimiser = torch.optim.Adam(critic, 1e-3)
    for part in agent.parameters():
        part.requires_grad_(False)
    for part in critic:
        part.requires_grad_(True)
    for _ in range(CRITIC_ROUNDS):
        learn(agent, optimiser, collect(worlds, agent, CONFIG.settings), CONFIG.settings)
    for part in agent.parameters():
        part.requires_grad_(True)


class Flights(NamedTuple):
    """Means over drones of some episodes: safe landings, score and time of safe landings, s."""

    success: float
    score: float
    time: float


def fly(policy: str, episodes: int, seed: int, **options: Any) -> Flights:
    """Fly a policy in one batch of worlds, and return success, score and time."""
    aviary = bulletuav.Aviary(TASK, episodes, **options)
    pilot = find_policy(policy, trust=True)(aviary)
    seen = aviary.reset(seeds=seed)
    pilot.reset(np.ones(episodes, dtype=bool))
    landed = np.zeros((episodes, aviary.num_drones))
    while aviary.alive.any():
        step = aviary.step(pilot.act(seen, aviary.swarm))
        seen = step.observations
        now = (step.info["score"] > 0) & (landed == 0)
        landed[now] = (aviary.steps[:, None] * np.ones_like(landed))[now]
    period = 1 / aviary.options.decision_hz
    aviary.close()
    done, score = landed > 0, step.info["score"].mean()
    return Flights(done.mean(), score, period * landed[done].mean() if done.any() else 0.0)


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("--rounds", type=int, default=LESSON.rounds, help="of imitation; 0: none")
    parser.add_argument("--steps", type=int, default=CONFIG.steps, help="decisions of PPO")
    parser.add_argument("--episodes", type=int, default=50, help="episodes of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("pad_landing_ppo"), help="folder for the policy"
    )
    return parser.parse_args()


def main() -> None:
    """Train, save, and evaluate the policy after the imitation and after PPO."""
    args = parse_arguments()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    config = replace(CONFIG, seed=args.seed, steps=args.steps)
    worlds = make_batches(config, WORLDS, Maps)
    first = worlds.parts[0]
    agent = Agent(first.features, first.env.action_space.shape[0], config)
    if args.rounds:
        warm_start(worlds, agent, LESSON._replace(rounds=args.rounds))
    save(agent, config, args.out / CHECKPOINTS / "000", "pad_landing_ppo")
    train(agent, worlds, config)
    save(agent, config, args.out, "pad_landing_ppo")
    for policy in (args.out / CHECKPOINTS / "000", args.out):
        options = {**OPTIONS, "difficulty": "medium"}
        found = fly(str(policy), args.episodes, 1000, **options)
        print(
            f"{policy} at medium: success {found.success:.3f}, score {found.score:.3f}, "
            f"landed after {found.time:.2f} s"
        )


if __name__ == "__main__":
    main()
