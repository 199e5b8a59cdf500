"""Where the scenarios start and where they lead."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
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


RANGES = [
    ({"num_moving": (5, 30)}, "num_moving \\(5, 30\\) of 25"),
    ({"num_moving": (9, 4)}, "from low to high is needed"),
    ({"num_moving": (-1, 4)}, "num_moving is -1"),
    ({"num_moving": (1, 2, 3)}, "num_moving is .* of 2 values is needed"),
    ({"num_moving": 2.5}, "num_moving is 2.5"),
    ({"obstacle_speed": (3.0, -3.0)}, "obstacle_speed is .* from low to high"),
    ({"obstacle_speed": (0.0, 200.0)}, "at most 100"),
    ({"obstacle_speed": (-200.0, 0.0)}, "at least -100"),
    ({"obstacle_speed": -1.0}, "must not be negative"),
    ({"obstacle_speed": "fast"}, "a finite number is needed"),
    ({"obstacle_radius": (5.0, 3.0)}, "from low to high"),
    ({"obstacle_radius": 0.0}, "above 0"),
]


@pytest.mark.parametrize(("options", "said"), RANGES)
def test_ranges_of_obstacles_that_cannot_be_are_refused(options, said):
    with pytest.raises(ValueError, match=said):
        bulletuav.Aviary("obstacles", **options)


@pytest.mark.parametrize("task", ["obstacles", "crossing"])
def test_obstacles_are_drawn_from_ranges_in_each_episode(task):
    """Task `obstacles` draws them with the starts, and `crossing` afterwards."""
    options = {"num_drones": 1, "num_obstacles": 12, "num_moving": (3, 6), "obstacle_radius": 4.0}
    options |= {"obstacle_speed": (-2.0, 5.0), "dynamics": "single_integrator", **CALM}
    aviary = bulletuav.Aviary(task, 200, **options)
    aviary.reset(seeds=list(range(200)))
    velocity = aviary.scene.obstacle_velocity.copy()
    counts = (velocity != 0).any(axis=-1).sum(axis=1)
    assert set(counts.tolist()) == {3, 4, 5, 6}
    moving = np.arange(12) < counts[:, None]
    np.testing.assert_array_equal((velocity != 0).any(axis=-1), moving)
    drawn = velocity[moving]
    assert -2.0 <= drawn.min() < -1.9
    assert 4.9 < drawn.max() <= 5.0
    np.testing.assert_allclose(aviary.task.field.radius, 4.0)
    # The same seeds give the same episodes
    aviary.reset(seeds=list(range(200)))
    np.testing.assert_array_equal(aviary.scene.obstacle_velocity, velocity)
    before = aviary.scene.obstacle.copy()
    aviary.step(np.zeros((200, 1, 3)))
    moved = (aviary.scene.obstacle != before).any(axis=-1)
    np.testing.assert_array_equal(moved, moving)
    aviary.close()


@pytest.mark.parametrize("task", ["obstacles", "crossing"])
def test_a_range_of_one_value_draws_what_a_number_draws(task):
    options = {"num_drones": 1, "num_obstacles": 12, "dynamics": "single_integrator", **CALM}
    drawn = []
    for numbers in (
        {"num_moving": 5, "obstacle_speed": 3.0, "obstacle_radius": 4.0},
        {"num_moving": (5, 5), "obstacle_speed": (-3.0, 3.0), "obstacle_radius": (4.0, 4.0)},
    ):
        aviary = bulletuav.Aviary(task, 3, **options, **numbers)
        aviary.reset(seeds=[0, 1, 2])
        scene = aviary.scene
        drawn.append((scene.obstacle.copy(), scene.obstacle_velocity.copy(), scene.goal.copy()))
        aviary.close()
    for one, other in zip(*drawn, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("drones", [300, 1000, 2500])
@pytest.mark.parametrize("task", ["crossing", "converge", "free_flight", "flocking"])
def test_airspaces_grow_with_large_swarms(task, drones):
    aviary = bulletuav.Aviary(task, num_drones=drones, dynamics="point_mass")
    aviary.reset(seeds=0)
    place, goal = aviary.swarm.position[0], aviary.scene.goal[0]
    assert cKDTree(place).query(place, 2)[0][:, 1].min() > aviary.task.config.d_safe
    low, high = aviary.task.arena_low, aviary.task.arena_high
    for points in (place, goal):
        assert ((low < points) & (points < high)).all()
    if task == "converge":
        np.testing.assert_allclose((place + goal)[:, :2], 0.0, atol=1.0)
        assert len(np.unique(goal[:, 2])) == {300: 3, 1000: 7, 2500: 12}[drones]
    if task == "crossing":
        along = np.ptp(place[: drones // 2, 1])
        assert along < 99 * aviary.task.config.lane_spacing + 2
    aviary.close()


@pytest.mark.parametrize(
    ("difficulty", "drones"), [("easy", 300), ("easy", 2500), ("medium", 10_000), ("hard", 10_000)]
)
def test_large_swarms_cross_at_any_difficulty(difficulty, drones):
    options = {"dynamics": "point_mass", "difficulty": difficulty}
    aviary = bulletuav.Aviary("crossing", num_drones=drones, **options)
    assert aviary.task.arena_high[0] < 2048
    aviary.close()


@pytest.mark.parametrize("task", ["navigation", "los", "patrol"])
def test_cities_grow_with_large_swarms(task):
    options = {"num_layouts": 1, "dynamics": "point_mass"}
    aviary = bulletuav.Aviary(task, num_drones=600, **options)
    aviary.reset(seeds=0)
    place = aviary.swarm.position[0]
    apart = aviary.task.config.min_separation
    assert cKDTree(place).query(place, 2)[0][:, 1].min() >= apart
    # A fifth of the city's square is covered by discs of that diameter
    side = np.sqrt(600 * np.pi / 4 * apart**2 / 0.2)
    np.testing.assert_allclose(aviary.task.arena_high[:2], side / 2, rtol=1e-9)
    aviary.close()
    # Smaller swarms have the city that was asked for
    few = bulletuav.Aviary(task, num_drones=20, **options)
    assert few.task.arena_high[0] == few.task.config.area / 2
    few.close()


def test_cities_without_room_name_the_side_that_is_needed():
    with pytest.raises(ValueError, match=r"need a city of side 6267 m.*lower min_separation"):
        bulletuav.Aviary("coverage", num_drones=1000)
