"""Train drones to fly through cities by a depth camera, without a map, with PPO of `fast_ppo.py`.

As `streets.py`, with a forward camera of 64 x 64 pixels instead of the lidar: drones observe the
velocity, the goal and the arena's bounds relative to their heading, and turn their nose to where
they fly. A small convolutional network, `PictureFeatures`, is shared by all drones and trained at
three difficulties at once. It is also written to ONNX, with the picture in metres as an input.

Run it:

    python examples/depth_ppo.py

Takes 12 minutes on one core, and then evaluates at medium in `bullet`. Needs the extras `sb3`
and `onnx`. The output folder can be flown: `--policy FOLDER`, in this folder and with `--trust`.
"""

import argparse
import math
import warnings
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from fast_ppo import Agent, Plan, Worlds, train
from streets import BATCHES, LEARN, TASK
from torch import nn

import bulletuav
from bulletuav.adapters.features import PictureFeatures
from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.rotation import heading, to_body
from bulletuav.policies import find_policy
from bulletuav.sensors import Label
from bulletuav.tasks import block

SIDE, CELLS = 64, 16  # pixels of a side of pictures, and of prepared pictures
FAR = 60.0  # m, maximum of observed distances to bounds
LABELS = [Label(f"goal {axis}", "1", -1.0, 1.0) for axis in ("ahead", "left")]
LABELS += [Label("goal distance", "m", 0.0, 1000.0), Label("goal above", "m", -50.0, 50.0)]
LABELS += [Label(f"room {side}", "m", 0.0, FAR) for side in ("ahead", "left", "right")]
LABELS += [Label(f"room {side}", "m", 0.0, FAR) for side in ("up", "down")]
LABELS += [Label(f"tilt {axis}", "1", -1.0, 1.0) for axis in ("ahead", "left")]


@kernel
def distance_to_bounds(x, y, angle, east, north, west, south):
    """Return the distance to the arena's bounds in a direction, at most FAR."""
    along, across = cos(angle), sin(angle)
    distance = FAR
    if abs(along) > 1e-6:
        distance = min(distance, ((east if along > 0 else west) - x) / along)
    if abs(across) > 1e-6:
        distance = min(distance, ((north if across > 0 else south) - y) / across)
    return distance


@block(LABELS)
def egocentric(
    known_position, quaternion, goal, bound_east, bound_north, bound_up, bound_west, bound_south
):
    """Observe the goal and the arena's bounds relative to the heading, and the tilt."""
    x, y, z = known_position
    yaw = heading(quaternion)
    east, north = goal[0] - x, goal[1] - y
    bearing = atan2(north, east) - yaw
    bounds = bound_east, bound_north, bound_west, bound_south
    up = to_body(quaternion, (0.0, 0.0, 1.0))
    return (
        cos(bearing),
        sin(bearing),
        math.sqrt(east * east + north * north),
        goal[2] - z,
        distance_to_bounds(x, y, yaw, *bounds),
        distance_to_bounds(x, y, yaw + math.pi / 2, *bounds),
        distance_to_bounds(x, y, yaw - math.pi / 2, *bounds),
        bound_up - z,
        z,
        up[0],
        up[1],
    )


CAMERA = {
    "action": "turn_speed",
    "max_climb": 4.0,
    "observation": ["body_velocity", "depth_ppo:egocentric", "depth"],
    "camera_size": [SIDE, SIDE],
}
PLAN = Plan(TASK, {**LEARN, **CAMERA}, BATCHES, 4_000_000, rate=7e-4, width=128, features="symlog")


class RowFeatures(PictureFeatures):
    """Features of rows of prepared numbers and pixels, or of observations."""

    def forward(self, observations: Any) -> torch.Tensor:
        """Return features (M, F) of rows (M, numbers + pixels), or of a dict."""
        if isinstance(observations, dict):
            return super().forward(observations)
        numbers, pixels = observations.tensor_split([-CELLS * CELLS], 1)
        return self.encode({"vector": numbers, "depth": pixels.unflatten(1, (1, CELLS, CELLS))})


