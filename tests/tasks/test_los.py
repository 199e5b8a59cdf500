"""Task `los`: who sees whom, what that is worth, and what is observed of users."""

import numpy as np
import pytest
from urban import DRONES, SEEN, STAY, TOWER, USERS, blocked

import bulletuav


def test_sight_by_hand(put_urban):
    exact = [
        [not blocked(drone, user, TOWER.solids.boxes[0]) for user in USERS] for drone in DRONES
    ]
    np.testing.assert_array_equal(exact, SEEN)
    aviary = put_urban("los", TOWER, DRONES, users=USERS, weights={"served": 2.0, "sight": 1.0})
    step = aviary.step(np.zeros((1, 2, 3)))
    np.testing.assert_allclose(step.info["reward/sight"][0], (0.6, 0.4))
    # Of 5 users each but the second is seen.
    np.testing.assert_allclose(step.info["reward/served"][0], 2 * 0.8)
    np.testing.assert_allclose(step.rewards[0], (2.2, 2.0))
    assert not step.terminated.any()


@pytest.mark.parametrize(("wanted", "success"), [(0.8, True), (0.81, False)])
def test_success_is_to_serve_as_many_as_wanted(put_urban, wanted, success):
    aviary = put_urban("los", TOWER, DRONES, users=USERS, wanted=wanted, horizon=3)
    for decisions in range(1, 4):
        step = aviary.step(np.zeros((1, 2, 3)))
        # Decisions to come count as without service
        np.testing.assert_allclose(step.info["mean_service"][0], 0.8 * decisions / 3)
    assert step.info["success"][0].tolist() == [success, success]


def test_service_at_the_end_of_an_episode_is_not_enough(put_urban):
    """A drone behind the tower comes into sight of the user, which then is seen to the end."""
    drones, users = [(-20.0, 0, 30)], [(90.0, 0, 1.5)]
    succeeded = []
    for wanted in (0.5, 0.3):
        aviary = put_urban("los", TOWER, drones, users=users, wanted=wanted, horizon=12)
        seen = []
        while aviary.alive.any():
            step = aviary.step(np.array([[(0.0, 0, 1)]]))
            seen.append(step.info["served"][0, 0])
        assert seen == sorted(seen)
        assert (seen[0], seen[-1]) == (0, 1)
        np.testing.assert_allclose(step.info["mean_service"][0, 0], np.mean(seen))
        succeeded.append(step.info["success"][0, 0] == (np.mean(seen) >= wanted))
    assert all(succeeded)


def test_targets_are_observed_where_they_are_and_whether_they_are_seen(put_urban):
    aviary = put_urban("los", TOWER, DRONES, users=USERS)
    moved = np.array([(0.0, 0.15, 0), (0.15, 0, 0)])
    for observation, place in (
        (aviary.reset(seeds=0), DRONES),
        (aviary.step(np.array([moved / 1.5])).observations, None),
    ):
        place = DRONES + moved if place is None else place
        told = observation[0, :, -20:].reshape(2, 5, 4)
        np.testing.assert_allclose(told[..., :3], USERS - place[:, None], rtol=1e-6)
        np.testing.assert_array_equal(told[..., 3], SEEN)
    assert aviary.observer.labels[-1].name == "target 5 seen"


def test_who_has_left_sees_nothing_and_serves_nobody(put_urban):
    aviary = put_urban("los", TOWER, DRONES, users=USERS, weights={"sight": 1.0}, wanted=0.8)
    while aviary.alive.all():
        step = aviary.step(np.array([[(0, 0, -1.0), STAY]]))  # the first one dives
    assert step.info["collision"][0].tolist() == [True, False]
    step = aviary.step(np.zeros((1, 2, 3)))
    assert step.info["reward/sight"][0].tolist() == [0, 0.4]
    assert step.info["reward/served"][0].tolist() == [0, 0.4]
    assert not step.info["success"].any()
    assert step.rewards[0].tolist() == pytest.approx([0, 0.8])


@pytest.mark.parametrize("task", ["los", "coverage"])
def test_infos_tell_what_is_served(task):
    options = {
        "num_drones": 2,
        "area": 250.0,
        "num_layouts": 1,
        "dynamics": "point_mass",
        "min_separation": 20.0,
    }
    aviary = bulletuav.Aviary(task, 2, **options)
    aviary.reset(seeds=0)
    step = aviary.step(np.zeros((2, 2, 3)))
    seen = aviary.worlds.frame.readings["sight"].any(axis=1)
    np.testing.assert_allclose(
        step.info["served"], np.repeat(seen.mean(axis=-1)[:, None], 2, axis=1)
    )
    assert 0 < step.info["served"].min() < 1
    aviary.close()


def test_contributions_count_users_that_no_other_drone_sees():
    blocks = ("contribution_ahead", "sight_matrix", "sight_ahead")
    aviary = bulletuav.Aviary("los", 3, observation=blocks, dynamics="single_integrator")
    aviary.reset(seeds=0)
    rows = aviary.step(np.random.default_rng(0).uniform(-1, 1, (3, 3, 3))).observations
    contribution, sight, ahead = np.split(rows.astype(float), [5, 65], axis=-1)
    own, *others = np.moveaxis(sight.reshape(3, 3, 3, 20), 2, 0)
    free = ~np.any(others, axis=0)
    assert free.any()
    assert not free.all()
    np.testing.assert_allclose(contribution[..., 0], 100 * (own * free).mean(axis=-1), atol=1e-5)
    gains = 100 * ((ahead.reshape(3, 3, 4, 20) - own[:, :, None]) * free[:, :, None]).mean(axis=-1)
    np.testing.assert_allclose(contribution[..., 1:], gains, atol=1e-5)
    # Users that only an inactive drone saw count for the others
    aviary.alive[:] = [True, False, False]
    alone = aviary.observer.observe(aviary.current_frame(), aviary.alive)[:, 0]
    np.testing.assert_allclose(alone[:, 0], 100 * own[:, 0].mean(axis=-1), atol=1e-5)
    aviary.close()
