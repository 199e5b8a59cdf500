"""Files of evaluations and comparisons, and their making from pieces."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bulletuav.analysis.episodes import BATCH
from bulletuav.analysis.evaluation import EPISODES, RUN, Evaluation, evaluate
from bulletuav.analysis.pieces import PIECES, piece_folders
from bulletuav.analysis.results_folder import read_rows
from bulletuav.analysis.seals import parse_call
from bulletuav.errors import as_int, naming, read_file, reason_of, shown
from bulletuav.files import replace_file
from bulletuav.parsing import read_json
from bulletuav.report.charts import plot_evaluation, plot_leaderboard
from bulletuav.report.leaderboard import LEADERBOARD, format_leaderboard, write_csv, write_json

CASES = "cases.json"
"""File that tells the evaluations of a comparison whose pieces are flown"""


def write_evaluation(result: Evaluation, folder: Path) -> list[Path]:
    """Add summary and picture to the run and the episodes of an evaluation.

    Args:
        result: The evaluation.
        folder: The folder that it was flown in.

    Returns:
        The paths of all its files.
    """
    picture = folder / "summary.png"
    plot_evaluation(result, picture)
    return [folder / RUN, folder / EPISODES, result.save(folder), picture]


def write_comparison(results: Sequence[Evaluation], against: str | None, out: Path) -> list[Path]:
    """Write the same leaderboard as markdown, csv and picture, and what verifies it.

    Args:
        results: Its evaluations.
        against: As of `leaderboard.format_leaderboard`.
        out: Folder of the files.

    Returns:
        Their paths, that of the markdown first.
    """
    names = ("leaderboard.md", "leaderboard.csv", "leaderboard.png", LEADERBOARD)
    files = [out / name for name in names]
    replace_file(files[0], format_leaderboard(results, against))
    write_csv(results, files[1])
    plot_leaderboard(results, files[2])
    write_json(results, against, files[3])
    return files


def write_cases(folders: Sequence[Path], against: str | None, out: Path) -> None:
    """Tell what the pieces of a comparison are of, for `merge`.

    Args:
        folders: Those of its evaluations, in their order, below `out`.
        against: As of `leaderboard.format_leaderboard`.
        out: Folder of the comparison.

    Raises:
        ValueError: Pieces of another comparison are there.
    """
    path = out / PIECES / CASES
    told = {"runs": [folder.name for folder in folders], "against": against}
    text = json.dumps(told, indent=2) + "\n"
    if path.exists() and read_file(path) != text:
        raise ValueError(f"{out} holds pieces of another comparison: choose another folder")
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, text)


def merge(out: Path, trust: bool = False) -> list[Path]:
    """Make the files of an evaluation, a comparison or a dataset from its pieces.

    They are the same to the last byte as those of one process that flew all.

    Args:
        out: The folder that the pieces were written to.
        trust: Whether names of code in the files are trusted.

    Returns:
        Paths of the files.

    Raises:
        FileNotFoundError: There are no pieces.
        ValueError: Some are missing or not finished, or of other code than this.
    """
    # The folder tells of what it holds pieces
    if (out / "parquet").is_dir():
        return _merged_dataset(out, trust)
    cases = out / PIECES / CASES
    if not cases.exists():
        return write_evaluation(_merged(out, trust), out)
    # A comparison is several evaluations, each with pieces
    try:
        told = read_json(cases)
        folders = [out / "runs" / str(name) for name in told["runs"]]
        against = told["against"]
        if not isinstance(told["runs"], list) or not folders:
            raise ValueError(f"its runs are {shown(told['runs'])}")
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{cases} is damaged ({reason_of(error)}): fly a piece again") from None
    results = []
    for folder in folders:
        results.append(_merged(folder, trust))
        results[-1].save(folder)
    return write_comparison(results, against, out)


def _merged(out: Path, trust: bool) -> Evaluation:
    """Join the pieces of an evaluation, all of which must be there."""
    # A piece counts from when its description is there
    pieces = {piece: path for piece, path in piece_folders(out).items() if (path / RUN).exists()}
    if not pieces:
        raise FileNotFoundError(
            f"{out} holds no pieces: fly them with --piece 1/N to N/N and --out {out}"
        )
    # All episodes must have been flown by one of the pieces
    about = _about(next(iter(pieces.values())) / RUN)
    flown = {episode for path in pieces.values() for episode in read_rows(path)}
    missing = sorted(set(range(about["episodes"])) - flown)
    if missing:
        of = next(iter(pieces)).of
        there = ", ".join(str(piece.number) for piece in pieces)
        raise ValueError(
            f"{out} lacks {len(missing)} of {about['episodes']} episodes, the first is "
            f"{missing[0]}: pieces {there} of {of} were begun; fly the others, and again those "
            f"that were interrupted, {BATCH} episodes at a time are kept"
        )
    # Nothing is flown again: episodes that are there are only read
    call = parse_call(about["call"], trust, out)
    options = call.pop("options")
    with naming(out / RUN):
        return evaluate(**call, episodes=about["episodes"], trust=trust, out=out, **options)


def _merged_dataset(out: Path, trust: bool) -> list[Path]:
    """Finish a dataset, all tables of which must be there."""
    from bulletuav.analysis.dataset import collect, missing_batches  # which need an extra

    about = _about(out / RUN)
    if missing := missing_batches(out, about["episodes"]):
        raise ValueError(
            f"{out} lacks {len(missing)} tables, the first is that of episode {missing[0].start}: "
            f"fly the pieces that are missing"
        )
    call = parse_call(about["call"], trust, out)
    options = call.pop("options")
    with naming(out / RUN):
        return collect(**call, episodes=about["episodes"], trust=trust, out=out, **options)


def _about(path: Path) -> dict[str, Any]:
    """Read what a piece is of."""
    try:
        about: dict[str, Any] = read_json(path)
        as_int("episodes", about["episodes"], 1)
        about["call"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is damaged ({reason_of(error)}): fly that piece again") from None
    return about
