"""Rates of physics, decisions and pictures."""

from typing import Any

from bulletuav.errors import as_int, finite

MAX_HZ = 100_000
MIN_DECISION_HZ = 0.1
"""Lowest decision rate, for decisions of 10 s"""
ROUNDING = 1e-9
"""Relative tolerance of the number of substeps, as 1/3 has no exact binary form"""


def decision_rate(rate: Any, physics_hz: int) -> float:
    """Check the number of decisions per second.

    Args:
        rate: A whole number that divides `physics_hz`; or from 0.1 to 1, if a decision has a whole
            number of substeps.
        physics_hz: Physics substeps per second.

    Returns:
        The rate, an int from 1 on.

    Raises:
        ValueError: If the rate is invalid.
    """
    if isinstance(rate, float) and 0 < rate < 1:
        slow = finite("decision_hz", rate, MIN_DECISION_HZ)
        substeps = round(physics_hz / slow)
        if abs(substeps * slow - physics_hz) > ROUNDING * physics_hz:
            raise ValueError(
                f"decision_hz {slow:g} gives decisions of {physics_hz / slow:g} substeps of "
                f"physics_hz {physics_hz}: a whole number is needed, try {physics_hz}/{substeps}"
            )
        return slow
    whole = as_int("decision_hz", rate, 1, MAX_HZ)
    require_divisor("decision_hz", whole, "physics_hz", physics_hz)
    return whole


def picture_rate(rate: Any, decision_hz: float) -> int:
    """Check the number of camera pictures per second.

    Raises:
        ValueError: If the rate is not a whole number that divides `decision_hz`.
    """
    whole = as_int("camera_hz", rate, 1, MAX_HZ)
    if decision_hz < 1:
        raise ValueError(
            f"camera_hz is {whole}, and decision_hz {decision_hz:g}: leave it out for a picture a "
            f"decision"
        )
    require_divisor("camera_hz", whole, "decision_hz", int(decision_hz))
    return whole


def require_divisor(name: str, rate: int, into: str, total: int) -> None:
    """Raise ValueError that suggests rates nearby if `rate` does not divide `total`."""
    if total % rate:
        divisors = [divisor for divisor in range(1, total + 1) if total % divisor == 0]
        near = sorted(divisors, key=lambda divisor: abs(divisor - rate))[:3]
        raise ValueError(f"{name} {rate} does not divide {into} {total}: try {sorted(near)}")
