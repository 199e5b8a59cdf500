"""Power that flight takes, and batteries that it empties."""

import numpy as np
import pytest
from urban import DRONES, EXACT, PERIOD, SPEED, STAY, USERS, WALL

import bulletuav
from bulletuav.vehicle.power import airframe_wing, propulsion_power


def hover_power(gravity=9.80665):
    """Of a hummingbird, W."""
    wing = airframe_wing(bulletuav.load_airframe("hummingbird"), gravity)
    return propulsion_power((0.0, 0.0, 0.0), wing)


def test_power_in_hover_is_that_of_the_formula(put_urban):
    aviary = put_urban("los", WALL, DRONES, users=USERS)
    assert (aviary.first_info()["power"] == 0).all()
    np.testing.assert_allclose(
        aviary.step(np.zeros((1, 2, 3))).info["power"], hover_power(), rtol=1e-12
    )


def test_wind_counts(put_urban):
    """At rest in wind of 6 m/s from the side costs what flying at 6 m/s costs in calm air."""
    wing = airframe_wing(bulletuav.load_airframe("hummingbird"))
    windy = (
        put_urban("los", WALL, DRONES, users=USERS, wind=(0.0, 6.0, 0.0))
        .step(np.zeros((1, 2, 3)))
        .info["power"]
    )
    np.testing.assert_allclose(windy, propulsion_power((6.0, 0.0, 0.0), wing), rtol=1e-12)
    with_it = put_urban("los", WALL, DRONES, users=USERS, wind=(0.0, 6.0, 0.0))
    for _ in range(2):  # the mean of the speeds before and after counts
        power = with_it.step(np.full((1, 2, 3), (0.0, 6 / SPEED, 0.0))).info["power"]
    np.testing.assert_allclose(power, hover_power(), rtol=1e-9)


@pytest.mark.parametrize("horizon", [300, 5])
def test_an_empty_battery_ends_the_episode_then_and_only_then(put_urban, horizon):
    """4.5 decisions of hover: the fifth empties it.

    The other drone flies at 7.5 m/s, which takes less, and goes on.
    """
    wing = airframe_wing(bulletuav.load_airframe("hummingbird"))
    flying = propulsion_power((7.5, 0.0, 0.0), wing)
    mean = propulsion_power((3.75, 0.0, 0.0), wing)  # of the first decision, from rest
    np.testing.assert_allclose(
        (mean, flying), np.array((0.9127, 0.7665)) * hover_power(), rtol=1e-3
    )
    energy = 4.5 * PERIOD * hover_power()  # J
    aviary = put_urban(
        "los", WALL, DRONES, users=USERS, battery_capacity=energy / 3600, horizon=horizon
    )
    used, charge = np.zeros(2), [label.name for label in aviary.observer.labels].index("charge")
    for k in range(1, 6):
        step = aviary.step(np.array([(STAY, (0, -0.5, 0))]))
        np.testing.assert_allclose(
            step.info["power"][0], (hover_power(), mean if k == 1 else flying), rtol=1e-9
        )
        used += step.info["power"][0] * PERIOD
        np.testing.assert_allclose(
            step.info["charge"][0], np.maximum(1 - used / energy, 0), atol=1e-12
        )
        if aviary.alive.all():
            np.testing.assert_array_equal(
                step.observations[0, :, charge], step.info["charge"][0].astype(np.float32)
            )
        assert step.terminated[0].tolist() == [k == 5, False]
        assert step.truncated[0].tolist() == [False, horizon == k]
    assert not step.info["collision"].any()
    if horizon == 5:
        return
    # 0.91 + 0.77 (k - 1) times hover's comes to 3.98, then to 4.75
    step = aviary.step(np.array([(STAY, (0, -0.5, 0))]))
    assert step.terminated[0].tolist() == [False, True]
    assert (aviary.reset(seeds=0)[0, :, charge] == 1).all()
    assert not aviary.step(np.zeros((1, 2, 3))).terminated.any()


def test_without_a_capacity_batteries_never_empty(put_urban):
    aviary = put_urban("los", WALL, DRONES, users=USERS, battery_capacity=None)
    assert (aviary.step(np.zeros((1, 2, 3))).info["charge"] == 1).all()


