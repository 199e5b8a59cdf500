"""Policies of `flocking`: formulas, flocks that form, and policies that avoid the task."""

import math

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.flocking import (
    OLFATI_SABER,
    REYNOLDS,
    VASARHELYI,
    FlockRules,
    braking_curve,
    bump,
    olfati_saber_velocities,
    reynolds_velocities,
    sigma_1,
    sigma_norm,
    vasarhelyi_velocities,
)
from bulletuav.policies.traffic import Traffic
from bulletuav.tasks import find_task

RULES = FlockRules(spacing=10.0, link_range=15.0, radius=20.0, speed=6.0, leads=True)
FLOCKS = ("reynolds", "olfati_saber", "vasarhelyi", "flock_oracle")


def seen(others=(), velocities=(), spheres=(), walls=(), own=(6.0, 0, 0), goal=(0.0, 0, 0)):
    """What one drone sees: offsets and velocities of others, (offset, radius), (normal, gap)."""

    def rows(given, width):
        return np.array(given, dtype=float).reshape(1, 1, -1, width)

    return Traffic(
        velocity=np.array([[own]], dtype=float),
        goal=np.array([[goal]], dtype=float),
        goal_velocity=np.array([[(6.0, 0, 0)]]),
        offset=rows(others, 3),
        other_velocity=rows(velocities or [(6.0, 0, 0)] * len(others), 3),
        known=np.ones((1, 1, len(others)), dtype=bool),
        sphere=rows([one for one, _ in spheres], 3),
        sphere_velocity=np.zeros((1, 1, len(spheres), 3)),
        sphere_radius=np.array([radius for _, radius in spheres], dtype=float).reshape(1, 1, -1),
        surface=rows([(*normal, gap) for normal, gap in walls], 4),
    )


RULE_OF = {
    "reynolds": lambda traffic, rules=RULES: reynolds_velocities(traffic, rules, REYNOLDS)[0, 0],
    "olfati_saber": lambda traffic, rules=RULES: olfati_saber_velocities(
        traffic, rules, OLFATI_SABER
    )[0, 0],
    "vasarhelyi": lambda traffic, rules=RULES: vasarhelyi_velocities(traffic, rules, VASARHELYI)[
        0, 0
    ],
}


@pytest.mark.parametrize(
    ("distance", "speed"),
    [(-1.0, 0), (0.0, 0), (0.4, 1.28), (0.40625, 1.3), (2.0, math.sqrt(4 * 4.16 - 1.69))],
)
def test_the_braking_curve_is_linear_then_a_constant_deceleration(distance, speed):
    # a / p^2 = 0.40625 m and a / p = 1.3 m/s
    assert braking_curve(distance, 4.16, 3.2) == pytest.approx(speed)


def test_sigma_norm_and_bump_of_olfati_saber():
    # (sqrt(1 + 0.1 * 100) - 1) / 0.1
    assert sigma_norm(10.0, 0.1) == pytest.approx(10 * (math.sqrt(11) - 1))
    assert sigma_1(0.75) == pytest.approx(0.6)
    assert [bump(z, 0.2) for z in (0.1, 0.6, 1.0)] == pytest.approx([1, 0.5, 0])


@pytest.mark.parametrize("name", RULE_OF)
def test_a_drone_alone_flies_as_the_leader_does(name):
    np.testing.assert_allclose(RULE_OF[name](seen()), (6, 0, 0), atol=1e-12)
    # From beyond the radius of the lattice the pull is at most 4 m/s
    far = RULE_OF[name](seen(goal=(100.0, 0, 2)))
    assert far[0] == pytest.approx(8.0 if name == "olfati_saber" else 10.0)
    assert far[2] == 2
    assert RULE_OF[name](seen(goal=(0, 0, 50)))[2] == 3


@pytest.mark.parametrize("name", RULE_OF)
def test_without_a_leader_drones_keep_their_direction(name):
    rules = RULES._replace(leads=False)
    along = RULE_OF[name](seen(own=(0.0, 6.0, 0)), rules)
    np.testing.assert_allclose(along, (0, 6, 0), atol=1e-12)
    slow = RULE_OF[name](seen(own=(0.0, 3.0, 0)), rules)
    assert slow[0] == 0
    assert 3 < slow[1] <= 6


@pytest.mark.parametrize("name", RULE_OF)
def test_drones_repel_and_align(name):
    near = RULE_OF[name](seen([(0, 6.0, 0)]))
    assert near[1] < -0.5
    faster = RULE_OF[name](seen([(0, 10.0, 0)], [(9.0, 0, 0)]))
    assert faster[0] > 6
    # Drones at the spacing with equal velocities do nothing but gather in `reynolds`
    at_rest = RULE_OF[name](seen([(0, 10.0, 0)]))
    expected = (6, REYNOLDS.cohesion * 10 if name == "reynolds" else 0, 0)
    np.testing.assert_allclose(at_rest, expected, atol=1e-12)


