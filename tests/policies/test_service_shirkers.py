"""Policies that try to be paid for service without the work of a swarm do what they say."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.tasks import find_task

NAMES = (
    "service_fixed",
    "service_by_one",
    "service_but_one",
    "service_late",
    "service_half",
    "service_conflict",
)


@pytest.fixture(scope="module")
def flights():
    """Positions (T, N, 3) of drones, service (T,) and users of an episode by policy."""
    found = {}
    for name in ("oracle", *NAMES, "service_follow_one"):
        aviary = bulletuav.Aviary(
            "mobile_users", dynamics="point_mass", action="velocity", area=250.0, num_layouts=1
        )
        policy = find_policy(name)(aviary)
        observations = aviary.reset(seeds=0)
        policy.reset(np.ones(1, dtype=bool))
        positions, served, users = [aviary.swarm.position[0].copy()], [], []
        for _ in range(aviary.options.horizon):
            step = aviary.step(policy.act(observations, aviary.swarm))
            observations = step.observations
            positions.append(aviary.swarm.position[0].copy())
            users.append(aviary.scene.memory["users"][0].copy())
            served.append(step.info["served"][0, 0])
        found[name] = np.array(positions), np.array(served), np.array(users)
        aviary.close()
    return found


def test_each_serves_less_than_the_oracle(flights):
    served = {name: flown[1].mean() for name, flown in flights.items()}
    best = served.pop("oracle")
    # It serves as well, but after a conflict
    assert served.pop("service_conflict") < best
    assert max(served.values()) < best - 0.05


def test_fixed_places_are_on_a_ring_around_the_centre(flights):
    last = flights["service_fixed"][0][-1]
    np.testing.assert_allclose(np.linalg.norm(last[:, :2], axis=1), 0.6 * 125.0, atol=8.0)
    gaps = np.linalg.norm(last - np.roll(last, 1, axis=0), axis=1)
    np.testing.assert_allclose(gaps, 0.6 * 125.0 * np.sqrt(3), atol=12.0)


def test_followers_of_one_are_close_to_it(flights):
    positions, _, users = flights["service_follow_one"]
    gaps = np.linalg.norm(positions[30:, :, :2] - users[29:, :1, :2], axis=-1)
    assert np.median(gaps) < 25.0


def test_one_flies_and_the_others_stay(flights):
    moved = np.linalg.norm(np.ptp(flights["service_by_one"][0], axis=0), axis=1)
    assert moved[0] > 20.0
    assert moved[1:].max() < 5.0


def test_the_last_stays_and_the_others_fly(flights):
    moved = np.linalg.norm(np.ptp(flights["service_but_one"][0], axis=0), axis=1)
    assert moved[:-1].min() > 20.0
    assert moved[-1] < 5.0


def test_two_drones_are_in_conflict_first_and_then_serve(flights):
    positions, served, _ = flights["service_conflict"]
    pairs = [(0, 1), (0, 2), (1, 2)]
    gaps = np.array([np.linalg.norm(positions[:, i] - positions[:, j], axis=1) for i, j in pairs])
    assert ((gaps < 2.0).any(axis=1)).sum() == 1
    assert gaps[:, -30:].min() > 20.0
    assert served[-30:].mean() > flights["service_but_one"][1][-30:].mean()


def test_the_late_stay_for_half_of_the_episode(flights):
    positions = flights["service_late"][0]
    assert np.ptp(positions[:50], axis=0).max() < 5.0
    assert np.ptp(positions[50:], axis=0).max() > 20.0


def test_the_resting_land_after_half_of_the_episode(flights):
    positions, served, _ = flights["service_half"]
    assert positions[48, :, 2].min() > 30.0
    # On the ground or on roofs
    assert positions[-1, :, 2].max() < 30.0
    assert served[45] > 0.0
    assert served[-1] == 0.0


@pytest.mark.parametrize("task", ["los", "mobile_users", "mec", "mec_advanced", "coverage"])
def test_tasks_of_service_list_them(task):
    assert set(NAMES) <= set(find_task(task).shirkers)
