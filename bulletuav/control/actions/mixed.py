"""Actions of drones that differ in kind, such as body rates for some and velocities for others."""

import itertools
from collections.abc import Sequence

import numpy as np

from bulletuav.control.actions.base import Action, Encoder


def mix_actions(names: Sequence[str], parts: Sequence[Action], part_of: Sequence[int]) -> Action:
    """Create the action of drones of several kinds.

    Actions (W, N, A) have as many numbers as the drone with the most. The others of a drone are
    padding, with bounds of 0.

    Args:
        names: Name of each drone's action.
        parts: The action of each kind, made for its own drones only.
        part_of: Index of the kind of each drone.

    Returns:
        The action. It can be encoded if all kinds can.

    Raises:
        ValueError: If one of the kinds is discrete.
    """
    for part in parts:
        if part.choices is not None:
            raise ValueError(
                f"action {part.name!r} is a choice, and the actions of other drones are "
                f"{', '.join(one.name for one in parts if one is not part)}: choose one discrete "
                f"action for all drones, or continuous ones"
            )
    kind = np.array(part_of)
    rows = [np.flatnonzero(kind == k) for k in range(len(parts))]
    labels: list[tuple[str, ...]] = [()] * len(names)
    for part, own in zip(parts, rows, strict=True):
        for i, one in zip(own.tolist(), part.labels, strict=True):
            labels[i] = one
    width = max(map(len, labels))
    low, high = np.zeros((2, len(names), width))
    for part, own in zip(parts, rows, strict=True):
        low[own, : part.low.shape[1]] = part.low
        high[own, : part.low.shape[1]] = part.high

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        # Each kind reads its own drones and columns
        decoded = [
            part.decode(
                np.ascontiguousarray(action[:, own, : part.low.shape[1]]),
                np.ascontiguousarray(commanded[:, own]),
            )
            for part, own in zip(parts, rows, strict=True)
        ]
        setpoint = np.zeros((*action.shape[:2], max(one.shape[-1] for one in decoded)))
        for own, one in zip(rows, decoded, strict=True):
            setpoint[:, own, : one.shape[-1]] = one
        return setpoint

    return Action(
        name=", ".join(f"{len(list(run))} x {name}" for name, run in itertools.groupby(names)),
        level=max(part.level for part in parts),
        labels=tuple(labels),
        low=low,
        high=high,
        decode=decode,
        encode=_mix_encoders(parts, rows, width),
        parts=tuple(parts),
        part_of=tuple(part_of),
    )


def _mix_encoders(
    parts: Sequence[Action], rows: Sequence[np.ndarray], width: int
) -> Encoder | None:
    """Return the encoder of actions (W, N, `width`); None if one of the kinds has none."""
    encoders = [part.encode for part in parts if part.encode is not None]
    if len(encoders) < len(parts):
        return None

    def encode(vector: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        action = np.zeros((*vector.shape[:2], width))
        for one, own in zip(encoders, rows, strict=True):
            numbers = one(vector[:, own], commanded[:, own])
            action[:, own, : numbers.shape[-1]] = numbers
        return action

    return encode
