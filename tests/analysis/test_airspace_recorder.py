"""Recordings of airspaces: what they hold, and that they are replayed, exported and verified."""

import csv
import json

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.airspace_recorder import fly_calls
from bulletuav.analysis.recording import load
from bulletuav.commands.export import FORMATS
from bulletuav.dynamics import DYNAMICS
from bulletuav.envs.airspace import CHANGES
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.report.film import Film
from bulletuav.report.replay import read_run, replay_run
from bulletuav.report.verification import Verifier

STARTS = [(0.0, 0.0, 1.0), (2.0, 0.0, 1.0)]
STEPS = 24


def airspace_of(**options):
    return bulletuav.Airspace(
        STARTS, **{"decision_hz": 48, "rotor_speed": "hover", "dynamics": "rigid_body", **options}
    )


def fly(airspace, steps=STEPS):
    """Call everything that changes an airspace, with arguments of different types."""
    level = airspace.consumes
    airspace.command(0, "position" if level > 1 else "velocity", (1.0, 0.0, 1.5))
    velocity = np.array([0.0, 0.5, 0.2])
    airspace.command([1], bulletuav.SetpointLevel.VELOCITY, velocity, yaw_rate=0.5)
    velocity[:] = np.nan  # the caller's own again
    airspace.place_obstacle(0, (3.0, 3.0, 1.0), velocity=np.array((-0.1, 0.0, 0.0)))
    airspace.add_body(Obstacle("box", (0.5, 0.5, 0.1)), (1.0, 0.0, 0.3))
    airspace.set_wind((1.0, 0.0, 0.0))
    for k in range(steps):
        if k == steps // 2:
            airspace.place(1, (2.0, 2.0, 2.0), velocity=(0.0, 1.0, 0.0))
        airspace.step()


