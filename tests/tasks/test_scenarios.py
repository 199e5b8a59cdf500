"""Where the scenarios start and where they lead."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

import bulletuav
from bulletuav.policies import find_policy

CALM = {"randomization": {}}
REFUSED = [
    ("converge", {"radius": 5.0}, "start positions may be in conflict"),
    ("converge", {"altitude": 1.0}, "too low for jitter"),
    ("obstacles", {"area": 40.0}, "keep others out of"),
    ("obstacles", {"num_moving": 26}, "num_moving 26 of 25"),
    ("obstacles", {"obstacle_radius": (0.0, 5.0)}, "obstacle_radius is"),
    ("obstacles", {"altitude": 10.0}, "too low for altitude_spread"),
    ("obstacles", {"leg": 150.0}, "leg 150 m with jitter 0 m is too long"),
    ("converge", {"at_goal": "rest"}, "unknown at_goal 'rest'"),
    ("converge", {"boundary": "sof"}, "did you mean 'soft'"),
    ("converge", {"warning_zone": 1.0}, "warning_zone is 1"),
    ("converge", {"discount": 1.5}, "discount is 1.5"),
    ("converge", {"normalise": 1}, "normalise is 1"),
    ("converge", {"num_neighbours": 0}, "num_neighbours is 0"),
]


@pytest.mark.parametrize(("task", "options", "said"), REFUSED)
def test_what_cannot_be_is_refused(task, options, said):
    with pytest.raises(ValueError, match=said):
        bulletuav.Aviary(task, **options)


def test_converge_starts_on_a_circle_and_leads_to_antipodes():
    aviary = bulletuav.Aviary("converge", 20, jitter=1.0)
    aviary.reset(seeds=0)
    angle = 2 * np.pi * np.arange(8) / 8
    circle = np.stack([80 * np.cos(angle), 80 * np.sin(angle), np.full(8, 40.0)], axis=1)
    off = aviary.swarm.position - circle
    assert (np.abs(off) <= 1).all()
    assert np.abs(off).max(axis=(0, 1)).min() > 0.9  # on each axis
    np.testing.assert_allclose(aviary.scene.goal[0], circle * (-1, -1, 1), atol=1e-12)
    along = (aviary.swarm.velocity * (aviary.scene.goal - aviary.swarm.position)).sum(axis=-1)
    np.testing.assert_allclose(
        along, np.linalg.norm(aviary.swarm.velocity, axis=-1) * aviary.first_info()["goal_distance"]
    )
    aviary.close()


def test_obstacles_start_clear_and_everything_has_its_room():
    aviary = bulletuav.Aviary("obstacles", 20, difficulty="hard")
    aviary.reset(seeds=0)
    radius = np.array([obstacle.radius for obstacle in aviary.task.obstacles()])
    assert (radius >= 3).all()
    assert (radius <= 10).all()
    assert np.ptp(radius) > 5
    assert {obstacle.kind for obstacle in aviary.task.obstacles()} == {"sphere", "box"}
    for w in range(20):
        for places in (aviary.swarm.position[w], aviary.scene.goal[w]):
            assert pdist(places).min() > 10
            gaps = np.linalg.norm(places[:, None] - aviary.scene.obstacle[w], axis=-1) - radius
            assert gaps.min() > 5
    assert (aviary.first_info()["goal_distance"] >= 80).all()
    moving = np.any(aviary.scene.obstacle_velocity != 0, axis=-1)
    np.testing.assert_array_equal(moving, np.tile(np.arange(25) < 16, (20, 1)))
    assert np.abs(aviary.scene.obstacle_velocity).max() <= 5
    aviary.close()


def test_moving_obstacles_are_reflected_at_the_bounds():
    aviary = bulletuav.Aviary(
        "obstacles",
        num_drones=1,
        dynamics="single_integrator",
        obstacle_speed=40.0,
        horizon=300,
        **CALM,
    )
    aviary.reset(seeds=0)
    place, velocity = aviary.scene.obstacle[0].copy(), aviary.scene.obstacle_velocity[0].copy()
    low, high = np.array((-100, -100, 25.0)), np.array((100, 100, 55.0))
    for step in range(1, 200):
        aviary.step(np.zeros((1, 1, 3)))
        # A triangle wave in closed form.
        folded = (place + 0.1 * step * velocity - low) % (2 * (high - low))
        folded = low + np.minimum(folded, 2 * (high - low) - folded)
        np.testing.assert_allclose(aviary.scene.obstacle[0], folded, atol=1e-9)
        np.testing.assert_allclose(np.abs(aviary.scene.obstacle_velocity[0]), np.abs(velocity))
        if not aviary.alive.any():
            break
    assert step > 60
    aviary.close()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "point_mass"])
def test_obstacles_can_be_hit_where_they_have_moved_to(dynamics):
    """A drone that flies to where an obstacle is now ends in a collision with it."""
    aviary = bulletuav.Aviary("obstacles", num_drones=1, dynamics=dynamics, **CALM)
    aviary.reset(seeds=2)
    while aviary.alive.any():
        towards = aviary.scene.obstacle[0, 0] - aviary.swarm.position[0, 0]
        step = aviary.step((towards / np.linalg.norm(towards))[None, None])
    assert step.info["collision"].all()
    assert step.info["reward/obstacle_warning"][0, 0] < -4
    gap = np.linalg.norm(aviary.scene.obstacle[0, 0] - aviary.swarm.position[0, 0])
    assert gap < aviary.task.obstacles()[0].radius + 1
    aviary.close()


def test_a_hundred_drones_fly_in_extreme_converge():
    aviary = bulletuav.Aviary("converge", difficulty="extreme")
    observations = aviary.reset(seeds=0)
    policy = find_policy("orca")(aviary)
    for _ in range(3):
        step = aviary.step(policy.act(observations, aviary.swarm))
    assert aviary.alive.sum() == 100
    assert np.isfinite(step.observations).all()
    aviary.close()
