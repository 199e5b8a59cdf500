"""Policies: the baselines, those that were trained, and how to find one by its name."""

from bulletuav.policies.base import Policy, check_action
from bulletuav.policies.find import (
    SHIPPED_NAMES,
    PolicySource,
    PolicySpec,
    find_policy,
    policy_names,
)

__all__ = [
    "SHIPPED_NAMES",
    "Policy",
    "PolicySource",
    "PolicySpec",
    "check_action",
    "find_policy",
    "policy_names",
]
