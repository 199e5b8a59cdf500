"""Starts that users give in a reset: positions, motions and charges, for all or single worlds."""

import numpy as np
import pytest

import bulletuav

WORLDS, DRONES = 4, 3
START = np.array([[10.0 * i, 0.0, 50.0] for i in range(DRONES)])
OPTIONS = {"num_drones": DRONES, "dynamics": "rigid_body", "battery_capacity": 5.0}
HALF = np.sqrt(0.5)


def given_values():
    """Return values of all options, with a row for each world."""
    world = np.arange(WORLDS)[:, None, None]
    turn = np.zeros((WORLDS, DRONES, 4))
    turn[..., 2:] = HALF  # north
    return {
        "start": START + world,
        "goal": START + (0.0, 60.0, 0.0) - world,
        "velocity": np.full((WORLDS, DRONES, 3), (1.0, -2.0, 0.5)) * (world + 1),
        "quaternion": turn,
        "rates": np.full((WORLDS, DRONES, 3), (0.1, 0.2, -0.3)) + world,
        "charge": np.linspace(0.1, 1.0, WORLDS * DRONES).reshape(WORLDS, DRONES),
    }


def read_state(batch):
    swarm, scene = batch.aviary.swarm, batch.aviary.scene
    return {
        "start": swarm.position,
        "goal": scene.goal,
        "velocity": swarm.velocity,
        "quaternion": swarm.quaternion,
        "rates": swarm.rates,
        "charge": batch.aviary.readings["charge"],
    }


def test_each_world_starts_as_given():
    given = given_values()
    batch = bulletuav.batch_env("free_flight", WORLDS, **OPTIONS)
    batch.reset(seed=0, options=given)
    for name, value in read_state(batch).items():
        np.testing.assert_allclose(value, given[name], rtol=1e-15, err_msg=name)
    # The next reset draws again, with full batteries
    batch.reset(seed=0)
    drawn = {name: value.copy() for name, value in read_state(batch).items()}
    fresh = bulletuav.batch_env("free_flight", WORLDS, **OPTIONS)
    fresh.reset(seed=0)
    for name, value in read_state(fresh).items():
        np.testing.assert_array_equal(value, drawn[name], err_msg=name)
    assert (drawn["charge"] == 1).all()


def test_values_without_worlds_apply_to_all_worlds():
    given = {name: value[1] for name, value in given_values().items()}
    batch = bulletuav.batch_env("free_flight", WORLDS, **OPTIONS)
    batch.reset(seed=0, options=given)
    for name, value in read_state(batch).items():
        expected = np.broadcast_to(given[name], value.shape)
        np.testing.assert_allclose(value, expected, rtol=1e-15, err_msg=name)


def test_a_mask_takes_the_rows_of_its_worlds():
    given, mask = given_values(), np.array([False, True, False, True])
    batch = bulletuav.batch_env("free_flight", WORLDS, **OPTIONS)
    batch.reset(seed=0)
    before = {name: value.copy() for name, value in read_state(batch).items()}
    batch.reset(options={"reset_mask": mask, **given})
    for name, value in read_state(batch).items():
        np.testing.assert_allclose(value[mask], given[name][mask], rtol=1e-15, err_msg=name)
        np.testing.assert_array_equal(value[~mask], before[name][~mask], err_msg=name)


def test_workers_start_as_one_process():
    given, flown = given_values(), []
    for workers in (1, 2):
        batch = bulletuav.batch_env("free_flight", WORLDS, workers=workers, **OPTIONS)
        first, _ = batch.reset(seed=3, options=given)
        then = batch.step(np.zeros((WORLDS, DRONES, 3)))[0]
        flown.append((first, then))
        batch.close()
    np.testing.assert_array_equal(flown[0], flown[1])


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_drone_begins_to_move_with_the_given_motion(dynamics):
    env = bulletuav.parallel_env("hover", num_drones=1, dynamics=dynamics, physics_hz=240)
    velocity, rates = np.array([[3.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 2.0]])
    motion = {"velocity": velocity, "rates": rates, "quaternion": [[0.0, 0.0, 0.0, 1.0]]}
    env.reset(seed=0, options=motion)
    before = env.aviary.swarm.position[0].copy()
    env.step({"drone_0": np.zeros(env.action_space("drone_0").shape)})
    seconds = 1 / env.aviary.options.decision_hz
    moved = env.aviary.swarm.position[0] - before
    # Drag slows it by less than a tenth within a decision
    assert 0.9 * 3.0 * seconds < moved[0, 0] <= 3.0 * seconds
    yaw = 2 * env.aviary.swarm.quaternion[0, 0, 2]
    assert 0.5 * 2.0 * seconds < yaw < 1.1 * 2.0 * seconds
    env.close()


BAD = {
    "shape": ({"velocity": np.zeros((2, 3))}, r"velocity is .* shape \(3, 3\) .*\(4, 3, 3\)"),
    "no numbers": ({"rates": "fast"}, "rates is not numbers"),
    "not finite": (
        {"velocity": np.full((DRONES, 3), np.nan)},
        "velocity is .*finite .*less than .* m/s",
    ),
    "too fast": ({"rates": np.full((DRONES, 3), 1e6)}, "rates is .*less than .* rad/s"),
    "norm": ({"quaternion": np.full((DRONES, 4), 1.0)}, "quaternion is .*divide by its norm"),
    "empty battery": ({"charge": np.zeros(DRONES)}, "charge is .*above 0 and at most 1"),
    "one world": (
        {"start": np.stack([START, START - (0, 0, 60), START, START])},
        "start is .* m up|start .*arena|below",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_values_leave_the_worlds_unchanged(name):
    options, message = BAD[name]
    batch = bulletuav.batch_env("free_flight", WORLDS, **OPTIONS)
    batch.reset(seed=0)
    before = batch.state_hash()
    with pytest.raises(ValueError, match=message):
        batch.reset(options=options)
    assert batch.state_hash() == before


def test_values_without_effect_are_refused():
    level = {"num_drones": DRONES, "dynamics": "point_mass"}
    env = bulletuav.parallel_env("free_flight", **level)
    with pytest.raises(ValueError, match="rates has no effect in dynamics 'point_mass'"):
        env.reset(options={"rates": np.zeros((DRONES, 3))})
    with pytest.raises(ValueError, match="charge has no effect without .* battery_capacity"):
        env.reset(options={"charge": np.ones(DRONES)})
    with pytest.raises(ValueError, match="quaternion has no effect in dynamics 'point_mass'"):
        env.reset(options={"quaternion": np.tile((0.0, 0.0, HALF, HALF), (DRONES, 1))})
    exact = bulletuav.parallel_env("free_flight", num_drones=DRONES, dynamics="single_integrator")
    with pytest.raises(ValueError, match="velocity has no effect in dynamics 'single_integrator'"):
        exact.reset(options={"velocity": np.zeros((DRONES, 3))})
    grounded = bulletuav.parallel_env("free_flight", take_off=True, **level)
    with pytest.raises(ValueError, match="velocity cannot be given .* on the ground"):
        grounded.reset(options={"velocity": np.zeros((DRONES, 3))})
