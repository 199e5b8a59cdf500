"""`bulletuav verify`: what was flown is flown again, and a changed byte is found."""

import contextlib
import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import bulletuav
from bulletuav.analysis.recording import fly_episode, load, save
from bulletuav.analysis.seals import (
    add_seal,
    format_call,
    hash_arrays,
    hash_files,
    hash_rows,
    parse_call,
)
from bulletuav.cli import main
from bulletuav.policies import find_policy
from bulletuav.report.verification import Verifier
from bulletuav.tasks import find_task

FLIGHT = ["crossing", "--drones", "2", "--dynamics", "point_mass", "--horizon", "15"]
CASE = ["--policy", "straight", "--set", "lane_spacing=15.0"]
TABLE = "parquet/episodes-000000.parquet"


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A recording, an evaluation, a leaderboard and a dataset, each in its folder."""
    place = tmp_path_factory.mktemp("results")
    main(["fly", *FLIGHT, *CASE, "--animation", "none", "--out", str(place / "flight")])
    few = ["--episodes", "3", "--seed", "5"]
    main(["evaluate", *FLIGHT, *CASE, *few, "--out", str(place / "evaluation")])
    main(["dataset", *FLIGHT, *CASE, *few, "--out", str(place / "dataset")])
    tasks = ["--tasks", "crossing", "--policies", "straight,orca", "--against", "straight"]
    main(["compare", *tasks, *FLIGHT[1:], *few, "--out", str(place / "leaderboard")])
    return place


def verified(path):
    """Whether the command finds all the same; errors of reading count as found."""
    with contextlib.suppress(SystemExit):
        main(["verify", str(path)])
        return True
    return False


@pytest.mark.parametrize(
    ("folder", "counts", "files"),
    [
        ("flight", 4, ("run.json", "trajectory.npz", "trajectory.csv", "flight")),
        ("evaluation", 5, ("summary.json", "run.json", "episodes.csv", "episodes", "estimates")),
        ("leaderboard", 5, ("leaderboard.json", "leaderboard.csv", "leaderboard.md")),
        ("dataset", 4, ("dataset.json", TABLE, "episodes-000000: states", "episodes-000000: rows")),
    ],
)
def test_what_was_flown_is_flown_again(folders, folder, counts, files, capsys):
    checks = Verifier().verify(folders / folder)
    assert len(checks) == counts
    assert {check.what for check in checks} >= set(files)
    assert all(check.same for check in checks)
    main(["verify", str(folders / folder / files[0])])
    assert "NO" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("folder", "file"),
    [
        ("flight", "run.json"),
        ("flight", "trajectory.npz"),
        ("flight", "trajectory.csv"),
        ("evaluation", "summary.json"),
        ("evaluation", "episodes.csv"),
        ("evaluation", "run.json"),
        ("leaderboard", "leaderboard.json"),
        ("dataset", "dataset.json"),
        ("dataset", TABLE),
    ],
)
def test_a_changed_byte_is_found(folders, folder, file, tmp_path):
    shutil.copytree(folders / folder, tmp_path / "copy")
    path = tmp_path / "copy" / file
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for at in [0, len(whole) - 1, *rng.integers(0, len(whole), 10)]:
        changed = bytearray(whole)
        changed[at] ^= 1 << int(rng.integers(7))
        path.write_bytes(bytes(changed))
        assert not verified(tmp_path / "copy"), (file, at)


@pytest.mark.parametrize("file", ["leaderboard.csv", "leaderboard.md"])
def test_a_changed_row_of_a_leaderboard_is_found(folders, file, tmp_path):
    shutil.copytree(folders / "leaderboard", tmp_path / "copy")
    path = tmp_path / "copy" / file
    path.write_text(path.read_text().replace("straight", "straighter", 1))
    assert not verified(path)


def test_a_sealed_lie_is_found_by_the_flight(folders, tmp_path, capsys):
    """Whoever seals a changed file anew does not make drones fly so."""
    shutil.copytree(folders / "flight", tmp_path / "copy")
    path = tmp_path / "copy" / "run.json"
    document = json.loads(path.read_text())
    document["call"] = document["call"].replace("'seed': 0", "'seed': 1")
    path.write_text(json.dumps(add_seal({k: v for k, v in document.items() if k != "seal"})))
    assert not verified(path)
    shown = capsys.readouterr().out
    assert "NO" in next(line for line in shown.splitlines() if "flight" in line)


@pytest.mark.parametrize("what", ["rows", "states"])
def test_a_sealed_lie_in_a_dataset_is_found_by_the_flights(folders, what, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(folders / "dataset", copy)
    table = pq.read_table(copy / TABLE)
    if what == "rows":
        at = table.column_names.index("reward")
        paid = table["reward"].to_numpy().copy()
        paid[-1] = np.nextafter(paid[-1], 9)
        table = table.set_column(at, "reward", pa.array(paid))
    else:
        ends = json.loads(table.schema.metadata[b"bulletuav"])
        ends[-1]["state_hash"] = ends[0]["state_hash"]
        table = table.replace_schema_metadata({"bulletuav": json.dumps(ends)})
    pq.write_table(table, copy / TABLE)
    document = json.loads((copy / "dataset.json").read_text())
    document["files"] = hash_files(copy, [TABLE])
    (copy / "dataset.json").write_text(json.dumps(add_seal({**document, "seal": ""})))
    different = [check.what for check in Verifier().verify(copy) if not check.same]
    assert different == [f"episodes-000000: {what}"]


def test_tables_of_leaderboards_tell_hashes(folders):
    text = (folders / "leaderboard" / "leaderboard.md").read_text()
    rows = (folders / "leaderboard" / "leaderboard.csv").read_text().splitlines()
    document = json.loads((folders / "leaderboard" / "leaderboard.json").read_text())
    hashes = [case["hash"] for case in document["cases"]]
    assert len(set(hashes)) == 2
    for one in hashes:
        assert f"| {one[:8]} |" in text
        assert sum(one in row for row in rows) == sum(hashes[0] in row for row in rows)


def test_flights_of_objects_are_not_flown_again(tmp_path):
    aviary = bulletuav.Aviary(find_task("crossing"), dynamics="point_mass", horizon=3)
    recording = fly_episode(aviary, find_policy("straight")(aviary), 0)
    save(recording, aviary, "straight", 0, tmp_path)
    assert load(tmp_path).hash() == recording.hash()
    with pytest.raises(ValueError, match="were Python objects"):
        Verifier().verify(tmp_path)
    aviary.close()


def test_what_cannot_be_verified_is_told(folders, tmp_path, capsys):
    with pytest.raises(FileNotFoundError, match="pass a file or a folder of results"):
        Verifier().verify(tmp_path / "gone")
    with pytest.raises(ValueError, match="holds no recording"):
        Verifier().verify(tmp_path)
    shutil.copytree(folders / "evaluation", tmp_path / "copy")
    (tmp_path / "copy" / "episodes.csv").unlink()
    assert not verified(tmp_path / "copy")
    assert "missing" in capsys.readouterr().out
    (tmp_path / "copy" / "summary.json").write_text("{}")
    with pytest.raises(ValueError, match="has no seal"):
        Verifier().verify(tmp_path / "copy")


def test_calls_are_literals_and_name_no_code():
    call = {"task": "crossing", "options": {"wind": (1.0, 0, 0), "weights": {"goal": 1e-9}}}
    assert parse_call(format_call(call), trust=False) == call
    assert format_call({"options": {"wind": np.zeros(3)}}) is None
    assert format_call({"options": {"wind": float("nan")}}) is None
    for text in (
        "[]",
        "{'options': 1}",
        "{'task': 'hover', 'options': {1: 2}}",
        "{'options': {}}",
        "__import__('os')",
        "(" * 200,
    ):
        with pytest.raises(ValueError, match="has no valid call"):
            parse_call(text, trust=True)
    for named in ("mine:Policy", "ppo:model.zip"):
        text = format_call(
            {"task": "crossing", "policy": "orca", "options": {"sensors": ("imu", named)}}
        )
        with pytest.raises(ValueError, match=f"{named}.*--trust"):
            parse_call(text, trust=False)
        assert parse_call(text, trust=True)["policy"] == "orca"


def test_hashes_tell_numbers_names_and_types_apart():
    arrays = {"a": np.arange(4.0), "b": np.arange(4)}
    document = hash_arrays(arrays)
    assert hash_arrays(dict(reversed(arrays.items()))) == document
    for other in (
        {"a": np.arange(4.0), "c": np.arange(4)},
        {"a": np.arange(4.0), "b": np.arange(4.0)},
        {"a": np.arange(4.0).reshape(2, 2), "b": np.arange(4)},
        {"a": np.nextafter(np.arange(4.0), 9), "b": np.arange(4)},
    ):
        assert hash_arrays(other) != document
    rows = [{"x": 1.0, "y": float("nan")}, {"x": 2.0, "y": 0.0}]
    assert hash_rows(rows) == hash_rows([{"y": float("nan"), "x": 1}, {"x": 2, "y": 0}])
    assert hash_rows(rows) != hash_rows(rows[::-1])
