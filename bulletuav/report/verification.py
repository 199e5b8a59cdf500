"""Verification of results: seals of files, and bitwise repetition of flights from their seeds."""

import contextlib
import itertools
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple

from bulletuav.analysis.airspace_recorder import fly_calls
from bulletuav.analysis.conditions import Conditions
from bulletuav.analysis.evaluation import RUN, Evaluation, evaluate
from bulletuav.analysis.recording import ARRAYS_FILE, CALLS_FILE, fly_episode, load
from bulletuav.analysis.seals import (
    SEAL,
    compute_seal,
    hash_arrays,
    hash_bytes,
    hash_files,
    parse_call,
)
from bulletuav.analysis.transitions import DATASET
from bulletuav.dynamics import DYNAMICS
from bulletuav.engine.calls import require_bullet
from bulletuav.envs.aviary import Aviary
from bulletuav.errors import naming, read_file, shown
from bulletuav.parsing import read_json
from bulletuav.policies import find_policy
from bulletuav.report.leaderboard import LEADERBOARD, format_leaderboard, write_csv

SUMMARY = "summary.json"
"""File with the summary of an evaluation"""
ROW = "row.json"
"""File of a row of the leaderboard of algorithms: a policy, and its evaluation"""
ROW_POLICY = "{row}"
"""Placeholder in the call for the row's folder, which holds the trained policy"""
ReportProgress = Callable[[float], None]
"""Function that receives the amount of work done so far"""
ShowProgress = Callable[[str, int, str], AbstractContextManager[ReportProgress]]
"""Context manager that shows the progress of an activity, up to a total, in a unit"""


OF_EVALUATION = {"call": object, "episodes": int, "hash": str}
OF_CASE = {**OF_EVALUATION, "options": dict, "task": str, "policy": str}
NEEDED: Mapping[str, Mapping[str, type]] = {
    LEADERBOARD: {"cases": list, "against": object},
    ARRAYS_FILE: {"call": object, "hash": str},
    SUMMARY: {**OF_EVALUATION, "estimates": dict},
    ROW: {**OF_EVALUATION, "estimates": dict},
    DATASET: {"call": object, "episodes": int},
}
"""Entries of sealed files that are needed to repeat the flights, by the file that identifies the
kind
"""


@contextlib.contextmanager
def _show_nothing(activity: str, total: int, unit: str) -> Iterator[ReportProgress]:
    """Show no progress."""
    yield lambda done: None


class Check(NamedTuple):
    """One comparison.

    Attributes:
        what: Name of the compared object.
        expected: Hash in the file.
        found: Hash of the object itself.
    """

    what: str
    expected: str
    found: str

    @property
    def same(self) -> bool:
        """Whether both hashes agree."""
        return self.expected == self.found


