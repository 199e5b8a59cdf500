"""Virtual Crazyflies fly as they are told, and stop as the firmware does."""

import math
import struct

import numpy as np
import pytest
from bridges.crtp_client import Drone
from hypothesis import given
from hypothesis import strategies as st

from bulletuav import load_airframe
from bulletuav.bridges import crazyflie_fleet
from bulletuav.bridges.crazyflie_fleet import CrazyflieFleet
from bulletuav.bridges.crazyflie_setpoints import Commander, ThrustMap, decompress_quaternion
from bulletuav.bridges.crtp import Packet
from bulletuav.bridges.setpoints import SetpointController
from bulletuav.bridges.starts import make_start_positions

CF2X = load_airframe("cf2x")
EBUSY, EINVAL, ENOENT, ENOEXEC, ENOMEM = 16, 22, 2, 8, 12
ARMED, CAN_FLY, FLYING, TUMBLED, LOCKED, CRASHED, ACTIVE = 2, 8, 16, 32, 64, 128, 256
HOVER_COMMAND = 38_754
"""Command at which a cf2x carries its weight: its motors' map, by hand"""


def in_the_air(drone, height=1.0):
    """Put it there, at rest, with rotors as in hover."""
    drone.fleet.airspace.place(
        drone.index, (*drone.place[:2], height), rotor_speed=CF2X.hover_speed()
    )
    drone.fleet.step()  # it notices
    return drone


# Numbers


def test_the_motors_follow_their_published_map():
    motors = ThrustMap(CF2X)
    hover = CF2X.mass * 9.80665
    assert motors.thrust(HOVER_COMMAND) == pytest.approx(hover, rel=2e-3)
    assert motors.thrust(65535) == pytest.approx(CF2X.max_thrust, rel=1e-2)
    assert motors.thrust(0) == 0
    assert motors.command([CF2X.hover_speed()] * 4) == pytest.approx(HOVER_COMMAND, rel=1e-3)
    for command in (100, 5000, 19999, 20001, 50000):
        speed = math.sqrt(motors.thrust(command) / 4 / CF2X.thrust_coefficient)
        assert motors.command([speed] * 4) == pytest.approx(command, rel=1e-9)
    thrusts = [motors.thrust(command) for command in range(0, 65536, 997)]
    assert (np.diff(thrusts) > 0).all()
    plain = ThrustMap(load_airframe("hummingbird"))
    assert plain.thrust(65535) == pytest.approx(load_airframe("hummingbird").max_thrust)


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.abs(q).max() > 0.1))
def test_quaternions_are_packed_into_32_bits(numbers):
    turn = np.array(numbers) / np.linalg.norm(numbers)
    largest = int(np.abs(turn).argmax())
    packed, sign = largest, np.sign(turn[largest])
    for k in range(4):
        if k != largest:
            entry = sign * turn[k]
            size = int(511 * abs(entry) * math.sqrt(2) + 0.5)
            packed = packed << 10 | int(entry < 0) << 9 | size
    np.testing.assert_allclose(decompress_quaternion(packed), sign * turn, atol=2e-3)


def test_any_32_bits_are_a_unit_quaternion():
    for packed in (0, 0xFFFFFFFF, 0x3FFFFFFF, 0x12345678):
        assert np.linalg.norm(decompress_quaternion(packed)) == pytest.approx(1)


def test_places_of_drones_lie_apart():
    places = make_start_positions(10, 0.02, 0.5)
    assert places.shape == (10, 3)
    assert places[0].tolist() == [0, 0, 0.02]
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + 9 * np.eye(10)
    assert gaps.min() == 0.5
    assert make_start_positions([(1, 2), (3, 4)], 0.1, 0.5).tolist() == [[1, 2, 0.1], [3, 4, 0.1]]
    with pytest.raises(ValueError, match="decision_hz is 100"):
        CrazyflieFleet(1, decision_hz=50)
    for wrong in (0, 257, []):
        with pytest.raises(ValueError, match="drones is"):
            make_start_positions(wrong, 0.1, 0.5)


