"""Baseline policies."""

from bulletuav.errors import pick
from bulletuav.policies.base import Policy
from bulletuav.policies.straight import StraightLine

POLICIES: dict[str, type[Policy]] = {policy.name: policy for policy in (StraightLine,)}


def find_policy(name: str) -> type[Policy]:
    """The policy of that name. Raises ValueError with the nearest names when there is none."""
    return pick("policy", name, POLICIES)
