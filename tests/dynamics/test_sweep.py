import numpy as np
import pytest
from bench import FLIGHTS, rims
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.vehicle.swarm import GROUND

ROTORS = [flight for flight in FLIGHTS if flight[0] in ("rigid_body", "bullet")]
GAP = 1e-4 + 1e-9  # m; what counts as a touch, and rounding
every = pytest.mark.parametrize(("dynamics", "contacts"), ROTORS)


def pairs(contacts):
    """Tell who touched whom."""
    return list(zip(contacts.drone.tolist(), contacts.other.tolist(), strict=True))


@every
def test_a_drone_rests_where_it_touches_the_ground_and_can_take_off_again(
    make_bench, dynamics, contacts
):
    bench = make_bench(dynamics, effects=(), contacts=contacts)
    bench.swarm.position[..., 2] = 0.5
    bench.swarm.rotor_speed[:] = 0
    touched = bench.place().spin(0.0, decisions=10)
    assert pairs(touched) == [(0, GROUND)]
    assert 0.055 < bench.swarm.position[0, 0, 2] <= 0.055 + GAP
    np.testing.assert_allclose(bench.swarm.velocity, 0, atol=1e-6)
    np.testing.assert_allclose(bench.swarm.rates, 0, atol=1e-6)
    touched = bench.spin(1.2 * bench.airframe.hover_speed(), decisions=5)
    assert not len(touched.drone)
    rise = 0.5 * (1.2**2 - 1) * 9.80665 * 0.5**2
    assert bench.swarm.position[0, 0, 2] == pytest.approx(0.055 + rise, rel=0.02)


@every
def test_the_impulse_is_that_of_a_stop(make_bench, dynamics, contacts):
    bench = make_bench(dynamics, effects=(), gravity=0.0, contacts=contacts)
    bench.swarm.position[..., 2] = 0.5
    bench.swarm.velocity[:] = 0, 0, -8
    bench.swarm.rotor_speed[:] = 0
    assert bench.place().spin(0.0).impulse == pytest.approx(8 * 0.716)


@every
def test_a_fast_drone_does_not_pass_through_the_ground(make_bench, dynamics, contacts):
    """It comes down after 7 ms of the 100 ms, and slides on if that is what contacts do."""
    bench = make_bench(dynamics, "cf2x", effects=(), gravity=0.0, contacts=contacts, friction=0.0)
    bench.swarm.rotor_speed[:] = 0
    bench.swarm.position[..., 2] = 3
    bench.swarm.velocity[:] = 10, 0, -400
    bench.place().spin(0.0)
    assert 0.015 < bench.swarm.position[0, 0, 2] <= 0.015 + GAP
    east = 10 * (3 - 0.015) / 400 if contacts == "stop" else 10 * 0.1
    assert bench.swarm.position[0, 0, 0] == pytest.approx(east, abs=1e-3)


def sunk(bench):
    """Tell how deep any rim of drone 1 is in drone 0, and the other way round, m."""
    radius, _, half = bench.airframe.shape.half
    points = rims(bench.airframe)
    deepest = -np.inf
    for own, other in ((0, 1), (1, 0)):
        worlds = len(bench.alive)
        turn = Rotation.from_quat(np.repeat(bench.swarm.quaternion[:, own], len(points), axis=0))
        back = Rotation.from_quat(np.repeat(bench.swarm.quaternion[:, other], len(points), axis=0))
        apart = bench.swarm.position[:, own] - bench.swarm.position[:, other]
        places = turn.apply(np.tile(points, (worlds, 1))) + np.repeat(apart, len(points), axis=0)
        local = back.inv().apply(places)
        aside = radius - np.hypot(local[:, 0], local[:, 1])
        deepest = max(deepest, np.minimum(aside, half - np.abs(local[:, 2])).max())
    return deepest