def test_the_former_name_of_the_fleet_warns():
    with pytest.warns(DeprecationWarning, match="Fleet is now CrazyflieFleet; .* next release"):
        assert crazyflie_fleet.Fleet is CrazyflieFleet
    with pytest.raises(AttributeError, match="no attribute 'Flotilla'"):
        _ = crazyflie_fleet.Flotilla


# The high-level commander


def test_it_takes_off_goes_somewhere_and_lands(drone, fly):
    assert drone.take_off(1.0, 1.5) == 0
    fly(drone.fleet, 2.5)
    np.testing.assert_allclose(drone.place, (0, 0, 1), atol=0.02)
    assert drone.bits() & (FLYING | ACTIVE) == FLYING | ACTIVE
    assert drone.take_off(1.0, 1.5) == EBUSY
    assert drone.go_to(1.0, 0.5, 1.2, math.pi / 2, 2.0) == 0
    fly(drone.fleet, 1.0)
    assert drone.go_to(0.0, 0.0, 0.1, 0.0, 2.0, relative=True) == 0  # back to half way
    fly(drone.fleet, 3.0)
    np.testing.assert_allclose(drone.place, (0.5, 0.25, 1.2), atol=0.05)
    assert drone.go_to(0.0, 0.0, 1.0, 0.0, 2.0, linear=True) == 0
    fly(drone.fleet, 3.0)
    np.testing.assert_allclose(drone.place, (0, 0, 1), atol=0.06)  # it stopped all of a sudden
    assert drone.land(1.5) == 0
    fly(drone.fleet, 2.5)
    assert drone.place[2] < 0.02
    assert not drone.bits() & (FLYING | ACTIVE)
    assert drone.fleet.airspace.swarm.rotor_speed[0].max() < 10


def test_it_follows_a_trajectory_from_its_memory(drone, fly):
    """A quarter of a circle, as a polynomial; forwards, then backwards to where it was."""
    in_the_air(drone)
    terms = np.zeros((4, 8))
    terms[0, 4:] = terms[1, 4:] = np.array([35, -84, 70, -20]) / 2.0 ** np.arange(4, 8)
    piece = struct.pack("<33f", *terms.ravel(), 2.0)
    for address in range(0, len(piece), 24):
        where = struct.pack("<BI", 0, address)
        assert drone.data(4, 2, where + piece[address : address + 24])[-1] == 0
    assert drone.plan("BBBBIB", 6, 1, 1, 0, 0, 1) == 0
    assert drone.go_to(0, 0, 1, 0, 0.5) == 0
    fly(drone.fleet, 0.5)
    assert drone.plan("BBBBBBf", 13, 0, True, False, False, 1, 1.0) == 0
    fly(drone.fleet, 3.0)
    np.testing.assert_allclose(drone.place, (1, 1, 1), atol=0.03)
    assert drone.plan("BBBBBBf", 13, 0, True, True, True, 1, 0.8) == 0
    fly(drone.fleet, 2.6)
    np.testing.assert_allclose(drone.place, (0, 0, 1), atol=0.05)
    assert drone.plan("BBBBBBf", 13, 0, True, True, True, 1, 0.0) == EINVAL
    assert drone.plan("BBBBBBf", 13, 0, True, True, True, 2, 1.0) == ENOENT
    assert drone.plan("BBBBIB", 6, 2, 1, 1, 4000, 9) == 0
    assert drone.plan("BBBBBBf", 13, 0, True, True, True, 2, 1.0) == EINVAL


def test_it_turns_to_a_yaw_as_it_takes_off(drone, fly):
    assert drone.plan("BBff?f", 7, 0, 1.0, 1.0, False, 2.0) == 0
    fly(drone.fleet, 3.5)
    told = drone.fleet.vehicles[0].telemetry(lambda height: 0.0)
    assert told.euler[2] == pytest.approx(math.degrees(1.0), abs=2)
    assert told.target == pytest.approx([0, 0, 1], abs=1e-6)


