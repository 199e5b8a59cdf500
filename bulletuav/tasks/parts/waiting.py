"""Decisions of a drone before it has reached what its task asks for."""

from bulletuav.compiled.kernel import func


@func
def decisions_waited(
    is_done: bool, is_lost: bool, time: float, duration: float, period: float
) -> float:
    """Return 1 per decision until the drone is done; if it is lost, also 1 per remaining decision.

    Args:
        is_done: Whether the drone has reached what its task asks for.
        is_lost: Whether its episode ended otherwise.
        time: Time since the start, s.
        duration: Duration of an episode, s.
        period: Duration of a decision, s.
    """
    if is_done:
        return 0.0
    return 1.0 + ((duration - time) / period if is_lost else 0.0)
