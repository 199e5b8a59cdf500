"""Masks of discrete actions: which moves are valid, and that random flight within them stays in."""

import numpy as np
import pytest

import bulletuav
from bulletuav.envs.gymnasium import CentralAviary
from bulletuav.policies import find_policy

SMALL = {"num_drones": 4, "difficulty": "easy", "radius": 20.0, "margin": 10.0, "horizon": 400}
"""Drones that fly at random leave this small arena one after the other"""


def made(action="discrete", worlds=1, **options):
    options = {"dynamics": "single_integrator", "action_masks": True, **SMALL, **options}
    return bulletuav.Aviary("converge", worlds, action=action, **options)


def fly_at_random(aviary):
    """Fly all episodes; return the number of drones that left, and of invalid moves."""
    observations, left, invalid = aviary.reset(seeds=3), 0, 0
    policy = find_policy("random")(aviary)
    policy.reset(np.ones(aviary.num_worlds, dtype=bool))
    while aviary.alive.any():
        flown = aviary.alive.copy()
        actions = policy.act(observations, aviary.swarm)
        if aviary.options.action_masks:
            chosen = actions.astype(int)
            valid = np.take_along_axis(aviary.action_masks(), chosen, axis=-1)[..., 0]
            invalid += int((valid[flown] == 0).sum())
        observations = aviary.step(actions).observations
        place = aviary.swarm.position
        outside = ((place < aviary.task.arena_low) | (place > aviary.task.arena_high)).any(axis=-1)
        left += int((outside & flown).sum())
    aviary.close()
    return left, invalid


@pytest.mark.parametrize("action", ["discrete", "discrete_27"])
@pytest.mark.parametrize("dynamics", ["single_integrator", "point_mass", "rigid_body"])
def test_random_flight_leaves_the_arena_only_without_masks(dynamics, action):
    free = {"action_masks": False, "dynamics": dynamics}
    assert fly_at_random(made(action, 4, **free))[0] > 2
    assert fly_at_random(made(action, 4, dynamics=dynamics)) == (0, 0)


def test_a_drone_that_flies_straight_while_it_may_stays_inside():
    """At cruise speed staying needs as much space as flying on: only the end speeds differ."""
    options = {"num_drones": 1, "num_obstacles": 0, "horizon": 400, "dynamics": "rigid_body"}
    aviary = bulletuav.Aviary("navigation", 12, action="discrete", action_masks=True, **options)
    aviary.reset(seeds=3)
    moves = np.repeat(np.arange(1, 7), 2)[:, None]
    while aviary.alive.any():
        valid = np.take_along_axis(aviary.action_masks()[:, 0], moves, axis=-1)
        aviary.step(np.where(valid, moves, 0)[:, None].astype(float))
        place = aviary.swarm.position[:, 0]
        assert ((place > aviary.task.arena_low) & (place < aviary.task.arena_high)).all()
    aviary.close()


def test_a_team_that_decides_less_often_holds_its_move_longer():
    options = {"action": "discrete", "action_masks": True, "dynamics": "single_integrator"}
    rates = {"chasers": 1, "evaders": 4}
    aviary = bulletuav.Aviary("pursuit_evasion", decision_every=rates, **options)
    aviary.reset(seeds=0)
    radius = np.array([one.collision_radius for one in aviary.options.airframe])
    # The distance of one move, times the decisions for which it is held
    speed = aviary.worlds.masks.velocity[:, 1, 0]
    path = speed / aviary.options.decision_hz * np.where(aviary.task.team == 1, 4, 1)
    for extra, valid in ((0.01, 1), (-0.01, 0)):
        aviary.swarm.position[0] = (aviary.task.arena_low + aviary.task.arena_high) / 2
        aviary.swarm.position[0, :, 0] = aviary.task.arena_high[0] - radius - path - extra
        assert (aviary.action_masks()[0, :, 1] == valid).all()
    aviary.close()


def test_a_move_is_invalid_where_one_decision_leads_beyond_the_bound():
    """Drones that follow immediately fly 2 m in a decision of 0.1 s at 20 m/s."""
    aviary = made(num_drones=1, decision_hz=10, max_speed=20.0)
    aviary.reset(seeds=0)
    radius = aviary.options.airframe[0].collision_radius
    middle = (aviary.task.arena_low + aviary.task.arena_high) / 2
    for axis in range(3):
        for side, bound in ((1, aviary.task.arena_high), (-1, aviary.task.arena_low)):
            limit = max(bound[axis], 0.0) if axis == 2 else bound[axis]
            move = 1 + 2 * axis + (side < 0)
            for distance, valid in ((2.01 + radius, 1), (1.99 + radius, 0)):
                aviary.swarm.position[0, 0] = middle
                aviary.swarm.position[0, 0, axis] = limit - side * distance
                expected = np.ones(7)
                expected[move] = valid
                np.testing.assert_array_equal(aviary.action_masks()[0, 0], expected)
    aviary.close()


def test_a_drone_with_inertia_needs_room_to_stop():
    """Velocity after the decision, and the distance to stop, by the documented formula."""
    aviary = made(num_drones=1, dynamics="point_mass", decision_hz=10, max_speed=20.0)
    aviary.reset(seeds=0)
    lag, radius = 0.25, aviary.options.airframe[0].collision_radius  # 1 / (1.6 * 2.5 rad/s)
    speed = 20 + (5 - 20) * np.exp(-0.1 / lag)  # from 5 m/s, commanded 20 m/s
    needed = speed * (0.1 + lag + speed / 10)
    stay = 5 * (0.1 + lag + 5 / 10)
    assert stay < needed
    aviary.swarm.velocity[0, 0] = (5.0, 0, 0)
    for distance, valid in ((needed + 0.01, 1), (needed - 0.01, 0)):
        aviary.swarm.position[0, 0] = (0, 0, aviary.task.arena_high[2] / 2)
        aviary.swarm.position[0, 0, 0] = aviary.task.arena_high[0] - radius - distance
        assert aviary.action_masks()[0, 0, 1] == valid
        assert aviary.action_masks()[0, 0, [0, 2]].all()
    aviary.close()


