"""An airspace: drones do what they are told, each by itself, and what cannot be is refused."""

import copy
import math

import bench
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav import Airspace, SetpointLevel
from bulletuav.contact.time_of_impact import CONTACT_DISTANCE
from bulletuav.dynamics import DEFAULT_DYNAMICS, DYNAMICS
from bulletuav.dynamics.base import Dynamics
from bulletuav.engine import engine as engine_module
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import DRONE, FAR, OBSTACLE
from bulletuav.sensors.imu import Imu
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, GROUND

CF2X = load_airframe("cf2x")
HOVER = CF2X.hover_speed()
G = STANDARD_GRAVITY
SIX = ("bullet", "rigid_body")
"""Dynamics of six degrees of freedom"""
APART = np.array([(0.0, 0, 50), (20, 0, 50), (40, 0, 50), (0, 20, 50), (20, 20, 50), (40, 20, 50)])
"""Places where drones do not feel each other, m"""
ORDERS = [
    (SetpointLevel.POSITION, (1.0, 2.0, 51.0, 0.5)),
    (SetpointLevel.VELOCITY, (0.5, -0.5, 0.2, 0.0)),
    (SetpointLevel.ACCELERATION, (0.3, 0.0, 0.1, -0.4)),
    (SetpointLevel.ATTITUDE, (0.1, -0.05, 0.3, 1.02 * CF2X.mass * G)),
    (SetpointLevel.RATES, (0.2, 0.1, 0.5, CF2X.mass * G)),
    (SetpointLevel.ROTOR, (1.01 * HOVER, HOVER, 0.99 * HOVER, HOVER)),
]


def state(airspace):
    """All numbers of the state, one row a drone."""
    return np.concatenate(airspace.swarm, axis=1)


def steps(airspace, count):
    for _ in range(count):
        airspace.step()
    return airspace


# Commands


@pytest.mark.parametrize("dynamics", SIX)
def test_levels_mix_in_one_swarm_and_each_flies_as_in_a_swarm_of_its_own(dynamics):
    mixed = Airspace(APART, dynamics=dynamics, decision_hz=48, rotor_speed=HOVER)
    offset = np.zeros((6, 4))
    offset[0, :3] = APART[0] - (0, 0, 50)
    for i, (level, setpoint) in enumerate(ORDERS):
        mixed.command(i, level, setpoint)
    steps(mixed, 20)
    assert mixed.levels.tolist() == [int(level) for level, _ in ORDERS]
    # The same in one swarm of a single level, which is what tasks fly
    for i, (level, setpoint) in enumerate(ORDERS):
        alone = bench.Bench(dynamics, "cf2x", drones=6, substeps=5, max_speed=CF2X.max_speed)
        alone.swarm.position[0] = APART
        alone.place().fly(level, setpoint, 20)
        np.testing.assert_array_equal(alone.swarm.position[0, i], mixed.swarm.position[i])
        np.testing.assert_array_equal(alone.swarm.quaternion[0, i], mixed.swarm.quaternion[i])
        np.testing.assert_array_equal(alone.swarm.rotor_speed[0, i], mixed.swarm.rotor_speed[i])


@pytest.mark.parametrize("dynamics", SIX)
def test_each_level_does_what_its_name_says(dynamics):
    airspace = Airspace(APART, dynamics=dynamics, decision_hz=48, rotor_speed=HOVER)
    orders = [
        (SetpointLevel.POSITION, (1.0, 2.0, 51.0)),
        (SetpointLevel.VELOCITY, (0.5, -0.5, 0.2)),
        (SetpointLevel.ACCELERATION, (0.3, 0.0, 0.1)),
        (SetpointLevel.ATTITUDE, (0.1, 0.0, 0.3, CF2X.mass * G)),
        (SetpointLevel.RATES, (0.0, 0.0, 0.5, CF2X.mass * G)),
        (SetpointLevel.ROTOR, (0.0,) * 4),
    ]
    for i, (level, setpoint) in enumerate(orders):
        airspace.command(i, level, setpoint)
    steps(airspace, 24)
    before = airspace.swarm.velocity[2].copy()
    fallen = airspace.swarm.position[5, 2]
    steps(airspace, 24)
    swarm = airspace.swarm
    gained = (swarm.velocity[2] - before) / 0.5
    # Drag, which grows by 0.4 1/s of it, is made up for after the attitude's delay of 0.2 s
    np.testing.assert_allclose(gained, (0.3, 0.0, 0.1), atol=0.03)
    roll, _, yaw = Rotation.from_quat(swarm.quaternion[3]).as_euler("xyz")
    np.testing.assert_allclose((roll, yaw), (0.1, 0.3), atol=0.02)
    np.testing.assert_allclose(swarm.rates[4], (0, 0, 0.5), atol=0.01)
    # Off: slower than free fall only by drag and by rotors that run down
    assert 50 - G / 2 < swarm.position[5, 2] < fallen - G / 8 < 50
    assert swarm.rotor_speed[5].max() < 1e-3 * HOVER
    steps(airspace, 4 * 48)
    np.testing.assert_allclose(swarm.position[0], (1, 2, 51), atol=0.02)
    np.testing.assert_allclose(swarm.velocity[1], (0.5, -0.5, 0.2), atol=0.02)


