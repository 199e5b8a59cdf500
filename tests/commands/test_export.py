"""`bulletuav export`: files beside a flight, and one line for bad input."""

import importlib.util
import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

import bulletuav
from bulletuav.analysis.recording import fly_episode, load, save
from bulletuav.analysis.results_folder import RUN
from bulletuav.analysis.seals import add_seal, hash_files
from bulletuav.cli import main
from bulletuav.policies import find_policy
from bulletuav.policies.run import shipped


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a short flight with an IMU."""
    folder = tmp_path_factory.mktemp("run")
    aviary = bulletuav.Aviary(
        "crossing", num_drones=2, dynamics="point_mass", horizon=5, observation=("goal", "imu")
    )
    save(fly_episode(aviary, find_policy("straight")(aviary), 0), aviary, "straight", 0, folder)
    aviary.close()
    return folder


@pytest.fixture
def copied(run, tmp_path):
    return shutil.copytree(run, tmp_path / "flight")


def counts(path):
    """How many messages each topic has."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        told = summary.statistics.channel_message_counts
        return {summary.channels[k].topic: count for k, count in told.items()}


def refused(arguments, capsys):
    """The one line of an error."""
    with pytest.raises(SystemExit) as end:
        main(["export", *map(str, arguments)])
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("bulletuav export: error: ")
    return line


def test_a_flight_becomes_mcap(copied, capsys):
    main(["export", str(copied), "--to", "mcap"])
    path = copied / "flight.mcap"
    assert capsys.readouterr().out == f"wrote {path}\n"
    told = counts(path)
    for name in ("/time", "/tf", "/drone_0/odometry", "/drone_1/imu", "/drone_1/goal"):
        assert told[name] == 6, name
    terms = [name for name in load(copied).info if name.startswith("reward/")]
    assert terms
    for name in ("reward", *(f"info/{name}" for name in terms)):
        assert told[f"/drone_1/{name}"] == 5


def test_the_commands_of_the_pages_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    docs = Path(__file__).parents[2] / "docs" / "howto"
    (commands,), (_, of_policies, to_hub) = (
        re.findall(r"```bash\n(.*?)```", (docs / page).read_text(), re.DOTALL)
        for page in ("export.md", "deploy_a_policy.md")
    )
    short = ["--horizon", "5", "--animation", "none", "--dynamics", "point_mass"]
    fly, mcap, rerun = (shlex.split(line, comments=True)[1:] for line in commands.splitlines())
    main(fly + short)
    main(mcap)
    assert counts(tmp_path / "flight" / "flight.mcap")["/drone_7/odometry"] == 6
    if importlib.util.find_spec("rerun"):
        main(rerun)
        assert (tmp_path / "crossing.rrd").stat().st_size > 10000
    shutil.copytree(shipped("crossing"), "crossing-run")
    as_c, as_onnx = (shlex.split(line, comments=True)[1:] for line in of_policies.splitlines())
    main(as_c)
    assert {path.name for path in Path("crossing-run").glob("policy.[ch]")} == {
        "policy.c",
        "policy.h",
    }
    if importlib.util.find_spec("onnxruntime"):
        main(as_onnx)
        assert Path("crossing-run", "policy.onnx").is_file()
    main(shlex.split(to_hub)[1:])
    assert Path("interception-hub", "README.md").is_file()


def test_a_file_of_the_run_and_another_place_will_do(copied, tmp_path):
    main(["export", str(copied / RUN), "--to", "mcap", "--out", str(tmp_path / "other.mcap")])
    assert counts(tmp_path / "other.mcap")["/time"] == 6
    assert not (copied / "flight.mcap").exists()


def test_a_flight_in_a_city_is_written_for_rerun(tmp_path):
    rerun_chunk = pytest.importorskip("rerun.chunk", reason="needs the extra rerun")
    aviary = bulletuav.Aviary(
        "lidar_navigation", num_drones=2, dynamics="point_mass", area=200.0, horizon=5
    )
    recording = fly_episode(aviary, find_policy("straight")(aviary), 0)
    save(recording, aviary, "straight", 0, tmp_path)
    aviary.close()
    main(["export", str(tmp_path), "--to", "rerun"])
    for chunk in rerun_chunk.RrdReader(tmp_path / "flight.rrd").stream().to_chunks():
        if chunk.entity_path == "/world/city":
            corners = np.array(chunk.to_record_batch()["Mesh3D:vertex_positions"].to_pylist()[0])
            highest = recording.building[:, 1].max(axis=0)
            np.testing.assert_array_equal(corners.max(axis=0), np.float32(highest))
            return
    pytest.fail("there is no city")


