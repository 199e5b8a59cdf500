"""Aircraft with wings in recordings, replays and snapshots."""

import numpy as np
import pytest
from payload_block import Block

import bulletuav
from bulletuav.analysis.fleet_recorder import FleetRecorder
from bulletuav.analysis.recording import fly_episode, load, save
from bulletuav.envs.airspace import Airspace
from bulletuav.policies import find_policy
from bulletuav.report.replay import replay_run
from bulletuav.report.replay_sampling import take_sample
from bulletuav.vehicle.airframes import load_airframe

WIND = (3.0, 0.0, 0.0)
FLEET = ("trainer", "quadplane", "iris")
TITLES = {"airspeed", "forward rotors, mean", "control surfaces"}


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Folder and recording of a short flight of a mixed fleet in wind."""
    folder = tmp_path_factory.mktemp("flight")
    aviary = bulletuav.Aviary(
        "crossing",
        num_drones=3,
        airframe=FLEET,
        dynamics="rigid_body",
        action="velocity",
        wind=WIND,
        horizon=20,
    )
    recording = fly_episode(aviary, find_policy("straight")(aviary), 0)
    save(recording, aviary, "straight", 0, folder)
    aviary.close()
    return folder, recording


def test_recordings_keep_deflections_and_airspeed(flight):
    folder, recording = flight
    read = load(folder)
    surfaces = max(len(load_airframe(name).surfaces) for name in FLEET)
    deflection, airspeed = read.scene["deflection"], read.scene["airspeed"]
    assert deflection.shape == (len(read.time), 3, surfaces)
    np.testing.assert_array_equal(deflection, recording.scene["deflection"])
    assert np.abs(deflection[1:, 0]).max() > 0
    assert (deflection[:, 2] == 0).all()
    expected = np.linalg.norm(read.velocity - WIND, axis=-1)
    np.testing.assert_allclose(airspeed, expected, rtol=1e-12)


def test_replays_have_charts_of_wings(flight):
    folder, recording = flight
    block = Block.of_page(replay_run(folder))
    titles = [chart["title"] for chart in block.about["charts"]]
    assert set(titles) >= TITLES
    # Rotors of each kind by their mean
    speed = recording.scene["rotor_speed"]
    forward, step = block.series("forward rotors")
    wanted = np.stack([speed[:, 0, 0], speed[:, 1, 4], np.zeros(len(speed))], axis=1)
    assert (np.abs(forward - wanted) <= 0.51 * step + 1e-3).all()
    lifting, step = block.series("rotors")
    zero = np.zeros(len(speed))
    wanted = np.stack([zero, speed[:, 1, :4].mean(axis=-1), speed[:, 2, :4].mean(axis=-1)], axis=1)
    assert (np.abs(lifting - wanted) <= 0.51 * step + 1e-3).all()
    trainer, quadplane, iris = block.about["airframes"]
    assert trainer["forward"] == [0]
    assert trainer["surfaces"] == ["left aileron", "right aileron", "elevator", "rudder"]
    assert quadplane["forward"] == [4]
    assert quadplane["heights"] == [0.05, 0.05, 0.05, 0.05, 0.0]
    assert "forward" not in iris


def test_multirotors_have_no_charts_of_wings(tmp_path):
    aviary = bulletuav.Aviary("crossing", num_drones=2, dynamics="rigid_body", horizon=3)
    recording = fly_episode(aviary, find_policy("straight")(aviary), 0)
    save(recording, aviary, "straight", 0, tmp_path)
    aviary.close()
    assert not {"deflection", "airspeed"} & set(recording.scene)
    about = Block.of_page(replay_run(tmp_path)).about
    assert not TITLES & {chart["title"] for chart in about["charts"]}


def test_large_fleets_are_sampled_with_their_wings(flight, monkeypatch):
    _, recording = flight
    monkeypatch.setattr("bulletuav.report.replay_sampling.MAX_DETAILED", 2)
    monkeypatch.setattr("bulletuav.report.replay_sampling.MAX_POSITIONS", 12)
    about = {"airframe_of": [0, 1, 2]}
    taken = take_sample(recording, about)
    rows = np.isin(recording.time, taken.recording.time)
    assert rows.sum() < len(rows)
    for name in ("deflection", "airspeed"):
        expected = recording.scene[name][rows][:, taken.drones]
        np.testing.assert_array_equal(taken.recording.scene[name], expected)


class Fleet:
    """An airspace as servers step it."""

    def __init__(self, airspace):
        self.airspace = airspace

    def step(self):
        self.airspace.step()


def test_fleets_keep_deflections_and_airspeed():
    airspace = Airspace([(0, 0, 100)], airframe="trainer", dynamics="rigid_body", wind=WIND)
    fleet = Fleet(airspace)
    with FleetRecorder(fleet) as recorder:
        for _ in range(60):
            fleet.step()
        recording = recorder.recording()
    rows = len(recording.time)
    assert recording.scene["deflection"].shape == (rows, 1, 4)
    expected = np.linalg.norm(recording.velocity - WIND, axis=-1)
    np.testing.assert_allclose(recording.scene["airspeed"], expected, rtol=1e-12)
    airspace.close()


def test_flights_of_wings_go_on_from_a_snapshot():
    aviary = bulletuav.Aviary(
        "crossing",
        num_drones=2,
        airframe="trainer",
        dynamics="rigid_body",
        action="velocity",
        thermals={"count": 3},
    )
    policy = find_policy("straight")(aviary)
    seen = aviary.reset(seeds=3)
    policy.reset(np.ones(1, dtype=bool))
    for _ in range(5):
        seen = aviary.step(policy.act(seen, aviary.swarm)).observations
    saved, deflection = aviary.save_state(), aviary.swarm.deflection.copy()
    assert np.abs(deflection).max() > 0

    def flown():
        for _ in range(5):
            aviary.step(np.zeros(aviary.given.shape))
        return [array.copy() for array in aviary.swarm]

    first = flown()
    aviary.load_state(saved)
    np.testing.assert_array_equal(aviary.swarm.deflection, deflection)
    for one, again in zip(first, flown(), strict=True):
        np.testing.assert_array_equal(one, again)
    aviary.close()
