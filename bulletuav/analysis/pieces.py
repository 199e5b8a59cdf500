"""Pieces of an evaluation or a dataset, which are flown separately, such as in a Slurm array."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

from bulletuav.errors import shown

Item = TypeVar("Item")
PIECES = "pieces"
"""Subfolder of an evaluation that holds a folder for each piece"""
FORM = re.compile(r"([0-9]+)/([0-9]+)")
FOLDER = re.compile(r"([0-9]+)-of-([0-9]+)")


class WorkPiece(NamedTuple):
    """One of several pieces of the same work, such as one job of a Slurm array.

    Attributes:
        number: Number of the piece, from 1 to `of`.
        of: Number of pieces.
        first: Number of batches of earlier evaluations in the same work, such as a comparison.
    """

    number: int
    of: int
    first: int = 0

    def select(self, batches: Sequence[Item]) -> list[Item]:
        """Select every `of`-th batch, so that all pieces take about the same time."""
        return [
            batch
            for k, batch in enumerate(batches)
            if (self.first + k) % self.of == self.number - 1
        ]

    def folder(self, out: Path) -> Path:
        """Return the folder of the piece within that of its evaluation."""
        return out / PIECES / f"{self.number}-of-{self.of}"


def parse_piece(source: "WorkPiece | str") -> WorkPiece:
    """Parse a piece, such as "2/8".

    Raises:
        ValueError: If the text has another form.
    """
    if isinstance(source, WorkPiece):
        return source
    found = FORM.fullmatch(source) if isinstance(source, str) else None
    piece = WorkPiece(*map(int, found.groups())) if found else WorkPiece(0, 0)
    if not 1 <= piece.number <= piece.of:
        raise ValueError(
            f"piece is {shown(source)}: K/N is needed, the K-th of N pieces, such as '2/8'"
        )
    return piece


def piece_folders(out: Path) -> dict[WorkPiece, Path]:
    """Find the folders of an evaluation's pieces, in the order of the pieces."""
    found = {}
    for path in sorted((out / PIECES).glob("*-of-*")):
        if match := FOLDER.fullmatch(path.name):
            found[WorkPiece(*map(int, match.groups()))] = path
    return dict(sorted(found.items()))
