"""Replays of servers: what a fleet flew, within bounded memory, and what clients plotted."""

import json
import logging
import math
import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from bridges.airsim_world_client import pose, vector
from payload_block import Block
from waiting import PATIENCE

from bulletuav.analysis import fleet_recorder, markers
from bulletuav.analysis.fleet_recorder import FleetRecorder
from bulletuav.analysis.markers import MarkerLog
from bulletuav.cli import main
from bulletuav.commands import serve
from bulletuav.report.replay import write_replay

RED = [1.0, 0.0, 0.0, 1.0]
POINTS = [vector(1.0, 2.0, -3.0), vector(4.0, 5.0, -6.0)]
IN_WORLD = [[2.0, 1.0, 3.0], [5.0, 4.0, 6.0]]


@pytest.fixture
def record():
    """Makes recorders, and closes them."""
    made = []

    def record(fleet):
        made.append(FleetRecorder(fleet))
        if hasattr(fleet, "markers"):
            fleet.markers = made[-1].markers
        return made[-1]

    yield record
    for recorder in made:
        recorder.close()


@pytest.fixture
def client(make_client):
    return make_client(1)


def test_rows_are_the_states_every_50_ms(client, record):
    recorder = record(client.world)
    client.at((0, 0, -5))
    seen = []
    for _ in range(22):
        client.world.step()
        seen.append(client.world.airspace.swarm.position.copy())
    recording = recorder.recording()
    np.testing.assert_allclose(recording.time, [0, 0.05, 0.1, 0.15, 0.2, 0.22])
    np.testing.assert_array_equal(recording.position[1:], np.array(seen)[[4, 9, 14, 19, 21]])
    assert recording.scene["rotor_speed"].shape[:2] == (6, 1)
    recorder.close()
    client.world.step()
    assert len(recorder.recording().time) == 6


def test_long_flights_have_sparser_rows_and_keep_their_contacts(client, record, monkeypatch):
    monkeypatch.setattr(fleet_recorder, "MAX_ROWS", 8)
    recorder = record(client.world)
    touched = 0
    for _ in range(500):
        client.world.step()
        touched += float(client.world.airspace.contacts.impulse.sum())
        assert len(recorder._rows) <= 8
    recording = recorder.recording()
    assert recording.time[-1] == pytest.approx(5.0)
    steps = np.diff(recording.time)[:-1]
    assert len(steps) >= 3
    assert steps == pytest.approx(np.full(len(steps), steps[0]))
    # The vehicle stands on the ground, whose impulses add up
    assert touched > 0
    assert recording.contact_impulse.sum() == pytest.approx(touched, rel=0.01)


def test_an_added_vehicle_stands_at_its_place_before(client, record, tmp_path):
    recorder = record(client.world)
    client.fly(0.5)
    client("simAddVehicle", "Second", "SimpleFlight", pose((0, 4, 0)), "")
    client.fly(0.5)
    recording = recorder.recording()
    assert recording.position.shape[1] == 2
    np.testing.assert_allclose(recording.position[0, 1, :2], [4, 0], atol=0.01)
    assert recording.separation[-1] == pytest.approx([4, 4], abs=0.01)
    write_replay(recording, "two", tmp_path / "page.html")


def test_points_lines_and_texts_are_recorded(client, record):
    recorder = record(client.world)
    client.fly(0.1)
    client("simPlotPoints", POINTS, [0.5, 2.0, -1.0, 1.0], 7.4, 2.0, False)
    client("simPlotLineStrip", POINTS, RED, 99.0, -1.0, True)
    client("simPlotLineList", POINTS, RED, 3.0, 0.0, False)
    client("simPlotStrings", ["a", "b"], POINTS, 5.0, RED, -1.0)
    client.fly(0.3)
    client("simFlushPersistentMarkers")
    client("simPlotTransforms", [pose((0.0, 0.0, -2.0), 90)], 100.0, 2.0, -1.0, True)
    scene = recorder.recording().scene
    np.testing.assert_allclose(scene["marker_point"], IN_WORLD)
    assert scene["marker_point_style"].tolist() == [[128, 255, 0, 7]] * 2
    assert scene["marker_point_time"] == pytest.approx(np.array([[0.1, 2.1]] * 2))
    np.testing.assert_allclose(scene["marker_line"][:2], [IN_WORLD] * 2)
    assert scene["marker_line_style"][:2].tolist() == [[255, 0, 0, 24], [255, 0, 0, 3]]
    # The strip is flushed; the list has no duration
    ends = np.array([[0.1, 0.4], [0.1, 1.1]])
    assert scene["marker_line_time"][:2] == pytest.approx(ends)
    texts = json.loads(str(scene["marker_text"]))
    assert [one["text"] for one in texts] == ["a", "b"]
    assert [one["position"] for one in texts] == IN_WORLD
    assert texts[0]["time"] == pytest.approx([0.1, 0.4])
    # Facing east: the forward axis is red, the one to the right, southwards, green, down blue
    lines = scene["marker_line"][2:]
    axes = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    np.testing.assert_allclose(lines[:, 1] - lines[:, 0], axes, atol=1e-9)
    assert scene["marker_line_style"][2:, :3].tolist() == (255 * np.eye(3)).tolist()
    assert np.isinf(scene["marker_line_time"][2:, 1]).all()


@pytest.mark.parametrize("end", [(0.0, 0.0, -5.0), (3.0, 4.0, 0.0)])
def test_arrows_have_heads_of_two_strokes(client, record, end):
    recorder = record(client.world)
    client("simPlotArrows", [vector(0.0, 0.0, 0.0)], [vector(*end)], RED, 1.0, 40.0, 1.0, False)
    client.fly(0.05)
    shaft, *strokes = recorder.recording().scene["marker_line"]
    along = (shaft[1] - shaft[0]) / 5
    for stroke in strokes:
        np.testing.assert_allclose(stroke[0], shaft[1])
        back = stroke[0] - stroke[1]
        # At least a tenth of the arrow
        assert np.linalg.norm(back) == pytest.approx(0.5)
        assert back @ along == pytest.approx(0.5 * math.cos(math.radians(25)))