def test_it_flies_a_spiral(drone, fly):
    in_the_air(drone)
    assert drone.plan("BBBBfffff", 11, 0, False, False, math.pi, 0.5, 0.5, 0.2, 3.0) == 0
    fly(drone.fleet, 4.0)
    np.testing.assert_allclose(drone.place, (0, 1, 1.2), atol=0.04)


def test_plans_that_cannot_be_are_refused(drone, fly):
    assert drone.take_off(5000.0, 1.0) == EINVAL
    assert drone.take_off(1.0, 0.0) == EINVAL
    assert drone.go_to(1e6, 0, 1, 0, 1) == EINVAL
    assert drone.plan("BBBBfffff", 11, 0, 0, 0, 1.0, -0.5, 0.5, 0.2, 3.0) == EINVAL
    assert drone.plan("BBBBIB", 6, 1, 0, 0, 0, 1) == EINVAL
    assert drone.plan("BBBBIB", 6, 1, 1, 0, 0, 0) == EINVAL
    for number in range(10):
        assert drone.plan("BBBBIB", 6, number, 1, 0, 0, 1) == 0
    assert drone.plan("BBBBIB", 6, 99, 1, 0, 0, 1) == ENOMEM
    assert drone.plan("BBB", 99, 0, 0) == ENOEXEC
    fly(drone.fleet, 0.1)
    assert not drone.bits() & ACTIVE


def test_commands_for_other_groups_are_not_for_it(drone):
    assert drone.plan("BBB", 0, 0b10, 0) == 0
    assert drone.plan("BBff?f", 7, 0b01, 1.0, 0.0, True, 1.0) == 0
    assert not drone.bits() & ACTIVE
    assert drone.plan("BBff?f", 7, 0b11, 1.0, 0.0, True, 1.0) == 0
    assert drone.bits() & ACTIVE
    assert drone.plan("BBB", 3, 0, 0) == 0
    assert not drone.bits() & ACTIVE


# Low-level setpoints


def test_a_position_is_held_and_the_yaw_with_it(drone, fly):
    in_the_air(drone)
    fly(drone.fleet, 3.0, lambda: drone.setpoint(7, "ffff", 0.4, -0.3, 1.2, 90.0))
    np.testing.assert_allclose(drone.place, (0.4, -0.3, 1.2), atol=0.03)
    told = drone.fleet.vehicles[0].telemetry(lambda height: 0.0)
    assert told.euler[2] == pytest.approx(90, abs=2)
    assert told.thrust == pytest.approx(HOVER_COMMAND, rel=0.02)


def test_velocities_are_of_the_world_or_of_the_body(drone, fly):
    in_the_air(drone)
    fly(drone.fleet, 2.0, lambda: drone.setpoint(8, "ffff", 0.0, 0.5, 0.1, 45.0))
    np.testing.assert_allclose(drone.velocity, (0, 0.5, 0.1), atol=0.05)
    fly(drone.fleet, 2.0, lambda: drone.setpoint(10, "ffff", 0.0, 0.0, 0.0, 1.2))
    yaw = drone.fleet.vehicles[0].telemetry(lambda height: 0.0).euler[2]
    assert yaw == pytest.approx(90, abs=3)
    fly(drone.fleet, 2.5, lambda: drone.setpoint(10, "ffff", 0.5, 0.0, 0.0, 1.2))
    np.testing.assert_allclose(drone.velocity, (0, 0.5, 0), atol=0.05)
    assert drone.place[2] == pytest.approx(1.2, abs=0.03)


def test_pitch_of_cflib_leads_forward_and_that_of_zdistance_backward(drone, fly):
    in_the_air(drone)
    drone.attitude(0, 0, 0, 0)
    fly(drone.fleet, 0.5, lambda: drone.attitude(0, 10, 0, 39_000))
    assert drone.velocity[0] > 0.3
    assert abs(drone.velocity[1]) < 0.01
    in_the_air(drone)
    fly(drone.fleet, 0.5, lambda: drone.setpoint(9, "ffff", 10.0, 10.0, 0.0, 1.0))
    assert drone.velocity[0] < -0.3
    assert drone.velocity[1] < -0.3  # to the right
    assert drone.place[2] == pytest.approx(1.0, abs=0.03)


