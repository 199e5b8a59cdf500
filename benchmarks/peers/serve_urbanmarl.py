"""urbanmarl: UAVs in batched cities, in PyTorch, as environments of TorchRL."""

from serve import serve  # first: it takes care of what others print

# isort: split

from functools import partial

import torch
from urbanmarl.envs.base_env import UrbanEnv

SETTLE = 30  # steps: hardly an episode of random actions takes more
SCENARIOS = {
    "lidar_navigation": {
        "scenario": "uav_lidar_navigation",
        "num_lidar_beams": 16,
        "lidar_max_range": 60.0,
    },
    "mec": {"scenario": "uavmec_offloading", "num_ues": 50},
}


def random_flight(worlds: int, **options):
    """Fly a scenario with random actions, and reset worlds that are done.

    By default a step is a second.
    """
    torch.set_num_threads(1)
    torch.manual_seed(0)
    env = UrbanEnv(
        num_envs=worlds,
        continuous_actions=True,
        seed=0,
        device="cpu",
        num_uavs=3,
        **options,
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
    serve(
        {
            f"{case}, {worlds}": partial(random_flight, worlds, **options)
            for case, options in SCENARIOS.items()
            for worlds in (1, 64, 256)
        }
    )
