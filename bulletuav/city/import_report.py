"""What an importer of cities mended, guessed, left out and measured, as data."""

import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

FIRST_SHOWN = 3
"""Notes of a kind that a listing names"""


class Kind(NamedTuple):
    """What notes of a kind are about.

    Attributes:
        meaning: In words, in the plural.
        mends: Whether the city is not quite what the file tells: the library warns then.
        refused: Whether `strict=True` refuses it.
    """

    meaning: str
    mends: bool
    refused: bool


KINDS = {
    "skipped": Kind("without a shape to build, left out", True, True),
    "repaired": Kind("rings that cross or touch themselves, repaired", True, True),
    "unreadable": Kind("heights that cannot be, taken as not told", True, True),
    "guessed": Kind("heights not told, guessed", True, True),
    "levels": Kind("heights guessed from the number of levels", True, True),
    "list": Kind("lists of heights, of which the highest counts", True, True),
    "underside": Kind("undersides that cannot be, put on the ground", True, True),
    "hull": Kind("meshes that are not closed, filled to their convex hulls", True, True),
    "uncovered": Kind("outlines left out whose parts cover less than 90 %", True, True),
    "unit": Kind("heights with a unit or a decimal comma", False, True),
    "default": Kind("heights not told, set to the default height", False, False),
    "outline": Kind("outlines left out, as their parts count", False, False),
    "above": Kind("parts that begin above the ground", False, False),
    "moved": Kind("buildings put on the ground", False, False),
}
"""Kinds of notes by their names"""


class MendedWarning(UserWarning):
    """Warning that a city is not quite what its file tells."""


class Note(NamedTuple):
    """What was done with one feature or object of a file.

    Attributes:
        kind: A name among `KINDS`.
        where: Name of the feature or object.
        what: What was found there.
    """

    kind: str
    where: str
    what: str


class Split(NamedTuple):
    """How well convex pieces stand for a mesh that is not convex.

    Attributes:
        where: Name of the object.
        pieces: Number of pieces.
        mesh_volume: Volume of the mesh, m^3.
        pieces_volume: Sum of the volumes of the pieces, m^3.
        beyond: Greatest distance of samples of the pieces' surfaces from the mesh, outside of it,
            m.
    """

    where: str
    pieces: int
    mesh_volume: float
    pieces_volume: float
    beyond: float


@dataclass(frozen=True)
class ImportReport:
    """What an importer did to make a city of a file.

    Attributes:
        path: The file.
        notes: What was mended, guessed, left out or moved, in the order of the file.
        splits: Meshes that were split into convex pieces, with the error of each.
    """

    path: Path
    notes: tuple[Note, ...] = ()
    splits: tuple[Split, ...] = ()

    @property
    def counts(self) -> dict[str, int]:
        """Number of notes by their kind, in the order of `KINDS`."""
        found = Counter(note.kind for note in self.notes)
        return {kind: found[kind] for kind in KINDS if found[kind]}

    def first(self, kind: str) -> list[str]:
        """List the places of the first notes of a kind."""
        return [note.where for note in self.notes if note.kind == kind][:FIRST_SHOWN]

    def summary(self) -> str:
        """Tell in one line what was mended; empty where nothing was."""
        mended = [
            f"{count} {KINDS[kind].meaning} ({self.first(kind)[0]}{', ...' * (count > 1)})"
            for kind, count in self.counts.items()
            if KINDS[kind].mends
        ]
        return "; ".join(mended)


class Notebook:
    """Notes of an importer at work, which refuses what is odd where that is asked for.

    Attributes:
        path: The file.
        strict: Whether what is odd is refused.
        notes: So far.
        splits: So far.
    """

    def __init__(self, path: Path, strict: bool) -> None:
        """Begin without notes.

        Args:
            path: The file.
            strict: Whether what is odd is refused.
        """
        self.path = path
        self.strict = strict
        self.notes: list[Note] = []
        self.splits: list[Split] = []

    def add(self, kind: str, where: str, what: str, needed: str = "") -> None:
        """Note what was found.

        Args:
            kind: A name among `KINDS`.
            where: Name of the feature or object.
            what: What was found there, for people.
            needed: What is needed in its place, told where it is refused.

        Raises:
            ValueError: It is refused.
        """
        if self.strict and KINDS[kind].refused:
            told = f"{what}: {needed}" if needed else what
            raise ValueError(f"{self.path}, {where}: {told}")
        self.notes.append(Note(kind, where, what))

    def report(self) -> ImportReport:
        """Make the report of all notes so far."""
        return ImportReport(self.path, tuple(self.notes), tuple(self.splits))

    def warn(self) -> ImportReport:
        """Make the report, and warn in one line where something was mended."""
        report = self.report()
        if mended := report.summary():
            warnings.warn(
                f"{self.path} is mended: {mended}; city.report tells more, strict=True refuses it",
                MendedWarning,
                stacklevel=4,
            )
        return report
