"""Gravity of a world that changes in flight, in all dynamics, against motions by hand."""

import numpy as np
import pytest

import bulletuav
from bulletuav import Airspace, SetpointLevel
from bulletuav.control.gains import gain_rows
from bulletuav.envs.events import Event
from bulletuav.vehicle.airframe import STANDARD_GRAVITY as G
from bulletuav.vehicle.airframes import load_airframe

CF2X = load_airframe("cf2x")
SIX = ("bullet", "rigid_body")
MARS = 3.71
"""Gravity of Mars, m/s^2"""
HZ = 240


def steps(airspace, count):
    for _ in range(count):
        airspace.step()
    return airspace


@pytest.mark.parametrize("dynamics", SIX)
@pytest.mark.parametrize("num_drones", [1, 5])
def test_a_free_fall_has_the_new_acceleration(dynamics, num_drones):
    places = [(20.0 * i, 0.0, 50.0) for i in range(num_drones)]
    airspace = Airspace(places, dynamics=dynamics, effects=())
    steps(airspace, 24)
    airspace.set_condition(gravity=MARS)
    height, speed = airspace.swarm.position[:, 2].copy(), airspace.swarm.velocity[:, 2].copy()
    assert speed == pytest.approx(-G * 24 / HZ)
    steps(airspace, 120)
    time = 120 / HZ
    assert airspace.swarm.velocity[:, 2] == pytest.approx(speed - MARS * time)
    fallen = height + speed * time - MARS * time**2 / 2
    assert airspace.swarm.position[:, 2] == pytest.approx(fallen, abs=1e-9)
    assert airspace.gravity == MARS


def test_a_double_integrator_rises_as_thrust_balances_the_old_gravity():
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics="double_integrator")
    airspace.command(0, SetpointLevel.ACCELERATION, (0.0, 0.0, 0.0, 0.0))
    airspace.set_condition(gravity=MARS)
    steps(airspace, 120)
    assert airspace.swarm.position[0, 2] == pytest.approx(5.0 + (G - MARS) * 0.5**2 / 2)


def test_a_point_mass_drifts_to_the_velocity_at_which_its_lag_balances_gravity():
    airspace = Airspace([(0.0, 0.0, 50.0)], dynamics="point_mass", effects=())
    airspace.command(0, SetpointLevel.VELOCITY, (0.0, 0.0, 0.0, 0.0))
    airspace.set_condition(gravity=2 * G)
    steps(airspace, 120)
    (gain,) = gain_rows((CF2X,), CF2X.max_speed)
    lag = 1 / (2 * gain["damping"] * gain["position_frequency"])
    drift = -G * lag  # at which (0 - v) / lag = G
    left = np.exp(-0.5 / lag)
    assert airspace.swarm.velocity[0, 2] == pytest.approx(drift * (1 - left))
    assert airspace.swarm.position[0, 2] == pytest.approx(50 + drift * (0.5 - lag * (1 - left)))


def test_a_single_integrator_has_no_gravity():
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics="single_integrator")
    with pytest.raises(ValueError, match="ignores it: .* 'point_mass' or 'double_integrator'"):
        airspace.set_condition(gravity=MARS)
    with pytest.raises(ValueError, match="gravity is 3.71, and dynamics 'single_integrator'"):
        bulletuav.Aviary(
            "crossing", dynamics="single_integrator", events=[{"time": 1, "gravity": MARS}]
        )


@pytest.mark.parametrize("dynamics", SIX)
def test_hover_commands_keep_the_thrust_of_the_old_gravity(dynamics):
    airspace = Airspace(
        [(0.0, 0.0, 5.0)], dynamics=dynamics, effects=(), rotor_speed="hover", decision_hz=240
    )
    airspace.command(0, SetpointLevel.ACCELERATION, (0.0, 0.0, 0.0, 0.0))
    airspace.set_condition(gravity=MARS)
    airspace.step()
    # The controller commands the thrust m G, so that the drone climbs
    thrust = CF2X.thrust_coefficient * (airspace.swarm.rotor_speed[0] ** 2).sum()
    assert thrust == pytest.approx(CF2X.mass * G)
    assert airspace.swarm.velocity[0, 2] == pytest.approx((G - MARS) / HZ)


@pytest.mark.parametrize("dynamics", SIX)
def test_position_control_settles_at_the_new_weight(dynamics):
    heights = {}
    for integral in (False, True):
        airspace = Airspace(
            [(0.0, 0.0, 5.0)],
            dynamics=dynamics,
            effects=("lag",),
            decision_hz=48,
            rotor_speed="hover",
            integral=integral,
        )
        airspace.command(0, SetpointLevel.POSITION, (0.0, 0.0, 5.0, 0.0))
        airspace.set_condition(gravity=0.8 * G)
        steps(airspace, 48 * 8)
        thrust = CF2X.thrust_coefficient * (airspace.swarm.rotor_speed[0] ** 2).sum()
        assert thrust == pytest.approx(CF2X.mass * 0.8 * G, rel=1e-3)
        heights[integral] = airspace.swarm.position[0, 2] - 5
    # A spring of the position loop carries the difference; an integral learns it
    (gain,) = gain_rows((CF2X,), CF2X.max_speed)
    assert heights[False] == pytest.approx(0.2 * G / gain["position_frequency"] ** 2, rel=1e-2)
    assert heights[True] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("dynamics", [*SIX, "point_mass", "double_integrator"])
