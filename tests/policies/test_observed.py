import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy

BASELINES = ("straight", "orca", "mvp", "voronoi")
CALM = {"dynamics": "single_integrator", "randomization": {}}
BLOCKS = ("position", "velocity")


def both(name, task, decisions=60, **options):
    """Actions of a policy of the true state and of its observed form, which see the same flight."""
    aviary = bulletuav.Aviary(task, 2, **{**CALM, **options})
    observations = aviary.reset(seeds=1)
    true, observed = (find_policy(one)(aviary) for one in (name, f"{name}_observed"))
    pairs = []
    for _ in range(decisions):
        actions = true.act(observations, aviary.swarm)
        pairs.append(
            (actions[aviary.alive], observed.act(observations, aviary.swarm)[aviary.alive])
        )
        observations = aviary.step(actions).observations
    aviary.close()
    return (np.concatenate(one) for one in zip(*pairs, strict=True))


@pytest.mark.parametrize("name", BASELINES)
@pytest.mark.parametrize(
    "options",
    [
        {"observation": (*BLOCKS, "goal_offset", "all_neighbours", "obstacles")},
        {"observation": (*BLOCKS, "goal", "neighbours", "obstacles"), "normalise": True},
        {
            "observation": (*BLOCKS, "goal", "goal_velocity", "neighbours", "obstacles"),
            "observation_format": "dict",
        },
    ],
)
def test_what_is_seen_whole_is_avoided_as_if_it_were_known(name, options):
    """Nothing is noisy, and all drones and obstacles are among the nearest ones."""
    true, observed = both(
        name, "obstacles", num_neighbours=10, num_obstacles=10, num_moving=5, **options
    )
    np.testing.assert_allclose(observed, true, atol=1e-4)
    assert np.abs(observed - true).mean() < 1e-6


def test_observed_forms_read_no_swarm():
    for name in BASELINES:
        assert not find_policy(f"{name}_observed").reads_swarm
        assert find_policy(name).reads_swarm


def test_only_what_is_observed_counts():
    """The nearest one of seven others, and noise."""
    for options in ({"num_neighbours": 1}, {"randomization": {"gps_noise": 1.0}}):
        true, observed = both("orca", "converge", **options)
        assert np.abs(observed - true).max() > 0.01


def test_goals_that_move_are_followed_where_their_velocity_is_observed():
    blocks = (*BLOCKS, "goal", "all_neighbours")
    true, observed = both("orca", "pursuit", observation=(*blocks, "goal_velocity"))
    np.testing.assert_allclose(observed, true, atol=1e-4)
    true, observed = both("orca", "pursuit", observation=blocks)
    assert np.abs(observed - true).max() > 0.01


def test_without_its_position_a_drone_knows_no_bounds():
    for blocks, faces in ((BLOCKS, 6), (BLOCKS[1:], 0)):
        aviary = bulletuav.Aviary(
            "crossing", observation=(*blocks, "goal_offset", "neighbours"), **CALM
        )
        observations = aviary.reset(seeds=0)
        policy = find_policy("orca_observed")(aviary)
        surface = policy.traffic(observations, aviary.swarm).surface
        assert surface.shape == (1, 8, faces, 4)
        assert np.isfinite(policy.act(observations, aviary.swarm)).all()
        aviary.close()


@pytest.mark.parametrize(
    ("task", "name", "observation", "said"),
    [
        ("crossing", "orca", ("goal", "neighbours"), "block 'velocity', and"),
        ("crossing", "mvp", ("velocity", "neighbours"), "block 'goal_offset' or 'goal', and"),
        ("crossing", "voronoi", ("velocity", "goal"), "'all_neighbours' or 'neighbours', and"),
        (
            "obstacles",
            "orca",
            ("velocity", "goal", "neighbours"),
            "'obstacles', and the observation has velocity, goal, neighbours: add it with option",
        ),
        ("crossing", "straight", ("velocity",), "block 'goal_offset' or 'goal', and"),
    ],
)
def test_blocks_that_are_missing_are_named(task, name, observation, said):
    aviary = bulletuav.Aviary(task, observation=observation, **CALM)
    with pytest.raises(ValueError, match=said):
        find_policy(f"{name}_observed")(aviary)
    aviary.close()


def test_one_drone_alone_flies_to_its_goal():
    for task in ("crossing", "converge"):
        aviary = bulletuav.Aviary(task, num_drones=1, num_neighbours=1, **CALM)
        observations = aviary.reset(seeds=0)
        policy = find_policy("orca_observed")(aviary)
        while aviary.alive.any():
            observations = aviary.step(policy.act(observations, aviary.swarm)).observations
        assert aviary.first_info()["success"].all()
        aviary.close()
