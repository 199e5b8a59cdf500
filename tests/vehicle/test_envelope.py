"""Trim, glide, climb, turn, stall speed and envelope, against hand calculations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from stability import DENSITY, G, drag_polar, level_lift, reference

from bulletuav import load_airframe
from bulletuav.control.autopilot import autopilot_rows
from bulletuav.vehicle.envelope import (
    find_climb,
    find_envelope,
    find_stall,
    find_trim,
    maximize,
    solve_linear,
)
from bulletuav.vehicle.wing_power import wing_power

TRAINER, QUADPLANE = load_airframe("trainer"), load_airframe("quadplane")
BOTH = pytest.mark.parametrize("airframe", [TRAINER, QUADPLANE], ids=["trainer", "quadplane"])


def thrust(airframe, rotor, airspeed):
    return airframe.thrust_coefficient * rotor**2 - airframe.drag_z * rotor * airspeed


def drag(airframe, airspeed, load=1.0):
    pressure = 0.5 * DENSITY * airspeed**2
    return (
        pressure
        * reference(airframe).area
        * drag_polar(airframe, level_lift(airframe, airspeed, load))
    )


@BOTH
@pytest.mark.parametrize("airspeed", [11.0, 13.0, 16.0])
def test_the_glide_angle_is_that_of_the_drag_polar(airframe, airspeed):
    """tan of the angle is drag over lift, both of the lift W cos(angle)."""
    glide = find_climb(airframe, airspeed, 0.0)
    load = math.cos(glide.climb)
    lift = level_lift(airframe, airspeed, load)
    assert math.tan(-glide.climb) == pytest.approx(drag_polar(airframe, lift) / lift, rel=0.02)
    assert glide.speed == (0.0,) * len(airframe.rotors)
    assert glide.pitch == pytest.approx(glide.climb + glide.alpha, abs=1e-9)


@BOTH
@pytest.mark.parametrize("airspeed", [11.0, 14.0])
def test_the_climb_is_that_of_the_excess_power(airframe, airspeed):
    """Climb = (T - D) V / W, with the thrust of the propeller at this airspeed.

    The slipstream adds drag to the parts behind the propeller, which the hand calculation neglects.
    """
    climb = find_climb(airframe, airspeed)
    load = math.cos(climb.climb)
    pull = thrust(airframe, airframe.max_rotor_speed, airspeed)
    excess = pull - drag(airframe, airspeed, load)
    by_hand = excess * airspeed / (airframe.mass * G)
    assert airspeed * math.sin(climb.climb) == pytest.approx(by_hand, rel=0.05)


@BOTH
def test_level_flight_needs_the_rotor_speed_whose_thrust_is_the_drag(airframe):
    trim = find_trim(airframe, 13.0)
    assert thrust(airframe, max(trim.speed), 13.0) == pytest.approx(drag(airframe, 13.0), rel=0.03)
    assert (trim.climb, trim.bank, trim.turn_rate) == (0.0, 0.0, 0.0)
    assert trim.pitch == pytest.approx(trim.alpha, abs=1e-6)


@BOTH
@pytest.mark.parametrize("bank", [0.5, -0.8])
def test_a_turn_needs_the_angle_of_attack_of_its_load_factor(airframe, bank):
    """Lift W / cos(bank); the hand calculation has the lift slope of level flight."""
    level, faster, turn = (
        find_trim(airframe, 14.0),
        find_trim(airframe, 14.5),
        find_trim(airframe, 14.0, 0.0, bank),
    )
    slope = (level.alpha - faster.alpha) / (1 - (14.0 / 14.5) ** 2)
    load = (turn.alpha - level.alpha) / slope + 1
    assert load == pytest.approx(1 / math.cos(bank), rel=0.05)
    assert turn.turn_rate == pytest.approx(G * math.tan(bank) / 14.0)
    assert max(turn.speed) > max(level.speed)


@BOTH
def test_turns_to_both_sides_are_mirror_images_without_a_spinning_rotor(airframe):
    right, left = (find_climb(airframe, 13.0, 0.0, bank) for bank in (0.6, -0.6))
    for name in ("alpha", "climb", "pitch"):
        assert getattr(right, name) == pytest.approx(getattr(left, name), abs=1e-9)
    assert right.sideslip == pytest.approx(-left.sideslip, abs=1e-9)
    assert right.deflection[0] == pytest.approx(left.deflection[1], abs=1e-9)
    assert right.deflection[2] == pytest.approx(left.deflection[2], abs=1e-9)


def maximum_lift(wing):
    """Maximum lift coefficient of Khan and Nahon's blend, with angles instead of their sines."""
    angle = np.linspace(0.0, 0.5, 5001)
    relative = angle - wing.zero_lift
    normal = (
        1.98
        * np.sin(angle)
        * (1 / (0.56 + 0.44 * np.sin(angle)) - 0.41 * (1 - math.exp(-17 / wing.aspect_ratio)))
    )
    plate = normal * np.cos(angle) - 0.5 * wing.drag * np.cos(angle) * np.sin(angle)
    step = np.clip((relative - wing.stall) / math.radians(10), 0, 1)
    blend = step**2 * (3 - 2 * step)
    lift = (1 - blend) * wing.lift_slope * relative + blend * plate
    return lift.max(), angle[np.argmax(lift)] - wing.incidence


