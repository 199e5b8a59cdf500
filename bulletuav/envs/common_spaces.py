"""Observation spaces and labels that are valid for all stages of a curriculum."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from bulletuav.envs.env_spec import EnvSpec
from bulletuav.sensors.base import Label


def common_observation(specs: Sequence[EnvSpec]) -> Space[Any]:
    """Return the observation space that contains those of all stages.

    Args:
        specs: Specification of each stage.

    Returns:
        A Box, or a Dict of them, with bounds that include those of all stages.

    Raises:
        ValueError: If observations differ in more than their bounds, such as in their blocks, or
            actions differ in kind.
    """
    spaces = [spec.observer.space() for spec in specs]
    if len(spaces) == 1:
        return spaces[0]
    # A network has one input size for all stages
    shapes = [_shapes(space) for space in spaces]
    if any(shape != shapes[0] for shape in shapes):
        raise ValueError(
            f"the stages' observations have shapes {shapes}: choose vectors whose size does not "
            f"depend on the number of drones, such as 'neighbours' instead of 'all_neighbours' "
            f"and 'identity'"
        )
    _require_same_blocks(specs)
    # One kind of output, too
    actions = [spec.action.name for spec in specs]
    if len(set(actions)) > 1:
        raise ValueError(f"the stages' actions are {actions}: one kind for all is needed")
    return _union(spaces)


def _require_same_blocks(specs: Sequence[EnvSpec]) -> None:
    """Raise ValueError for vectors of the same size with other blocks, or in another order."""
    block_lists = [_blocks(spec) for spec in specs]
    for stage, blocks in enumerate(block_lists):
        if blocks != block_lists[0]:
            raise ValueError(
                f"stage 0 observes {block_lists[0]}, and stage {stage} observes {blocks}: the same "
                f"blocks of the same sizes, in the same order, are needed"
            )


def _blocks(spec: EnvSpec) -> str:
    """List the blocks of a stage's vector with their sizes, as text."""
    parts = spec.observer.slices.items()
    return ", ".join(f"{name} ({part.stop - part.start})" for name, part in parts)


def _shapes(space: Space[Any]) -> Any:
    """Return the shape of observations; for dicts, the shape of each entry by name."""
    if isinstance(space, Dict):
        return {name: one.shape for name, one in space.spaces.items()}
    return space.shape


def _union(spaces: Sequence[Space[Any]]) -> Space[Any]:
    """Return the smallest space that contains all spaces of the same shape."""
    dicts = [space for space in spaces if isinstance(space, Dict)]
    if dicts:
        names = dicts[0].spaces
        return Dict({name: _union([space.spaces[name] for space in dicts]) for name in names})
    boxes = [space for space in spaces if isinstance(space, Box)]
    low = np.min([box.low for box in boxes], axis=0)
    high = np.max([box.high for box in boxes], axis=0)
    return Box(low, high, dtype=boxes[0].low.dtype)


def common_labels(specs: Sequence[EnvSpec]) -> list[Label]:
    """Return observation labels with bounds that include those of all stages."""
    labels: list[Label] = []
    for same in zip(*(spec.observer.labels for spec in specs), strict=False):
        low = min(label.low for label in same)
        high = max(label.high for label in same)
        labels.append(same[0]._replace(low=low, high=high))
    return labels