@every
def test_random_head_on_shots_never_pass(make_bench, dynamics, contacts):
    """Pairs of drones at random attitudes are shot at each other at 5 to 40 m/s each.

    Stopped, they never overlap. Pushed apart, they sink by less than half a millimetre at closing
    speeds of up to 80 m/s, and keep the sum of their momenta.
    """
    worlds = 60
    bench = make_bench(
        dynamics,
        worlds=worlds,
        drones=2,
        effects=(),
        gravity=0.0,
        substeps=1,
        contacts=contacts,
    )
    rng = np.random.default_rng(0)
    aim = rng.normal(size=(worlds, 3))
    aim /= np.linalg.norm(aim, axis=1, keepdims=True)
    bench.swarm.position[:, 0] = (0, 0, 50) - 1.0 * aim
    bench.swarm.position[:, 1] = (0, 0, 50) + 1.0 * aim
    speed = rng.uniform(5, 40, (worlds, 1))
    bench.swarm.velocity[:, 0], bench.swarm.velocity[:, 1] = speed * aim, -speed * aim
    attitude = rng.normal(size=(worlds, 2, 4))
    bench.swarm.quaternion[:] = attitude / np.linalg.norm(attitude, axis=-1, keepdims=True)
    bench.swarm.rotor_speed[:] = 0
    met = np.zeros((worlds, 2), dtype=bool)
    bench.place()
    for _ in range(96):
        if contacts == "stop":
            bench.alive[:] = ~met
        met |= bench.spin(0.0).mask(met.shape)
        assert sunk(bench) < (0 if contacts == "stop" else 5e-4)
    assert met.all()
    if contacts == "stop":
        gap = ((bench.swarm.position[:, 1] - bench.swarm.position[:, 0]) * aim).sum(axis=1)
        assert (gap > 0.1).all()  # the flattest pair of discs is 0.11 m thick
        assert not bench.swarm.velocity.any()
    else:
        np.testing.assert_allclose(bench.swarm.velocity.sum(axis=1), 0, atol=1e-9)


@every
def test_a_near_miss_is_no_contact(make_bench, dynamics, contacts):
    bench = make_bench(dynamics, drones=2, effects=(), gravity=0.0, contacts=contacts)
    bench.swarm.position[0] = (-1, 0, 10), (1, 0, 10.1102)  # discs 0.11 m thick, 0.2 mm apart
    bench.swarm.velocity[0] = (20, 0, 0), (-20, 0, 0)
    bench.swarm.rotor_speed[:] = 0
    assert not len(bench.place().spin(0.0).drone)
    np.testing.assert_allclose(bench.swarm.position[0, :, 0], (1, -1), atol=1e-9)


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_third_drone_meets_a_stopped_one(make_bench, dynamics):
    """Drones 0 and 1 meet and stop; drone 2 crosses that place later in the same decision.

    Without the stop nobody would have been there.
    """
    bench = make_bench(dynamics, drones=3, effects=(), gravity=0.0, contacts="stop")
    bench.swarm.position[0] = (-1, 0, 10), (1, 0, 10), (0, -3, 10)
    bench.swarm.velocity[0] = (40, 0, 0), (-40, 0, 0), (0, 40, 0)
    bench.swarm.rotor_speed[:] = 0
    contacts = bench.place().spin(0.0)
    assert {0, 1, 2} == set(contacts.drone)
    assert bench.swarm.position[0, 2, 1] < 0


@every
def test_who_would_have_met_a_drone_further_on_meets_nobody(make_bench, dynamics, contacts):
    """Drone 0 meets drone 2 at the origin; drone 1 would have crossed its path later, at x = 2.

    Pushed, both are 0.8 m short of that place when drone 1 passes.
    """
    bench = make_bench(dynamics, drones=3, effects=(), gravity=0.0, contacts=contacts)
    bench.swarm.position[0] = (-1.5, 0, 10), (2.0, -3.4, 10), (0, 0, 10)
    bench.swarm.velocity[0] = (40, 0, 0), (0, 40, 0), (0, 0, 0)
    bench.swarm.rotor_speed[:] = 0
    assert pairs(bench.place().spin(0.0)) == [(0, 2), (2, 0)]
    np.testing.assert_allclose(bench.swarm.position[0, 1], (2, 0.6, 10), atol=1e-9)
    # 24 ms until they meet; then half the speed for both
    meet = (1.5 - 0.54) / 40
    way = 20 * (0.1 - meet) if contacts == "impulse" else 0.0
    assert bench.swarm.position[0, 2, 0] == pytest.approx(way, abs=2e-3)