def test_yaw_rates_of_the_old_port_turn_clockwise_and_others_counter_clockwise(drone, fly):
    in_the_air(drone)
    drone.attitude(0, 0, 0, 0)
    fly(drone.fleet, 1.0, lambda: drone.attitude(0, 0, 45.0, 39_000))
    told = drone.fleet.vehicles[0]
    assert -50 < told.telemetry(lambda height: 0.0).euler[2] < -10
    drone.setpoint(0)
    in_the_air(drone)
    fly(drone.fleet, 1.0, lambda: drone.setpoint(11, "fffHB", 0.0, 0.0, 45.0, 39_000, False))
    assert 10 < told.telemetry(lambda height: 0.0).euler[2] < 50


def test_roll_and_pitch_can_be_rates(drone, fly):
    in_the_air(drone, 3.0)
    fly(drone.fleet, 0.5, lambda: drone.setpoint(11, "fffHB", 60.0, 0.0, 0.0, 39_000, True))
    assert math.degrees(drone.fleet.airspace.swarm.rates[0, 0]) == pytest.approx(60, abs=8)
    for axis in ("Roll", "Pitch"):
        assert drone.parameter(f"flightmode.stabMode{axis}", 0) == 0
    in_the_air(drone, 3.0)
    drone.attitude(0, 0, 0, 0)
    fly(drone.fleet, 0.5, lambda: drone.attitude(0, 60.0, 0.0, 39_000))
    assert math.degrees(drone.fleet.airspace.swarm.rates[0, 1]) == pytest.approx(60, abs=8)
    drone.parameter("flightmode.stabModeYaw", 1)
    in_the_air(drone, 3.0)
    drone.attitude(0, 0, 0, 0)
    fly(drone.fleet, 0.3, lambda: drone.attitude(0, 0, 90.0, 39_000))
    assert abs(drone.fleet.airspace.swarm.rates[0, 2]) < 0.1


def test_a_full_state_is_followed_with_its_motion(drone, fly):
    in_the_air(drone)
    fly(drone.fleet, 3.0, drone.swing())
    np.testing.assert_allclose(drone.place, (0.5 * (1 - math.cos(3)), 0, 1), atol=0.06)
    assert drone.velocity[0] == pytest.approx(0.5 * math.sin(3), abs=0.1)


def test_thrust_is_locked_until_it_was_zero_once(drone, fly):
    fly(drone.fleet, 0.3, lambda: drone.attitude(0, 0, 0, 50_000))
    assert not drone.bits() & FLYING
    drone.attitude(0, 0, 0, 0)
    fly(drone.fleet, 0.3, lambda: drone.attitude(0, 0, 0, 50_000))
    assert drone.place[2] > 0.05
    drone.setpoint(0)
    fly(drone.fleet, 0.01, lambda: drone.attitude(0, 0, 0, 50_000))
    fly(drone.fleet, 0.4)
    assert not drone.bits() & FLYING


def test_without_setpoints_it_levels_out_and_then_stops():
    commander = Commander(ThrustMap(CF2X))
    packet = Packet(7, 0, struct.pack("<Bffff", 8, 0.5, 0.0, 0.1, 20.0))
    commander.set_setpoint(packet, 10.0, (False, True))
    assert commander.current(10.5).xy == (0.5, 0.0)
    level = commander.current(10.51)
    assert (level.xy_mode, level.xy, level.z_mode, level.yaw) == ("attitude", (0, 0), "velocity", 0)
    assert level.z == pytest.approx(0.1)
    assert commander.current(12.0) is not None
    assert commander.current(12.01) is None
    assert commander.is_released


