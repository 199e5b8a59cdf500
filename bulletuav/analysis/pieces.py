"""Pieces of long work: which batches of episodes fly where, and how what they gave is told."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

from bulletuav.errors import shown

Item = TypeVar("Item")
PIECES = "pieces"
"""Folder, in that of an evaluation, with a folder for each of its pieces"""
FORM = re.compile(r"([0-9]+)/([0-9]+)")
FOLDER = re.compile(r"([0-9]+)-of-([0-9]+)")


class WorkPiece(NamedTuple):
    """One of several pieces of the same work, such as one job of a Slurm array.

    Attributes:
        number: From 1 to `of`.
        of: How many pieces there are.
        first: How many batches come before those of this evaluation, in work that has several.
    """

    number: int
    of: int
    first: int = 0

    def share(self, batches: Sequence[Item]) -> list[Item]:
        """Take every `of`-th batch, so that pieces take equally long."""
        return [
            batch
            for k, batch in enumerate(batches)
            if (self.first + k) % self.of == self.number - 1
        ]

    def folder(self, out: Path) -> Path:
        """Tell the folder of the piece within that of its evaluation."""
        return out / PIECES / f"{self.number}-of-{self.of}"


def parse_piece(source: "WorkPiece | str") -> WorkPiece:
    """Read a piece, such as "2/8".

    Raises:
        ValueError: It is none.
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
    """Find the pieces of an evaluation that were begun, and their folders, in their order."""
    found = {}
    for path in sorted((out / PIECES).glob("*-of-*")):
        if match := FOLDER.fullmatch(path.name):
            found[WorkPiece(*map(int, match.groups()))] = path
    return dict(sorted(found.items()))
