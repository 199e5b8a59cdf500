"""Power of many drones at once."""

import numpy as np
import pytest

import bulletuav
from bulletuav.compiled.gather import pack_numbers
from bulletuav.compiled.lanes import WIDTH, lane_zeros
from bulletuav.envs.energy import _fill_propulsion
from bulletuav.envs.events import Event
from bulletuav.policies import find_policy
from bulletuav.vehicle.airframe import STANDARD_GRAVITY as G
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.power import (
    ROTARY_WING,
    W20,
    W100,
    airframe_wing,
    propulsion,
    propulsion_power,
)

CF2X = load_airframe("cf2x")


def test_power_in_lanes_has_the_bits_of_drones_one_by_one():
    wings = np.array([[W20, W100, airframe_wing(load_airframe("cf2x"))]] * 7, dtype=ROTARY_WING)
    packed = lane_zeros(-(-wings.size // WIDTH), len(ROTARY_WING))
    pack_numbers(wings.view(float).reshape(7, 3, -1), packed)
    rng = np.random.default_rng(0)
    before, after, wind = rng.normal(0, 6, (3, 7, 3, 3))
    # Hover, and each way to climb and to descend: the vortex ring, and the windmill brake
    before[:4] = after[:4] = wind[:4] = 0.0
    before[1:4, :, 2] = after[1:4, :, 2] = np.array([2.0, -4.0, -40.0])[:, None]
    power = np.full((7, 3), np.nan)
    rows = np.tile(parameter_rows((CF2X,) * 3, ()), (7, 1))
    rows["mass"] = wings["weight"] / 8
    numbers, gravity = rows.view(float).reshape(7, 3, -1), np.full((7, 3), 8.0)
    pull = np.zeros((7, 3))
    _fill_propulsion(before, after, wind, numbers, gravity, pull, wings, packed, power)
    np.testing.assert_array_equal(power, propulsion((before + after) / 2 - wind, wings))
    # Twice the mass, and half the gravity
    rows["mass"] *= 2
    _fill_propulsion(before, after, wind, numbers, gravity / 2, pull, wings, packed, power)
    np.testing.assert_array_equal(power, propulsion((before + after) / 2 - wind, wings))
    _fill_propulsion(before, after, wind, numbers, gravity, pull, wings, packed, power)
    one_by_one = [
        [propulsion_power(tuple(v), wing, 2.0) for v, wing in zip(*row, strict=True)]
        for row in zip((before + after) / 2 - wind, wings, strict=True)
    ]
    np.testing.assert_array_equal(power, one_by_one)
    # A cable that pulls by the weight of the drone
    rows["mass"] /= 2
    pull[:] = wings["weight"]
    _fill_propulsion(before, after, wind, numbers, gravity, pull, wings, packed, power)
    np.testing.assert_array_equal(power, one_by_one)


def hovering(options):
    """Return worlds of drones that stay in place in still air."""
    given = {"num_drones": 2, "airframe": "cf2x", "energy": "zeng", "battery_capacity": 1.0}
    aviary = bulletuav.Aviary("crossing", dynamics="point_mass", **given, **options)
    aviary.reset(seeds=0, velocity=np.zeros((2, 3)))
    return aviary


def test_an_added_mass_drains_the_battery_by_the_power_of_the_whole_weight():
    event = Event(time=0.2, drone=0, added_mass=CF2X.mass / 4)
    aviary = hovering({"events": [event], "decision_hz": 10})
    charges, powers = [], []
    for _ in range(5):
        aviary.step(np.zeros(aviary.given.shape))
        charges.append(aviary.readings["charge"][0].copy())
        powers.append(aviary.readings["power"][0].copy())
    hover = propulsion_power((0.0, 0.0, 0.0), airframe_wing(CF2X))
    # Blade and induced power are of the weight to the power of 3/2
    heavy = (hover - CF2X.electronics) * 1.25**1.5 + CF2X.electronics
    assert powers[1] == pytest.approx([hover, hover])
    assert powers[2] == pytest.approx([heavy, hover])
    used = np.array([2 * hover + 3 * heavy, 5 * hover]) * 0.1 / 3600
    assert charges[-1] == pytest.approx(1.0 - used)


def test_a_load_on_a_cable_costs_the_power_of_its_weight():
    aviary = bulletuav.Aviary("transport", energy="zeng")
    policy, seen = find_policy("transport_lift")(aviary), aviary.reset(seeds=0)
    policy.reset(np.ones(1, dtype=bool))
    for _ in range(240):
        seen = aviary.step(policy.act(seen, aviary.swarm)).observations
    airframe = aviary.options.airframe[0]
    load = 1 + aviary.task.config.load_mass / airframe.mass
    expected = propulsion_power((0.0, 0.0, 0.0), airframe_wing(airframe), load)
    assert aviary.readings["power"][0] == pytest.approx(expected, rel=0.02)
    aviary.close()


def test_power_follows_randomized_mass_and_gravity():
    aviary = hovering({"randomization": {"mass": (1.2, 1.5)}})
    aviary.step(np.zeros(aviary.given.shape))
    ratio = aviary.parameters["mass"][0] / CF2X.mass
    shafts = propulsion_power((0.0, 0.0, 0.0), airframe_wing(CF2X)) - CF2X.electronics
    assert ratio.min() > 1.2
    expected = shafts * ratio**1.5 + CF2X.electronics
    assert aviary.readings["power"][0] == pytest.approx(expected)
    aviary.set_condition(gravity=G / 4)
    aviary.step(np.zeros(aviary.given.shape))
    wing, velocity = airframe_wing(CF2X, G / 4), aviary.swarm.velocity[0]
    loaded = [
        propulsion_power((0.0, 0.0, v / 2), wing, r)
        for v, r in zip(velocity[:, 2], ratio, strict=True)
    ]
    assert aviary.readings["power"][0] == pytest.approx(loaded)
