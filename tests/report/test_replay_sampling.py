"""Pages of large swarms: which drones and rows are in them."""

import dataclasses
import itertools

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.recording import fly_episode
from bulletuav.parsing import parse_json
from bulletuav.policies import find_policy
from bulletuav.report import replay_sampling
from bulletuav.report.replay_sampling import MAX_DETAILED, spread, take_sample


@pytest.fixture(scope="module")
def swarm():
    """A flight of 300 drones, with conflicts."""
    aviary = bulletuav.Aviary("crossing", num_drones=300, dynamics="point_mass", horizon=25)
    recording = fly_episode(aviary, find_policy("straight")(aviary), 0)
    aviary.close()
    return recording, parse_json(str(recording.scene["about"]), "scene")


def test_first_indices_are_spread_evenly():
    # Bit reversal of 0 to 7, by hand
    assert spread(8, 8).tolist() == [0, 4, 2, 6, 1, 5, 3, 7]
    assert spread(6, 3).tolist() == [0, 3, 1]
    for count in (257, 1000, 10_000):
        indices = spread(count, 256)
        assert len(np.unique(indices)) == 256
        gaps = np.diff(np.append(np.sort(indices), count))
        assert gaps.max() <= 2 * count / 256
        assert np.diff(np.sort(indices[:16])).max() <= count / 16 + 1


def test_small_swarms_are_whole(swarm):
    recording, about = swarm
    few = {**about, "airframe_of": about["airframe_of"][:5]}
    one = dataclasses.replace(recording, position=recording.position[:, :5])
    sample = take_sample(one, few)
    assert sample.recording is one
    assert sample.drones == [0, 1, 2, 3, 4]
    assert sample.every == 1


def test_all_positions_and_conflicts_of_large_swarms_are_kept(swarm, monkeypatch):
    recording, about = swarm
    # 7 rows of 300 drones: every fourth of 26, and the last
    monkeypatch.setattr(replay_sampling, "MAX_POSITIONS", 300 * 7)
    sample = take_sample(recording, about)
    assert sample.every == 4
    rows = [0, 4, 8, 12, 16, 20, 24, 25]
    taken, order = sample.recording, sample.order
    np.testing.assert_array_equal(np.sort(order), np.arange(300))
    np.testing.assert_array_equal(order[:MAX_DETAILED], sample.drones)
    np.testing.assert_array_equal(taken.time, recording.time[rows])
    np.testing.assert_array_equal(taken.position, recording.position[rows][:, order])
    np.testing.assert_array_equal(taken.alive, recording.alive[rows][:, order])
    for name in ("quaternion", "velocity", "goal"):
        expected = getattr(recording, name)[rows][:, sample.drones]
        np.testing.assert_array_equal(getattr(taken, name), expected)
    for k, (first, last) in enumerate(itertools.pairwise(rows)):
        nearest = recording.separation[first:last].min(axis=0)[order]
        np.testing.assert_array_equal(taken.separation[k], nearest)
        expected = recording.reward[last - 1][sample.drones]
        np.testing.assert_array_equal(taken.reward[k], expected)
    assert [about["airframe_of"][drone] for drone in order] == sample.about["airframe_of"]
    # Contacts are shown at the first row that is not earlier
    for step, shown in zip(recording.contact_step, taken.contact_step, strict=True):
        assert rows[shown + 1] >= step + 1 > rows[shown]