def test_a_drone_outside_can_stay_or_return():
    aviary = made(num_drones=1, dynamics="point_mass", boundary="open")
    aviary.reset(seeds=0)
    aviary.swarm.position[0, 0] = aviary.task.arena_high + (1.0, 0, -30.0)
    aviary.swarm.position[0, 0, 1] = 0
    aviary.swarm.velocity[0, 0] = 0
    assert aviary.action_masks()[0, 0, :3].tolist() == [1, 0, 1]
    aviary.close()


def test_drones_that_may_land_may_descend_to_the_ground():
    for lands in (False, True):
        aviary = made(num_drones=1, take_off=True) if lands else made(num_drones=1)
        aviary.reset(seeds=0)
        aviary.swarm.position[0, 0] = (0, 0, 1.0)
        assert aviary.action_masks()[0, 0, 6] == lands
        aviary.close()


def test_commanded_speeds_are_those_of_the_task():
    """Teams with another speed limit have another table of moves."""
    options = {"action": "discrete", "action_masks": True, "dynamics": "single_integrator"}
    aviary = bulletuav.Aviary("pursuit_evasion", chaser_speed=0.9, evader_speed=0.6, **options)
    assert len(set(aviary.task.speed_limit.tolist())) == 2
    speeds = np.linalg.norm(aviary.worlds.masks.velocity[:, 1:], axis=-1)
    limit = np.minimum(aviary.task.speed_limit, aviary.options.max_speed)
    np.testing.assert_allclose(speeds, np.broadcast_to(limit[:, None], speeds.shape))
    aviary.close()


def test_infos_of_pettingzoo_have_the_mask_of_each_agent():
    env = bulletuav.parallel_env(
        "converge", action="discrete", action_masks=True, dynamics="single_integrator", **SMALL
    )
    _, infos = env.reset(seed=0)
    while env.agents:
        actions = {}
        for agent in env.agents:
            mask = infos[agent]["action_mask"]
            assert mask.dtype == np.int8
            assert mask.shape == (7,)
            actions[agent] = env.action_space(agent).sample(mask)
        _, _, terminated, truncated, infos = env.step(actions)
        for agent, info in infos.items():
            if terminated[agent]:
                assert info["action_mask"].tolist() == [1] + 6 * [0]
            elif truncated[agent]:
                assert info["action_mask"].sum() > 1
    env.close()


def test_the_conversion_to_turns_passes_the_mask():
    env = bulletuav.aec_env("converge", action="discrete", action_masks=True, **SMALL)
    env.reset(seed=0)
    _, _, _, _, info = env.last()
    assert info["action_mask"].shape == (7,)
    env.close()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_batches_have_the_masks_of_new_episodes(mode):
    options = {"action": "discrete", "action_masks": True, "dynamics": "single_integrator"}
    env = bulletuav.batch_env(
        "converge", 2, autoreset_mode=mode, **options, **SMALL | {"horizon": 3}
    )
    _, infos = env.reset(seed=0)
    for _ in range(5):
        assert infos["action_mask"].shape == (2, 4, 7)
        np.testing.assert_array_equal(infos["action_mask"], env.aviary.action_masks())
        infos = env.step(np.zeros((2, 4)))[-1]
    env.close()


def test_masks_are_the_same_from_several_processes():
    options = {"action": "discrete", "action_masks": True, "dynamics": "single_integrator"}
    infos = []
    for workers in (1, 2):
        env = bulletuav.batch_env("converge", 2, workers=workers, **options, **SMALL)
        env.reset(seed=0)
        masks = [env.step(np.full((2, 4), 1))[-1]["action_mask"] for _ in range(20)]
        infos.append(np.array(masks))
        env.close()
    np.testing.assert_array_equal(*infos)
    assert infos[0].min() == 0


def test_gymnasium_has_the_masks_of_all_drones():
    one = CentralAviary("converge", action="discrete", action_masks=True, **SMALL)
    _, info = one.reset(seed=0)
    assert info["action_mask"].shape == (4, 7)
    one.close()


def test_masks_need_a_choice_of_velocities():
    for action in ("velocity", "rates"):
        with pytest.raises(ValueError, match="action_masks is True, .* no choice of velocities"):
            bulletuav.Aviary("converge", action=action, action_masks=True)
    aviary = bulletuav.Aviary("converge", action="discrete", dynamics="single_integrator")
    aviary.reset(seeds=0)
    with pytest.raises(ValueError, match="make it with action_masks=True"):
        aviary.action_masks()
    aviary.close()


def test_a_snapshot_restores_the_masks():
    aviary = made()
    aviary.reset(seeds=0)
    for _ in range(15):
        aviary.step(np.full((1, 4, 1), 1.0))
    saved, masks = aviary.save_state(), aviary.action_masks()
    aviary.reset(seeds=1)
    aviary.load_state(saved)
    np.testing.assert_array_equal(aviary.action_masks(), masks)
    # Masks do not change how the flight continues
    without = made(action_masks=False)
    without.load_state(saved)
    actions = np.full((1, 4, 1), 3.0)
    one, other = aviary.step(actions), without.step(actions)
    np.testing.assert_array_equal(one.observations, other.observations)
    assert aviary.state_hash() == without.state_hash()
    aviary.close()
    without.close()