@BOTH
def test_the_stall_speed_is_that_of_the_maximum_lift(airframe):
    """W = q (S C_Lmax + tail + fuselage); the tail balances the moment of the wing."""
    wing, at = airframe.wings[0], reference(airframe)
    lift, angle = maximum_lift(wing)
    arm = -airframe.wings[2].position[0]
    moment = lift * wing.position[0] + at.chord * wing.moment
    # The wing's lift leans forward, above the centre of mass, and its drag backward
    moment -= wing.position[2] * (lift * math.sin(angle) - 0.09)
    total = at.area * lift + at.area * moment / arm + airframe.body_drag[1] * math.sin(angle)
    by_hand = math.sqrt(airframe.mass * G / (0.5 * DENSITY * total))
    speed, alpha = find_stall(airframe)
    assert speed == pytest.approx(by_hand, rel=0.03)
    assert alpha == pytest.approx(angle, abs=0.02)
    assert find_envelope(airframe).stall_speed == speed


@BOTH
def test_no_slower_glide_than_the_stall_speed(airframe):
    speed, _ = find_stall(airframe)
    assert find_climb(airframe, 1.02 * speed, 0.0).alpha < find_stall(airframe)[1]
    with pytest.raises(ValueError, match=rf"cannot trim at .*stall speed is {speed:.4g} m/s"):
        find_climb(airframe, 0.97 * speed, 0.0)


def test_a_tail_that_stalls_first_limits_the_lift():
    """Beyond the stall of the whole tail, at 7.7 degrees, its elevator has no effect."""
    left, right, tail, fin = TRAINER.wings
    small = replace(tail, stall=0.01, downwash=0.0, incidence=0.05)
    speed, alpha = find_stall(replace(TRAINER, wings=(left, right, small, fin)))
    assert speed > find_stall(TRAINER)[0]
    assert alpha < find_stall(TRAINER)[1]


@BOTH
def test_the_envelope_by_hand(airframe):
    found = find_envelope(airframe)
    assert found.min_speed == pytest.approx(1.2 * found.stall_speed)
    # Least drag where parasite and induced drag are equal, and 3^(1/4) times that (Carson)
    wing, at = airframe.wings[0], reference(airframe)
    factor = math.pi * wing.efficiency * wing.aspect_ratio
    lift = math.sqrt(drag_polar(airframe, 0.0) * factor)
    least = math.sqrt(airframe.mass * G / (0.5 * DENSITY * at.area * lift))
    assert found.cruise_speed == pytest.approx(3**0.25 * least, rel=0.03)
    assert found.max_speed <= airframe.max_speed
    # (1.2 / 1.05)^2 = 1.306 = 1 / cos(40.04 degrees)
    assert math.degrees(found.max_bank) == pytest.approx(40.04, abs=0.01)
    sink = found.cruise_speed * drag(airframe, found.cruise_speed) / (airframe.mass * G)
    assert found.max_sink == pytest.approx(sink, rel=0.03)
    assert found.max_climb == pytest.approx(
        found.cruise_speed * math.sin(find_climb(airframe, found.cruise_speed).climb)
    )
    assert find_envelope(airframe) is found


def test_the_fastest_level_flight_has_the_thrust_of_its_drag():
    fast = replace(TRAINER, max_speed=40.0)
    speed = find_envelope(fast).max_speed
    assert 17 < speed < 18
    assert thrust(fast, fast.max_rotor_speed, speed) == pytest.approx(drag(fast, speed), rel=0.05)
    assert find_climb(fast, speed).climb == pytest.approx(0.0, abs=1e-6)


