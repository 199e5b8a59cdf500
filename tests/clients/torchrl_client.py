"""TorchRL: `PettingZooWrapper` with drones that leave early, and `GymEnv` by name.

Drones leave early, and ends are mixed: see `swarm.py`. The wrapper sends
actions of departed drones too.
"""

import logging
import warnings

import torch
from swarm import HORIZON, make_env
from torchrl.envs import GymEnv
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.envs.utils import check_env_specs

EPISODES = 50


def wrap(**options):
    """The environment in TorchRL's wrapper."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "PettingZoo in TorchRL is tested")
        env = make_env()
        return PettingZooWrapper(env, use_mask=True, seed=0, **options)


def ends(rollout):
    """Whether drones left before the last step, and whether that mixed both ends."""
    flown = rollout["drone", "mask"]  # (T, drones): alive before each step
    terminated = rollout["next", "drone", "terminated"][-1, :, 0][flown[-1]]
    truncated = rollout["next", "drone", "truncated"][-1, :, 0][flown[-1]]
    return not bool(flown[-1].all()), bool(terminated.any() and truncated.any())


def fly_swarm():
    """Counts (early, mixed) of episodes until all drones are done."""
    env = wrap(done_on_any=False, return_state=True)
    check_env_specs(env)
    early = mixed = 0
    for _ in range(EPISODES):
        rollout = env.rollout(2 * HORIZON)
        assert rollout["next", "done"][-1].item(), "an episode did not end"
        assert len(rollout) <= HORIZON, f"an episode took {len(rollout)} steps"
        assert rollout["next", "drone", "observation"].isfinite().all(), "observation not finite"
        left, both = ends(rollout)
        early, mixed = early + left, mixed + both
    env.close()
    return early, mixed


def fly_until_first():
    """Steps flown with the wrapper's default: all start anew as soon as one drone is done."""
    env = wrap()
    check_env_specs(env)
    rollout = env.rollout(100, break_when_any_done=False)
    env.close()
    return len(rollout)


def fly_hover(**options):
    """Steps of a rollout of the Gymnasium environment."""
    env = GymEnv("bulletuav/Hover-v2", **options)
    env.set_seed(0)
    check_env_specs(env)
    rollout = env.rollout(100)
    env.close()
    return len(rollout)


def main():
    """Fly, and check that the ends that matter did happen."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    torch.set_num_threads(1)
    torch.manual_seed(0)
    early, mixed = fly_swarm()
    assert early > 0, "no drone left early"
    assert mixed > 0, "no last step mixed terminations with truncations"
    steps = fly_until_first()
    hover, skipped = fly_hover(), fly_hover(frame_skip=2)
    print(
        f"torchrl: {EPISODES} episodes, {early} with early leavers, {mixed} with mixed ends; "
        f"{steps} steps with done_on_any; hover {hover} steps, {skipped} with frame_skip=2"
    )


if __name__ == "__main__":
    main()