def test_unknown_formats_are_refused_with_the_nearest(run, capsys):
    assert "unknown format 'mcpa': did you mean 'mcap'?" in refused([run, "--to", "mcpa"], capsys)
    assert "choose from c, hub, mcap, onnx, rerun" in refused([run, "--to", "zzz"], capsys)
    assert "--to" in refused([run], capsys)


def test_folders_without_a_recording_are_refused(tmp_path, capsys):
    assert f"there is no {tmp_path / 'none'}" in refused(
        [tmp_path / "none", "--to", "mcap"], capsys
    )
    assert "holds no recording" in refused([tmp_path, "--to", "mcap"], capsys)


def test_damaged_recordings_are_refused(copied, capsys):
    path = copied / "trajectory.npz"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)
    assert "is damaged or was changed" in refused([copied, "--to", "mcap"], capsys)
    path.write_bytes(content[:100])
    assert "is damaged or was changed" in refused([copied, "--to", "mcap"], capsys)


def reseal(folder, entry, values):
    """Change an entry of a recording, and seal it anew."""
    with np.load(folder / "trajectory.npz") as file:
        arrays = dict(file)
    np.savez_compressed(folder / "trajectory.npz", **{**arrays, entry: values})
    about = json.loads((folder / RUN).read_text())
    about["files"] = hash_files(folder, tuple(about["files"]))
    about.pop("seal", None)
    (folder / RUN).write_text(json.dumps(add_seal(about)))


@pytest.mark.parametrize(
    ("entry", "values"),
    [
        ("position", np.zeros((6, 2))),
        ("quaternion", np.zeros((6, 1, 4))),
        ("velocity", np.zeros((6, 2, 2))),
        ("alive", np.ones((6, 2), dtype="U3")),
        ("time", np.full(6, np.nan)),
        ("time", np.float64(0)),
        ("alive", np.True_),
        ("goal", np.zeros(6)),
        ("reward", np.zeros((6, 2))),
        ("reading/imu", np.zeros((6, 2, 1))),
    ],
)
def test_sealed_recordings_of_odd_shapes_are_refused(entry, values, copied, capsys):
    reseal(copied, entry, values)
    assert f"{entry!r} of the recording is damaged" in refused([copied, "--to", "mcap"], capsys)
    assert not (copied / "flight.mcap").exists()


@pytest.mark.parametrize("about", ["{", "[]", "{}", '{"airframe_of": [0, 0], "airframes": [1]}'])
def test_odd_scenes_are_refused(about, copied, capsys):
    pytest.importorskip("rerun", reason="needs the extra rerun")
    reseal(copied, "scene/about", np.array(about))
    line = refused([copied, "--to", "rerun"], capsys)
    assert "the scene of the recording is damaged" in line
    assert not (copied / "flight.rrd").exists()


@pytest.mark.parametrize(("to", "package"), [("mcap", "rosbags"), ("rerun", "rerun")])
def test_a_missing_extra_is_named(to, package, run, capsys, monkeypatch):
    name = f"bulletuav.adapters.{to}"
    monkeypatch.delitem(sys.modules, name, raising=False)
    if importlib.util.find_spec(package):
        for own in [own for own in sys.modules if own.split(".")[0] == package]:
            monkeypatch.delitem(sys.modules, own)
        monkeypatch.setitem(sys.modules, package, None)
    line = refused([run, "--to", to], capsys)
    assert f"needs the extra {to!r}: pip install" in line
    assert f"[{to}]" in line


def test_places_that_cannot_be_written_to_are_named(run, tmp_path, capsys):
    path = tmp_path / "none" / "flight.mcap"
    line = refused([run, "--to", "mcap", "--out", path], capsys)
    assert f"{path} cannot be written: No such file or directory" in line
