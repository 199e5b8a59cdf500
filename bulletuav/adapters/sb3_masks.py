"""Rollout buffer for MaskablePPO of sb3-contrib, which learns with masks of discrete actions.

env = DroneVecEnv("crossing", action="discrete", action_masks=True)
model = MaskablePPO("MlpPolicy", env, rollout_buffer_class=LivingMaskableRollouts)
"""

from typing import ClassVar

from bulletuav.adapters.sb3_buffers import LivingRollouts
from bulletuav.errors import missing_extra

try:
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.buffers import MaskableRolloutBuffer
except ImportError:
    raise missing_extra("learning with masks of actions", "contrib") from None


__all__ = ["LivingMaskableRollouts", "MaskablePPO"]


class LivingMaskableRollouts(LivingRollouts, MaskableRolloutBuffer):  # type: ignore[misc]
    """`LivingRollouts` with the masks of actions."""

    rows: ClassVar[tuple[str, ...]] = (*LivingRollouts.rows, "action_masks")
