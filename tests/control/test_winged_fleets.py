"""Environments with aeroplanes and mixed fleets, from actions down to control surfaces."""

import numpy as np
import pytest

import bulletuav
from bulletuav import load_airframe
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.base import Dynamics
from bulletuav.vehicle.envelope import find_envelope

TRAINER = load_airframe("trainer")
ENVELOPE = find_envelope(TRAINER)
VELOCITY, ROTOR = SetpointLevel.VELOCITY, SetpointLevel.ROTOR
APART = np.array([(0.0, 0.0, 50.0), (0.0, 300.0, 50.0), (0.0, 600.0, 50.0)])


def airspace(airframes, **options):
    settings = {"dynamics": "rigid_body", "decision_hz": 24, "rotor_speed": "hover", **options}
    return bulletuav.Airspace(APART[: len(airframes)], list(airframes), **settings)


def flown(airframes, steps=120):
    """States of drones which fly at velocities of their own."""
    world = airspace(airframes)
    for i in range(len(airframes)):
        world.command(i, VELOCITY, (2.0 + 10.0 * (i == 2), 1.0, -0.5, 0.3 * i))
    for _ in range(steps):
        world.step()
    states = [np.array(array) for array in world.swarm]
    world.close()
    return states


def test_multirotors_fly_the_same_next_to_aeroplanes():
    """Property: to the bit."""
    alone, mixed = flown(["cf2x", "iris"]), flown(["cf2x", "iris", "trainer"])
    for one, other in zip(alone[:5], mixed[:5], strict=True):
        np.testing.assert_array_equal(one, other[:2, : one.shape[1]])
    assert np.linalg.norm(mixed[2][2, :2]) == pytest.approx(np.hypot(12, 1), abs=0.3)
    # Multirotors have no control surfaces
    assert not mixed[5][:2].any()
    assert mixed[5][2].any()


def test_plain_python_gives_the_same_bits():
    states = []
    for debug in (False, True):
        world = airspace(["iris", "trainer", "quadplane"], debug=debug)
        for i, east in enumerate((2.0, 12.0, 14.0)):
            world.command(i, VELOCITY, (east, 3.0, 1.0, 0.5))
        world.step()
        world.command(1, SetpointLevel.ATTITUDE, (0.3, 0.1, 0.0, 3.0))
        world.command(2, SetpointLevel.POSITION, (9.0, 600.0, 55.0, 0.0))
        world.step()
        world.command(1, SetpointLevel.POSITION, (0.0, 310.0, 55.0, 0.0))
        world.step()
        states.append([np.array(array) for array in world.swarm])
        world.close()
    for one, other in zip(*states, strict=True):
        np.testing.assert_array_equal(one, other)


def test_surfaces_follow_the_rotors_in_setpoints_of_mixed_fleets():
    world = airspace(["cf2x", "trainer", "quadplane"])
    world.command(1, ROTOR, (700.0, 0.1, -0.1, 0.2, -0.2, 0, 0, 0, 0, 0))
    for _ in range(24):
        world.step()
    np.testing.assert_allclose(world.swarm.deflection[1, :4], (0.1, -0.1, 0.2, -0.2))
    assert world.swarm.rotor_speed[1, 0] == pytest.approx(700, rel=1e-3)
    commands = world.rotor_commands()
    assert commands.shape == (3, 5)
    assert commands[1].tolist() == [700.0, 0, 0, 0, 0]
    with pytest.raises(ValueError, match=r"setpoint of ROTOR has shape \(5,\): \(10,\) is needed"):
        world.command(1, ROTOR, (700.0, 0.1, -0.1, 0.2, -0.2))
    world.close()


def test_dynamics_of_ones_own_get_the_deflections():
    class Gliding(Dynamics):
        consumes = ROTOR

        def advance_substep(self, swarm, alive, setpoint, air):
            taken.append(setpoint.copy())

    taken = []
    world = airspace(["cf2x", "trainer"], dynamics=Gliding)
    world.command(1, VELOCITY, (0.0, 12.0, 1.0, 0.0))
    world.step()
    # Rotors of the first, and the rotor and surfaces of the second
    assert taken[0].shape == (1, 2, 8)
    assert (taken[0][0, 0, 4:] == 0).all()
    assert taken[0][0, 1, 0] > 100
    # A left turn: the left aileron goes up, and the right one down
    left, right, _, rudder = taken[0][0, 1, 1:5]
    assert left < 0 < right
    assert rudder != 0
    assert (taken[0][0, 1, 5:] == 0).all()
    world.close()


def test_the_wind_of_commands_is_that_of_the_flight():
    speeds = []
    for wind in ((0.0, 0.0, 0.0), (-4.0, 0.0, 0.0)):
        world = airspace(["trainer"], wind=wind, rotor_speed=None)
        world.command(0, VELOCITY, (12.0, 0.0, 0.0, 0.0))
        for _ in range(240):
            world.step()
        speeds.append(world.rotor_commands()[0, 0])
        assert world.rotor_commands()[0, 0] == pytest.approx(
            world.swarm.rotor_speed[0, 0], rel=0.01
        )
        world.close()
    assert speeds[1] > 1.1 * speeds[0]


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_heading_speed_climb_flies_all_airframes(dynamics):
    aviary = bulletuav.Aviary(
        "free_flight",
        1,
        airframe=["iris", "trainer", "quadplane"],
        action="heading_speed_climb",
        dynamics=dynamics,
        horizon=400,
    )
    aviary.reset(seeds=1)
    low = np.array([0.0, ENVELOPE.min_speed, 0.0])
    high = np.array([load_airframe("iris").max_speed, ENVELOPE.max_speed, 19.0])
    high = np.minimum(high, aviary.options.max_speed)
    action = np.tile(np.array([0.5, 0.2, 0.0]), (1, 3, 1))
    for _ in range(round(6 * aviary.options.decision_hz)):
        aviary.step(action)
    velocity = aviary.swarm.velocity[0]
    wanted = low + 0.6 * (high - low)
    np.testing.assert_allclose(velocity[:, 1], wanted, rtol=0.08)
    np.testing.assert_allclose(velocity[:, 0], 0, atol=0.8)
    aviary.close()


def test_a_reset_forgets_the_flight():
    aviary = bulletuav.Aviary("crossing", 2, airframe="trainer", dynamics="rigid_body")
    states = []
    for _ in range(2):
        aviary.reset(seeds=5)
        assert not aviary.worlds.cascade.memory.any()
        for _ in range(10):
            aviary.step(np.full((2, aviary.options.num_drones, 3), 0.5))
        assert aviary.worlds.cascade.memory.any()
        states.append(aviary.swarm.position.copy())
    np.testing.assert_array_equal(*states)
    aviary.close()