def test_setpoints_are_held_until_the_next_and_a_name_is_as_good_as_a_level():
    one, two = (Airspace([(0, 0, 2)], decision_hz=48, rotor_speed=HOVER) for _ in range(2))
    one.command(0, "position", (0.5, 0.0, 2.0))
    for _ in range(10):
        two.command(0, SetpointLevel.POSITION, np.array((0.5, 0.0, 2.0)))
        two.step()
    np.testing.assert_array_equal(state(steps(one, 10)), state(two))


@pytest.mark.parametrize("drones", [[2, 0], np.array([True, False, True]), np.array([2, 0])])
def test_several_drones_are_told_at_once(drones):
    airspace = Airspace(APART[:3])
    rows = np.array([(1.0, 2, 3), (4, 5, 6)])
    airspace.command(drones, "velocity", rows)
    order = np.flatnonzero(drones) if np.asarray(drones).dtype == bool else np.array(drones)
    np.testing.assert_array_equal(airspace.setpoint[order, :3], rows)
    assert airspace.levels[1] == SetpointLevel.ROTOR
    airspace.command(None, "velocity", (0.0, 0.0, 1.0))
    np.testing.assert_array_equal(airspace.setpoint[:, :3], np.tile((0.0, 0, 1), (3, 1)))


def test_yaws_are_held_turned_and_wrapped():
    airspace = Airspace(APART[:2], decision_hz=48, rotor_speed=HOVER)
    airspace.command(0, "position", APART[0], yaw=0.7)
    airspace.command(0, "velocity", (0.0, 0, 0))  # goes on to hold 0.7
    assert airspace.setpoint[0, 3] == 0.7
    airspace.command(1, "position", APART[1], yaw=0.2, yaw_rate=0.5)
    steps(airspace, 96)
    heading = Rotation.from_quat(airspace.swarm.quaternion.copy()).as_euler("xyz")[:, 2]
    assert heading[0] == pytest.approx(0.7, abs=0.02)
    assert airspace.setpoint[1, 3] == pytest.approx(1.2, abs=1e-12)
    assert steps(airspace, 4 * 48).setpoint[1, 3] == pytest.approx(3.2 - 2 * math.pi, abs=1e-12)
    # It follows at the rate
    before = Rotation.from_quat(steps(airspace, 96).swarm.quaternion[1])
    after = Rotation.from_quat(steps(airspace, 48).swarm.quaternion[1])
    assert (before.inv() * after).as_rotvec()[2] == pytest.approx(0.5, abs=0.01)
    # Who was told rates keeps the heading that it has
    airspace.command(0, "rates", (0.0, 0, 0.2, CF2X.mass * G))
    steps(airspace, 24)
    now = Rotation.from_quat(airspace.swarm.quaternion[0]).as_euler("xyz")[2]
    airspace.command(0, "position", APART[0])
    assert airspace.setpoint[0, 3] == pytest.approx(now, abs=1e-12)


# Placing and pushing


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_what_is_placed_stands_there_to_the_bit_and_knows_no_past(dynamics):
    start = APART[:2] + 0.1
    turn = Rotation.from_euler("xyz", [(0.2, -0.1, 0.3), (0, 0.4, -1)]).as_quat()
    moving = {"velocity": [(1.0, 0.3, -0.2), (0.1, 0, 0)], "rates": [(0.5, 1, 2), (0.0, 0, 0.1)]}
    flights = []
    for past in (0, 37):
        airspace = Airspace(APART[:2], dynamics=dynamics, decision_hz=48, seed=0)
        steps(airspace, past)
        airspace.place(None, start, turn, **moving, rotor_speed=0.7 * HOVER)
        np.testing.assert_array_equal(airspace.swarm.position, start)
        np.testing.assert_array_equal(airspace.swarm.velocity, moving["velocity"])
        if dynamics in SIX:
            np.testing.assert_array_equal(airspace.swarm.quaternion, turn)
            np.testing.assert_array_equal(airspace.swarm.rates, moving["rates"])
            assert (airspace.swarm.rotor_speed == 0.7 * HOVER).all()
        flights.append(state(steps(airspace, 12)))
    np.testing.assert_array_equal(*flights)


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_given_attitudes_at_the_start_are_those_of_place(dynamics):
    turn = Rotation.from_euler("xyz", [(0.2, -0.1, 0.3), (0, 0.4, -1)]).as_quat()
    flights = []
    for start in ({"quaternion": turn}, {}):
        airspace = Airspace(APART[:2], dynamics=dynamics, decision_hz=48, seed=0, **start)
        if not start:
            airspace.place(None, APART[:2], turn)
        flights.append(state(steps(airspace, 12)))
    np.testing.assert_array_equal(*flights)


