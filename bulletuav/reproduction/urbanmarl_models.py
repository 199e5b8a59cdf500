"""Numbers of the models of UrbanMARL 0.3.1, next to those of this package.

Places in docstrings are files of https://github.com/yemenlinux/vUrbanMARL, commit 451cc28.
"""

import math

import numpy as np

from bulletuav.city.generator import generate
from bulletuav.network.access import ACCESS, uplink_rates
from bulletuav.network.antenna import PEAK, gain_towards
from bulletuav.network.assignment import dtlcm_score
from bulletuav.network.link import capacity, noise_power, ratio
from bulletuav.network.mobility.gauss_markov import gauss_markov
from bulletuav.network.propagation import EXPONENTS, log_distance
from bulletuav.network.queueing import core_power, mean_response, utilisation
from bulletuav.reproduction.hand_made import compare_number
from bulletuav.reproduction.table import Row
from bulletuav.vehicle.power import RotaryWing, propulsion_power

WING = RotaryWing(79.86, 88.63, 120.0, 4.03, 0.6, 1.225, 0.05, 0.503, weight=2 * 9.81)
"""Their constants of the propulsion power"""
BAND, NOISE = 10e6, float(noise_power(10e6, 7.0))
"""Bandwidth, Hz, and noise power, W"""


def receive_power(distance: float, exponent: float = 2.0) -> float:
    """Return the power that a drone receives from a user of 0.5 W at 29 GHz, W.

    Args:
        distance: Distance, m.
        exponent: Exponent of the path loss.
    """
    return float(0.5 * ratio(-log_distance(distance, 29.0, exponent)))


def their_gain(east: float, north: float, up: float) -> float:
    """Return the antenna gain of `models/channel_advanced.py` towards a user below, dBi."""
    off_nadir = math.degrees(math.atan2(max(math.hypot(east, north), 0.1), -up))
    azimuth = math.degrees(math.atan2(north, east))
    loss = min(12 * (off_nadir / 65) ** 2, 30.0) + min(12 * (azimuth / 65) ** 2, 30.0)
    return 15.0 - min(loss, 30.0)


def _compare_radio() -> list[Row]:
    """Compare `models/channel.py` and `models/channel_advanced.py`."""
    clear = capacity(BAND, receive_power(100.0) / NOISE) / 1e6
    hidden = capacity(BAND, receive_power(100.0, EXPONENTS["urbanmarl"]) / NOISE) / 1e6
    power, serving = np.array([[[receive_power(100.0), receive_power(200.0)]]]), np.array([[0, 0]])
    both = uplink_rates(power, serving, BAND, NOISE, ACCESS["shared"], 1.0)[0] / 1e6
    rows = [
        compare_number("rate, 100 m, in sight", clear, 74.0618, "Mbit/s"),
        compare_number("rate, 100 m, hidden", hidden, 2.24808375, "Mbit/s"),
        compare_number("rate, 100 m, user at 200 m in the same band", both[0], 22.949334, "Mbit/s"),
        compare_number(
            "rate, 200 m, user at 100 m in the same band", both[1], 3.20225975, "Mbit/s"
        ),
    ]
    peak = "their antenna has 15 dBi, the element of TR 38.901 8 dBi"
    axis = (
        "their azimuth is from the world's x axis, not in the antenna's frame: 30 dB from the east"
    )
    for name, (east, north), why in (
        ("straight below", (0.0, 0.0), peak),
        ("0.5 m east", (0.5, 0.0), peak),
        ("0.5 m west", (-0.5, 0.0), axis),
        ("0.5 m north", (0.0, 0.5), axis),
    ):
        ours = gain_towards(east, north, -50.0, PEAK)
        theirs = their_gain(east, north, -50.0)
        rows.append(compare_number(f"gain 50 m below, {name}", ours, theirs, "dBi", why))
    return rows


