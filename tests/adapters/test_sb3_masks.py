"""MaskablePPO of sb3-contrib with masks of discrete actions."""

import numpy as np
import torch
from sb3_contrib import MaskablePPO

from bulletuav.adapters.sb3 import DroneVecEnv
from bulletuav.adapters.sb3_masks import LivingMaskableRollouts

CALM = {
    **{"dynamics": "point_mass", "num_drones": 3, "horizon": 60, "radius": 20.0, "margin": 10.0},
    **{"action": "discrete", "action_masks": True, "difficulty": "hard"},
}


def test_maskable_ppo_learns_from_active_drones_and_picks_valid_actions():
    torch.set_num_threads(1)
    env = DroneVecEnv("converge", 2, **CALM)
    buffer = {"rollout_buffer_class": LivingMaskableRollouts}
    model = MaskablePPO("MlpPolicy", env, n_steps=64, batch_size=64, seed=0, **buffer)
    model.learn(64 * 6)
    buffer = model.rollout_buffer
    assert not buffer.action_masks.all()
    assert 0 < len(buffer.flown) < 64 * 6
    assert len(buffer.action_masks) == len(buffer.flown)
    chosen = buffer.actions.astype(int)[:, 0]
    assert buffer.action_masks[np.arange(len(chosen)), chosen].all()
    assert all(torch.isfinite(one).all() for one in model.policy.parameters())
    env.close()