@every
def test_who_lands_on_another_does_not_touch_the_ground(make_bench, dynamics, contacts):
    bench = make_bench(dynamics, drones=2, effects=(), gravity=0.0, contacts=contacts)
    bench.swarm.position[0] = (0, 0, 3), (0, 0, 1)
    bench.swarm.velocity[0] = (0, 0, -40), (0, 0, 0)
    bench.swarm.rotor_speed[:] = 0
    touched = pairs(bench.place().spin(0.0))
    upper, lower = bench.swarm.position[0, :, 2]
    assert 0.11 < upper - lower <= 0.11 + GAP
    if contacts == "stop":
        assert touched == [(0, 1), (1, 0)]
        assert lower == 1.0
    else:
        assert touched == [(0, 1), (1, GROUND), (1, 0)]
        assert 0.055 < lower <= 0.055 + GAP


@every
def test_who_is_met_on_the_way_is_asked_for_anew(make_bench, dynamics, contacts):
    """One substep at 10 Hz: drone 0 meets drone 1; drone 2 would have crossed its path further on.

    Where drone 1 is pushed instead, it is there 20 ms before drone 2, who meets it.
    """
    bench = make_bench(
        dynamics, drones=3, effects=(), gravity=0.0, hz=10, substeps=1, contacts=contacts
    )
    bench.swarm.position[0] = (0, 0, 20), (0.8, 0, 20), (1.4, 1.4, 20)
    bench.swarm.velocity[0] = (15, 0, 0), (0, 0, 0), (0, -15, 0)
    bench.swarm.rotor_speed[:] = 0
    touched = pairs(bench.place().spin(0.0))
    if contacts == "stop":
        assert touched == [(0, 1), (1, 0)]
        np.testing.assert_allclose(bench.swarm.position[0, 2], (1.4, -0.1, 20), atol=1e-9)
    else:
        assert set(touched) >= {(0, 1), (1, 0), (1, 2), (2, 1)}


@pytest.mark.parametrize("airframe", ["cf2x", "hummingbird"])
def test_flat_drones_meet_face_to_face_in_bullet(make_bench, airframe):
    """3 and 11 cm thick, 40 m/s towards each other, 17 cm a substep: no contact is jumped over."""
    worlds = 100
    bench = make_bench("bullet", airframe, worlds=worlds, drones=2, effects=(), gravity=0.0)
    rng = np.random.default_rng(0)
    bench.swarm.position[:, 0, 2] = 50 - rng.uniform(0.8, 1.2, worlds)
    bench.swarm.position[:, 1] = 0, 0, 51
    bench.swarm.velocity[:, 0, 2], bench.swarm.velocity[:, 1, 2] = 20, -20
    bench.swarm.rotor_speed[:] = 0
    bench.swarm.position[:, :, 0] = 0
    met = np.zeros((worlds, 2), dtype=bool)
    bench.place()
    for _ in range(2):
        met |= bench.spin(0.0).mask(met.shape)
    assert met.all()
    assert (bench.swarm.position[:, 1, 2] > bench.swarm.position[:, 0, 2]).all()


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_flight_that_diverges_is_named_and_can_be_reset(urdf, dynamics):
    inertia = ('ixx="1.68e-5" iyy="1.68e-5" izz="2.93e-5"', 'ixx="1e-12" iyy="1e-12" izz="1e-12"')
    aviary = bulletuav.Aviary("hover", airframe=urdf("cf2x", inertia), dynamics=dynamics)
    aviary.reset(seeds=0)

    def fly_on():
        for _ in range(50):
            aviary.step(np.array([[(0.3, -0.5, 0.1, 0.2)]]))

    with pytest.raises(RuntimeError, match="flight of drone 0 in world 0 diverged.*physics_hz"):
        fly_on()
    hover = (
        2
        * (aviary.options.airframe[0].hover_speed() / aviary.options.airframe[0].max_rotor_speed)
        ** 2
        - 1
    )
    aviary.reset(seeds=0)
    aviary.step(np.full((1, 1, 4), hover))
    aviary.close()


