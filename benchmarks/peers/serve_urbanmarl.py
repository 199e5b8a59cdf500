"""urbanmarl: UAVs in batched cities, in PyTorch, with the faces of TorchRL."""

from serve import serve  # first: it takes care of what others print

# isort: split

from functools import partial

import torch
from urbanmarl.envs.base_env import UrbanEnv

SETTLE = 30  # steps: an episode of random actions takes fewer


def lidar_navigation(worlds: int):
    """Its scenario of this name under random actions, worlds that are done reset; by default a step is a second."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    env = UrbanEnv(
        num_envs=worlds,
        continuous_actions=True,
        seed=0,
        device="cpu",
        scenario="uav_lidar_navigation",
        num_uavs=3,
        num_lidar_beams=16,
        lidar_max_range=60.0,
    )
    now = env.reset()

    def step() -> None:
        nonlocal now
        now.update(env.full_action_spec.rand())
        _, now = env.step_and_maybe_reset(now)

    for _ in range(SETTLE):
        step()
    return step, worlds


if __name__ == "__main__":
    serve({f"lidar_navigation, {worlds}": partial(lidar_navigation, worlds) for worlds in (1, 64, 256)})
