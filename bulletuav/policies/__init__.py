"""Baseline and trained policies, and functions that find a policy by name."""

from bulletuav.catalogue import SHIPPED_NAMES
from bulletuav.policies.base import Policy, check_action
from bulletuav.policies.find import (
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