def _compare_servers() -> list[Row]:
    """Compare `models/mec_queue.py`, `models/dtlcm.py` and the energy of computing."""
    limit = "theirs jumps to a million from a utilisation of 0.99 on; the steady state ends at 1"
    cubed = "theirs cubes the sum of four cores' clocks, and multiplies by four again"
    scores = [
        dtlcm_score(distance, 20e9, 1.25e9, load, 0.7)
        for distance, load in ((100.0, 0.0), (200.0, 0.0), (100.0, 16e9))
    ]
    return [
        compare_number(
            "response, 4 cores of 4/s, 5/s", mean_response(4, 5.0, 4.0), 0.25383803, "s"
        ),
        compare_number("response, 15.9/s", mean_response(4, 15.9, 4.0), 1e6, "s", limit),
        compare_number("utilisation, 20/s", utilisation(4, 20.0, 4.0), 1.25),
        # 1.25 Mbit of 800 cycles each, cores of 2 GHz
        compare_number("response without load, advanced", mean_response(4, 0.0, 2.0), 0.5, "s"),
        # 0.7 (1 - d / 1000 m) + 0.3, minus 0.1 times the load
        compare_number("score of a drone at 100 m", scores[0], 0.93),
        compare_number("score of a drone at 200 m", scores[1], 0.86),
        compare_number("score at 100 m with a load of 0.8", scores[2], 0.85),
        # 1e-28 (20e9)^3 times 4 cores
        compare_number("power of busy cores", 4 * core_power(1e-28, 5e9), 3200.0, "W", cubed),
    ]


def _compare_flight() -> list[Row]:
    """Compare `models/aerodynamics.py`, `models/mobility.py` and `models/urban_map.py`."""
    climb = "theirs adds m g v_z; the induced velocity decreases in a climb (momentum theory)"
    fall = "theirs subtracts m g v_z and stops at 0; rotors also turn in a descent"
    single = "theirs subtracts similar numbers in single precision; 30 digits give 1214.4814 W"
    powers = [
        propulsion_power(velocity, WING)
        for velocity in ((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (25.0, 0.0, 0.0), (49.0, 0.0, 0.0))
    ]
    vertical = [propulsion_power((0.0, 0.0, speed), WING) for speed in (2.0, -12.0)]
    # One step from (1, 0) m/s with mean (0.5, 0) and normal numbers (1, -1)
    east = gauss_markov(1.0, 0.5, 0.75, 0.5, 1.0)
    north = gauss_markov(0.0, 0.0, 0.75, 0.5, -1.0)
    noise = "theirs multiplies the noise by 1 - a where its documentation has sqrt(1 - a^2)"
    whole = "theirs rounds houses and streets down to whole metres"
    city = generate("urban", 500.0, np.random.default_rng(0))
    return [
        compare_number("power in hover", powers[0], 168.49, "W"),
        compare_number("power at 10 m/s", powers[1], 126.03367, "W"),
        compare_number("power at 25 m/s", powers[2], 248.95683, "W"),
        compare_number("power at 49 m/s", powers[3], 1214.4791, "W", single),
        compare_number("power of a climb at 2 m/s", vertical[0], 207.73, "W", climb),
        compare_number("power of a descent at 12 m/s", vertical[1], 0.0, "W", fall),
        compare_number("user after a second, east, documented", east, 1.2057189, "m/s"),
        compare_number("user after a second, north, documented", north, -0.3307189, "m/s"),
        # 0.75 * 1 + 0.25 * 0.5 + 0.25 * 0.5 * 1
        compare_number("user after a second, east, as coded", east, 1.0, "m/s", noise),
        compare_number("built-up fraction of alpha 0.3", city.coverage, 0.3),
        # 11 houses of 24 m along 500 m, squared
        compare_number(
            "built-up fraction, as generated", city.coverage, (264 / 500) ** 2, "", whole
        ),
    ]


def compare_models() -> list[Row]:
    """Compare radio, servers, power, mobility and cities."""
    return _compare_radio() + _compare_servers() + _compare_flight()