def test_accelerometers_measure_the_new_gravity(dynamics):
    airspace = Airspace(
        [(0.0, 0.0, 50.0)],
        dynamics=dynamics,
        effects=(),
        sensors=["imu"],
        rotor_speed="hover" if dynamics in SIX else 0.0,
    )
    level = airspace.consumes
    command = airspace.hover_speed[0] if level == SetpointLevel.ROTOR else (0.0, 0.0, 0.0, 0.0)
    airspace.command(0, level, command)
    airspace.step()
    assert airspace.readings["imu"][0, :3] == pytest.approx([0, 0, G])
    airspace.set_condition(gravity=MARS)
    airspace.step()
    # Thrust is as before, and so is the specific force; that of points is of their velocity
    rel = 0.05 if dynamics == "point_mass" else 1e-6
    assert airspace.readings["imu"][0, :3] == pytest.approx([0, 0, G], rel=rel, abs=1e-9)
    if dynamics in SIX:
        airspace.stop()
        steps(airspace, 2)
        assert airspace.readings["imu"][0, :3] == pytest.approx([0, 0, 0], abs=1e-9)


@pytest.mark.parametrize("dynamics", SIX)
def test_a_drone_that_lies_on_the_ground_weighs_less(dynamics):
    airspace = Airspace(
        [(0.0, 0.0, CF2X.standing_height)], dynamics=dynamics, sensors=["imu"], decision_hz=48
    )
    for gravity in (G, MARS, 2 * G, MARS):
        airspace.set_condition(gravity=gravity)
        steps(airspace, 48)
        assert airspace.readings["imu"][0, 2] == pytest.approx(gravity, rel=1e-6)
        assert airspace.swarm.position[0, 2] == pytest.approx(CF2X.standing_height, abs=1e-3)


@pytest.mark.parametrize("dynamics", SIX)
def test_snapshots_and_hashes_include_gravity(dynamics):
    places = [(0.0, 0.0, 9.0)]
    airspace, other = (Airspace(places, dynamics=dynamics) for _ in range(2))
    fresh, first = airspace.save_state(), airspace.state_hash()
    airspace.set_condition(gravity=MARS)
    assert airspace.state_hash() != first
    changed = airspace.save_state()
    end = steps(airspace, 5).state_hash()
    other.load_state(changed)
    assert other.gravity == MARS
    assert steps(other, 5).state_hash() == end
    other.load_state(fresh)
    assert other.state_hash() == first


def test_events_and_calls_change_the_gravity_of_a_world_until_its_reset():
    options = {"num_drones": 3, "dynamics": "rigid_body", "decision_hz": 10}
    event = Event(time=0.2, gravity=MARS)
    scheduled = bulletuav.Aviary("crossing", 2, events=[event], **options)
    called = bulletuav.Aviary("crossing", 2, **options)
    action = np.zeros(called.given.shape)
    for aviary in (scheduled, called):
        aviary.reset(seeds=0)
    for k in range(5):
        if k == 2:
            called.set_condition(worlds=1, gravity=MARS)
        scheduled.step(action)
        called.step(action)
    gravity = called.worlds.dynamics.local_gravity
    assert gravity.tolist() == [[G] * 3, [MARS] * 3]
    assert (called.swarm.velocity[1] == scheduled.swarm.velocity[1]).all()
    assert (called.swarm.velocity[0] != scheduled.swarm.velocity[0]).any()
    for aviary in (scheduled, called):
        aviary.reset(seeds=1)
        assert (aviary.worlds.dynamics.local_gravity == G).all()
        aviary.close()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"gravity": -1.0}, "gravity is -1"),
        ({"gravity": np.nan}, "gravity is nan"),
        ({"gravity": (1.0, 2.0)}, "gravity is"),
        ({"drones": 0, "gravity": MARS}, "gravity is that of the world: set it with None"),
    ],
)
def test_invalid_gravity_is_refused(given, message):
    airspace = Airspace([(0.0, 0.0, 5.0)], dynamics="rigid_body")
    with pytest.raises(ValueError, match=message):
        airspace.set_condition(**given)
    assert airspace.gravity == G
    with pytest.raises(ValueError, match="gravity of an event"):
        Event(time=0.0, gravity=-1.0)
    with pytest.raises(ValueError, match="the gravity of an event is that of all drones"):
        Event(time=0.0, drone=0, gravity=1.0)
