"""Report of a city import: repairs, estimates, skipped features and errors, as data."""

import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

FIRST_SHOWN = 3
"""Number of notes of a kind that a listing names"""


class NoteKind(NamedTuple):
    """Kind of import note.

    Attributes:
        meaning: Description in the plural.
        is_repair: Whether the city differs from the file, so that a warning is raised.
        is_error: Whether `strict=True` raises an error.
    """

    meaning: str
    is_repair: bool
    is_error: bool


KINDS = {
    "skipped": NoteKind("without a usable shape, skipped", True, True),
    "repaired": NoteKind("self-intersecting rings, repaired", True, True),
    "unreadable": NoteKind("invalid heights, ignored", True, True),
    "guessed": NoteKind("missing heights, estimated", True, True),
    "levels": NoteKind("heights estimated from the number of levels", True, True),
    "list": NoteKind("lists of heights, maximum used", True, True),
    "underside": NoteKind("invalid undersides, put on the ground", True, True),
    "hull": NoteKind("meshes that are not closed, replaced by their convex hulls", True, True),
    "uncovered": NoteKind("outlines replaced by parts that cover less than 90 %", True, True),
    "unit": NoteKind("heights with a unit or a decimal comma", False, True),
    "default": NoteKind("missing heights, set to the default height", False, False),
    "other": NoteKind("no buildings above the ground, left out", False, False),
    "outline": NoteKind("outlines replaced by their parts", False, False),
    "above": NoteKind("parts above the ground", False, False),
    "moved": NoteKind("buildings put on the ground", False, False),
}
"""Kinds of notes by name"""


class MendedWarning(UserWarning):
    """Warning that an imported city differs from its file."""


class Note(NamedTuple):
    """Note on one feature or object of a file.

    Attributes:
        kind: A key of `KINDS`.
        where: Name of the feature or object.
        what: Description of the finding.
    """

    kind: str
    where: str
    what: str


class Split(NamedTuple):
    """Accuracy of the convex decomposition of a mesh.

    Attributes:
        where: Name of the object.
        pieces: Number of pieces.
        mesh_volume: Volume of the mesh, m^3.
        pieces_volume: Sum of the volumes of the pieces, m^3.
        beyond: Maximum distance of surface samples of the pieces outside the mesh, m.
    """

    where: str
    pieces: int
    mesh_volume: float
    pieces_volume: float
    beyond: float


@dataclass(frozen=True)
class ImportReport:
    """Report of the import of a city.

    Attributes:
        path: The file.
        notes: Repairs, estimates, skipped and moved features, in the order of the file.
        splits: Decomposed meshes, with the errors of the decompositions.
    """

    path: Path
    notes: tuple[Note, ...] = ()
    splits: tuple[Split, ...] = ()

    @property
    def counts(self) -> dict[str, int]:
        """Number of notes by kind, in the order of `KINDS`."""
        found = Counter(note.kind for note in self.notes)
        return {kind: found[kind] for kind in KINDS if found[kind]}

    def first(self, kind: str) -> list[str]:
        """List the features of the first notes of a kind."""
        return [note.where for note in self.notes if note.kind == kind][:FIRST_SHOWN]

    @property
    def others(self) -> dict[str, int]:
        """Number of features that are no buildings, by the key of their tag, largest first."""
        kinds = Counter(note.what.partition("=")[0] for note in self.notes if note.kind == "other")
        return dict(kinds.most_common())

    def summary(self) -> str:
        """Return a one-line summary of all repairs; empty if there are none."""
        mended = [
            f"{count} {KINDS[kind].meaning} ({self.first(kind)[0]}{', ...' * (count > 1)})"
            for kind, count in self.counts.items()
            if KINDS[kind].is_repair
        ]
        return "; ".join(mended)


class Notebook:
    """Collector of import notes, which raises errors in strict mode.

    Attributes:
        path: The file.
        strict: Whether deviations raise an error.
        notes: Notes so far.
        splits: Decompositions so far.
    """

    def __init__(self, path: Path, strict: bool) -> None:
        """Initialise without notes.

        Args:
            path: The file.
            strict: Whether deviations raise an error.
        """
        self.path = path
        self.strict = strict
        self.notes: list[Note] = []
        self.splits: list[Split] = []

    def add(self, kind: str, where: str, what: str, needed: str = "") -> None:
        """Add a note.

        Args:
            kind: A key of `KINDS`.
            where: Name of the feature or object.
            what: Description of the finding.
            needed: Required format, included in the error of strict mode.

        Raises:
            ValueError: If strict mode forbids this kind of note.
        """
        if self.strict and KINDS[kind].is_error:
            message = f"{what}: {needed}" if needed else what
            raise ValueError(f"{self.path}, {where}: {message}")
        self.notes.append(Note(kind, where, what))

    def report(self) -> ImportReport:
        """Return the report of all notes so far."""
        return ImportReport(self.path, tuple(self.notes), tuple(self.splits))

    def warn(self) -> ImportReport:
        """Return the report, and raise a one-line warning if there are repairs."""
        report = self.report()
        if mended := report.summary():
            warnings.warn(
                f"{self.path} was repaired: {mended}; see city.report, "
                f"or set strict=True to raise an error",
                MendedWarning,
                stacklevel=4,
            )
        return report