@pytest.mark.parametrize("dynamics", SIX)
def test_forces_and_torques_from_outside_follow_newton_and_euler(dynamics):
    airspace = Airspace([(0, 0, 100)], dynamics=dynamics, effects=(), decision_hz=120)
    force, torque, dt = np.array((0.1, -0.05, 0.02)), (0.0, 0.0, 2e-6), 1 / 120
    for _ in range(10):
        airspace.apply(0, force / 2, torque)
        airspace.apply(0, force / 2)
        airspace.step()
    gained = 10 * dt * (force / CF2X.mass - (0, 0, G))
    np.testing.assert_allclose(airspace.swarm.velocity[0], gained, rtol=1e-12)
    spin = 10 * dt * torque[2] / CF2X.inertia[2]
    np.testing.assert_allclose(airspace.swarm.rates[0], (0, 0, spin), rtol=1e-12, atol=1e-15)
    # They end with the step
    steps(airspace, 1)
    np.testing.assert_allclose(
        airspace.swarm.velocity[0], gained - (0, 0, dt * G), rtol=1e-12, atol=1e-12
    )


def test_points_feel_forces_by_their_own_formulas():
    force = np.array((0.02, 0.0, -0.01))
    pull = force / CF2X.mass
    free = Airspace([(0, 0, 100)], dynamics="double_integrator", decision_hz=60)
    free.apply(0, force)
    free.step()
    np.testing.assert_allclose(free.swarm.velocity[0], pull / 60, rtol=1e-12)
    np.testing.assert_allclose(free.swarm.position[0], pull / 7200 + (0, 0, 100), rtol=1e-12)
    # v' = -v / lag + pull, without drag
    lagged = Airspace([(0, 0, 100)], dynamics="point_mass", effects=(), decision_hz=60)
    for _ in range(6):
        lagged.apply(0, force)
        lagged.step()
    lag = 1 / (2 * 0.8 * min(10, 1 / (2 * max(CF2X.lag_up, CF2X.lag_down))) / 4)
    expected = pull * lag * -math.expm1(-0.1 / lag)
    np.testing.assert_allclose(lagged.swarm.velocity[0], expected, rtol=1e-9)


def test_a_dynamics_that_feels_no_force_refuses_one():
    airspace = Airspace([(0, 0, 5)], dynamics="single_integrator")
    with pytest.raises(ValueError, match="'single_integrator' ignores forces"):
        airspace.apply(0, (0.1, 0, 0))
    with pytest.raises(ValueError, match="'point_mass' ignores torques"):
        Airspace([(0, 0, 5)], dynamics="point_mass").apply(0, torque=(0.1, 0, 0))
    airspace.apply(0)  # nothing is no force


# Contacts and what stands


@pytest.mark.parametrize("dynamics", SIX)
def test_motors_off_a_drone_falls_rests_is_stood_up_and_flies(dynamics):
    airspace = Airspace([(0, 0, 1)], dynamics=dynamics, decision_hz=48, rotor_speed=HOVER)
    airspace.command(0, "position", (0.0, 0, 1))
    steps(airspace, 24).stop()
    hit = []
    for _ in range(96):
        airspace.step()
        contacts = airspace.contacts
        hit += [(int(contacts.other[k]), contacts.normal[k, 2]) for k in range(len(contacts.other))]
    assert hit
    assert {other for other, _ in hit} == {GROUND}
    assert all(up == 1.0 for _, up in hit)
    assert airspace.contacts.depth.tolist() == [0.0] * len(airspace.contacts.depth)
    assert not airspace.swarm.velocity.any()
    height = airspace.swarm.position[0, 2]
    assert height == pytest.approx(CF2X.standing_height, abs=2 * CONTACT_DISTANCE)
    airspace.place(0, (0, 0, CF2X.standing_height))
    airspace.command(0, "position", (0.0, 0, 1))
    steps(airspace, 5 * 48)
    np.testing.assert_allclose(airspace.swarm.position[0], (0, 0, 1), atol=0.02)
    assert not len(airspace.contacts.other)


def test_a_take_off_to_a_metre_overshoots_little():
    airspace = Airspace([(0, 0, CF2X.standing_height)], decision_hz=48)
    airspace.command(0, "position", (0.0, 0, 1))
    heights = [steps(airspace, 1).swarm.position[0, 2] for _ in range(5 * 48)]
    assert 0 < max(heights) - 1 < 0.05
    assert heights[-1] == pytest.approx(1, abs=0.01)


def test_bodies_and_obstacles_are_hit_and_told_by_their_names():
    ball = Obstacle("sphere", (0.2,))
    airspace = Airspace(
        APART[:2], "hummingbird", obstacles=(ball,), decision_hz=48, dynamics="rigid_body"
    )
    box = airspace.add_body(Obstacle("box", (1.0, 1.0, 0.2)), (0, 0, 48))
    assert box == FIRST_OBSTACLE - 1
    airspace.place(1, APART[1], rotor_speed=airspace.hover_speed[1])
    airspace.command(1, "position", APART[1])
    airspace.place_obstacle(0, (18.0, 0, 50), velocity=(4.0, 0, 0))
    met = set()
    for _ in range(48):
        airspace.step()
        met |= set(zip(airspace.contacts.drone, airspace.contacts.other, strict=True))
    assert met == {(0, box), (1, FIRST_OBSTACLE)}
    airspace.place_obstacle(0, (0.0, 30, 0))  # out of the way, at rest
    assert FIRST_OBSTACLE not in steps(airspace, 2).contacts.other


