"""Features of a drone among others, whatever their number and order, by NumPy.

`bulletuav.adapters.swarm_features` has the same for PyTorch, to learn with.
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import log1p
from bulletuav.policies.features import Layers, dense, symlog
from bulletuav.policies.layers import Dense, Others, Swarm
from bulletuav.sensors.base import Label

OTHERS = ("neighbour", "intruder", "other", "opponent", "teammate", "obstacle", "target")
"""Words by which labels name one of several others of which it does not matter which is which"""
NUMBERED = re.compile(rf"({'|'.join(OTHERS)}) (\d+)\b ?(.*)")
"""Label of a number of one of several others: the word, its number, and what is told of it"""
LOOK_AHEAD = 10.0
"""Longest time to the closest approach that features tell, s"""
APPROACH = 5
"""Features of a closest approach: where the other is then, how far, and when"""
TINY = 1e-3
"""Square of a speed, (m/s)^2, that counts as none beside those of flight"""


class Kind(NamedTuple):
    """Others of one kind, such as neighbours, among the numbers of an observation.

    Attributes:
        columns: Places of the numbers of each of them, (K, numbers of one).
        motion: Places of relative position and velocity among the numbers of one; empty where
            they are not told.
    """

    columns: tuple[tuple[int, ...], ...]
    motion: tuple[int, ...]


class Layout(NamedTuple):
    """Where the numbers of an observation are.

    Attributes:
        own: Places of those that tell of no other.
        kinds: Others by the word that names them.
    """

    own: tuple[int, ...]
    kinds: Mapping[str, Kind]

    def inputs(self, word: str) -> int:
        """Tell how many numbers the layers of a kind take."""
        kind = self.kinds[word]
        return len(kind.columns[0]) + APPROACH * bool(kind.motion) + len(self.own)


def find_layout(labels: Sequence[Label]) -> Layout:
    """Find which numbers of an observation tell of which other.

    Args:
        labels: Those of the numbers, in their order.

    Returns:
        The layout. All that labels tell of "neighbour 1", in whatever blocks, belongs together.
    """
    own: list[int] = []
    places: dict[str, dict[int, list[int]]] = {}
    told: dict[str, dict[int, list[str]]] = {}
    for place, label in enumerate(labels):
        # Labels with a number tell of another, the rest of the drone itself
        match = NUMBERED.fullmatch(label.name)
        if match is None:
            own.append(place)
            continue
        word, number = match[1], int(match[2])
        places.setdefault(word, {}).setdefault(number, []).append(place)
        told.setdefault(word, {}).setdefault(number, []).append(match[3])
    # Others of a kind have the same numbers, in the same order
    kinds = {}
    for word, ones in places.items():
        first = min(ones)
        columns = tuple(tuple(ones[number]) for number in sorted(ones))
        kinds[word] = Kind(columns, _motion(told[word][first]))
    return Layout(tuple(own), kinds)


def _motion(told: Sequence[str]) -> tuple[int, ...]:
    """Find relative position and velocity in what is told of another; () without both."""
    wanted = [f"{what} {axis}" for what in ("position", "velocity") for axis in "xyz"]
    if not set(wanted) <= set(told):
        return ()
    return tuple(told.index(name) for name in wanted)


class SwarmFeatures:
    """Features from layers that were learned.

    See `bulletuav.adapters.swarm_features.SwarmFeatures`.
    """

    def __init__(self, layout: Layout, layers: Mapping[str, Layers], scale: float = 1.0) -> None:
        """Take the layers that others go through.

        Args:
            layout: Where numbers are.
            layers: Weights and biases by kind, first to last.
            scale: Scale of the numbers, see `symlog`.

        Raises:
            ValueError: The layers are for other numbers.
        """
        for word in sorted({*layout.kinds, *layers}):
            inputs = layout.inputs(word) if word in layout.kinds else 0
            known = layers[word][0][0].shape[1] if layers.get(word) else 0
            if inputs != known:
                raise ValueError(
                    f"features of each {word} take {known} numbers, and here they are {inputs}"
                )
        self._layout, self._layers, self._scale = layout, layers, scale

    def layer(self) -> Swarm:
        """Tell what it computes, for writers of other formats."""
        kinds = tuple(
            Others(
                np.array(kind.columns),
                np.array(kind.motion, dtype=int),
                tuple(Dense(weight, bias) for weight, bias in self._layers[word]),
            )
            for word, kind in self._layout.kinds.items()
        )
        return Swarm(np.array(self._layout.own, dtype=int), kinds, self._scale)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Compute features.

        Args:
            rows: (M, D) observations.

        Returns:
            (M, F) features: own numbers, and of each kind the sum and the largest over others.
        """
        own = symlog(rows[:, self._layout.own], self._scale)
        parts = [own]
        for word, kind in self._layout.kinds.items():
            # All numbers of all others of a kind; zeros mean that nobody is there
            others = rows[:, np.array(kind.columns)]
            is_there = (others != 0).any(axis=-1, keepdims=True)
            known = [symlog(others, self._scale)]
            if kind.motion:
                known += _approach(others[..., kind.motion])
            # The drone's own numbers go along with those of each other
            shared = np.broadcast_to(own[:, None], (*others.shape[:2], own.shape[1]))
            each = np.concatenate([*known, shared], axis=-1)
            for weight, bias in self._layers[word]:
                each = np.maximum(dense(each, weight, bias), 0)
            # Who is not there adds nothing
            each = each * is_there
            parts += [each.sum(axis=1) / 2, each.max(axis=1)]
        return np.concatenate(parts, axis=1)


def _approach(motion: np.ndarray) -> list[np.ndarray]:
    """Compute where others (..., 6) come closest if both fly straight on: place, distance, time."""
    position, velocity = motion[..., :3], motion[..., 3:]
    along = (position * velocity).sum(axis=-1, keepdims=True)
    square = (velocity * velocity).sum(axis=-1, keepdims=True)
    time = np.clip(-along / (square + TINY), 0.0, LOOK_AHEAD)
    place = position + velocity * time
    distance = np.sqrt((place * place).sum(axis=-1, keepdims=True) + TINY)
    return [symlog(place), log1p(distance), time / (LOOK_AHEAD / 2)]
