"""VMAS (M. Bettini et al. 2022): vectorised point masses in PyTorch."""

from serve import serve  # first: it takes care of what others print

# isort: split

from functools import partial

import torch
import vmas


def navigation(worlds: int, agents: int):
    """Fly the navigation scenario: agents to goals, collisions, lidar and reward.

    A decision is one step.
    """
    torch.set_num_threads(1)
    env = vmas.make_env(
        "navigation",
        num_envs=worlds,
        n_agents=agents,
        device="cpu",
        continuous_actions=True,
        seed=0,
    )
    env.reset()
    actions = [torch.zeros(worlds, 2) for _ in range(agents)]

    def step() -> None:
        env.step(actions)

    return step, worlds * agents


def reset(worlds: int, agents: int):
    """Reset all worlds."""
    env = vmas.make_env(
        "navigation",
        num_envs=worlds,
        n_agents=agents,
        device="cpu",
        continuous_actions=True,
        seed=0,
    )
    return env.reset, 1


if __name__ == "__main__":
    serve({"navigation, 64 x 8": partial(navigation, 64, 8), "reset, 10": partial(reset, 1, 10)})
