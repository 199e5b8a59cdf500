"""Files of evaluations and comparisons, also merged from pieces."""

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
"""File that lists the evaluations of a comparison that is flown in pieces"""


def write_evaluation(result: Evaluation, folder: Path) -> list[Path]:
    """Write summary and picture of an evaluation, next to its run and episodes.

    Args:
        result: The evaluation.
        folder: Folder of the evaluation.

    Returns:
        The paths of all its files.
    """
    picture = folder / "summary.png"
    plot_evaluation(result, picture)
    return [folder / RUN, folder / EPISODES, result.save(folder), picture]


def write_comparison(results: Sequence[Evaluation], against: str | None, out: Path) -> list[Path]:
    """Write a leaderboard as Markdown, CSV, picture and JSON for verification.

    Args:
        results: Its evaluations.
        against: Reference policy, as for `leaderboard.format_leaderboard`.
        out: Folder of the files.

    Returns:
        Their paths, that of the Markdown file first.
    """
    names = ("leaderboard.md", "leaderboard.csv", "leaderboard.png", LEADERBOARD)
    files = [out / name for name in names]
    replace_file(files[0], format_leaderboard(results, against))
    write_csv(results, files[1])
    plot_leaderboard(results, files[2])
    write_json(results, against, files[3])
    return files


def write_cases(folders: Sequence[Path], against: str | None, out: Path) -> None:
    """Write the list of a comparison's evaluations, for `merge`.

    Args:
        folders: Folders of its evaluations, in order, below `out`.
        against: Reference policy, as for `leaderboard.format_leaderboard`.
        out: Folder of the comparison.

    Raises:
        ValueError: If the folder holds pieces of another comparison.
    """
    path = out / PIECES / CASES
    content = {"runs": [folder.name for folder in folders], "against": against}
    text = json.dumps(content, indent=2) + "\n"
    if path.exists() and read_file(path) != text:
        raise ValueError(f"{out} holds pieces of another comparison: choose another folder")
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, text)


def merge(out: Path, trust: bool = False) -> list[Path]:
    """Merge the pieces of an evaluation, a comparison or a dataset, and write its files.

    The files are identical to the last byte to those of a single process.

    Args:
        out: The folder that the pieces were written to.
        trust: Whether names of code in the files are trusted.

    Returns:
        Paths of the files.

    Raises:
        FileNotFoundError: If there are no pieces.
        ValueError: If pieces are missing, incomplete, or from other code than this.
    """
    # The contents of the folder determine the kind of result
    if (out / "parquet").is_dir():
        return _merged_dataset(out, trust)
    cases = out / PIECES / CASES
    if not cases.exists():
        return write_evaluation(_merged(out, trust), out)
    # A comparison consists of several evaluations, each in pieces
    try:
        content = read_json(cases)
        folders = [out / "runs" / str(name) for name in content["runs"]]
        against = content["against"]
        if not isinstance(content["runs"], list) or not folders:
            raise ValueError(f"its runs are {shown(content['runs'])}")
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{cases} is damaged ({reason_of(error)}): fly a piece again") from None
    results = []
    for folder in folders:
        results.append(_merged(folder, trust))
        results[-1].save(folder)
    return write_comparison(results, against, out)


def _merged(out: Path, trust: bool) -> Evaluation:
    """Merge the pieces of an evaluation, which must be complete."""
    # A piece exists once its description is written
    pieces = {piece: path for piece, path in piece_folders(out).items() if (path / RUN).exists()}
    if not pieces:
        raise FileNotFoundError(
            f"{out} holds no pieces: fly them with --piece 1/N to N/N and --out {out}"
        )
    # Every episode must be in one of the pieces
    about = _about(next(iter(pieces.values())) / RUN)
    flown = {episode for path in pieces.values() for episode in read_rows(path)}
    missing = sorted(set(range(about["episodes"])) - flown)
    if missing:
        of = next(iter(pieces)).of
        there = ", ".join(str(piece.number) for piece in pieces)
        raise ValueError(
            f"{out} lacks {len(missing)} of {about['episodes']} episodes, the first is "
            f"{missing[0]}: pieces {there} of {of} were started; fly the others, and repeat "
            f"interrupted ones, which keep every finished batch of {BATCH} episodes"
        )
    # No episode is flown again: all are read from the pieces
    call = parse_call(about["call"], trust, out)
    options = call.pop("options")
    with naming(out / RUN):
        return evaluate(**call, episodes=about["episodes"], trust=trust, out=out, **options)


def _merged_dataset(out: Path, trust: bool) -> list[Path]:
    """Write the index of a dataset, whose tables must be complete."""
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
    """Read the description of a piece."""
    try:
        about: dict[str, Any] = read_json(path)
        as_int("episodes", about["episodes"], 1)
        about["call"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is damaged ({reason_of(error)}): fly that piece again") from None
    return about