class Verifier(NamedTuple):
    """Settings of a verification.

    Attributes:
        workers: Number of processes that fly evaluations.
        trust: Whether names in the files may refer to code.
        show: Context manager that shows the progress of flights.
    """

    workers: int = 1
    trust: bool = False
    show: ShowProgress = _show_nothing

    def verify(self, path: Path) -> list[Check]:
        """Compare files with their seals, and their results with repeated flights.

        Args:
            path: The folder of a recording, an evaluation, a leaderboard, a row of the leaderboard
                of algorithms or a dataset, or a file in it.

        Returns:
            The comparisons: files first, then flights.

        Raises:
            FileNotFoundError: If the path does not exist.
            ValueError: If the files are none of these, cannot be read, or cannot be flown again.
            ImportError: If the extra `dataset`, which datasets need, is not installed; or PyBullet,
                if the flights used it.
        """
        if not path.exists():
            raise FileNotFoundError(f"there is no {path}: pass a file or a folder of results")
        folder = path if path.is_dir() else path.parent
        for name, sealed, fly_again in (
            (LEADERBOARD, LEADERBOARD, self._leaderboard),
            (ARRAYS_FILE, RUN, self._recording),
            (SUMMARY, SUMMARY, self._evaluation),
            (ROW, ROW, self._evaluation),
            (DATASET, DATASET, self._dataset),
        ):
            if (folder / name).exists():
                about, checks = read_sealed(folder / sealed)
                # If files were changed, flights are not repeated.
                if all(check.same for check in checks):
                    _require(folder / sealed, about, NEEDED[name])
                    with naming(folder / sealed):
                        checks += fly_again(folder, about)
                return checks
        raise ValueError(
            f"{folder} holds no recording ({ARRAYS_FILE}), evaluation ({SUMMARY}), leaderboard "
            f"({LEADERBOARD}), row of one ({ROW}) or dataset ({DATASET}): pass the folder of one"
        )

    def _recording(self, folder: Path, about: dict[str, Any]) -> list[Check]:
        """Repeat the flight of a recording that `bulletuav fly` wrote."""
        recording = load(folder)
        if CALLS_FILE in about.get("files", {}):
            most, done = len(recording.reward), itertools.count(1)
            with self.show("flying", most, "steps") as report:
                calls = folder / CALLS_FILE
                flown = fly_calls(calls, most, self.trust, lambda: report(next(done)))
            return [Check("flight", about["hash"], flown.hash(like=recording))]
        call = self._parse_call(about, folder / RUN)
        if lacking := {"policy", "seed", "num_worlds"} - set(call):
            raise ValueError(f"{folder / RUN} is damaged: its call lacks {min(lacking)}")
        aviary = Aviary(call["task"], call["num_worlds"], **call["options"])
        policy = find_policy(call["policy"], call["task"], self.trust)(aviary)
        done = itertools.count(1)
        with self.show("flying", len(recording.reward), "decisions") as report:
            flown = fly_episode(aviary, policy, call["seed"], lambda: report(next(done)))
        aviary.close()
        return [Check("flight", about["hash"], flown.hash(like=recording))]

    def _evaluation(self, folder: Path, about: dict[str, Any]) -> list[Check]:
        """Repeat an evaluation of `bulletuav evaluate`, or of the policy in the folder."""
        (result,) = self._fly([about], folder)
        expected, found = (
            hash_bytes([json.dumps(one, sort_keys=True).encode()])
            for one in (about["estimates"], result.figures())
        )
        flight = Check("episodes", about["hash"], result.hash)
        return [flight, Check("estimates", expected, found)]

    def _leaderboard(self, folder: Path, about: dict[str, Any]) -> list[Check]:
        """Repeat each row of a leaderboard of `bulletuav compare`, and compare the new tables."""
        results, checks = self._fly(about["cases"], folder), []
        for case, result in zip(about["cases"], results, strict=True):
            what = f"{Conditions.of(case)}: {case['policy']}"
            checks.append(Check(what, case["hash"], result.hash))
        # The tables are recomputed from the repeated flights.
        with tempfile.TemporaryDirectory() as place:
            table = Path(place) / "leaderboard.csv"
            write_csv(results, table)
            texts = {"leaderboard.csv": table.read_text(encoding="utf-8")}
        texts["leaderboard.md"] = format_leaderboard(results, about["against"])
        for name, text in texts.items():
            expected = hash_bytes([read_file(folder / name).encode()])
            checks.append(Check(name, expected, hash_bytes([text.encode()])))
        return checks

    def _dataset(self, folder: Path, about: dict[str, Any]) -> list[Check]:
        """Repeat a dataset of `bulletuav dataset`, and compare rows of tables and final states."""
        from bulletuav.analysis.dataset import collect  # which needs an extra

        call = self._parse_call(about, folder / DATASET)
        options = call.pop("options")
        with (
            self._advance(about["episodes"]) as advance,
            tempfile.TemporaryDirectory() as place,
        ):
            # Piece 1/1 writes the tables only.
            again = collect(
                **call,
                episodes=about["episodes"],
                workers=self.workers,
                out=place,
                progress=advance,
                trust=self.trust,
                piece="1/1",
                **options,
            )
            return [check for path in again for check in _table_checks(folder, path)]

    def _fly(self, cases: list[dict[str, Any]], folder: Path) -> list[Evaluation]:
        """Repeat evaluations."""
        calls = [self._parse_call(case, folder) for case in cases]
        for call in calls:
            if isinstance(call.get("policy"), str):
                call["policy"] = call["policy"].replace(ROW_POLICY, str(folder))
        with self._advance(sum(case["episodes"] for case in cases)) as advance:
            how: dict[str, Any] = {"workers": self.workers, "trust": self.trust}
            return [
                evaluate(**call, episodes=case["episodes"], progress=advance, **how, **options)
                for case, call in zip(cases, calls, strict=True)
                for options in (call.pop("options"),)
            ]

    def _parse_call(self, about: Mapping[str, Any], path: Path) -> dict[str, Any]:
        """Parse the call of flights, and add the dynamics that flew them.

        If a call names no dynamics, the default depends on whether PyBullet is installed.

        Args:
            about: Description of the flights.
            path: Its file or folder, for messages.

        Raises:
            ImportError: If the flights used PyBullet, which is missing.
        """
        call = parse_call(about["call"], self.trust, path)
        flown, options = about.get("options"), call["options"]
        if isinstance(flown, dict) and flown.get("dynamics") in DYNAMICS:
            options.setdefault("dynamics", flown["dynamics"])
        if options.get("dynamics") == "bullet":
            require_bullet(f"{path}, which was flown with dynamics 'bullet'")
        return call

    @contextlib.contextmanager
    def _advance(self, episodes: int) -> Iterator[Callable[[int], None]]:
        """Show the progress of flights; yields a callback of the number of new episodes."""
        done = 0
        with self.show("flying", episodes, "episodes") as report:

            def advance(more: int) -> None:
                nonlocal done
                done += more
                report(done)

            yield advance


