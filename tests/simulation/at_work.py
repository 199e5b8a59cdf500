"""Environments in use, and the operations that there are."""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .faces import Face
from .invariants import Digest

SLOTS = 3
WARNINGS = (
    "controller 'pid' is made for motors without lag",
    "is multi-threaded, use of fork",  # Python's own, where the simulation forks
    "Gym has been unmaintained",
)
"""Beginnings of warnings that are told in the guide, or are of other libraries"""

BAD_SEEDS = (-1, 1.5, "text", float("nan"), True, [0] * 9, object())
BAD_OPTIONS = (
    *("text", 7, [1]),
    *({"start": "text"}, {"start": np.full((4, 3), np.nan)}, {"goal": np.zeros((1, 2))}),
    {"starts": np.zeros((4, 3))},
)
BAD_MASKS = (np.ones(9, dtype=bool), np.ones(1), "text", [1], np.array([None]), [[True], [True, 1]])


class Sim:
    """Environments in use, and what came out so far.

    Attributes:
        wide: Whether to draw from everything.
        slots: Environments; None where there is none.
        digest: Hash of all that came out.
        folder: Where files are written.
        notes: Reports for the operation that runs, such as the name of the face.
    """

    def __init__(self, wide: bool, folder: Any) -> None:
        self.wide, self.folder = wide, folder
        self.slots: list[Face | None] = [None] * SLOTS
        self.digest = Digest()
        self.notes = ""

    def close(self) -> None:
        """Close all environments."""
        for face in self.slots:
            if face is not None:
                face.env.close()
        self.slots = [None] * SLOTS


class Turn(NamedTuple):
    """One operation at work.

    Attributes:
        sim: The environments.
        slot: Number of the environment that it is about.
        rng: Random numbers.
    """

    sim: Sim
    slot: int
    rng: np.random.Generator

    @property
    def face(self) -> Face:
        """The environment that it is about."""
        face = self.sim.slots[self.slot]
        assert face is not None
        return face

    def drop(self) -> str:
        """Close the environment and forget it."""
        self.face.env.close()
        self.sim.slots[self.slot] = None
        return "closed"


OPERATIONS: dict[str, tuple[float, Callable[[Turn], str]]] = {}
"""Weight and function of each operation by name; a function tells in a word how it went"""


def operation(weight: float) -> Callable[[Callable[[Turn], str]], Callable[[Turn], str]]:
    """Make a decorator that enters an operation with a weight."""

    def decorated(function: Callable[[Turn], str]) -> Callable[[Turn], str]:
        OPERATIONS[function.__name__] = (weight, function)
        return function

    return decorated


def unexpected(told: list[warnings.WarningMessage]) -> list[str]:
    """List the warnings that nothing documents."""
    texts = [str(one.message) for one in told if not _is_others(one)]
    return [text for text in texts if not any(known in text for known in WARNINGS)]


def _is_others(one: warnings.WarningMessage) -> bool:
    """Tell whether a wrapper of Gymnasium warns of what the simulation does to it on purpose."""
    return "gymnasium" in one.filename