BOX = (Obstacle("box", (0.5, 0.5, 0.5)),)


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Return a folder with a recorded flight, and the positions that its loop saw."""
    folder, seen = tmp_path_factory.mktemp("flight"), []
    airspace = airspace_of(obstacles=BOX, sensors=["optical_flow"], turbulence="light", seed=3)
    with bulletuav.AirspaceRecorder(airspace) as recorder:
        step = airspace.step
        airspace.step = lambda: (step(), seen.append(airspace.swarm.position.copy()))
        fly(airspace)
        airspace.step = step
    files = recorder.save(folder)
    assert all(path.exists() for path in files)
    return folder, np.array(seen)


def test_a_recording_holds_what_the_loop_saw(flight):
    folder, seen = flight
    recording = load(folder)
    np.testing.assert_array_equal(recording.position[0], STARTS)
    np.testing.assert_array_equal(recording.position[1:], seen)
    np.testing.assert_allclose(recording.time, np.arange(STEPS + 1) / 48, rtol=1e-15)
    assert recording.action.shape == (STEPS, 2, 4)
    np.testing.assert_array_equal(recording.action[0, 1, :3], (0.0, 0.5, 0.2))
    np.testing.assert_array_equal(recording.info["level"][0], (0, 1))
    apart = np.linalg.norm(recording.position[:, 0] - recording.position[:, 1], axis=-1)
    # The minimum within a step is at most the distance at its ends
    assert (recording.separation[:, 0] <= np.minimum(apart[:-1], apart[1:]) + 1e-12).all()
    # The obstacle flies 0.1 m/s west
    np.testing.assert_allclose(recording.obstacle[1:, 0, 0], 3.0 - 0.1 * recording.time[1:])
    assert recording.reading["optical_flow"].shape == (STEPS + 1, 2, 3)


def test_a_recording_is_replayed_filmed_and_exported(flight, tmp_path):
    folder, seen = flight
    recording, title = read_run(folder)
    assert title == "airspace: 2 drones, own loop, seed 3"
    assert "airspace" in replay_run(folder, tmp_path / "page.html").read_text(encoding="utf-8")
    film = Film(recording, title)
    assert np.ptp(np.asarray(film.picture(0.25))) > 0
    film.close()
    for name, (file, write) in FORMATS.items():
        try:
            write(recording, tmp_path / file)
        except ImportError:
            continue
        assert (tmp_path / file).stat().st_size > 1000, name
    with (folder / "trajectory.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["x"]) == pytest.approx(seen[-1, 1, 0], rel=1e-8)


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_a_flight_is_verified_to_the_bit(tmp_path, dynamics):
    airspace = airspace_of(dynamics=dynamics, obstacles=BOX)  # with a drawn seed
    with bulletuav.AirspaceRecorder(airspace) as recorder:
        fly(airspace)
    recorder.save(tmp_path)
    checks = Verifier().verify(tmp_path)
    assert [check.what for check in checks][-2:] == ["calls.json", "flight"]
    assert all(check.same for check in checks)


def test_other_calls_are_another_flight(flight, tmp_path):
    folder, _ = flight
    recording, _ = read_run(folder)
    content = json.loads((folder / "calls.json").read_text(encoding="utf-8"))
    content["calls"][0][1][2][0] = 1.0 + 1e-9
    (tmp_path / "calls.json").write_text(json.dumps(content), encoding="utf-8")
    assert fly_calls(tmp_path / "calls.json", STEPS, False).hash() != recording.hash()


def test_a_flight_from_a_used_airspace_is_recorded_but_not_verified(tmp_path):
    airspace = airspace_of()
    airspace.step()
    with bulletuav.AirspaceRecorder(airspace) as recorder:
        airspace.step()
    recorder.save(tmp_path)
    assert load(tmp_path).time[0] == pytest.approx(1 / 48)
    with pytest.raises(ValueError, match="cannot be flown again"):
        Verifier().verify(tmp_path)


def test_calls_of_an_earlier_flight_do_not_stay(flight, tmp_path):
    airspace = airspace_of()
    with bulletuav.AirspaceRecorder(airspace) as recorder:
        airspace.step()
    recorder.save(tmp_path)
    assert (tmp_path / "calls.json").exists()
    snapshot = airspace.save_state()
    with bulletuav.AirspaceRecorder(airspace) as recorder:
        airspace.load_state(snapshot)
        airspace.step()
    recorder.save(tmp_path)
    assert not (tmp_path / "calls.json").exists()


def test_a_recorder_ends_and_is_alone():
    airspace = airspace_of()
    with bulletuav.AirspaceRecorder(airspace) as recorder:
        with pytest.raises(ValueError, match=r"nothing was recorded: call step\(\)"):
            recorder.recording()
        with pytest.raises(RuntimeError, match="close the other recorder first"):
            bulletuav.AirspaceRecorder(airspace)
        with pytest.raises(ValueError, match="drones is 7"):
            airspace.command(7, "velocity", (0.0, 0.0, 0.0))
        airspace.step()
    airspace.step()
    recorder.close()
    assert len(recorder.recording().reward) == 1
    assert "step" not in vars(airspace)


def test_recording_changes_no_bit():
    hashes = []
    for recorded in (False, True):
        airspace = airspace_of(obstacles=BOX, seed=5, turbulence="light")
        if recorded:
            with bulletuav.AirspaceRecorder(airspace):
                fly(airspace)
        else:
            fly(airspace)
        hashes.append(airspace.state_hash())
    assert hashes[0] == hashes[1]


READS = {
    *("require_level", "save_state", "state_hash", "render", "picture", "draw", "shot"),
    *("scene_poses", "rotor_commands", "close"),
}
"""Methods that leave the flight unchanged"""
BY_OTHERS = {"stop", "warm_up"}
"""Methods that call those of `CHANGES`"""


def test_all_changes_of_an_airspace_are_kept():
    public = {name for name, one in vars(bulletuav.Airspace).items() if callable(one)}
    public = {name for name in public if not name.startswith("_")}
    assert public == READS | BY_OTHERS | set(CHANGES)


DAMAGED = {
    "call": lambda content: content["calls"].insert(0, ["close", [], {}]),
    "too many steps": lambda content: content["calls"].append(["step", 10**12]),
    "negative steps": lambda content: content["calls"].append(["step", -5]),
    "empty call": lambda content: content["calls"].append([]),
    "steps": lambda content: content["calls"].insert(0, ["step"]),
    "arguments": lambda content: content["calls"].insert(0, ["place", 3]),
    "no calls": lambda content: content.pop("calls"),
    "code": lambda content: content["kwargs"].update(dynamics="mine:Own"),
    "option": lambda content: content["kwargs"].update(airframee="cf2x"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_calls_give_one_clear_error(flight, tmp_path, name):
    folder, _ = flight
    content = json.loads((folder / "calls.json").read_text(encoding="utf-8"))
    DAMAGED[name](content)
    path = tmp_path / "calls.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match="fly it again|unknown|pass --trust|option|steps is|call"):
        fly_calls(path, STEPS, False)


def test_bodies_that_come_move_and_go_are_recorded_and_flown_again(tmp_path):
    airspace = airspace_of()
    with bulletuav.AirspaceRecorder(airspace) as recorder:
        airspace.step()
        ball = airspace.add_body(
            Obstacle("sphere", (0.5,)), (0.0, 5.0, 1.0), velocity=(4.8, 0.0, 0.0)
        )
        airspace.step()
        airspace.move_body(ball, (0.0, 6.0, 1.0), angular_velocity=(0.0, 0.0, 48.0))
        airspace.step()
        airspace.remove_body(ball)
        airspace.step()
    recorder.save(tmp_path)
    recording = load(tmp_path)
    # Before and after, the ball is shown in the ground below the drones
    hidden = (1.0, 0.0, -1.0)
    places = [hidden, hidden, (0.1, 5.0, 1.0), (0.0, 6.0, 1.0), hidden]
    np.testing.assert_allclose(recording.obstacle[:, 0], places, atol=1e-3)
    turn = (0.0, 0.0, np.sin(0.5), np.cos(0.5))
    np.testing.assert_allclose(recording.scene["obstacle_quaternion"][3, 0], turn, atol=1e-12)
    assert recording.obstacle_radius.tolist() == [0.5]
    again = fly_calls(tmp_path / "calls.json", 10**3, trust=False)
    assert again.hash() == recording.hash()
