"""What the controller learns while flying: pushes with `integral`, torques always."""

import numpy as np
import pytest

import bulletuav
from bulletuav import Airspace, load_airframe
from bulletuav.control.gains import gain_rows
from bulletuav.control.observers import MEMORY, learned_push, learned_torque
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.rotors import rotor_wrench

G = 9.80665
CF2X = load_airframe("cf2x")
ROW = parameter_rows([CF2X])[0]
GAIN = gain_rows([CF2X], 5.0)[0]
DT = 1 / 240


def hovering(seconds, push, integral, dynamics="rigid_body", airframe="cf2x", **options):
    """Hover at 2 m while a constant force pushes; give the positions, one a step."""
    hover = load_airframe(airframe).hover_speed()
    start = {"dynamics": dynamics, "airframe": airframe, "rotor_speed": hover, "integral": integral}
    places = []
    with Airspace([(0, 0, 2)], **start, **options) as airspace:
        airspace.command(0, "position", (0, 0, 2))
        for _ in range(int(seconds * 240)):
            airspace.apply(0, force=push)
            airspace.step()
            places.append(airspace.swarm.position[0].copy())
    return np.array(places)


def test_a_push_is_learned_as_a_second_order_system():
    """With a constant push a the estimate approaches a by the observer's own f and z."""
    memory = np.zeros(MEMORY)
    velocity, estimates = np.zeros(3), []
    frequency = 2 * GAIN["position_frequency"]
    for _ in range(int(10 / frequency / DT)):
        velocity = velocity + DT * np.array((0.0, 0.5, 0.0))
        known = (0.0, 0.0, 0.0)
        estimates.append(learned_push(tuple(velocity), known, memory, DT, G, GAIN)[1])
    assert estimates[-1] == pytest.approx(0.5, rel=1e-3)
    assert 0.5 < max(estimates) < 0.52
    # A step answer of damping 0.8 is at one half after 1.6 / f
    half = np.flatnonzero(np.array(estimates) > 0.25)[0] * DT
    assert half == pytest.approx(1.6 / frequency, rel=0.2)


def test_a_push_is_bounded_and_what_is_known_is_not_learned():
    memory = np.zeros(MEMORY)
    for k in range(2000):
        push = learned_push((3.0 * k * DT, 0.0, 0.0), (3.0, 0.0, 0.0), memory, DT, G, GAIN)
    assert np.abs(push).max() < 1e-9
    for k in range(2000):
        push = learned_push((90.0 * k * DT, 0.0, 0.0), (0.0,) * 3, memory, DT, G, GAIN)
    assert np.linalg.norm(push) == pytest.approx(0.5 * G)


def test_a_torque_is_learned_and_bounded():
    memory = np.zeros(MEMORY)
    rotors = rotor_wrench(np.full(4, CF2X.hover_speed()), 0.0, ROW)
    still = (0.0, 0.0, 0.0)
    for torque, expected in ((2e-4, 2e-4), (1.0, 0.25 * CF2X.max_thrust * CF2X.arm)):
        memory[:] = 0
        rate = 0.0
        for _ in range(480):
            # Against the damping that the observer knows
            damped = CF2X.damping[0] * rate
            rate += DT * (torque / CF2X.inertia[0] - damped)
            got = learned_torque((rate, 0.0, 0.0), rotors, still, memory, DT, ROW, GAIN)
        assert got[0] == pytest.approx(expected, rel=1e-3)
        assert got[1] == pytest.approx(0, abs=1e-9)
        assert got[2] == 0


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_crazyflie_below_another_sinks_and_with_the_integral_comes_back(dynamics):
    """Told to hover 0.3 m below: it sinks to 0.41 m deeper, where wake and error balance."""
    deepest, after = {}, {}
    for integral in (False, True):
        start = {"dynamics": dynamics, "rotor_speed": CF2X.hover_speed(), "integral": integral}
        heights = []
        with Airspace([(0, 0, 2.0), (0, 0, 2.3)], **start) as airspace:
            airspace.command(None, "position", [(0, 0, 2.0), (0, 0, 2.3)])
            for _ in range(240 * 4):
                airspace.step()
                heights.append(airspace.swarm.position[0, 2])
        deepest[integral], after[integral] = 2 - min(heights), 2 - np.array(heights[3 * 240 :])
    # (w^2 + 0.36 w / 1.6) e = 0.32 g r / sqrt(r^2 + (0.1 (0.3 + e))^2), w = 1.923 1/s: e = 0.41 m
    assert 0.41 < deepest[False] < 0.5
    assert after[False][-1] == pytest.approx(0.41, abs=0.01)
    assert deepest[True] < 0.3
    assert np.abs(after[True]).max() < 0.1