def test_buildings_stand():
    walls = Solids(np.array([[(1.0, -1.0, 0.0), (2.0, 1.0, 3.0)]]))
    airspace = Airspace([(0, 0, 1)], dynamics="point_mass", layout=walls, sensors=("lidar",))
    assert airspace.readings["lidar"][0, 0] == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(ValueError, match="drone 0 at .* would overlap a building by"):
        airspace.place(0, (1.5, 0, 1))
    airspace.command(0, "velocity", (1.0, 0, 0))
    steps(airspace, 2 * 240)
    assert airspace.swarm.position[0, 0] == pytest.approx(
        1 - CF2X.shape.half[0], abs=2 * CONTACT_DISTANCE
    )


# Sensors, wind, pictures


def test_sensors_measure_by_name_or_as_objects_with_noise_of_the_seed():
    options = {"decision_hz": 48, "rotor_speed": HOVER, "randomization": {"gps_noise": 0.1}}

    def flight(seed):
        airspace = Airspace(APART[:2], sensors=("gps", Imu(), "lidar"), seed=seed, **options)
        airspace.command(None, "velocity", (0.0, 0, 0))
        steps(airspace, 3)
        return {name: reading.copy() for name, reading in airspace.readings.items()}

    one, same, other = flight(0), flight(0), flight(1)
    assert one["position"].shape == (2, 3)
    assert one["lidar"].shape == (2, 16)
    for name, reading in one.items():
        np.testing.assert_array_equal(reading, same[name])
    assert (one["position"] != other["position"]).all()
    error = one["position"] - APART[:2]
    assert 0.001 < np.abs(error).max() < 0.6


def test_wind_carries_and_gusts_come_from_the_seed():
    blown = Airspace([(0, 0, 20)], dynamics="rigid_body", wind=(3.0, 0, 0), rotor_speed=HOVER)
    blown.command(0, "attitude", (0.0, 0, 0, CF2X.mass * G))
    assert steps(blown, 240).swarm.velocity[0, 0] > 0.3
    ends = []
    for seed in (0, 0, 1):
        gusty = Airspace([(0, 0, 20)], turbulence="severe", seed=seed, rotor_speed=HOVER)
        gusty.command(0, "position", (0.0, 0, 20))
        ends.append(state(steps(gusty, 60)))
    np.testing.assert_array_equal(ends[0], ends[1])
    assert (ends[0] != ends[2]).any()


def test_pictures_are_taken_from_a_drone_and_from_a_place():
    airspace = Airspace([(0, 0, 1), (0.5, 0, 1)], obstacles=(Obstacle("box", (1.0, 1, 1)),))
    airspace.place_obstacle(0, (0.0, 4, 1))
    ahead = airspace.picture(0, (CF2X.collision_radius, 0, 0), size=(64, 48))
    assert ahead.pixels.shape == (48, 64, 3)
    row, column = np.argwhere(ahead.labels == DRONE).mean(axis=0)
    assert (row, column) == (pytest.approx(23.5, abs=2), pytest.approx(31.5, abs=1))
    assert ahead.depth[ahead.labels == DRONE].min() == pytest.approx(
        0.5 - 2 * CF2X.collision_radius, abs=0.07
    )
    # To the left, in body axes; then the same from a camera in the world
    left = Rotation.from_euler("z", 90, degrees=True).as_quat()
    mounted = airspace.picture(0, (0, CF2X.collision_radius, 0), left, None, (64, 48), 40.0)
    assert mounted.labels[24, 32] == OBSTACLE
    standing = airspace.picture(None, (0, CF2X.collision_radius, 1), left, None, (64, 48), 40.0)
    np.testing.assert_array_equal(mounted.pixels, standing.pixels)
    assert standing.depth[0, 32] == FAR
    assert airspace.render().shape == (480, 640, 3)


# Care