def test_a_drone_left_alone_falls_after_two_seconds(drone, fly):
    in_the_air(drone, 2.0)
    drone.setpoint(7, "ffff", 0.0, 0.0, 2.0, 0.0)
    fly(drone.fleet, 1.99)
    np.testing.assert_allclose(drone.place, (0, 0, 2), atol=0.05)
    fly(drone.fleet, 1.0)
    assert drone.place[2] < 0.5


def test_the_planner_waits_until_low_level_control_is_handed_over(drone, fly):
    in_the_air(drone)
    drone.setpoint(7, "ffff", 0.0, 0.0, 1.0, 0.0)
    assert drone.go_to(1, 0, 1, 0, 1.0) == 0
    fly(drone.fleet, 0.4)
    assert abs(drone.place[0]) < 0.01
    assert not drone.bits() & ACTIVE
    assert drone.ask(7, 1, struct.pack("<BI", 0, 0)) == []
    fly(drone.fleet, 2.5)
    assert drone.place[0] == pytest.approx(1.0, abs=0.05)
    assert drone.bits() & ACTIVE
    drone.setpoint(7, "ffff", 0.0, 0.0, 1.0, 0.0)
    assert not drone.bits() & ACTIVE


def test_the_yaw_to_hold_does_not_run_away():
    guide = SetpointController(CF2X)
    setpoint = Commander(ThrustMap(CF2X))._decode_generic(8, struct.pack("<ffff", 0, 0, 0, 720.0))
    state = ([0.0] * 3, [0.0, 0.0, 0.0, 1.0], [0.0] * 3, [0.0] * 3)
    for _ in range(100):
        order = guide.compute_command(setpoint, state, 0.01)
    assert order.values[3] == pytest.approx(1.0)


# The supervisor


def test_who_is_not_armed_does_not_fly(drone, fly):
    assert drone.bits() & (ARMED | CAN_FLY) == ARMED | CAN_FLY
    assert drone.data(9, 1, b"\x01\x00") == b"\x81\x01\x00"
    assert drone.take_off(1.0, 1.0) == 0
    fly(drone.fleet, 0.5)
    assert drone.place[2] < 0.02
    assert not drone.bits() & (ARMED | CAN_FLY | FLYING)
    assert drone.ask(13, 0, b"\x01\x01") == [(13, 0, b"\x01\x01")]
    assert drone.bits() & (ARMED | CAN_FLY) == ARMED | CAN_FLY


def test_an_emergency_stop_is_for_good(drone, fly):
    in_the_air(drone)
    drone.go_to(0, 0, 1, 0, 1.0)
    fly(drone.fleet, 0.1)
    assert drone.data(9, 1, b"\x03") == b"\x83\x01\x01"
    fly(drone.fleet, 1.0)
    assert drone.place[2] < 0.1
    assert drone.bits() & LOCKED
    assert drone.data(9, 1, b"\x01\x01") == b"\x81\x00\x01"
    assert drone.data(9, 1, b"\x02") == b"\x82\x00\x00"
    drone.take_off(1.0, 1.0)
    fly(drone.fleet, 0.5)
    assert drone.place[2] < 0.1


def test_the_watchdog_stops_who_does_not_feed_it(drone, fly):
    in_the_air(drone)
    drone.go_to(0, 0, 1, 0, 1.0)
    for _ in range(3):
        assert drone.data(9, 1, b"\x04") == b"\x84\x01\x01"
        fly(drone.fleet, 0.9)
    assert drone.place[2] == pytest.approx(1.0, abs=0.02)
    fly(drone.fleet, 0.2)
    assert drone.bits() & LOCKED