def test_named_transforms_have_axes_and_texts(client, record):
    recorder = record(client.world)
    client("simPlotTransformsWithNames", [pose((1, 2, -3))], ["here"], 5, 1, 10, RED, 1.0)
    client.fly(0.05)
    scene = recorder.recording().scene
    assert len(scene["marker_line"]) == 3
    (text,) = json.loads(str(scene["marker_text"]))
    assert (text["text"], text["position"], text["size"]) == ("here", [2, 1, 3], 24)


def test_wrong_plots_are_errors(client, record):
    record(client.world)
    for call, *wrong in (
        ("simPlotLineList", POINTS[:1], RED, 1.0, 1.0, False),
        ("simPlotArrows", POINTS, POINTS[:1], RED, 1.0, 1.0, 1.0, False),
        ("simPlotStrings", ["a"], POINTS, 1.0, RED, 1.0),
        ("simPlotTransforms", [pose((math.nan, 0, 0))], 1.0, 1.0, 1.0, False),
        ("simPlotTransformsWithNames", [pose((0, 0, 0))], [], 1, 1, 1, RED, 1.0),
        ("simPlotPoints", POINTS, RED[:3], 1.0, 1.0, False),
    ):
        with pytest.raises(ValueError, match="needed"):
            client(call, *wrong)
    assert client.world.markers.arrays() == {}


def test_the_oldest_markers_are_discarded(monkeypatch, caplog):
    monkeypatch.setattr(markers, "MAX_VERTICES", 100)
    log = MarkerLog(lambda: 0.0)
    for k in range(1000):
        log.add_points(np.full((6, 3), k), RED[:3], 1.0, math.inf)
        log.add_texts(["x" * 80], np.zeros((1, 3)), RED[:3], 1.0, math.inf)
    points = log.arrays()["marker_point"]
    assert len(points) <= 100
    assert points[:, 0].max() == 999
    assert points[:, 0].min() > 990
    assert len(json.loads(str(log.arrays()["marker_text"]))) < 10
    assert [record.levelno for record in caplog.records] == [logging.WARNING]


def test_plots_without_a_replay_are_logged_once(client, caplog):
    for _ in range(3):
        client("simPlotPoints", POINTS, RED, 10.0, -1.0, False)
        client("simFlushPersistentMarkers")
    assert [record.message for record in caplog.records] == [
        "a client plots markers, which only a replay shows: start the server with --replay FILE"
    ]


@pytest.fixture
def interrupt_at_row(monkeypatch):
    """Interrupts a server, as Ctrl-C does, when its replay has this number of rows."""

    def interrupt_at_row(number):
        class Recorder(FleetRecorder):
            def _append_row(self):
                super()._append_row()
                if len(self._rows) == number:
                    signal.raise_signal(signal.SIGINT)

        monkeypatch.setattr(serve, "FleetRecorder", Recorder)

    return interrupt_at_row


@pytest.mark.parametrize("kind", ["airsim", "mavlink", "crazyflie"])
def test_servers_write_replays(kind, tmp_path, capsys, interrupt_at_row):
    interrupt_at_row(6)
    page = tmp_path / "flight.html"
    words = ["serve", kind, "--drones", "2", "--port", "0", "--seconds", str(PATIENCE)]
    with pytest.raises(SystemExit):
        main([*words, "--replay", str(page), "--seed", "0"])
    assert f"wrote {page}" in capsys.readouterr().out.replace("\n", "")
    about = Block.of_page(page).about
    assert about["title"] == f"serve {kind}: 2 drones"
    assert about["drones"] == 2
    assert about["rows"] == 6


def test_a_replay_has_the_seconds_of_a_server(tmp_path):
    page = tmp_path / "flight.html"
    # These are simulated seconds, which the machine's load does not change
    main(["serve", "mavlink", "--port", "0", "--seconds", "0.5", "--replay", str(page)])
    assert Block.of_page(page).about["rows"] == 11


def test_a_server_that_nothing_flies_writes_no_replay(tmp_path, capsys):
    page = tmp_path / "flight.html"
    main(["serve", "hil", "--port", "0", "--seconds", "0", "--replay", str(page)])
    assert "was not written: nothing has flown" in capsys.readouterr().out
    assert not page.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_servers_that_are_ended_by_a_signal_write_replays(number, tmp_path):
    page = tmp_path / "flight.html"
    words = ["serve", "airsim", "--port", "0", "--replay", str(page)]
    command = [sys.executable, "-m", "bulletuav", *words]
    server = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    port = re.search(r":(\d+)", server.stdout.readline()).group(1)
    with socket.create_connection(("127.0.0.1", int(port)), timeout=PATIENCE) as client:
        client.sendall(b"\x94\x00\x01\xa4ping\x90")  # MessagePack: [0, 1, "ping", []]
        assert client.recv(100)
    time.sleep(0.1)
    server.send_signal(number)
    output, _ = server.communicate(timeout=PATIENCE)
    assert "wrote" in output
    assert Block.of_page(page).about["drones"] == 1


def test_names_of_replays_are_checked_before_the_flight(tmp_path):
    (tmp_path / "folder.html").mkdir()
    for name in ("flight.mp4", "nowhere/flight.html", "folder.html"):
        with pytest.raises(SystemExit) as end:
            main(["serve", "airsim", "--port", "0", "--replay", str(tmp_path / name)])
        assert end.value.code
