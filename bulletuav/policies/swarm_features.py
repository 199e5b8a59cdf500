"""Permutation-invariant features of a drone among other entities, in NumPy.

`bulletuav.adapters.swarm_features` implements the same features in PyTorch for training.
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.policies.features import Layers, dense, symlog
from bulletuav.policies.layers import Dense, EntityGroup, SwarmLayer
from bulletuav.sensors.base import Label

ENTITY_WORDS = ("neighbour", "intruder", "other", "opponent", "teammate", "obstacle", "target")
"""Words by which labels name interchangeable entities"""
NUMBERED = re.compile(rf"({'|'.join(ENTITY_WORDS)}) (\d+)\b ?(.*)")
"""Label of a number of an entity: the word, the index of the entity, and the quantity"""
LOOK_AHEAD = 10.0
"""Maximum time to the closest point of approach in the features, s"""
APPROACH = 5
"""Number of features of a closest point of approach: relative position, distance, time"""
TINY = 1e-3
"""Squared speed that regularises divisions, (m/s)^2; negligible in flight"""


class EntityKind(NamedTuple):
    """Entities of one kind, such as neighbours, in an observation.

    Attributes:
        columns: (K, n) indices of the numbers of each entity.
        motion: Indices of relative position and velocity among the numbers of an entity; empty if
            they are not observed.
    """

    columns: tuple[tuple[int, ...], ...]
    motion: tuple[int, ...]


class ObservationLayout(NamedTuple):
    """Layout of an observation: which numbers describe which entities.

    Attributes:
        own: Indices of the numbers that describe no other entity.
        kinds: Other entities by the word that names them.
    """

    own: tuple[int, ...]
    kinds: Mapping[str, EntityKind]

    def inputs(self, word: str) -> int:
        """Return the number of inputs of the layers of a kind."""
        kind = self.kinds[word]
        return len(kind.columns[0]) + APPROACH * bool(kind.motion) + len(self.own)


def find_layout(labels: Sequence[Label]) -> ObservationLayout:
    """Find which numbers of an observation describe which entity.

    Args:
        labels: Labels of the numbers, in order.

    Returns:
        The layout. All numbers labelled "neighbour 1", in any block, belong to the same entity.
    """
    own: list[int] = []
    places: dict[str, dict[int, list[int]]] = {}
    quantities: dict[str, dict[int, list[str]]] = {}
    for place, label in enumerate(labels):
        # Labels with an index describe another entity, all others the drone itself
        match = NUMBERED.fullmatch(label.name)
        if match is None:
            own.append(place)
            continue
        word, number = match[1], int(match[2])
        places.setdefault(word, {}).setdefault(number, []).append(place)
        quantities.setdefault(word, {}).setdefault(number, []).append(match[3])
    # Entities of a kind have the same quantities in the same order
    kinds = {}
    for word, ones in places.items():
        first = min(ones)
        columns = tuple(tuple(ones[number]) for number in sorted(ones))
        kinds[word] = EntityKind(columns, _motion(quantities[word][first]))
    return ObservationLayout(tuple(own), kinds)


def _motion(quantities: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of relative position and velocity in the quantities; () if incomplete."""
    wanted = [f"{what} {axis}" for what in ("position", "velocity") for axis in "xyz"]
    if not set(wanted) <= set(quantities):
        return ()
    return tuple(quantities.index(name) for name in wanted)


class NumpySwarmFeatures:
    """Swarm features from trained layers.

    See `bulletuav.adapters.swarm_features.NumpySwarmFeatures`.
    """

    def __init__(
        self, layout: ObservationLayout, layers: Mapping[str, Layers], scale: float = 1.0
    ) -> None:
        """Set the layers that encode entities.

        Args:
            layout: Layout of the observation.
            layers: Weights and biases by kind, first to last.
            scale: Scale of the numbers, see `symlog`.

        Raises:
            ValueError: If the layers have other input widths.
        """
        for word in sorted({*layout.kinds, *layers}):
            inputs = layout.inputs(word) if word in layout.kinds else 0
            known = layers[word][0][0].shape[1] if layers.get(word) else 0
            if inputs != known:
                raise ValueError(f"features of each {word} expect {known} numbers, not {inputs}")
        self._layout, self._layers, self._scale = layout, layers, scale

    def layer(self) -> SwarmLayer:
        """Return the features as a layer, for export to other formats."""
        kinds = tuple(
            EntityGroup(
                np.array(kind.columns),
                np.array(kind.motion, dtype=int),
                tuple(Dense(weight, bias) for weight, bias in self._layers[word]),
            )
            for word, kind in self._layout.kinds.items()
        )
        return SwarmLayer(np.array(self._layout.own, dtype=int), kinds, self._scale)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Compute features.

        Args:
            rows: (M, D) observations.

        Returns:
            (M, F) features: own numbers, and for each kind the sum and the maximum over entities.
        """
        own = symlog(rows[:, self._layout.own], self._scale)
        parts = [own]
        for word, kind in self._layout.kinds.items():
            # Numbers of all entities of a kind; a row of zeros is an empty slot
            others = rows[:, np.array(kind.columns)]
            is_there = (others != 0).any(axis=-1, keepdims=True)
            known = [symlog(others, self._scale)]
            if kind.motion:
                known += _approach(others[..., kind.motion])
            # The drone's own numbers are an input of each entity
            shared = np.broadcast_to(own[:, None], (*others.shape[:2], own.shape[1]))
            each = np.concatenate([*known, shared], axis=-1)
            for weight, bias in self._layers[word]:
                each = np.maximum(dense(each, weight, bias), 0)
            # Empty slots contribute nothing
            each = each * is_there
            parts += [each.sum(axis=1) / 2, each.max(axis=1)]
        return np.concatenate(parts, axis=1)


def _approach(motion: np.ndarray) -> list[np.ndarray]:
    """Return the closest points of approach to entities (..., 6): position, distance, time."""
    position, velocity = motion[..., :3], motion[..., 3:]
    along = (position * velocity).sum(axis=-1, keepdims=True)
    square = (velocity * velocity).sum(axis=-1, keepdims=True)
    time = np.clip(-along / (square + TINY), 0.0, LOOK_AHEAD)
    place = position + velocity * time
    distance = np.sqrt((place * place).sum(axis=-1, keepdims=True) + TINY)
    return [symlog(place), symlog(distance), time / (LOOK_AHEAD / 2)]