@pytest.mark.parametrize("integral", [False, True])
def test_a_steady_push_is_made_up_for_by_the_integral_alone(integral):
    away = hovering(6, (0.0, 0.02, -0.05), integral)[-1] - (0, 0, 2)
    # Drag is made up for at the velocity wanted, which an error of position asks for: stiffer
    wanted = GAIN["position_frequency"] / 1.6
    hover = 4 * CF2X.hover_speed() * np.array((CF2X.drag_xy, CF2X.drag_xy, CF2X.drag_z))
    stiffness = CF2X.mass * GAIN["position_frequency"] ** 2 + hover * wanted
    expected = np.zeros(3) if integral else np.array((0.0, 0.02, -0.05)) / stiffness
    np.testing.assert_allclose(away, expected, atol=0.02)


@pytest.mark.parametrize("airframe", ["cf2x", "hummingbird"])
def test_wind_moves_a_hovering_drone_by_little_more_than_its_drag_tells(airframe):
    """Its torque is learned: without that a Crazyflie would be turned over by 3 m/s."""
    frame = load_airframe(airframe)
    gain = gain_rows([frame], 5.0)[0]
    drag = frame.drag_xy * len(frame.rotors) * frame.hover_speed()
    frequency = gain["position_frequency"]
    expected = 3 * drag / (frame.mass * frequency**2 + drag * frequency / 1.6)
    away = hovering(8, (0.0,) * 3, False, airframe=airframe, wind=(3.0, 0.0, 0.0))[-1]
    assert away[0] == pytest.approx(expected, rel=0.25)
    held = hovering(8, (0.0,) * 3, True, airframe=airframe, wind=(3.0, 0.0, 0.0))[-1]
    np.testing.assert_allclose(held, (0, 0, 2), atol=0.02)


@pytest.mark.parametrize("integral", [False, True])
def test_step_figures_stay(integral):
    with Airspace([(0, 0, 2)], rotor_speed=CF2X.hover_speed(), integral=integral) as airspace:
        airspace.command(0, "position", (1, 0, 2))
        x = []
        for _ in range(240 * 4):
            airspace.step()
            x.append(airspace.swarm.position[0, 0])
    error = np.array(x) - 1
    assert error.max() < 0.15
    assert np.flatnonzero(np.abs(error) > 0.05)[-1] / 240 < 2
    assert np.abs(error[3 * 240 :]).max() < 0.01


def test_what_is_learned_is_forgotten_with_the_world():
    options = {"action": "velocity", "integral": True, "wind": (2.0, 0.0, 0.0), "seed": 1}
    env = bulletuav.Aviary("hover", num_worlds=2, **options)
    env.reset(seeds=[1, 1])
    first = env.swarm.position.copy()
    for _ in range(20):
        env.step(np.zeros((2, 1, 3)))
    flown = env.swarm.position.copy()
    env.reset(seeds=[1, 1])
    np.testing.assert_array_equal(env.swarm.position, first)
    for _ in range(20):
        env.step(np.zeros((2, 1, 3)))
    np.testing.assert_array_equal(env.swarm.position, flown)
    env.close()


def test_bad_choices_are_refused():
    with pytest.raises(ValueError, match="integral is 'yes': True or False"):
        bulletuav.Aviary("hover", integral="yes")
    with pytest.raises(ValueError, match="integral is for controller 'lee'"):
        bulletuav.Aviary("hover", integral=True, controller="pid", effects=())