def test_limits_are_the_design_values_of_both_aircraft():
    assert find_envelope(TRAINER).stall_speed == pytest.approx(8.0, abs=0.1)
    assert 3 < find_envelope(TRAINER).max_climb < 5
    assert find_envelope(QUADPLANE).stall_speed == pytest.approx(9.1, abs=0.1)


def without(airframe, *names):
    """The airframe without these control surfaces."""
    return replace(
        airframe,
        wings=tuple(
            replace(one, surface=None) if one.surface and one.surface.name in names else one
            for one in airframe.wings
        ),
    )


def test_an_aircraft_without_ailerons_or_rudder_is_trimmed_by_sideslip():
    for names in (("rudder",), ("left aileron", "right aileron")):
        trim = find_trim(without(TRAINER, *names), 13.0)
        full = find_trim(TRAINER, 13.0)
        assert trim.alpha == pytest.approx(full.alpha, abs=1e-3)
        assert trim.speed == pytest.approx(full.speed, rel=1e-3)
        assert abs(trim.sideslip) < 0.05
        assert len(trim.deflection) == 4 - len(names)


@pytest.mark.parametrize("names", [("elevator",), ("left aileron", "right aileron", "rudder")])
def test_an_aircraft_needs_control_of_pitch_and_of_roll_or_yaw(names):
    with pytest.raises(ValueError, match="no control surfaces for pitch and for roll or yaw: add"):
        find_trim(without(TRAINER, *names), 13.0)


def test_elevons_control_roll_and_pitch():
    """A wing behind the centre of mass with the trainer's ailerons, and no other surface."""
    trim = find_trim(without(TRAINER, "rudder"), 13.0)
    assert trim.deflection[0] == pytest.approx(-trim.deflection[1])
    tail = TRAINER.wings[2]
    halves = [
        replace(
            tail,
            name=f"elevon {side}",
            position=(tail.position[0], side * 0.11, 0.02),
            span=0.22,
            surface=replace(tail.surface, name=f"elevon {side}"),
        )
        for side in (1, -1)
    ]
    bare = without(TRAINER, "left aileron", "right aileron", "rudder")
    elevons = replace(bare, wings=(*bare.wings[:2], *halves, bare.wings[3]))
    left, right = find_trim(elevons, 13.0).deflection
    # Half their sum is the elevator of the trainer, and their difference rolls
    assert (left + right) / 2 == pytest.approx(find_trim(TRAINER, 13.0).deflection[2], abs=2e-3)
    assert left > right


def test_a_wing_whose_moment_no_elevator_balances_has_no_lift():
    left, right, tail, fin = TRAINER.wings
    small = replace(tail, surface=replace(tail.surface, low=-0.01, high=0.01))
    curved = (replace(left, moment=-1.0), replace(right, moment=-1.0), small, fin)
    with pytest.raises(ValueError, match="has no lift at which its control surfaces balance"):
        find_stall(replace(TRAINER, wings=curved))


MISTAKES = [
    ((0.0,), "airspeed is 0"),
    ((-1.0,), "airspeed is -1"),
    ((13.0, 2.0), "climb is 2"),
    ((13.0, 0.0, 1.5), "bank is 1.5"),
    ((6.0,), "cannot trim at 6 m/s, a bank of 0 rad and a climb of 0 rad: its stall speed is 7.9"),
    ((9.0, 0.0, 1.2), r"grows by sqrt\(1 / cos bank\) in turns; fly faster"),
    ((13.0, 0.6), "rotors would need 9.* rad/s, and at most 816.8 are possible; climb less"),
    ((13.0, -0.5), "with stopped rotors it descends at 0.14.* rad; descend less steeply"),
    ((8.1, 0.0, 0.5), "cannot trim at 8.1 m/s"),
]


@pytest.mark.parametrize(("given", "message"), MISTAKES)
def test_flights_that_are_not_possible_name_the_airframe_and_a_remedy(given, message):
    with pytest.raises(ValueError, match=message):
        find_trim(TRAINER, *given)


def test_an_elevator_beyond_its_range_is_named():
    tail = TRAINER.wings[2]
    small = replace(tail, surface=replace(tail.surface, low=-0.02, high=0.02))
    limited = replace(TRAINER, wings=(*TRAINER.wings[:2], small, TRAINER.wings[3]))
    with pytest.raises(
        ValueError, match=r"elevator would need -0\.0.* range is from -0.02 to 0.02"
    ):
        find_trim(limited, 9.0)