def test_arrays_cannot_be_written_and_stay_the_same():
    airspace = Airspace([(0, 0, 1)])
    shown = airspace.swarm.position
    with pytest.raises(ValueError, match="read-only"):
        shown[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        airspace.setpoint[0] = 0
    airspace.place(0, (1, 0, 1))
    assert shown is airspace.swarm.position
    assert shown[0, 0] == 1
    assert steps(airspace, 24).time == pytest.approx(0.1, abs=1e-15)
    assert airspace.period == 1 / 240


WRONG = [
    (lambda a: a.command(2, "position", (0, 0, 1)), "drones is 2: an index from 0 to 1"),
    (lambda a: a.command(-1, "position", (0, 0, 1)), "drones is -1"),
    (lambda a: a.command([0, 0], "position", (0, 0, 1)), r"drones is \[0, 0\]"),
    (lambda a: a.command(0.5, "position", (0, 0, 1)), "drones is 0.5"),
    (lambda a: a.command(0, "positon", (0, 0, 1)), "did you mean 'position'"),
    (lambda a: a.command(0, 3, (0, 0, 1)), "unknown setpoint level 3"),
    (lambda a: a.command(0, np.int64(9), (0, 0, 1)), "unknown setpoint level"),
    (lambda a: a.command([[0], [0, 1]], "position", (0, 0, 1)), r"drones is \[\[0\], \[0, 1\]\]"),
    (lambda a: a.command(0, "position", (0, 0, 1, 2), yaw=1.0), "the yaw is given separately"),
    (lambda a: a.command(None, "position", (0, 0, 1), yaw=(1.0, 2, 3)), "one for each of the"),
    (lambda a: a.command(None, "position", (0, 0, 1), yaw_rate=(1.0, 2e4)), "up to 10000"),
    (lambda a: a.place(0, (3, 0, 1), velocity=(1e4, 0, 0)), "velocity is .* less than 4950"),
    (lambda a: a.place(0, (3, 0, 1), rates=(0, 1e4, 0)), "rates is .* less than 4950"),
    (lambda a: a.place(0, (3, 0, 1), rotor_speed="hovr"), "did you mean 'hover'"),
    (lambda a: a.place_obstacle(0, (0, 0, 0.1)), "drone 0 at .* would overlap a body by"),
    (lambda a: a.add_body(Obstacle("box", (9, 9, 9)), (0, 0, 0)), "would overlap a body by"),
    (lambda a: a.picture(0, target=(0, 0)), "target is"),
    (lambda a: a.picture(None, (1.0, 1, 1), target=(1.0, 1, 1)), "where the camera is"),
    (lambda a: a.command(0, "position", (0, math.nan, 1)), "finite numbers up to 1e.09"),
    (lambda a: a.command(0, "position", (0, 1e10, 1)), "finite numbers up to 1e.09"),
    (lambda a: a.command(0, "position", (0, "1", 1)), "not numbers"),
    (lambda a: a.command(0, "position", (0, 1)), r"POSITION has shape \(2,\): \(4,\) is needed"),
    (lambda a: a.command([0, 1], "rotor", np.ones((3, 4))), r"\(3, 4\): \(2, 4\) is needed"),
    (lambda a: a.command(0, "rates", (0, 0, 0, 1), yaw=1.0), "yaw and yaw_rate are for POSITION"),
    (lambda a: a.command(0, "position", (0, 0, 1), yaw=math.inf), "yaw is inf"),
    (lambda a: a.command(0, "position", (0, 0, 1), yaw_rate="fast"), "yaw_rate is 'fast'"),
    (lambda a: a.place(0, (0, 0, 0)), "drone 0 at .* would overlap the ground by 0.015 m"),
    (
        lambda a: a.place([0, 1], [(3, 0, 1), (3, 0, 1.01)]),
        "drone 0 at .* would overlap drone 1 by",
    ),
    (lambda a: a.place([0, 1], (5, 0, 1)), r"position has shape \(3,\): \(2, 3\)"),
    (lambda a: a.place(0, (0, 0, 1), (0, 0, 0, 2)), "a length of 1 is needed"),
    (lambda a: a.place(0, (0, 0, 1), velocity=(0, 0)), "velocity has shape"),
    (lambda a: a.place(0, (0, 0, 1), rotor_speed=1e4), "from 0 to the 2607.5 rad/s"),
    (lambda a: a.place(0, (0, 0, 1), rotor_speed=-1.0), "from 0 to the 2607.5 rad/s"),
    (lambda a: a.place(0, (3000, 0, 1)), "less than 2048 m aside"),
    (lambda a: a.apply(0, (1, 2)), r"force has shape \(2,\)"),
    (lambda a: a.apply(0, torque=(0, 0, math.nan)), "torque is"),
    (lambda a: a.apply(7), "drones is 7"),
    (lambda a: a.place_obstacle(1, (0, 0, 1)), "obstacle is 1: a whole number from 0 to 0"),
    (lambda a: a.place_obstacle(0, (0, 0)), "position is"),
    (lambda a: a.picture(2), "drone is 2"),
    (lambda a: a.picture(size=(4, 4)), "size is 4"),
    (lambda a: a.picture(field_of_view=180), "field_of_view is 180"),
    (lambda a: a.add_body("nothing.urdf", (0, 0, 3)), "nothing.urdf"),
]


@pytest.mark.parametrize(("call", "message"), WRONG)
def test_what_cannot_be_is_refused_and_changes_nothing(call, message):
    def flown(wrong):
        airspace = Airspace(
            [(0, 0, 1), (1, 0, 1)], obstacles=(Obstacle("sphere", (0.1,)),), decision_hz=48, seed=0
        )
        airspace.place(0, (0, 0, CF2X.standing_height))
        airspace.command(1, "position", (1, 0, 1.2))
        steps(airspace, 30)
        touched = len(airspace.contacts.other)
        assert touched  # one stands on the ground
        if wrong:
            with pytest.raises((ValueError, FileNotFoundError), match=message):
                call(airspace)
        assert len(airspace.contacts.other) == touched
        return state(steps(airspace, 5))

    np.testing.assert_array_equal(flown(True), flown(False))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"position": [(0, 0, 1), (0, 0, 1.001)]}, "drone 0 at .* would overlap drone 1"),
        ({"position": [(0, 0, 0)]}, "stands at standing_height = 0.015 m"),
        ({"position": (0, 0, 1)}, "a row x, y, z for each drone"),
        ({"position": []}, "a row x, y, z for each drone"),
        ({"position": [(0, 0, math.nan)]}, "position is"),
        ({"quaternion": (0, 0, 0, 0)}, "quaternion"),
        ({"airframe": ["cf2x", "cf2x"]}, "2 airframes for 1 drones"),
        ({"airframe": "cf3x"}, "did you mean 'cf2x'"),
        ({"decision_hz": 7}, "decision_hz 7 does not divide physics_hz 240"),
        ({"dynamcs": "bullet"}, "unknown option of Airspace: 'dynamcs': did you mean 'dynamics'"),
        ({"horizon": 3}, "unknown option of Airspace: 'horizon'"),
        ({"decision_every": {"drones": 2}}, "unknown option of Airspace: 'decision_every'"),
        ({"sensors": ("gsp",)}, "unknown sensor 'gsp': did you mean 'gps'"),
        ({"sensors": ("imu", "imu")}, "sensors has 'imu' 2 times"),
        ({"obstacles": ["box"]}, "obstacles is .* a list of `Obstacle`"),
        ({"layout": "city"}, "layout is 'city': `Solids`"),
        ({"gravity": 0.0, "dynamics": "point_mass"}, "'point_mass' bounds accelerations by it"),
        ({"wind": (1, 2)}, "wind is"),
        ({"controller": "pid", "airframe": "iris", "effects": ()}, "has no <pwm> tag"),
        (
            {"controller": "pid", "effects": (), "dynamics": "point_mass"},
            "'pid' drives motors, and .* has none",
        ),
    ],
)
def test_options_that_cannot_be_are_refused(options, message):
    with pytest.raises((ValueError, TypeError), match=message):
        Airspace(**{"position": [(0, 0, 1)], **options})


