"""Policies of `pad_landing`: pads in pictures, their tracks, the search and the shirkers."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.pad_approach import match_pads
from bulletuav.policies.pad_vision import PadTracks, find_pads, picture_rays


def picture_of(centres, height, size=(64, 64), tilt=0.0):
    """Points of a picture from the origin, looking 45 degrees down to the east, of discs."""
    rays = picture_rays(size, np.pi / 2)
    s = np.sqrt(0.5)
    frame = np.array([[s, 0, -s], [0, 1, 0], [s, 0, s]])  # forward, left, up
    ray = rays @ frame
    down = ray[..., 2] < -1e-6
    scale = np.where(down, -height / np.minimum(ray[..., 2], -1e-6), 0.0)
    points = ray * scale[..., None]
    gap = np.linalg.norm(points[..., None, :2] - np.array(centres), axis=-1)
    return points, down & (gap < 0.6).any(axis=-1)


def test_rays_go_through_the_upper_left_corners_of_pixels():
    rays = picture_rays((4, 2), np.pi / 2)
    np.testing.assert_allclose(rays[0, 0], [1, 2, 0])  # 90 degrees high, twice as wide
    np.testing.assert_allclose(rays[1, 3], [1, -1, -1])


def test_centres_of_pads_are_found_in_whole_and_in_part():
    whole = [(3.0, 0.5), (6.0, -2.0)]
    found = find_pads(*picture_of(whole, 4.0, (128, 128)), 0.0)
    order = np.argsort(found[:, 0])
    np.testing.assert_allclose(found[order, :2], whole, atol=0.08)
    np.testing.assert_allclose(found[:, 2], -4.0)
    # Above its centre the camera shows the eastern half only
    found = find_pads(*picture_of([(0.1, 0.05)], 1.5, (128, 128)), 0.0)
    np.testing.assert_allclose(found[:, :2], [(0.1, 0.05)], atol=0.08)


def test_no_pad_is_found_without_pixels():
    points, is_pad = picture_of([(3.0, 0.0)], 4.0)
    assert find_pads(points, is_pad & False, 0.0).shape == (0, 3)


def test_tracks_of_pads_that_circle_predict_them():
    speed, radius = 1.0, 4.0
    tracks = PadTracks(speed, speed / radius)
    places = np.array([(10.0, 0.0, 1.0), (14.0, 3.0, 2.0)])

    def pads(time):
        angle = speed / radius * time
        return places + radius * np.array([np.cos(angle), np.sin(angle), 0.0])

    own = np.array((10.0, 0.0, 3.0))
    for k in range(100):
        tracks.update(pads(0.1 * k), own, 0.1 * k)
    assert len(tracks.place) == 2
    assert tracks.turn_rate == pytest.approx(speed / radius, rel=0.3)
    error = np.linalg.norm(tracks.predict(10.9) - pads(10.9), axis=1)
    assert error.max() < 0.25  # a second after the last sight, in which pads moved 1 m
    tracks.update(np.zeros((0, 3)), own, 17.0)
    assert not len(tracks.place)  # forgotten


def test_the_nearest_pairs_of_drones_and_pads_come_first():
    drones = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (9.0, 0.0, 0.0)])
    pads = np.array([(2.0, 0.0, 0.0), (-3.0, 0.0, 0.0)])
    assert match_pads(drones, pads).tolist() == [1, 0, -1]


def test_the_seeker_lands_and_the_blind_one_does_not():
    options = {"dynamics": "rigid_body", "camera_hz": 10, "camera_size": (64, 64)}
    for name, succeeds in (("pad_seeker", True), ("pad_blind", False)):
        aviary = bulletuav.Aviary("pad_landing", 2, horizon=1500, **options)
        policy = find_policy(name)(aviary)
        observations = aviary.reset(seeds=3)
        policy.reset(np.ones(2, dtype=bool))
        done = np.zeros((2, 2), dtype=bool)
        while aviary.alive.any():
            step = aviary.step(policy.act(observations, aviary.swarm))
            observations = step.observations
            done |= step.terminated & step.info["success"].astype(bool)
        assert done.all() if succeeds else not done.any()
        aviary.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observation": ("velocity", "depth")}, "attitude"),
        ({"camera_mounts": [{"pitch": -45}, {"yaw": 90}]}, "one"),
        ({"normalise": True}, "normalise"),
        ({"camera_depth": "linear"}, "camera_depth"),
    ],
)
def test_observations_that_the_seeker_cannot_read_are_refused(options, message):
    aviary = bulletuav.Aviary("pad_landing", dynamics="rigid_body", **options)
    with pytest.raises(ValueError, match=message):
        find_policy("pad_seeker")(aviary)
    aviary.close()


@pytest.mark.parametrize("name", ["pad_hover", "pad_ground", "pad_drop", "pad_touch", "pad_same"])
def test_shirkers_earn_less_than_the_pilot(name):
    vector = ("velocity", "pad_clue")
    options = {"dynamics": "rigid_body", "observation": vector, "horizon": 1000}
    earned = {}
    for policy_name in ("pad_pilot", name):
        aviary = bulletuav.Aviary("pad_landing", 3, **options)
        policy = find_policy(policy_name)(aviary)
        aviary.reset(seeds=2)
        policy.reset(np.ones(3, dtype=bool))
        total, done = np.zeros((3, 2)), np.zeros((3, 2), dtype=bool)
        while aviary.alive.any():
            step = aviary.step(policy.act(None, aviary.swarm))
            total += step.rewards
            done |= step.terminated & step.info["success"].astype(bool)
        earned[policy_name] = total.mean(), done.mean()
        aviary.close()
    assert earned["pad_pilot"][1] == 1.0
    assert earned[name][1] <= 0.5  # one of two drones lands on the same pad
    assert earned[name][0] < 0.6 * earned["pad_pilot"][0]
