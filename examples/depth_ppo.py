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
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from fast_ppo import Agent, Worlds, save, train
from streets import LEARN, MODEL, TASK, WORLDS, make_batches
from torch import nn

import bulletuav
from bulletuav.adapters.features import PictureFeatures
from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.rotation import heading, to_body
from bulletuav.policies import find_policy
from bulletuav.policies.run import RunConfig
from bulletuav.sensors import Label
from bulletuav.tasks import block

SIDE = 64  # pixels of a side of pictures
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
CONFIG = RunConfig(
    TASK, steps=4_000_000, options={**LEARN, **CAMERA}, model={**MODEL, "features": "symlog"}
)


class RowFeatures(PictureFeatures):
    """Features of rows of prepared numbers and pixels, or of observations."""

    def pack(self, observations: Any) -> torch.Tensor:
        """Return rows (M, numbers + pixels), a sixteenth of the pictures' memory, of a dict."""
        prepared = self.prepare(observations)
        self.shapes = {name: one.shape[1:] for name, one in prepared.items()}
        return torch.cat([one.flatten(1) for one in prepared.values()], 1)

    def forward(self, observations: Any) -> torch.Tensor:
        """Return features (M, F) of rows, or of a dict."""
        if isinstance(observations, dict):
            return super().forward(observations)
        parts = observations.split([shape.numel() for shape in self.shapes.values()], 1)
        named = zip(self.shapes.items(), parts, strict=True)
        return self.encode({name: part.unflatten(1, shape) for (name, shape), part in named})


class Views(Worlds):
    """Worlds whose rows are prepared numbers and pixels."""

    scale = 1.0  # of the symlog of numbers

    @cached_property
    def features(self) -> RowFeatures:
        """Feature extractor of the observations."""
        return RowFeatures(self.env.observation_space, scale=self.scale)

    def rows(self, array: Any) -> torch.Tensor:
        """Reshape an array (W, N, ...), or pack observations, to rows (M, ...)."""
        if not isinstance(array, dict):
            return super().rows(array)
        flat = {name: np.reshape(one, (-1, *one.shape[2:])) for name, one in array.items()}
        return self.features.pack({name: torch.from_numpy(one) for name, one in flat.items()})


class Actor(nn.Module):
    """Mean actions of an agent, from a vector and a picture."""

    def __init__(self, agent: Agent) -> None:
        super().__init__()
        self.agent = agent

    def forward(self, vector: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
        """Return actions (M, 3) within their bounds."""
        choice, _ = self.agent({"vector": vector, "depth": depth}, vector[:, :0])
        return choice.mean.clamp(-1, 1)


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
    aviary = bulletuav.Aviary(TASK, 2, difficulty="medium", **{**CONFIG.options, "weights": {}})
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
    parser.add_argument("--steps", type=int, default=CONFIG.steps, help="decisions of all drones")
    parser.add_argument("--episodes", type=int, default=20, help="episodes of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("depth_ppo"), help="folder for the policy")
    return parser.parse_args()


def main() -> None:
    """Train, save, export, and evaluate the saved policy."""
    args = parse_arguments()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    config = replace(CONFIG, seed=args.seed, steps=args.steps)
    worlds = make_batches(config, WORLDS, Views)
    first = worlds.parts[0]
    agent = Agent(first.features, first.env.action_space.shape[0], config)
    train(agent, worlds, config)
    save(agent, config, args.out, "depth_ppo")
    write_onnx(agent, args.out / "policy.onnx")
    print(f"actions of the ONNX file differ by at most {largest_difference(args.out):.1e}")
    result = bulletuav.evaluate(
        TASK, args.out, args.episodes, 1000, difficulty="medium", trust=True
    )
    found = result.estimates()["drone_success"]
    print(f"at medium {found.mean:.3f} ({found.low:.3f} to {found.high:.3f}) reach their goals")


if __name__ == "__main__":
    main()
