"""Forces of wings, control surfaces and propellers in the air, on one aircraft."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bulletuav import load_airframe
from bulletuav.vehicle.envelope import air_wrench
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.wings import (
    MAX_SURFACES,
    attached_flow,
    deflection_after,
    flap_derivatives,
    separated_flow,
    slipstream_velocity,
    wing_rows,
)

TRAINER, QUADPLANE = load_airframe("trainer"), load_airframe("quadplane")
ZERO = (0.0, 0.0, 0.0)
DENSITY = 1.225


class Aircraft:
    """Force and torque on an airframe, body axes FLU."""

    def __init__(self, airframe):
        self.airframe = airframe
        self.rows = parameter_rows([airframe])[0], wing_rows([airframe])[0]

    def wrench(self, velocity, rates=ZERO, speed=(), deflection=()):
        rotors, surfaces = np.zeros(len(self.airframe.rotors)), np.zeros(MAX_SURFACES)
        rotors[: len(speed)], surfaces[: len(deflection)] = speed, deflection
        return np.array(air_wrench(tuple(velocity), tuple(rates), rotors, surfaces, *self.rows))

    def lift_and_drag(self, airspeed, alpha):
        """Lift and drag in symmetric flight with stopped rotors, N."""
        force, _ = self.wrench((airspeed * math.cos(alpha), 0.0, -airspeed * math.sin(alpha)))
        return (
            force[0] * math.sin(alpha) + force[2] * math.cos(alpha),
            force[2] * math.sin(alpha) - force[0] * math.cos(alpha),
        )


TRAINER_FORCES, QUADPLANE_FORCES = Aircraft(TRAINER), Aircraft(QUADPLANE)


def only(*wings, **changes):
    """The trainer with these wings, no fuselage, and rotors without drag across their axis."""
    return Aircraft(replace(TRAINER, wings=wings, body_drag=(0.0, 0.0), drag_xy=0.0, **changes))


def flat(wing, **changes):
    """A wing without dihedral, incidence, camber, slipstream and downwash, at the origin."""
    none = dict.fromkeys(("dihedral", "incidence", "zero_lift", "moment", "slipstream"), 0.0)
    return replace(wing, position=ZERO, downwash=0.0, **{**none, **changes})


# Panels


def coefficients(wing, degrees, shift=0.0):
    row = wing_rows([replace(TRAINER, wings=(wing,))])[0]
    angle = math.radians(degrees)
    sine, cosine = math.sin(angle), math.cos(angle)
    attached = attached_flow(sine, cosine, shift, 0.0, 0, row)
    return separated_flow(attached, sine, cosine, 0, row)[:3]


def test_attached_flow_by_hand():
    """4.7793 (0.087266 + 0.061) = 0.7086, and 0.014 + 0.7086^2 / (pi 0.8 7.22) = 0.04167."""
    lift, drag, moment = coefficients(TRAINER.wings[0], 5.0)
    assert lift == pytest.approx(0.7086, rel=2e-4)
    assert drag == pytest.approx(0.04167, rel=2e-4)
    assert moment == -0.07


# Normal force 1.98 sin a (1 / (0.56 + 0.44 sin a) - 0.41 (1 - exp(-17 / 7.22))) and tangential
# force 0.007 cos a of Khan and Nahon, computed by hand
PLATE = [
    (30.0, 0.9019, 0.7780, 0.4562),
    (45.0, 1.0877, 0.7656, 0.7726),
    (90.0, 1.2453, 0.0, 1.2453),
]


@pytest.mark.parametrize(("degrees", "normal", "lift", "drag"), PLATE)
def test_separated_flow_is_khan_and_nahons_plate(degrees, normal, lift, drag):
    found = coefficients(TRAINER.wings[0], degrees)
    assert found[0] == pytest.approx(lift, rel=2e-4, abs=1e-9)
    assert found[1] == pytest.approx(drag, rel=2e-4)
    # Centre of pressure at 0.25 - 0.175 (1 - 2 a / pi) chords behind the quarter chord; the model
    # has sin a in place of 2 a / pi
    behind = 0.25 - 0.175 * (1 - math.sin(math.radians(degrees)))
    assert found[2] == pytest.approx(-behind * normal, rel=2e-4)
    assert abs(behind - (0.25 - 0.175 * (1 - degrees / 90))) < 0.037


@given(st.floats(-180, 180))
def test_a_flat_panel_has_no_preferred_side(degrees):
    wing = flat(TRAINER.wings[0])
    above, below = coefficients(wing, degrees), coefficients(wing, -degrees)
    assert above[0] == pytest.approx(-below[0], abs=1e-12)
    assert above[1] == pytest.approx(below[1], abs=1e-12)
    assert above[2] == pytest.approx(-below[2], abs=1e-12)
    assert above[1] > 0


@pytest.mark.parametrize("degrees", [11.0, 14.0, 17.0, 22.0, -15.0, -25.0])
def test_coefficients_are_continuous_through_the_stall(degrees):
    near, far = (np.array(coefficients(TRAINER.wings[0], degrees + d)) for d in (1e-6, -1e-6))
    np.testing.assert_allclose(near, far, atol=1e-6)


def test_the_maximum_lift_is_near_the_start_of_the_stall():
    """4.7793 * 0.2 = 0.956 where the stall begins; below it the lift is linear."""
    angles = np.arange(0.0, 20.0, 0.1)
    lifts = [coefficients(TRAINER.wings[0], degrees)[0] for degrees in angles]
    assert 0.956 < max(lifts) < 1.15 * 0.956
    assert math.radians(angles[np.argmax(lifts)]) + 0.061 == pytest.approx(0.22, abs=0.03)


# Thin airfoil theory: 1 - (h - sin h) / pi and -sin h (1 - cos h) / 2, h = acos(2 E - 1), by hand
FLAPS = [(0.2, 0.5498, -0.64), (0.25, 0.6090, -0.6495), (0.5, 0.8183, -0.5), (1.0, 1.0, 0.0)]


@pytest.mark.parametrize(("fraction", "lift", "moment"), FLAPS)
def test_flaps_have_the_effect_of_thin_airfoils(fraction, lift, moment):
    assert flap_derivatives(fraction) == pytest.approx((lift, moment), abs=1e-4)


def test_an_elevator_turns_by_hand():
    """0.7 of 0.7067 (flap of 0.35 chord) times 3.883 q S per rad, 0.5566 m behind the centre."""
    tail = TRAINER.wings[2]
    alone = only(replace(tail, slipstream=0.0, incidence=0.0))
    force, torque = alone.wrench((13.0, 0, 0), deflection=(0.01,))
    pressure = 0.5 * DENSITY * 13**2 * tail.span * tail.chord
    hinge = math.acos(-0.3)
    lift = 0.7 * (1 - (hinge - math.sin(hinge)) / math.pi) * tail.lift_slope * 0.01
    moment = 0.7 * -0.5 * math.sin(hinge) * (1 - math.cos(hinge)) * 0.01
    drag = 0.012 + lift**2 / (math.pi * 0.8 * 4.0)
    assert force[2] == pytest.approx(pressure * lift, rel=1e-3)
    # Up behind the centre of mass turns the nose down, which is about +y
    turned = 0.5566 * lift - 0.11 * moment - 0.02 * drag
    assert torque[1] == pytest.approx(pressure * turned, rel=1e-3)


# Whole wings


def test_roll_damping_of_a_rectangular_wing_is_that_of_strip_theory():
    """Clp = -(a + C_D) / 6: two panels at the Gauss points integrate the squares exactly."""
    left, right, *_ = TRAINER.wings
    half = replace(flat(left), position=(0.0, 0.325, 0.0))
    other = replace(flat(right), position=(0.0, -0.325, 0.0))
    for wings in ((half, other), (flat(left, span=1.3),)):
        aircraft = only(*wings)
        rate = 0.1
        _, torque = aircraft.wrench((13.0, 0.0, 0.0), (rate, 0.0, 0.0))
        _, opposite = aircraft.wrench((13.0, 0.0, 0.0), (-rate, 0.0, 0.0))
        force = 0.5 * DENSITY * 13**2 * 1.3 * 0.18
        damping = (torque[0] - opposite[0]) / 2 / (force * 1.3) / (rate * 1.3 / (2 * 13))
        assert damping == pytest.approx(-(left.lift_slope + left.drag) / 6, rel=1e-4)


def test_dihedral_rolls_an_aircraft_out_of_a_sideslip():
    """Cl_beta = -a G / 4 for a rectangular wing with dihedral G (strip theory)."""
    left, right, *_ = TRAINER.wings
    wings = (
        replace(flat(left, dihedral=0.05), position=(0.0, 0.325, 0.0)),
        replace(flat(right, dihedral=-0.05), position=(0.0, -0.325, 0.0)),
    )
    # To the right, so that the air comes from the right: the right side rises
    _, torque = only(*wings).wrench((13.0, -0.13, 0.0))
    force = 0.5 * DENSITY * 13**2 * 1.3 * 0.18
    assert torque[0] / (force * 1.3) / 0.01 == pytest.approx(-left.lift_slope * 0.05 / 4, rel=0.01)


def test_the_trainer_has_the_drag_polar_of_a_hand_calculation():
    """At 13 m/s and the lift of its weight: C_L 0.4049, C_D 0.0476 + 0.4049^2 / 18.15 = 0.0566."""
    found = [TRAINER_FORCES.lift_and_drag(13.0, a) for a in np.radians((-1.0, 0.0, 1.0))]
    lift, drag = np.array(found).T / (0.5 * DENSITY * 13**2 * 0.234)
    assert np.interp(0.4049, lift, drag) == pytest.approx(0.0566, rel=0.02)


def test_the_neutral_point_by_hand():
    """Wing 4.779 * 0.234 at the quarter chord, tail 3.883 * 0.0484 * 0.58 at 0.58 m behind it.

    The neutral point is 0.0515 m behind the quarter chord; the centre of mass 0.0234 m. The
    fuselage's lift acts at the centre of mass, and the height of the wing adds 0.014 chords.
    """
    lifts, moments = [], []
    for alpha in (-1e-3, 1e-3):
        velocity = (13 * math.cos(alpha), 0.0, -13 * math.sin(alpha))
        moments.append(-TRAINER_FORCES.wrench(velocity)[1][1])
        lifts.append(TRAINER_FORCES.lift_and_drag(13.0, alpha)[0])
    margin = -(moments[1] - moments[0]) / (lifts[1] - lifts[0]) / 0.18
    slope = 4.779 * 0.234 + 3.883 * 0.0484 * 0.58
    by_hand = (slope * (0.0515 - 0.0234) / 0.18) / (slope + 0.03) + 0.014
    assert margin == pytest.approx(by_hand, rel=0.03)
    assert 0.05 < margin < 0.2


# Properties of the whole aircraft

speeds = st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-30, 30))
turns = st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(-10, 10))
angles = st.tuples(*[st.floats(-0.4, 0.4)] * 5)


def image_of(airframe):
    """The mirror image: a rotor along x spins the other way, and those along z are pairs."""
    rotors = tuple(
        (x, y, -turn if k in airframe.forward_rotors else turn)
        for k, (x, y, turn) in enumerate(airframe.rotors)
    )
    return Aircraft(replace(airframe, rotors=rotors))


# Aircraft, its image, and the order and signs of the image's surfaces, and order of its rotors
IMAGES = {
    "trainer": (TRAINER_FORCES, image_of(TRAINER), [1, 0, 2, 3], [1, 1, 1, -1], [0]),
    "quadplane": (
        QUADPLANE_FORCES,
        image_of(QUADPLANE),
        [1, 0, 2, 4, 3],
        [1, 1, 1, -1, -1],
        [3, 2, 1, 0, 4],
    ),
}


@pytest.mark.parametrize("name", IMAGES)
@given(speeds, turns, st.lists(st.floats(0, 800), min_size=5, max_size=5), angles)
def test_the_mirror_image_of_a_flight_has_the_mirror_image_of_the_wrench(
    name, velocity, rates, speed, deflection
):
    aircraft, image, surfaces, signs, rotors = IMAGES[name]
    speed, deflection = np.array(speed)[: len(rotors)], np.array(deflection)[: len(surfaces)]
    force, torque = aircraft.wrench(velocity, rates, speed, deflection)
    seen = image.wrench(
        np.multiply(velocity, (1, -1, 1)),
        np.multiply(rates, (-1, 1, -1)),
        speed[rotors],
        deflection[surfaces] * signs,
    )
    scale = 1e-9 * (1 + np.abs(force).max() + np.abs(torque).max())
    np.testing.assert_allclose(seen[0], force * (1, -1, 1), atol=scale)
    np.testing.assert_allclose(seen[1], torque * (-1, 1, -1), atol=scale)


@given(speeds, turns, angles)
def test_forces_are_finite_from_every_side_and_grow_with_the_square_of_the_speed(
    velocity, rates, deflection
):
    """At twice all velocities and rates, forces of stopped rotors and panels are four times."""
    once = TRAINER_FORCES.wrench(velocity, rates, (), deflection[:4])
    twice = TRAINER_FORCES.wrench(
        np.multiply(2, velocity), np.multiply(2, rates), (), deflection[:4]
    )
    assert np.isfinite(once).all()
    np.testing.assert_allclose(twice, 4 * once, rtol=1e-6, atol=1e-6)


NO_DOWNWASH = Aircraft(
    replace(TRAINER, wings=tuple(replace(one, downwash=0.0) for one in TRAINER.wings))
)


@given(speeds)
def test_air_takes_energy_from_an_aircraft_that_does_not_turn(velocity):
    force, _ = NO_DOWNWASH.wrench(velocity)
    assert np.dot(force, velocity) <= 1e-9


def test_nothing_acts_at_rest():
    for one in (TRAINER_FORCES, QUADPLANE_FORCES):
        np.testing.assert_allclose(one.wrench(ZERO), 0, atol=1e-10)


def test_air_from_behind_pushes_ahead():
    force, _ = TRAINER_FORCES.wrench((-13.0, 0.0, 0.0))
    assert force[0] > 0


# Propellers

# APC thin electric 10x5: J and C_T measured in the wind tunnel of the University of Illinois
UIUC = [
    (0.113, 0.0912), (0.145, 0.0890), (0.174, 0.0864), (0.200, 0.0834), (0.233, 0.0786),
    (0.260, 0.0734), (0.291, 0.0662), (0.316, 0.0612), (0.346, 0.0543), (0.375, 0.0489),
    (0.401, 0.0451), (0.432, 0.0401), (0.466, 0.0345), (0.493, 0.0297), (0.519, 0.0254),
    (0.548, 0.0204), (0.581, 0.0145),
]  # fmt: skip


@pytest.mark.parametrize(("ratio", "measured"), UIUC)
def test_thrust_against_airspeed_is_that_of_the_wind_tunnel(ratio, measured):
    """C_T = T / (rho n^2 D^4) at an advance ratio J = V / (n D); 0.005 is 5 % of the static C_T."""
    turns, diameter = 90.0, 0.254
    aircraft = only(flat(TRAINER.wings[0], drag=0.0))
    speed = 2 * math.pi * turns
    still = aircraft.wrench((ratio * turns * diameter, 0.0, 0.0))
    force = aircraft.wrench((ratio * turns * diameter, 0.0, 0.0), ZERO, (speed,)) - still
    assert force[0][0] / (DENSITY * turns**2 * diameter**4) == pytest.approx(measured, abs=5e-3)


def test_the_propeller_turns_the_body_against_its_own_spin():
    """0.01048 m times 1.495e-5 * 600^2 = 5.382 N is 0.0564 N m, to the left."""
    _, torque = only(flat(TRAINER.wings[0])).wrench(ZERO, ZERO, (600.0,))
    assert torque[0] == pytest.approx(-0.0564, rel=1e-3)


def test_the_spinning_propeller_is_a_gyroscope():
    """7e-5 kg m^2 at 600 rad/s ahead: a pitch up of 0.5 rad/s yaws to the right by 0.021 N m."""
    aircraft = only(flat(TRAINER.wings[0], lift_slope=1e-9), drag_z=0.0)
    spun = aircraft.wrench((13.0, 0.0, 0.0), (0.0, -0.5, 0.0), (600.0,))[1]
    assert spun[2] == pytest.approx(-7e-5 * 600 * 0.5, rel=1e-6)


def test_slipstream_by_momentum_theory():
    """5 N through 0.05067 m^2 at 10 m/s: sqrt(100 + 161.1) - 10 = 6.159 m/s far behind."""
    area = math.pi * 0.127**2
    added = slipstream_velocity(5.0, 10.0, area)
    assert added == pytest.approx(6.159, rel=1e-3)
    # Thrust is the mass flow through the disc, where half is added, times the added velocity
    assert DENSITY * area * (10 + added / 2) * added == pytest.approx(5.0)
    assert slipstream_velocity(-1.0, 10.0, area) == 0
    assert slipstream_velocity(5.0, 10.0, 0.0) == 0
    assert slipstream_velocity(5.0, -10.0, area) == slipstream_velocity(5.0, 0.0, area)


def test_an_elevator_in_the_slipstream_turns_more_by_the_square_of_its_airspeed():
    airspeed, speed = 10.0, 600.0
    thrust = 1.495e-5 * speed**2 - 5.561e-4 * speed * airspeed
    tail = flat(TRAINER.wings[2], slipstream=0.45)
    aircraft = only(replace(tail, position=(-0.5566, 0.0, 0.0)))
    turned = [
        aircraft.wrench((airspeed, 0.0, 0.0), ZERO, (rotor,), (side * 1e-3,))[1][1]
        for rotor in (0.0, speed)
        for side in (1, -1)
    ]
    jet = slipstream_velocity(thrust, airspeed, math.pi * 0.127**2)
    ratio = (turned[2] - turned[3]) / (turned[0] - turned[1])
    # Of the area, 0.45 is in the jet, and 0.55 in the air outside
    areas = 0.45 * (airspeed + jet) ** 2 + 0.55 * airspeed**2
    assert ratio == pytest.approx(areas / airspeed**2, rel=1e-6)
    assert ratio == pytest.approx(1.297, rel=1e-3)


def test_downwash_turns_the_flow_at_the_tail_by_the_lift_of_the_wing_ahead():
    """A tail at rest in the turned flow, a (1 - e) + i - e a_0: lift per angle is full for i."""
    wing = flat(TRAINER.wings[0], incidence=0.02, zero_lift=-0.06)
    tail = replace(flat(TRAINER.wings[2]), position=(-0.55, 0.0, 0.0), downwash=0.4)

    def tail_lift(alpha, incidence):
        both = only(wing, replace(tail, incidence=incidence)).lift_and_drag(10.0, alpha)[0]
        return both - only(wing).lift_and_drag(10.0, alpha)[0]

    pressure = 0.5 * DENSITY * 100.0 * tail.span * tail.chord * tail.lift_slope
    # 0.6 of 0.05 rad, 0.03 rad of its own, less 0.4 of 0.08 rad at which the wing lifts at 0
    assert tail_lift(0.05, 0.03) / pressure == pytest.approx(0.03 + 0.03 - 0.032, abs=5e-4)
    assert tail_lift(0.05, 0.0) / pressure == pytest.approx(-0.002, abs=2e-4)


def test_thrust_falls_with_airspeed_whatever_the_drag_of_rotors():
    """Full speed at 13 m/s: 1.495e-5 x 816.8^2 - 5.561e-4 x 816.8 x 13 = 4.07 N."""
    aircraft = only(flat(TRAINER.wings[0], lift_slope=1e-9, drag=0.0))
    bare = parameter_rows([aircraft.airframe], effects=())[0]
    for row in (aircraft.rows[0], bare):
        aircraft.rows = row, aircraft.rows[1]
        force, _ = aircraft.wrench((13.0, 0.0, 0.0), speed=(816.8,))
        assert force[0] == pytest.approx(4.07, abs=0.005)
    # A weaker propeller is weaker at any airspeed
    bare["thrust_coefficient"] *= 0.8
    assert aircraft.wrench((13.0, 0.0, 0.0), speed=(816.8,))[0][0] == pytest.approx(
        0.8 * 4.07, 1e-3
    )


# Servos


def test_servos_are_limited_in_rate_and_range():
    row = wing_rows([TRAINER])[0]
    assert deflection_after(0.0, 0.3, 0, 0.01, row) == 0.04
    assert deflection_after(0.0, -0.3, 0, 0.01, row) == -0.04
    assert deflection_after(0.1, 0.11, 0, 0.01, row) == 0.11
    assert deflection_after(0.39, 9.0, 0, 1.0, row) == 0.4
    assert deflection_after(-0.39, -9.0, 0, 1.0, row) == -0.4