def test_levels_that_cannot_drive_the_drone_are_refused():
    point = Airspace([(0, 0, 1)], dynamics="point_mass")
    with pytest.raises(ValueError, match="'point_mass' is driven by velocity setpoints"):
        point.command(0, "rates", (0, 0, 0, 1))
    with pytest.raises(ValueError, match="'point_mass' is driven by velocity setpoints"):
        point.stop()
    pid = Airspace([(0, 0, 1)], controller="pid", effects=(), rotor_speed=HOVER)
    with pytest.raises(ValueError, match="'pid' supports no attitude setpoints"):
        pid.command(0, "attitude", (0, 0, 0, 0.3))
    pid.command(0, "position", (0, 0, 1.2))
    assert steps(pid, 960).swarm.position[0, 2] == pytest.approx(1.2, abs=0.05)
    floating = Airspace([(0, 0, 1)], gravity=0.0)
    with pytest.raises(ValueError, match="VELOCITY need gravity"):
        floating.command(0, "velocity", (0, 0, 1))
    floating.command(0, "rotor", (0, 0, 0, 0))
    np.testing.assert_array_equal(steps(floating, 10).swarm.position[0], (0, 0, 1))
    floating.place(0, (0, 0, 1), rotor_speed=500.0)
    assert (floating.swarm.rotor_speed == 500).all()
    drifting = Airspace([(0, 0, 1)], gravity=0.0, dynamics="single_integrator")
    drifting.command(0, "velocity", (0, 0, 1))
    assert steps(drifting, 240).swarm.position[0, 2] == pytest.approx(2.0)


def test_a_closed_airspace_says_so():
    airspace = Airspace([(0, 0, 1)])
    airspace.close()
    airspace.close()
    for call in (airspace.step, airspace.stop, airspace.render):
        with pytest.raises(RuntimeError, match="this airspace is closed"):
            call()
    with pytest.raises(ValueError, match="make the airspace with the option obstacles"):
        Airspace([(0, 0, 1)]).place_obstacle(0, (0, 0, 1))


def test_a_copy_is_made_anew_and_dynamics_of_ones_own_fly():
    class Drifting(Dynamics):
        consumes = SetpointLevel.VELOCITY
        feels_force = True

        def advance_substep(self, swarm, alive, setpoint, air):
            swarm.velocity[:] = setpoint[..., :3] + air.force
            swarm.position[:] += self.flight.dt * swarm.velocity

    airspace = Airspace([(0, 0, 1), (1, 0, 1)], dynamics=Drifting, decision_hz=48)
    airspace.command(0, "velocity", (1.0, 0, 0))
    airspace.command(1, "position", (1.0, 0.0, 2.0))
    airspace.apply(0, (0, 0.5, 0))
    np.testing.assert_allclose(steps(airspace, 1).swarm.velocity[0], (1.0, 0.5, 0))
    assert airspace.swarm.velocity[1, 2] > 0
    again = copy.deepcopy(airspace)
    assert again.time == 0
    np.testing.assert_array_equal(again.swarm.position, [(0, 0, 1), (1, 0, 1)])