def test_what_flying_costs_is_drained_of_worlds_that_fly_alone(make_urban):
    aviary = make_urban("los", 2, battery_capacity=0.1, **EXACT)
    for _ in range(3):
        aviary.step(np.zeros((2, 3, 3)))
    aviary.reset(np.array([False, True]))
    charge = aviary.step(np.zeros((2, 3, 3))).info["charge"]
    spent = hover_power() * PERIOD / 360
    np.testing.assert_allclose(1 - charge, np.array([[4 * spent] * 3, [spent] * 3]))


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_power_of_the_rotors(make_urban, dynamics):
    """In hover it is torque times speed, k_m w^3, of four rotors; the formula is of its order."""
    options = {
        "airframe": "hummingbird",
        "action": "hover_rpm",
        "effects": (),
        "battery_capacity": 1.0,
    }
    aviary = make_urban(
        "hover", energy="actuator", dynamics=dynamics, observation=("battery",), **options
    )
    airframe = aviary.options.airframe[0]
    shafts = 4 * airframe.thrust_coefficient * airframe.torque_ratio * airframe.hover_speed() ** 3
    expected = shafts / 0.78 + 5
    for k in range(1, 4):
        step = aviary.step(np.zeros(aviary.action.low.shape)[None])
        assert step.info["power"][0, 0] == pytest.approx(expected, rel=1e-6)
        assert step.observations[0, 0, 0] == pytest.approx(1 - k * expected / 30 / 3600, rel=1e-6)
    assert 0.5 < expected / hover_power() < 2


@pytest.mark.parametrize("dynamics", ["point_mass", "double_integrator", "single_integrator"])
def test_dynamics_without_rotors_know_no_power_of_rotors(dynamics):
    with pytest.raises(
        ValueError,
        match=f"energy is 'actuator', and dynamics '{dynamics}' has no rotors: use 'zeng'",
    ):
        bulletuav.Aviary("los", city=WALL, dynamics=dynamics, energy="actuator")


@pytest.mark.parametrize("energy", ["zeng", "actuator"])
def test_power_without_gravity_is_that_of_the_rotors(make_urban, energy):
    """Rotors at rest take nothing; at full speed, from one decision to the next, 4 k_m w^3.

    The electronics take 0.96 W.
    """
    aviary = make_urban(
        "hover", gravity=0.0, action="rotor", effects=(), energy=energy, battery_capacity=1.0
    )
    step = aviary.step(np.full((1, 1, 4), -1.0))
    assert step.info["power"][0, 0] == 0.96
    period = 1 / aviary.options.decision_hz
    assert step.info["charge"][0, 0] == pytest.approx(1 - 0.96 * period / 3600, rel=1e-12)
    aviary.step(np.ones((1, 1, 4)))
    airframe = aviary.options.airframe[0]
    shafts = 4 * airframe.thrust_coefficient * airframe.torque_ratio * airframe.max_rotor_speed**3
    expected = shafts / 0.43 + 0.96
    assert aviary.step(np.ones((1, 1, 4))).info["power"][0, 0] == pytest.approx(expected, rel=1e-6)


def test_the_airframes_own_battery_lasts_as_long_as_it_tells():
    """A Crazyflie: 0.925 W h, 7.34 W in hover."""
    aviary = bulletuav.Aviary("hover", battery_capacity="airframe", dynamics="rigid_body")
    aviary.reset(seeds=0)
    step = aviary.step(np.zeros((1, 1, 4)))
    used = 1 - step.info["charge"][0, 0]
    power = step.info["power"][0, 0]
    assert power == pytest.approx(7.34, abs=0.3)
    period = 1 / aviary.options.decision_hz
    assert used == pytest.approx(power * period / 0.925 / 3600, rel=1e-6)
    aviary.close()
    with pytest.raises(ValueError, match="airframe 'racer' has no <battery> tag"):
        bulletuav.Aviary("hover", battery_capacity="airframe", airframe="racer")
    with pytest.raises(ValueError, match="battery_capacity 'airframes'"):
        bulletuav.Aviary("hover", battery_capacity="airframes")


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_a_drone_sinks_as_its_battery_does(dynamics):
    """At one command of rotor speeds: the fuller, the more thrust; firmware would help."""
    heights = {}
    for charge in (1.0, 0.3):
        for effects in (("lag",), ("lag", "voltage")):
            aviary = bulletuav.Aviary(
                "hover",
                battery_capacity="airframe",
                effects=effects,
                dynamics=dynamics,
                action="rpm",
                height=5.0,
            )
            aviary.reset(seeds=0)
            aviary.worlds.energy._battery.start(0, charge)
            for _ in range(30):
                aviary.step(np.full((1, 1, 4), 16608.0))
            heights[charge, effects] = aviary.swarm.position[0, 0, 2]
            volts = aviary.worlds.energy.voltage[0, 0]
            assert volts == pytest.approx({1.0: 3.92, 0.3: 3.44}[charge], abs=0.05)
            aviary.close()
    assert heights[1.0, ("lag",)] == heights[0.3, ("lag",)]
    assert heights[1.0, ("lag", "voltage")] > 5.3
    assert heights[0.3, ("lag", "voltage")] < 4.9
