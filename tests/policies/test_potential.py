import numpy as np
import pytest

import bulletuav
from bulletuav.policies.potential import Field, PotentialField, repulsion
from bulletuav.policies.straight import StraightLine

FIELD = Field(strength=10.0, drones=2.0, surfaces=1.0, influence=8.0, contact=0.1, body=0.5)
HIGH = 100.0  # m, far from the ground


def push(position, alive=None, obstacle=(), radius=(), field=FIELD):
    position = np.array([position], float)
    alive = np.ones(position.shape[:2], bool) if alive is None else np.array([alive])
    return repulsion(
        position, alive, np.array(obstacle, float).reshape(1, -1, 3), np.array(radius, float), field
    )[0]


def test_push_of_a_pair_by_hand():
    """4 m apart: 10 * 2^3 (1/4 - 1/8) / 4^2 = 0.625 m/s, along (0.6, 0.8, 0)."""
    first, second = push([(0, 0, HIGH), (2.4, 3.2, HIGH)])
    np.testing.assert_allclose(second, 0.625 * np.array((0.6, 0.8, 0)), atol=1e-12)
    np.testing.assert_allclose(first, -second)


def test_pushes_are_the_gradient_of_the_potential():
    def potential(place):
        return 0.5 * 80 * (1 / np.linalg.norm(place) - 1 / 8) ** 2

    place, h = np.array((1.0, -2.0, 2.5)), 1e-5
    gradient = [
        (potential(place + h * axis) - potential(place - h * axis)) / (2 * h) for axis in np.eye(3)
    ]
    lift = np.array((0, 0, HIGH))
    np.testing.assert_allclose(push([place + lift, lift])[0], -np.array(gradient), rtol=1e-6)


def test_nothing_pushes_beyond_its_influence():
    assert (push([(0, 0, HIGH), (8.001, 0, HIGH)]) == 0).all()
    assert (push([(0, 0, HIGH)], obstacle=[(11.501, 0, HIGH)], radius=[3]) == 0).all()
    assert (push([(0, 0, 8.501)]) == 0).all()


def test_the_dead_neither_push_nor_are_pushed():
    assert (push([(0, 0, HIGH), (4, 0, HIGH)], alive=[True, False]) == 0).all()


def test_obstacles_and_the_ground_push_from_their_surface():
    """4 m from surface to surface: 10 * 1^3 (1/4 - 1/8) / 4^2 = 0.078125 m/s."""
    np.testing.assert_allclose(
        push([(0, 0, HIGH)], obstacle=[(7.5, 0, HIGH)], radius=[3]), [(-0.078125, 0, 0)]
    )
    np.testing.assert_allclose(push([(0, 0, 4.5)]), [(0, 0, 0.078125)])


def test_contact_pushes_hard_and_finitely():
    """From 0.1 m and nearer 10 (1/0.1 - 1/8) / 0.1^2 = 9875 m/s."""
    inside = push([(0, 0, HIGH)], obstacle=[(1, 0, HIGH)], radius=[3])
    np.testing.assert_allclose(inside, [(-9875, 0, 0)])
    assert (push([(0, 0, HIGH), (0, 0, HIGH)]) == 0).all()  # in one point there is no direction


@pytest.fixture
def aviary():
    aviary = bulletuav.Aviary("crossing", 4, dynamics="double_integrator")
    yield aviary
    aviary.close()


def test_head_on_pair_gets_mirrored_velocities_within_the_limit(aviary):
    aviary.reset(seeds=0)
    aviary.alive[:, 2:] = False
    aviary.swarm.position[:, :2] = (-4, 0, 60), (4, 0, 60)
    aviary.scene.goal[:, :2] = (50, 0, 60), (-50, 0, 60)
    action = PotentialField(aviary).act(np.zeros(0), aviary.swarm)
    np.testing.assert_allclose(action[:, 0], -action[:, 1], atol=1e-12)
    assert (action[:, 0, 0] < 1).all()
    assert np.linalg.norm(action, axis=-1).max() <= 1 + 1e-12


def test_policy_has_fewer_conflicts_than_straight(aviary):
    def conflicts(policy):
        observations, count = aviary.reset(seeds=0), 0
        policy.reset(np.ones(4, bool))
        while aviary.alive.any():
            step = aviary.step(policy.act(observations, aviary.swarm))
            observations = step.observations
            count += step.info["conflicts"].sum() // 2
        return count

    assert conflicts(PotentialField(aviary)) < 0.8 * conflicts(StraightLine(aviary))
