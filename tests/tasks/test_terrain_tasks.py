"""Tasks in hills and forests: starts, goals, airspace, and what needs flat ground or streets."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

import bulletuav
from bulletuav.envs.env_spec import EnvSpec

WOODED = {"kind": "wooded_hills", "relief": 25.0, "tree_density": 60}
SMALL = {"area": 200.0, "num_layouts": 2, "min_separation": 10.0}


@pytest.mark.parametrize("kind", ["hills", "forest", WOODED])
@pytest.mark.parametrize("task", ["navigation", "lidar_navigation", "default", "coverage"])
def test_starts_and_goals_are_above_the_ground_and_clear_of_trees(task, kind):
    leg = {"leg": 80.0} if "navigation" in task else {}
    one = EnvSpec(task, 1, {"city": kind, "num_drones": 4, **SMALL, **leg}).task
    low, high = one.config.height
    margin = one.context.collision_radius + 1
    for seed in range(15):
        spawn = one.spawn(np.random.default_rng(seed))
        city = one.city_layouts.cities[spawn.layout]
        for places in (spawn.position, spawn.goal):
            above = places[:, 2] - city.surface(places)
            assert ((above >= low - 1e-9) & (above <= high + 1e-9)).all()
            assert city.outdoors(places, margin).all()
            assert pdist(places).min() >= 10
            assert ((places > one.arena_low) & (places < one.arena_high)).all()
        if leg:
            assert np.linalg.norm(spawn.goal - spawn.position, axis=1).min() >= 80


def test_the_ceiling_is_above_the_highest_ground():
    def ceiling(city):
        one = EnvSpec("navigation", 1, {"city": city, "leg": 50.0, **SMALL}).task
        highest = [
            0 if one.ground is None else one.ground.corners.max() for one in one.city_layouts.cities
        ]
        return one.arena_high[2], max(highest)

    assert ceiling(WOODED) == (pytest.approx(15 + 25), pytest.approx(25))
    assert ceiling("forest") == (15, 0)


def test_what_is_free():
    one = EnvSpec("navigation", 1, {"city": WOODED, "leg": 50.0, **SMALL}).task
    city = one.city_layouts.cities[0]
    crown = city.raised.bounds[-1].mean(axis=0)
    high = city.ground.corners.max()
    for place, expected in (
        (crown, False),
        (crown + (0, 0, 30), True),
        ((*crown[:2], city.surface(crown) - 1), False),
        ((0, 0, high + 30), True),
        ((0, 0, float(city.surface(np.zeros(2))) + 0.1), False),
    ):
        assert one.is_free(np.array(place, dtype=float), 0.3, 0) == expected


def test_drones_fly_and_crash_into_hills():
    """They descend from their starts, and collide at the surface."""
    env = bulletuav.Aviary(
        "navigation", city="hills", num_drones=2, leg=50.0, dynamics="rigid_body", seed=0, **SMALL
    )
    env.reset()
    start = env.swarm.position[0].copy()
    city = env.task.city_layouts.cities[env.scene.layout[0]]
    down = np.tile((0.0, 0.0, -0.3), (1, 2, 1))
    lowest = np.full(2, np.inf)
    ended = np.zeros(2, dtype=bool)
    for _ in range(60):
        flying = env.alive[0].copy()
        heights = env.swarm.position[0, :, 2] - city.surface(env.swarm.position[0])
        lowest = np.where(flying, heights, lowest)
        ended |= env.step(down).terminated[0]
        if ended.all():
            break
    assert ended.all()
    assert ((lowest > 0) & (lowest < 1.5)).all()
    assert (start[:, 2] - city.surface(start) > 5).all()
    env.close()


def test_users_walk_in_forests_and_below_crowns():
    one = EnvSpec("los", 1, {"city": "forest", "num_users": 400, **SMALL}).task
    users = one.spawn(np.random.default_rng(0)).memory["users"]
    city = one.city_layouts.cities[one.spawn(np.random.default_rng(0)).layout]
    assert city.outdoors(users, 0.09, headroom=2.0).all()
    assert 0.05 < (~city.outdoors(users)).mean() < 0.5


REFUSED = [
    ("los", {"city": "hills"}, "'hills' has hills, and users walk on flat ground only"),
    ("mec", {"city": WOODED}, "has hills, and users walk on flat ground only"),
    ("mobile_users", {"city": "forest"}, "'forest' has no streets, which users need"),
    ("navigation", {"city": "hills", "at_goal": "land"}, "drones land on flat ground only"),
    ("navigation", {"city": "hills", "take_off": True}, "drones land on flat ground only"),
    ("patrol", {"city": "hills"}, "turn off take-off, landing and charging pads"),
    ("navigation", {"city": "hills", "height": (0.3, 5.0)}, "at least 0.413 m above the slopes"),
    ("navigation", {"city": {"relief": 5.0}}, "a dict of terrain needs the key 'kind'"),
    ("navigation", {"city": {"kind": "urban"}}, "unknown kind of terrain 'urban'"),
    ("navigation", {"city": {"kind": "forest", "trees": 5}}, "unknown option of terrain 'forest'"),
    ("navigation", {"city": {"kind": "forest", "tree_density": 3000}}, "no gap between trees"),
    ("navigation", {"city": "hills", "area": 90.0}, "area is 90 m: its wavelength is 100 m"),
    ("navigation", {"city": "forrest"}, "unknown kind of city 'forrest': did you mean 'forest'"),
]


@pytest.mark.parametrize(("task", "options", "message"), REFUSED)
def test_what_terrain_does_not_offer(task, options, message):
    leg = {"leg": 50.0} if task == "navigation" else {}
    with pytest.raises(ValueError, match=message):
        EnvSpec(task, 1, {**SMALL, **leg, **options})


def test_flat_terrain_permits_landing():
    flat = {"kind": "hills", "relief": 0.0, "tree_density": 30.0}
    for option in ({"at_goal": "land"}, {"take_off": True}):
        EnvSpec("navigation", 1, {"city": flat, "leg": 50.0, **SMALL, **option})


def test_snapshots_fit_the_same_terrain_only():
    options = {"leg": 50.0, "dynamics": "point_mass", **SMALL}
    one, same, other = (
        bulletuav.Aviary("lidar_navigation", 2, city=city, num_drones=2, seed=seed, **options)
        for city, seed in ((WOODED, 0), (dict(WOODED), 5), ("forest", 0))
    )
    for env in (one, same, other):
        env.reset()
    actions = np.full((2, 2, 3), 0.3)
    one.step(actions)
    snapshot = one.save_state()
    same.load_state(snapshot)
    for env in (one, same):
        env.step(actions)
    np.testing.assert_array_equal(one.swarm.position, same.swarm.position)
    assert one.state_hash() == same.state_hash()
    with pytest.raises(ValueError, match="city"):
        other.load_state(snapshot)
    for env in (one, same, other):
        env.close()