@pytest.mark.parametrize("name", RULE_OF)
def test_obstacles_and_walls_repel(name):
    for traffic in (seen(spheres=[((7.0, 0, 0), 5.0)]), seen(walls=[((-1.0, 0, 0), 2.0)])):
        assert RULE_OF[name](traffic)[0] < 5
    # Unused rows, floors and ceilings do not
    for traffic in (seen(spheres=[((0, 0, 0), 0.0)]), seen(walls=[((0, 0, 1.0), 0.1)])):
        np.testing.assert_allclose(RULE_OF[name](traffic), (6, 0, 0), atol=1e-12)


def test_numbers_of_vasarhelyi():
    gains = VASARHELYI
    # Repulsion p_rep (r0 - r)
    assert RULE_OF["vasarhelyi"](seen([(0, 6.0, 0)]))[1] == pytest.approx(-4 * gains.p_rep)
    # Alignment c (v_ij - v_frict)
    faster = RULE_OF["vasarhelyi"](seen([(0, 12.0, 0)], [(9.0, 0, 0)]))
    assert faster[0] == pytest.approx(6 + gains.c_frict * (3 - 0.63))
    # A shill agent 2 m ahead, which flies towards the drone
    brake = math.sqrt(2 * gains.a_shill * 1.7 - (gains.a_shill / gains.p_shill) ** 2)
    ahead = RULE_OF["vasarhelyi"](seen(walls=[((-1.0, 0, 0), 2.0)]))
    assert ahead[0] == pytest.approx(6 - (gains.v_shill + 6 - brake))


def test_vasarhelyi_approaches_velocities_with_a_lag_in_single_integrator():
    expected = {}
    for dynamics in ("point_mass", "single_integrator"):
        aviary = bulletuav.Aviary("flocking", dynamics=dynamics, difficulty="easy")
        policy = find_policy("vasarhelyi")(aviary)
        traffic = policy.traffic(aviary.reset(seeds=5), aviary.swarm)
        wanted = vasarhelyi_velocities(traffic, policy.rules, VASARHELYI)
        expected[dynamics] = (policy.flock_velocities(traffic), traffic.velocity, wanted)
        aviary.close()
    found, _, wanted = expected["point_mass"]
    np.testing.assert_array_equal(found, wanted)
    found, own, wanted = expected["single_integrator"]
    # 10 decisions a second and 0.3 s: a third of the way
    np.testing.assert_allclose(found, own + (wanted - own) / 3.0, atol=1e-12)


def test_numbers_of_olfati_saber():
    gains, sigma = OLFATI_SABER, lambda z: 10 * (math.sqrt(1 + 0.1 * z * z) - 1)
    near = 0.5 * (1 + math.cos(math.pi * (sigma(6) / sigma(15) - 0.2) / 0.8))
    z = sigma(6) - sigma(10)
    force = gains.gradient * near * 5 * z / math.sqrt(1 + z * z) * 6 / math.sqrt(1 + 0.1 * 36)
    velocity = RULE_OF["olfati_saber"](seen([(0, 6.0, 0)]))
    assert velocity[1] == pytest.approx(max(force, -gains.max_acceleration) * gains.horizon)


def fly(name, decisions=None, **options):
    given = {"dynamics": "point_mass", "difficulty": "easy", **options}
    aviary = bulletuav.Aviary("flocking", 2, **given)
    policy = find_policy(name)(aviary)
    observations = aviary.reset(seeds=5)
    policy.reset(np.ones(2, dtype=bool))
    for _ in range(decisions or aviary.options.horizon):
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations = step.observations
    aviary.close()
    return step.info


@pytest.mark.parametrize(
    ("name", "dynamics"),
    [
        *((name, "point_mass") for name in FLOCKS),
        *((name, "single_integrator") for name in ("vasarhelyi", "flock_oracle")),
    ],
)
def test_flocks_form(name, dynamics):
    info = fly(name, dynamics=dynamics)
    assert info["order"].min() > 0.97
    assert info["connectivity"].min() == 1
    assert info["success"].mean() > 0.8


def test_a_flock_without_leader_turns_at_the_walls():
    info = fly("vasarhelyi", leader=False, roam=30.0, horizon=300)
    assert info["order"].min() > 0.9
    assert not info["collision"].any()


def test_the_oracle_gathers_drones_without_a_leader():
    assert fly("flock_oracle", leader=False)["success"].all()
    assert fly("vasarhelyi", leader=False)["success"].mean() < 0.5


@pytest.mark.parametrize("name", find_task("flocking").shirkers)
def test_policies_that_avoid_the_task_do_not_succeed(name):
    assert fly(name)["success"].mean() < 0.2


@pytest.mark.parametrize("name", [*FLOCKS, "flock_heading", "flock_scatter"])
def test_other_tasks_raise(name):
    observation = ("position", "velocity", "goal_offset", "goal_velocity", "neighbours")
    aviary = bulletuav.Aviary("converge", dynamics="point_mass", observation=observation)
    with pytest.raises(ValueError, match=f"{name!r} supports task 'flocking', not 'converge'"):
        find_policy(name)(aviary)
    aviary.close()


def test_policies_need_their_observations():
    aviary = bulletuav.Aviary("flocking", dynamics="point_mass", observation=("velocity",))
    with pytest.raises(ValueError, match="'vasarhelyi' needs the observation block 'position'"):
        find_policy("vasarhelyi")(aviary)
    aviary.close()