class Views(Worlds):
    """Worlds whose rows are prepared numbers and pixels, a sixteenth of the pictures' memory."""

    @cached_property
    def features(self) -> RowFeatures:
        """Feature extractor of the observations."""
        return RowFeatures(self.envs[0].observation_space)

    def _rows(self, arrays: list[Any]) -> torch.Tensor:
        """Concatenate arrays (W, N, ...), or observations, of all batches to rows (M, ...)."""
        if not isinstance(arrays[0], dict):
            return super()._rows(arrays)
        flat = [
            {name: np.reshape(one, (-1, *one.shape[2:])) for name, one in seen.items()}
            for seen in arrays
        ]
        whole = {
            name: torch.from_numpy(np.concatenate([one[name] for one in flat])) for name in flat[0]
        }
        return torch.cat([one.flatten(1) for one in self.features.prepare(whole).values()], 1)


class Actor(nn.Module):
    """Mean actions of an agent, from a vector and a picture."""

    def __init__(self, agent: Agent) -> None:
        super().__init__()
        self.agent = agent

    def forward(self, vector: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
        """Return actions (M, 3) within their bounds."""
        mean, _ = self.agent({"vector": vector, "depth": depth}, vector[:, :0])
        return mean.clamp(-1, 1)


def write_onnx(agent: Agent, path: Path) -> None:
    """Write the network, from observations in their own units to actions."""
    space = agent.features_extractor._observation_space
    inputs = tuple(torch.ones(2, *space[name].shape) for name in ("vector", "depth"))
    axes = {name: {0: "drones"} for name in ("vector", "depth", "action")}
    names = {"input_names": ["vector", "depth"], "output_names": ["action"], "dynamic_axes": axes}
    with warnings.catch_warnings():
        # The newer exporter of PyTorch needs another package
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(Actor(agent), inputs, path, dynamo=False, **names)


def largest_difference(folder: Path, decisions: int = 20) -> float:
    """Fly the saved policy, and return the largest difference to actions of the ONNX file."""
    session = onnxruntime.InferenceSession(folder / "policy.onnx")
    aviary = bulletuav.Aviary(TASK, 2, difficulty="medium", **{**PLAN.options, "weights": {}})
    policy = find_policy(str(folder), trust=True)(aviary)
    seen = aviary.reset(seeds=0)
    policy.reset(np.ones(2, dtype=bool))
    differences = []
    for _ in range(decisions):
        actions = policy.act(seen, aviary.swarm)
        rows = {name: one.reshape(-1, *one.shape[2:]) for name, one in seen.items()}
        (given,) = session.run(["action"], rows)
        differences.append(np.abs(given.reshape(actions.shape) - actions).max())
        seen = aviary.step(actions).observations
    aviary.close()
    return float(max(differences))


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("--steps", type=int, default=PLAN.steps, help="decisions of all drones")
    parser.add_argument("--episodes", type=int, default=20, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("depth_ppo"), help="folder for the policy")
    return parser.parse_args()


def main() -> None:
    """Train, save, export, and evaluate the saved policy."""
    args = parse_arguments()
    torch.set_num_threads(1)
    plan = PLAN._replace(steps=args.steps)
    parts = (Views, lambda worlds, _: worlds.features)
    agent = train(plan, args.seed, False, args.out, None, "depth_ppo", *parts)
    write_onnx(agent, args.out / "policy.onnx")
    print(f"actions of the ONNX file differ by at most {largest_difference(args.out):.1e}")
    result = bulletuav.evaluate(
        TASK, args.out, args.episodes, 1000, difficulty="medium", trust=True
    )
    found = result.estimates()["drone_success"]
    print(f"at medium {found.mean:.3f} ({found.low:.3f} to {found.high:.3f}) reach their goals")


if __name__ == "__main__":
    main()
