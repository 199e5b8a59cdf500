"""Replays: what a recording keeps for them, the block of numbers, and the page."""

import base64
import contextlib
import hashlib
import json
import re
import shutil
import zlib
from pathlib import Path

import numpy as np
import pytest
from payload_block import Block

import bulletuav
from bulletuav.analysis.recorder import Recorder
from bulletuav.analysis.recording import fly_episode, load, save
from bulletuav.analysis.seals import add_seal, hash_files
from bulletuav.city.terrain import CROWN_COLOUR, GROUND_COLOUR, TRUNK_COLOUR
from bulletuav.cli import main
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.policies import find_policy
from bulletuav.report.payload import Payload
from bulletuav.report.replay import WEB, replay_run, write_replay
from bulletuav.report.verification import Verifier
from bulletuav.tasks import find_task

ROOT = Path(__file__).parents[2]
SHORT = {"num_drones": 3, "dynamics": "point_mass", "horizon": 20}


def flown(folder, task="crossing", policy="straight", **options):
    """Fly, save, and return the recording and the options that it was flown with."""
    aviary = bulletuav.Aviary(task, **{**SHORT, **options})
    recording = fly_episode(aviary, find_policy(policy)(aviary), 0)
    save(recording, aviary, policy, 0, folder)
    aviary.close()
    return recording


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a short flight."""
    folder = tmp_path_factory.mktemp("run")
    flown(folder)
    return folder


@pytest.fixture
def copied(run, tmp_path):
    return shutil.copytree(run, tmp_path / "copy")


def test_series_come_back_to_half_a_step():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(50, 4, 3)) * [1.0, 1e3, 1e-3]
    values[7, 2, 1], values[8, 2, 1], values[:, 3, 0] = np.nan, np.inf, -np.inf
    values[:, 1, 2] = 5.25
    payload = Payload()
    payload.add("odd", np.arange(3), "u1")
    payload.add_series("values", values)
    payload.add_series("nothing", np.zeros((50, 0, 3)))
    read = Block(payload.text({"rows": 50}))
    again, step = read.series("values")
    wanted = np.where(np.isfinite(values), values, np.nan).reshape(50, -1)
    np.testing.assert_array_equal(np.isnan(again), np.isnan(wanted))
    error = np.nan_to_num(np.abs(again - wanted)).max(axis=0)
    # Half a step, and what single precision rounds.
    assert (error <= 0.5 * step + 2e-7 * np.nan_to_num(np.abs(wanted)).max(axis=0)).all()
    assert step[5] == 0
    assert (again[:, 5] == 5.25).all()
    span = np.ptp(wanted[:, 1])
    assert step[1] == pytest.approx(span / 65534)
    assert list(read.array("odd")) == [0, 1, 2]


def test_a_page_holds_the_flight(run, tmp_path):
    recording = load(run)
    page = replay_run(run, tmp_path / "page.html")
    block = Block.of_page(page)
    about = block.about
    assert (about["drones"], about["rows"], about["task"]) == (3, len(recording.time), "crossing")
    for name in ("position", "goal"):
        read, step = block.series(name)
        wanted = getattr(recording, name).reshape(len(read), -1)
        assert (np.abs(read - wanted) <= 0.51 * step + 1e-4).all(), name
    turn = block.series("quaternion")[0].reshape(-1, 3, 4)
    aligned = np.abs((turn * recording.quaternion).sum(axis=-1))
    np.testing.assert_allclose(aligned, 1, atol=1e-3)
    np.testing.assert_array_equal(block.array("end"), recording.alive[:-1].sum(axis=0))
    near = block.array("conflict").reshape(-1, 3)
    assert not near[0].any()
    np.testing.assert_array_equal(near[1:], recording.separation < about["d_safe"])
    titles = [(chart["group"], chart["title"], chart["unit"]) for chart in about["charts"]]
    assert titles[:3] == [
        ("Flight", "altitude", "m"),
        ("Flight", "separation", "m"),
        ("Flight", "speed", "m/s"),
    ]
    assert about["charts"][1]["mark"] == about["d_safe"] == 5
    terms = [title for group, title, _ in titles if group == "Reward"]
    document = [name[7:] for name in recording.info if name.startswith("reward/")]
    assert terms == ["reward", *(name.replace("_", " ") for name in document)]
    (speed,) = about["charts"][2]["lines"]
    read, step = block.series(speed["series"])
    wanted = np.linalg.norm(recording.velocity, axis=-1)
    assert (np.abs(read - wanted) <= 0.51 * step + 1e-5).all()


def test_the_page_is_whole_and_asks_for_nothing(run, tmp_path):
    text = replay_run(run, tmp_path / "page.html").read_text()
    assert "<!--put" not in text
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert "default-src 'none'" in text
    assert "Permission is hereby granted" in text
    assert not re.search(r"(from|import)\s*[\"']\./", text)
    packed = re.search(r'id="scripts">(.*?)</script>', text)[1]
    scripts = json.loads(zlib.decompress(base64.b64decode(packed)))
    assert set(scripts) == {path.name for path in WEB.glob("*.js")}
    for name, code in scripts.items():
        for other in re.findall(r'\bfrom\s*"([^"]+)"', code):
            assert other in scripts, f"{name} asks for {other}"


def test_three_js_is_as_it_was_published():
    document = dict(re.findall(r"- `(.*)`: `(.*)`", (ROOT / "THIRD_PARTY.md").read_text()))
    assert set(document) == {path.name for path in WEB.glob("three.*.js")}
    for name, digest in document.items():
        assert hashlib.sha256((WEB / name).read_bytes()).hexdigest() == digest


def test_names_from_a_recording_are_data_in_the_page(run, copied):
    evil = "</script><script>alert(1)</script>"
    path = copied / "run.json"
    document = json.loads(path.read_text())
    document["policy"] = evil
    path.write_text(json.dumps(add_seal({k: v for k, v in document.items() if k != "seal"})))
    text = replay_run(copied).read_text()
    assert evil not in text
    assert "&lt;/script&gt;" in text
    assert text.count("<script") == replay_run(run, copied / "other.html").read_text().count(
        "<script"
    )


def test_scenes_tell_shapes_links_and_readings(tmp_path):
    options = {"area": 200.0, "num_layouts": 1, "num_users": 12, "horizon": 6}
    recording = flown(tmp_path, "mec", "kmeans", **options)
    rows, drones, users = 7, 3, 12
    links = recording.scene["link"]
    assert links.shape[1] == 3
    assert len(links)
    assert (links.max(axis=0) < (rows, drones, users)).all()
    block = Block.of_page(replay_run(tmp_path))
    begins = block.array("link_start")
    for row in range(rows):
        mine = slice(begins[row], begins[row + 1])
        pairs = set(
            zip(block.array("link_drone")[mine], block.array("link_target")[mine], strict=True)
        )
        assert pairs == {(d, u) for r, d, u in links.tolist() if r == row}
    corners = block.array("city_corners").reshape(-1, 3)
    np.testing.assert_allclose(corners.min(axis=0), recording.building[:, 0].min(axis=0), rtol=1e-6)
    assert block.array("city_triangles").max() == len(corners) - 1


def test_ranges_of_the_finder_are_kept_as_they_were_measured(tmp_path):
    options = {"area": 200.0, "horizon": 5, "lidar_elevations": (0.0, 20.0), "leg": 50.0}
    aviary = bulletuav.Aviary("lidar_navigation", num_drones=2, dynamics="point_mass", **options)
    recording = fly_episode(aviary, find_policy("straight")(aviary), 0)
    observed = aviary.reset(seeds=0)
    first = aviary.observer.split(observed)["lidar"][0]
    np.testing.assert_allclose(recording.reading["lidar"][0], first, rtol=1e-6)
    about = json.loads(str(recording.scene["about"]))
    assert about["lidar"]["beams"] == [list(beam) for beam in aviary.task.context.beams]
    assert about["readings"]["lidar"][0] == ["beam 0", "m"]
    assert len(about["readings"]["lidar"]) == recording.reading["lidar"].shape[-1] == 32
    aviary.close()


def test_cables_are_kept_until_they_are_released(tmp_path):
    aviary = bulletuav.Aviary("transport", horizon=8)
    aviary.reset(seeds=0)
    recorder = Recorder(aviary)
    for k in range(6):
        if k == 4:
            aviary.scene.memory["cable_attached"][:] = 0.0
        actions = np.zeros((1, 1, 3))
        step = aviary.step(actions)
        recorder.record(actions, step.rewards, step.info)
    recording = recorder.recording()
    ends = recording.scene["cable"]
    assert ends.shape == (7, 1, 2, 3)
    np.testing.assert_array_equal(ends[:5, 0, 0], recording.position[:5, 0])
    # The load is the first of the bodies; the cable ends on its top
    top = recording.obstacle[:5, 0] + (0.0, 0.0, 0.125)
    np.testing.assert_allclose(ends[:5, 0, 1], top, atol=1e-6)
    assert np.isnan(ends[5:]).all()
    page = tmp_path / "page.html"
    write_replay(recording, "cables", page)
    values, step = Block.of_page(page).series("cable")
    np.testing.assert_allclose(values, ends.reshape(7, 6), atol=1e-6 + step.max())
    aviary.close()


def test_hills_and_trees_keep_their_colours(tmp_path):
    city = {"kind": "wooded_hills", "tree_density": 40.0, "relief": 10.0}
    recording = flown(tmp_path, "interception", "stay", city=city, horizon=3)
    colours = recording.scene["building_colour"]
    assert colours.shape == (len(recording.building), 3)
    assert set(map(tuple, colours)) == {GROUND_COLOUR, TRUNK_COLOUR, CROWN_COLOUR}
    block = Block.of_page(replay_run(tmp_path))
    shown = 255 * block.array("city_colours").reshape(-1, 3)
    corners = block.array("city_corners").reshape(-1, 3)
    assert shown.shape == corners.shape
    # Above all hills there are crowns only
    np.testing.assert_allclose(shown[corners[:, 2].argmax()], CROWN_COLOUR, rtol=1e-6)


def test_obstacles_are_kept_with_their_shapes(tmp_path):
    recording = flown(tmp_path, "race", "stay", num_drones=1, difficulty="medium", horizon=200)
    about = json.loads(str(recording.scene["about"]))
    assert len(about["obstacles"]) == recording.obstacle.shape[1]
    for document, axis, turn in zip(
        about["obstacles"],
        recording.obstacle_axis,
        recording.scene["obstacle_quaternion"][0],
        strict=True,
    ):
        assert document["kind"] == 2  # a box
        assert max(document["half"]) == pytest.approx(np.linalg.norm(axis))
        assert np.linalg.norm(turn) == pytest.approx(1)
    colour = Obstacle("sphere", (1.0,)).colour
    assert all(len(document["colour"]) == len(colour) for document in about["obstacles"])


@pytest.mark.parametrize("task", bulletuav.list_tasks())
def test_every_task_replays(task, tmp_path):
    horizon = {"race": 200, "pursuit": 400}.get(task, 3)
    aviary = bulletuav.Aviary(task, horizon=horizon)
    recording = fly_episode(aviary, find_policy("random")(aviary), 0)
    write_replay(recording, task, tmp_path / "page.html")
    block = Block.of_page(tmp_path / "page.html")
    assert block.about["task"] == task
    shown = {chart["title"] for chart in block.about["charts"] if chart["group"] == "Flight"}
    numbers = {name for name in aviary.task.shows if name in recording.info}
    assert {aviary.task.shows[name] for name in numbers} <= shown
    aviary.close()


def test_numbers_of_numpy_and_infinite_ones_are_no_trouble(tmp_path):
    class Odd(find_task("hover")):
        name = "odd"

        def obstacles(self):
            size = (np.float32(1.0), np.int64(2), np.float32(1.5))
            return [Obstacle("box", size, colour=(np.float32(0.5),) * 3 + (1,))]

        def spawn(self, rng):
            return (
                super()
                .spawn(rng)
                ._replace(obstacle=np.array([[50.0, 0, 5]]), obstacle_velocity=np.zeros((1, 3)))
            )

        def info(self, frame):
            height = frame.after.position[..., 2]
            odd = {"endless": height * np.inf, "none": height * np.nan, "huge": height * 1e200}
            return super().info(frame) | odd

    aviary = bulletuav.Aviary(Odd, num_drones=1, horizon=4, action="velocity")
    recording = fly_episode(aviary, find_policy("stay")(aviary), 0)
    write_replay(recording, "odd", tmp_path / "page.html")
    block = Block.of_page(tmp_path / "page.html")
    assert block.about["obstacles"][0]["half"] == [0.5, 1, 0.75]
    by_title = {chart["title"]: chart["lines"][0]["series"] for chart in block.about["charts"]}
    for name in ("endless", "none", "huge", "separation"):  # a single drone has no neighbour
        assert np.isnan(block.series(by_title[name])[0]).all(), name
    aviary.close()


def test_recordings_of_version_4_verify_but_do_not_replay(copied, capsys):
    recording = load(copied)
    path = copied / "trajectory.npz"
    with np.load(path) as file:
        arrays = {k: v for k, v in file.items() if not k.startswith(("scene/", "reading/"))}
    np.savez_compressed(path, **{**arrays, "version": np.array(4)})
    old = load(copied)
    assert (old.version, dict(old.scene), dict(old.reading)) == (4, {}, {})
    document = json.loads((copied / "run.json").read_text())
    document["hash"] = old.hash()
    assert document["hash"] != recording.hash()
    assert document["hash"] == recording.hash(like=old)
    document["files"] = hash_files(copied, document["files"])
    del document["seal"]
    (copied / "run.json").write_text(json.dumps(add_seal(document)))
    checks = Verifier().verify(copied)
    assert [check.what for check in checks if not check.same] == []
    assert checks[-1].what == "flight"
    refused(["replay", str(copied)], capsys, "is a recording of version 4, which has no scene")


def refused(words, capsys, *said):
    """The command line leaves with one line that tells this."""
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    for one in said:
        assert one in line


def test_bad_input_gets_one_line(run, copied, tmp_path, capsys):
    refused(["replay", str(tmp_path / "gone")], capsys, "there is no", "gone: pass the folder")
    (tmp_path / "empty").mkdir()
    empty = str(tmp_path / "empty")
    refused(["replay", empty], capsys, "holds no recording (trajectory.npz)", "`bulletuav fly`")
    refused(["replay", str(run), "--ouy", "x"], capsys, "--ouy: did you mean --out?")
    refused(["replay", str(run), "--out", str(tmp_path)], capsys, "end in .html or .mp4")
    (tmp_path / "folder.html").mkdir()
    folder = str(tmp_path / "folder.html")
    refused(["replay", str(run), "--out", folder], capsys, "cannot be written")
    refused(["replay", str(run), "--out", str(tmp_path / "no" / "x.html")], capsys, "cannot be")
    (copied / "run.json").unlink()
    refused(["replay", str(copied)], capsys, "run.json")


@pytest.mark.parametrize("harm", ["truncate", "flip", "empty"])
def test_a_damaged_recording_is_told(harm, copied, capsys):
    path = copied / "trajectory.npz"
    data = bytearray(path.read_bytes())
    if harm == "flip":
        data[len(data) // 2] ^= 1
    else:
        data = data[: len(data) // 2 if harm == "truncate" else 0]
    path.write_bytes(data)
    said = "trajectory.npz is damaged or was changed: it does not match run.json; fly the episode"
    refused(["replay", str(copied)], capsys, said)
    assert not (copied / "replay.html").exists()


def test_a_damaged_scene_is_told(copied, capsys):
    """As somebody may have made it, with seals that fit."""
    path = copied / "trajectory.npz"
    with np.load(path) as file:
        arrays = dict(file)
    for name, value in (
        ("scene/about", np.array("{")),
        ("scene/about", np.array("{}")),
        ("scene/link", np.zeros((2, 2), int)),
        ("scene/hull_size", np.array([9, 9])),
    ):
        np.savez_compressed(path, **{**arrays, name: value})
        document = json.loads((copied / "run.json").read_text())
        del document["seal"]
        document["files"] = hash_files(copied, document["files"])
        (copied / "run.json").write_text(json.dumps(add_seal(document)))
        refused(["replay", str(copied)], capsys, "the scene of the recording is damaged")


def test_any_damage_of_the_file_is_a_clear_error(copied):
    """Bytes changed or cut off anywhere: it is read as it was, or a ValueError."""
    path = copied / "trajectory.npz"
    whole, recording = path.read_bytes(), load(copied)
    rng = np.random.default_rng(0)
    refusals = 0
    for _ in range(150):
        data = bytearray(whole)
        if rng.random() < 0.2:
            data = data[: rng.integers(len(data))]
        else:
            for place in rng.integers(len(data), size=rng.integers(1, 4)):
                data[place] ^= rng.integers(1, 256)
        path.write_bytes(data)
        refused = False
        # Damage of times of entries and the like is not noticed: they are not read.
        with contextlib.suppress(ValueError):
            refused = True
            assert load(path).hash() == recording.hash()
            refused = False
        refusals += refused
    assert refusals > 100


def test_flying_with_html_writes_the_same_page(tmp_path):
    words = ["crossing", "--drones", "2", "--dynamics", "point_mass", "--horizon", "5"]
    out = tmp_path / "out"
    main(["fly", *words, "--animation", "none", "--html", "--out", str(out)])
    page = (out / "replay.html").read_bytes()
    main(["replay", str(out), "--out", str(tmp_path / "again.html")])
    assert (tmp_path / "again.html").read_bytes() == page
    # A flight without it leaves no page of the one before.
    main(["fly", *words, "--animation", "none", "--out", str(out)])
    assert not (out / "replay.html").exists()