def test_drones_of_several_kinds_have_the_rotors_that_they_have():
    both = Airspace([(0, 0, 5), (5, 0, 5)], ["cf2x", "firefly"], decision_hz=48)
    assert both.hover_speed.shape == (2, 6)
    both.place(None, [(0, 0, 5), (5, 0, 5)], rotor_speed=both.hover_speed)
    both.command(None, "position", [(0, 0, 5), (5, 0, 5)])
    steps(both, 48)
    np.testing.assert_allclose(both.swarm.position, [(0, 0, 5), (5, 0, 5)], atol=0.05)
    assert not both.swarm.rotor_speed[0, 4:].any()


def test_it_is_what_the_package_offers():
    assert bulletuav.Airspace is Airspace
    assert bulletuav.SetpointLevel is SetpointLevel


def test_without_the_extension_flights_are_the_same_to_the_bit(monkeypatch):
    def flight():
        airspace = Airspace(
            [(0, 0, 0.4), (0.2, 0, 0.6)], obstacles=(Obstacle("sphere", (0.1,)),), decision_hz=48
        )
        airspace.place_obstacle(0, (0.0, 0, 0.2), velocity=(0.1, 0, 0))
        airspace.command(1, "position", (0.0, 0.1, 0.5))
        airspace.apply(0, torque=(1e-5, 0, 0))
        return state(steps(airspace, 48)), tuple(airspace.contacts)

    fast = flight()
    without = engine_module.EXTENSION._replace(library=None)
    monkeypatch.setattr(engine_module, "EXTENSION", without)
    slow = flight()
    np.testing.assert_array_equal(fast[0], slow[0])
    for one, other in zip(fast[1], slow[1], strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_engines_own_contacts_are_deep_and_compiled_ones_are_not():
    deepest = {}
    for contacts in ("bullet", "impulse"):
        airspace = Airspace([(0, 0, 2)], contacts=contacts, decision_hz=240)
        deepest[contacts] = max(
            steps(airspace, 1).contacts.depth.max(initial=0.0) for _ in range(240)
        )
    assert deepest["impulse"] == 0
    # Bullet notices within some steps of a fall at 6.3 m/s
    assert 1e-4 < deepest["bullet"] < 3 * 6.3 / 240


@pytest.mark.parametrize("dynamics", SIX)
def test_a_fast_yaw_rate_turns_as_fast_as_the_drone_can_and_no_slower_one_faster(dynamics):
    rates = []
    for rate in (1.0, 3.0, 50.0):
        airspace = Airspace([(0, 0, 20)], dynamics=dynamics, decision_hz=48, rotor_speed="hover")
        airspace.command(0, "position", (0, 0, 20), yaw_rate=rate)
        steps(airspace, 3 * 48)
        rates.append(np.mean([steps(airspace, 1).swarm.rates[0, 2] for _ in range(96)]))
    assert rates[0] == pytest.approx(1.0, abs=0.02)
    assert rates[2] == pytest.approx(rates[1], rel=0.05)
    assert rates[1] > 1.8
    # One for each, and what is told without a rate stands still
    pair = Airspace(APART[:2], dynamics=dynamics, decision_hz=48, rotor_speed="hover")
    pair.command(None, "position", APART[:2], yaw=(0.3, -0.3), yaw_rate=(0.5, -0.5))
    steps(pair, 48)
    np.testing.assert_allclose(pair.setpoint[:, 3], (0.8, -0.8), atol=1e-12)
    pair.command(0, "position", APART[0])
    steps(pair, 48)
    np.testing.assert_allclose(pair.setpoint[:, 3], (0.8, -1.3), atol=1e-12)


def test_after_a_flight_that_diverged_placing_is_enough():
    airspace = Airspace(APART[:2], dynamics="rigid_body", decision_hz=48, rotor_speed="hover")
    airspace.command(None, "position", APART[:2])
    airspace.apply(0, (0, 1e6, 0))
    with pytest.raises(RuntimeError, match=r"diverged.*place\(\) restarts a drone"):
        airspace.step()
    airspace.place(0, APART[0], rotor_speed="hover")
    steps(airspace, 48)
    np.testing.assert_allclose(airspace.swarm.position, APART[:2], atol=0.05)


def test_a_placed_drone_forgets_pushes_integrals_and_what_its_sensors_felt():
    airspace = Airspace([(0, 0, 5)], decision_hz=48, effects=(), controller="pid", sensors=("imu",))
    airspace.command(0, "position", (1.0, 0, 5))
    steps(airspace, 48)
    airspace.apply(0, (0.1, 0, 0))
    airspace.place(0, (0, 0, 6), velocity=(5.0, 0, 0), rotor_speed="hover")
    airspace.command(0, "position", (0, 0, 6))
    steps(airspace, 1)
    new = Airspace([(0, 0, 6)], decision_hz=48, effects=(), controller="pid", sensors=("imu",))
    new.place(0, (0, 0, 6), velocity=(5.0, 0, 0), rotor_speed="hover")
    new.command(0, "position", (0, 0, 6))
    steps(new, 1)
    np.testing.assert_array_equal(state(airspace), state(new))
    np.testing.assert_array_equal(airspace.readings["imu"], new.readings["imu"])
    # From then on it is as if it had flown like that before
    assert np.abs(new.readings["imu"][0, :3]).max() < 3 * G
    # Motors that were off begin without integrals
    airspace.stop()
    assert not airspace.world.cascade.memory.any()


def test_points_keep_the_heading_with_which_they_are_placed():
    airspace = Airspace([(0, 0, 5)], dynamics="point_mass", decision_hz=48)
    tilted = Rotation.from_euler("xyz", (0.3, -0.2, 1.0)).as_quat()
    airspace.place(0, (0, 0, 5), tilted)
    expected = Rotation.from_quat(tilted).as_euler("xyz")[2]
    for _ in range(2):
        roll, pitch, yaw = Rotation.from_quat(airspace.swarm.quaternion[0].copy()).as_euler("xyz")
        np.testing.assert_allclose((roll, pitch, yaw), (0, 0, expected), atol=1e-9)
        airspace.command(0, "velocity", (1.0, 0, 0))
        airspace.step()


def test_dynamics_to_which_no_controller_leads_take_their_own_level_alone():
    class Turning(Dynamics):
        consumes = SetpointLevel.RATES

        def advance_substep(self, swarm, alive, setpoint, air):
            swarm.rates[:] = setpoint[..., :3]

    airspace = Airspace([(0, 0, 5)], dynamics=Turning)
    with pytest.raises(ValueError, match="which no controller outputs: command RATES"):
        airspace.command(0, "position", (0, 0, 5))
    airspace.command(0, "rates", (0, 0, 1.0, 0))
    assert steps(airspace, 1).swarm.rates[0, 2] == 1.0


def test_it_tells_what_it_is_closes_at_the_end_of_a_with_and_counts_whole_seconds():
    with Airspace([(0, 0, 1), (3, 0, 1)], physics_hz=490, decision_hz=49) as airspace:
        steps(airspace, 49)
        assert airspace.time == 1.0
        assert repr(airspace) == f"<Airspace of 2 cf2x, {DEFAULT_DYNAMICS}, 1 s>"
        before = airspace.setpoint.copy()
        airspace.command([], "position", (0, 0, 1))
        np.testing.assert_array_equal(airspace.setpoint, before)
        airspace.command(0, airspace.levels[0], np.zeros(4))
        airspace.command(0, "POSITION", (0, 0, 1))
    with pytest.raises(RuntimeError, match="closed"):
        airspace.step()


@pytest.mark.parametrize("contacts", ["impulse", "bullet"])
def test_what_contacts_tell_is_a_copy(contacts):
    airspace = Airspace([(0, 0, CF2X.standing_height)], contacts=contacts)
    steps(airspace, 24).contacts.other[:] = 77
    assert set(airspace.contacts.other) == {GROUND}


def test_cameras_look_at_what_they_are_told_to():
    airspace = Airspace([(0, 0, 1), (2, 2, 1.5)], obstacles=(Obstacle("box", (1.0, 1, 1)),))
    airspace.place_obstacle(0, (0.0, -4, 1))
    for drone, place in ((0, None), (None, (0.0, 0, 1.2))):
        seen = airspace.picture(drone, place, target=(0, -4, 1), size=(64, 48))
        assert seen.labels[24, 32] == OBSTACLE
    # Straight down: the ground, at the height of the camera
    down = airspace.picture(None, (5.0, 5, 3), target=(5, 5, 0), size=(64, 48))
    assert down.depth[24, 32] == pytest.approx(3, abs=0.01)
    # By default from the nose, where a drone does not see itself
    assert not (airspace.picture(0, size=(64, 48)).labels == DRONE).any()


def test_the_wind_can_change():
    """After it has, drones fly as in an airspace that had it from the start."""
    changed = Airspace([(0.0, 0.0, 50.0)], decision_hz=48, rotor_speed=HOVER, seed=0)
    given = Airspace([(0.0, 0.0, 50.0)], decision_hz=48, rotor_speed=HOVER, wind=(3, -1, 0), seed=0)
    changed.set_wind((3.0, -1.0, 0.0))
    for airspace in (changed, given):
        airspace.command(0, "attitude", (0.0, 0.0, 0.0, CF2X.mass * G))
        steps(airspace, 10)
    np.testing.assert_array_equal(state(changed), state(given))
    assert changed.swarm.velocity[0, 0] > 0.01
    changed.set_wind((0.0, 0.0, 0.0))
    for wrong in ((1.0, 2.0), (0.0, 0.0, 200.0), (0.0, np.nan, 0.0), "calm"):
        with pytest.raises(ValueError, match="wind is"):
            changed.set_wind(wrong)
    changed.close()
    given.close()
    with pytest.raises(RuntimeError, match="closed"):
        changed.set_wind((0.0, 0.0, 0.0))