@every
def test_pairs_in_touch_may_part_but_not_press(make_bench, dynamics, contacts):
    bench = make_bench(dynamics, drones=2, effects=(), gravity=0.0, contacts=contacts)
    bench.swarm.rotor_speed[:] = 0
    bench.swarm.position[0] = (0, 0, 10), (0.54005, 0, 10)
    bench.swarm.velocity[0] = (-1, 0, 0), (1, 0, 0)
    assert not len(bench.place().spin(0.0).drone)
    bench.swarm.position[0] = (0, 0, 10), (0.54005, 0, 10)
    bench.swarm.velocity[0] = (1, 0, 0), (-1, 0, 0)
    assert list(bench.place().spin(0.0).drone) == [0, 1]
    np.testing.assert_allclose(bench.swarm.position[0, :, 0], (0, 0.54005), atol=GAP)


@every
def test_landing_softly_under_control_rests_on_the_ground(make_bench, dynamics, contacts):
    bench = make_bench(dynamics, "cf2x", contacts=contacts)
    bench.swarm.position[..., 2] = 0.2
    touched = bench.place().fly(SetpointLevel.POSITION, (0.0, 0.0, -1.0, 0.0), decisions=30)
    assert pairs(touched) == [(0, GROUND)]
    assert 0.015 < bench.swarm.position[0, 0, 2] <= 0.015 + GAP


STRAIGHT = ["single_integrator", "point_mass"]


def flown(make_bench, dynamics, position, velocity, seconds=1.0):
    """Fly hummingbirds at velocities (N, 3) for one decision; returns swarm and contacts."""
    bench = make_bench(dynamics, drones=len(position), substeps=round(240 * seconds))
    bench.swarm.position[0] = position
    bench.swarm.velocity[0] = velocity
    bench.place()
    setpoint = np.concatenate(
        [np.array(velocity, dtype=float), np.zeros((len(position), 1))], axis=1
    )[None]
    return bench.swarm, bench.fly(SetpointLevel.VELOCITY, setpoint)


@pytest.mark.parametrize("seconds", [0.1, 1.0])
@pytest.mark.parametrize("dynamics", STRAIGHT)
def test_the_impulse_does_not_depend_on_how_a_decision_is_cut(make_bench, dynamics, seconds):
    _, contacts = flown(make_bench, dynamics, [(0, 0, 0.5)], [(0, 0, -10)], seconds)
    assert contacts.impulse == pytest.approx(
        10 * 0.716, rel=1e-3 if dynamics == "single_integrator" else 0.1
    )


@pytest.mark.parametrize(("height", "touches"), [(2.83, False), (0.09, True)])
@pytest.mark.parametrize("dynamics", STRAIGHT)
def test_who_fell_lies_where_it_fell_while_others_pass(make_bench, dynamics, height, touches):
    """The first falls for 0.46 s; the second comes over that place after 0.6 s, high or low."""
    swarm, contacts = flown(
        make_bench, dynamics, [(0, 0, 7), (-8.4, 0, height)], [(0, 0, -15), (14, 0, 0)]
    )
    assert (0, GROUND) in zip(contacts.drone.tolist(), contacts.other.tolist(), strict=True)
    assert ((1, 0) in zip(contacts.drone.tolist(), contacts.other.tolist(), strict=True)) == touches
    assert swarm.position[0, 0] == pytest.approx([0, 0, 0.055], abs=0.01)
    if not touches:
        assert swarm.position[0, 1, 0] == pytest.approx(-8.4 + 14, abs=0.6)