def test_who_lies_upside_down_stops_and_is_put_on_its_feet(drone, fly):
    drone.fleet.airspace.place(0, (0, 0, 0.02), (1.0, 0.0, 0.0, 0.0))
    fly(drone.fleet, 0.5, lambda: drone.setpoint(9, "ffff", 0.0, 0.0, 0.0, 1.0))
    assert not drone.bits() & TUMBLED
    fly(drone.fleet, 0.7, lambda: drone.setpoint(9, "ffff", 0.0, 0.0, 0.0, 1.0))
    assert drone.bits() & (TUMBLED | CRASHED | CAN_FLY) == TUMBLED | CRASHED
    fly(drone.fleet, 1.0, lambda: drone.setpoint(9, "ffff", 0.0, 0.0, 0.0, 1.0))
    assert not drone.bits() & FLYING
    assert drone.data(9, 1, b"\x02") == b"\x82\x01\x01"
    fly(drone.fleet, 0.3)
    assert not drone.bits() & (TUMBLED | CRASHED)
    assert drone.take_off(1.0, 1.5) == 0
    fly(drone.fleet, 2.5)
    np.testing.assert_allclose(drone.place[2], 1, atol=0.03)


def test_where_there_is_no_room_nobody_is_put_on_its_feet(make_fleet, fly):
    fleet = make_fleet([(0.0, 0.0), (0.5, 0.0)])
    drone = Drone(fleet)
    fleet.airspace.place(0, (0, 0, 0.0151), (1.0, 0.0, 0.0, 0.0))
    fleet.airspace.place(1, (0, 0, 0.0452))  # right above it
    fly(fleet, 1.2)
    assert drone.bits() & TUMBLED
    assert drone.data(9, 1, b"\x02") == b"\x82\x00\x00"


# Together


def test_drones_collide(make_fleet, fly):
    fleet = make_fleet([(0.0, 0.0), (1.0, 0.0)])
    drones = [Drone(fleet, 0), Drone(fleet, 1)]
    touched = []
    fleet.airspace.place(None, [(0, 0, 1), (1, 0, 1)], rotor_speed=CF2X.hover_speed())
    fleet.step()

    def towards():
        for drone, speed in zip(drones, (1.0, -1.0), strict=True):
            drone.setpoint(8, "ffff", speed, 0.0, 0.0, 0.0)
        touched.extend(fleet.airspace.contacts.other.tolist())

    fly(fleet, 1.5, towards)
    assert 0 in touched
    assert 1 in touched


def test_the_same_packets_give_the_same_flight(make_fleet, fly):
    ends = []
    for _ in range(2):
        fleet = make_fleet(3)
        for i in range(3):
            Drone(fleet, i).take_off(0.5 + 0.1 * i, 1.0)
        fly(fleet, 1.0)
        ends.append(fleet.airspace.state_hash())
    assert ends[0] == ends[1]


def test_warming_up_changes_nothing(make_fleet, fly):
    ends = []
    for warm in (False, True):
        fleet = make_fleet(2)
        if warm:
            fleet.warm_up()
        Drone(fleet).take_off(0.5, 1.0)
        fly(fleet, 0.5)
        ends.append(fleet.airspace.swarm.position.tolist())
    assert ends[0] == ends[1]


# Anything


def survive(fleet, packets):
    """Give drones packets of random bytes to ports that there are, and see that they fly on."""
    rng = np.random.default_rng(packets)
    ports = (2, 3, 4, 5, 6, 7, 8, 9, 13, 15)
    for count in range(packets):
        data = rng.bytes(rng.integers(0, 31))
        if rng.random() < 0.7:  # a first byte that means something more often
            data = bytes([rng.integers(0, 14)]) + data[1:]
        packet = Packet(int(rng.choice(ports)), int(rng.integers(0, 4)), data)
        for answer in fleet.take(count % len(fleet), packet):
            assert len(answer.frame()) <= 31
        if count % 40 == 0:
            for _, sent in fleet.step():
                assert len(sent.frame()) <= 31
    swarm = fleet.airspace.swarm
    assert all(np.isfinite(array).all() for array in swarm)
    assert np.abs(swarm.position).max() < 1e4
    return sum(vehicle.malformed for vehicle in fleet.vehicles)


def test_any_bytes_are_survived(make_fleet):
    assert survive(make_fleet(3), 1500) > 100


@pytest.mark.slow
def test_a_hundred_thousand_packets_of_any_bytes_are_survived(make_fleet):
    assert survive(make_fleet(3), 100_000) > 1000