def test_the_fastest_level_flight_is_a_trim_at_full_throttle():
    fast = replace(TRAINER, max_speed=30.0)
    trim = find_trim(fast, find_envelope(fast).max_speed)
    assert trim.speed == pytest.approx((816.8,), rel=1e-6)
    assert max(trim.speed) <= 816.8
    assert wing_power(fast).parasite == pytest.approx(wing_power(TRAINER).parasite, rel=0.01)


def test_throttle_is_a_fraction():
    with pytest.raises(ValueError, match="throttle is 1.5: at most 1"):
        find_climb(TRAINER, 13.0, 1.5)


def test_multirotors_and_gliders_have_no_envelope():
    with pytest.raises(ValueError, match="'cf2x' has no wings: envelope and trim are those of"):
        find_envelope(load_airframe("cf2x"))
    lifted = replace(QUADPLANE, forward_rotors=())
    for find in (find_envelope, lambda one: find_trim(one, 13.0)):
        with pytest.raises(ValueError, match='no forward rotor, .* add a rotor with axis="x"'):
            find(lifted)


def test_a_weak_airframe_cannot_fly_level():
    # 0.01 rad * 9.564 m/s
    message = r"cannot fly level: at 9.564 m/s .* its climb is -0.* at least 0.09564 m/s is needed"
    with pytest.raises(ValueError, match=message):
        find_envelope(replace(TRAINER, max_rotor_speed=450.0))
    # 1.05 * 9.5639
    message = "minimum speed is 9.564 m/s, 1.2 stall speeds: raise max_speed to 10.04 m/s or more"
    for speed in (9.0, 9.8):
        with pytest.raises(ValueError, match=message):
            find_envelope(replace(TRAINER, max_speed=speed))


@pytest.mark.parametrize("rotor", [480.0, 500.0, 520.0])
def test_an_airframe_that_hardly_flies_level_is_too_weak(rotor):
    with pytest.raises(ValueError, match="cannot fly level"):
        find_envelope(replace(TRAINER, max_rotor_speed=rotor))


@pytest.mark.parametrize("rotor", [535.0, 560.0, 580.0, 600.0, 625.0])
def test_a_weak_airframe_has_an_autopilot_and_climbs_at_cruise_speed(rotor):
    weak = replace(TRAINER, max_rotor_speed=rotor)
    found = find_envelope(weak)
    assert found.min_speed < found.cruise_speed < found.max_speed
    # At least half of the margin at the lowest speeds
    assert found.max_climb > 0.005 * found.cruise_speed
    rows = autopilot_rows([weak], 20.0)
    power = wing_power(weak)
    for speed in (found.min_speed, found.cruise_speed, found.max_speed):
        needed = drag(weak, speed)
        parasitic, induced = rows["drag"][0]
        assert parasitic * speed**2 + induced / speed**2 == pytest.approx(needed, rel=0.05)
        polar = power.parasite * speed**2 + power.induced * (weak.mass * G / speed) ** 2
        assert polar == pytest.approx(needed, rel=0.05)


def test_an_elevator_that_cannot_trim_the_fastest_flight_is_named():
    tail = TRAINER.wings[2]
    up = replace(tail, incidence=0.04, surface=replace(tail.surface, high=0.0))
    with pytest.raises(ValueError, match="cannot trim at 17 m/s.*elevator would need 0.0"):
        find_envelope(replace(TRAINER, wings=(*TRAINER.wings[:2], up, TRAINER.wings[3])))


def test_linear_equations_are_solved_as_by_numpy():
    rng = np.random.default_rng(0)
    for size in (1, 2, 6):
        matrix, right = rng.normal(size=(size, size)), rng.normal(size=size)
        found = solve_linear(matrix.tolist(), right.tolist())
        np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-10)
    assert solve_linear([[0.0, 1.0], [1.0, 0.0]], [2.0, 3.0]) == [3.0, 2.0]
    assert solve_linear([[1.0, 2.0], [2.0, 4.0]], [1.0, 1.0]) is None


def test_the_maximum_of_a_parabola_is_found_next_to_minus_infinity():
    best = maximize(lambda x: -((x - 0.3) ** 2) if x < 0.9 else -math.inf, 0.0, 1.0)
    assert best == pytest.approx(0.3, abs=1e-7)
    assert maximize(lambda x: x, 0.0, 1.0) == pytest.approx(1.0)
    assert maximize(lambda x: -x, 0.0, 1.0) == pytest.approx(0.0, abs=1e-8)