def _table_checks(folder: Path, again: Path) -> Iterator[Check]:
    """Compare a table of a dataset with the repeated one."""
    from bulletuav.adapters.parquet import read_about, read_table  # which needs an extra

    original = folder / again.parent.name / again.name
    ends = [hash_bytes([json.dumps(read_about(path)).encode()]) for path in (original, again)]
    yield Check(f"{again.stem}: states", *ends)
    yield Check(
        f"{again.stem}: rows", *(hash_arrays(read_table(path)) for path in (original, again))
    )


def _require(path: Path, about: dict[str, Any], needed: Mapping[str, type]) -> None:
    """Raise ValueError unless a file holds the entries that are needed to repeat a flight."""
    for name, kind in needed.items():
        if name not in about or not isinstance(about[name], kind):
            raise ValueError(
                f"{path} is damaged: its {name} is {shown(about.get(name))}; fly it again"
            )
    for case in about["cases"] if "cases" in needed else ():
        if not isinstance(case, dict):
            raise ValueError(f"{path} is damaged: one of its cases is {shown(case)}; fly it again")
        _require(path, case, OF_CASE)
        _require(path, case["options"], {"difficulty": str, "dynamics": str})


def read_sealed(path: Path) -> tuple[dict[str, Any], list[Check]]:
    """Read a sealed file, and compare its seal and the hashes of its files.

    Returns:
        The contents, and the comparisons.

    Raises:
        ValueError: If the file is not JSON, or has no seal.
    """
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get(SEAL), str):
        raise ValueError(
            f"{path} has no seal: it is damaged, or from an earlier bulletuav; fly it again"
        )
    checks = [Check(path.name, content[SEAL], compute_seal(content))]
    if checks[0].same:
        files = content.get("files", {})
        if not isinstance(files, dict):
            raise ValueError(f"{path} is damaged: its files are {shown(files)}; fly it again")
        found = hash_files(path.parent, files)
        checks += [Check(name, one, found.get(name, "missing")) for name, one in files.items()]
    return content, checks
