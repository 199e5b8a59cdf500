"""Links of edge computing against formulas: rates, fading, shared bands and antennas."""

import math

import numpy as np
import pytest
from edge_users import (
    BAND,
    COMPUTED,
    EAST,
    EQUAL,
    NOISE,
    POWER,
    STAY,
    alone,
    friis,
    hovered,
    shannon,
)
from placing import OPEN, WALL, fly
from scipy.spatial.transform import Rotation


def test_link_rates_are_those_of_shannon(put):
    """Right below, 48.5 m; aside, 111.1 m; and behind the wall, 62.9 m.

    There power falls with the exponent 3.19.
    """
    users = [(0, 0, 1.5), (-60, -80, 1.5), (40, 0, 1.5)]
    aviary = put("mec", WALL, [(0, 0, 50)], users, observation=("link_rates",))
    assert not aviary.reset(seeds=0).any()
    expected = [shannon(friis(48.5) / NOISE), shannon(friis(math.hypot(100, 48.5)) / NOISE)]
    expected.append(shannon(friis(1) * math.hypot(40, 48.5) ** -3.19 / NOISE))
    assert expected[0] == pytest.approx(94.87e6, rel=1e-3)
    np.testing.assert_allclose(fly(aviary, STAY).observations[0, 0] * 1e6, expected, rtol=1e-6)


FLY, GHZ, SEEN, HID = (
    math.log10(50),
    math.log10(5),
    math.log10(48.5),
    math.log10(math.hypot(40, 48.5)),
)
LOSSES = {
    "umi": (32.4 + 21 * SEEN + 20 * GHZ, 22.4 + 35.3 * HID + 21.3 * GHZ),
    "uma": (28 + 22 * SEEN + 20 * GHZ, 13.54 + 39.08 * HID + 20 * GHZ),
    "umi_av": (
        30.9 + (22.25 - 0.5 * FLY) * SEEN + 20 * GHZ,
        32.4 + (43.2 - 7.6 * FLY) * HID + 20 * GHZ,
    ),
    "uma_av": (
        28 + 22 * SEEN + 20 * GHZ,
        -17.5 + (46 - 7 * FLY) * HID + 20 * math.log10(40 * math.pi * 5 / 3),
    ),
}
"""dB, of TR 38.901 and TR 36.777, at 5 GHz to a user 48.5 m right below and one behind the wall"""


@pytest.mark.parametrize("name", LOSSES)
def test_path_losses_of_the_standards(put, name):
    options = {"observation": ("link_rates",), "path_loss": name, "frequency": 5.0}
    aviary = put("mec", WALL, [(0, 0, 50)], [(0, 0, 1.5), (40, 0, 1.5)], **options)
    expected = [shannon(POWER * 10 ** (-loss / 10) / NOISE) for loss in LOSSES[name]]
    np.testing.assert_allclose(fly(aviary, STAY).observations[0, 0] * 1e6, expected, rtol=1e-5)


@pytest.mark.parametrize("name", ["umi_av", "uma_av"])
def test_path_losses_for_other_bands_are_refused(make, name):
    with pytest.raises(
        ValueError, match="frequency is 29.0: TR 36.777 .* is valid for 0.5 to 6 GHz"
    ):
        make("mec", path_loss=name)


@pytest.mark.parametrize(
    ("fading", "variance"), [("none", 0.0), ("rician", 21 / 121), ("rayleigh", 1.0)]
)
def test_fading_spreads_the_power_and_keeps_its_mean(put, fading, variance):
    """With the factor K = 10 a Rician channel's power has the variance (2 K + 1) / (K + 1)^2."""
    users = [(48 * math.cos(k), 48 * math.sin(k), 1.5) for k in range(20)]
    aviary = put("mec", OPEN, [(0, 0, 50)], users, observation=("link_rates",), fading=fading)
    rates = np.array([fly(aviary, STAY).observations[0, 0] for _ in range(90)])
    gain = (2 ** (rates * 1e6 / BAND) - 1) / (friis(math.hypot(48, 48.5)) / NOISE)
    assert gain.mean() == pytest.approx(1, abs=5 * math.sqrt(variance / gain.size) + 1e-5)
    assert gain.var() == pytest.approx(variance, rel=0.3, abs=1e-6)
    assert (np.unique(rates, axis=0).shape[0] == 1) == (fading == "none")


def test_a_task_takes_its_upload_and_its_cycles_where_nothing_waits(put):
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], 20, arrival_rate=0.3, **EQUAL)
    latency = alone(aviary, 20)
    assert len(latency) > 50
    np.testing.assert_allclose(latency, 1e6 / shannon(friis(48.5) / NOISE) + COMPUTED, rtol=1e-12)


def test_sizes_of_tasks_are_between_their_ends(put):
    aviary = put(
        "mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], 20, arrival_rate=0.3, task_bits=(1e6, 2e6)
    )
    bits = alone(aviary, 30) / (1 / shannon(friis(48.5) / NOISE) + 1000 / 5e9)
    assert 1e6 <= bits.min() < 1.1e6
    assert 1.9e6 < bits.max() <= 2e6
    assert bits.mean() == pytest.approx(1.5e6, rel=5 * 0.1925 / math.sqrt(len(bits)))


OWN, CROSS = friis(math.hypot(20, 48.5)), friis(math.hypot(100, 20, 48.5))
SHARE = 0.15 * 2.0
"""Of the time in which a user may send: its rate of tasks, each given up after the deadline"""
RATES = {
    "ofdma": shannon(2 * OWN / (NOISE + SHARE * 2 * CROSS), BAND / 2),
    "tdma": shannon(OWN / (NOISE + SHARE * CROSS)) / 2,
    "shared": shannon(OWN / (NOISE + SHARE * (OWN + 2 * CROSS))),
}
"""Of two drones 100 m apart, each with two users 20 m aside of it"""


@pytest.mark.parametrize("access", RATES)
def test_users_share_the_band_and_disturb_each_other(put, access):
    users = [(-50, -20, 1.5), (50, 20, 1.5), (-50, 20, 1.5), (50, -20, 1.5)]
    options = {"access": access, "arrival_rate": 0.15, "deadline": 2.0, **EQUAL}
    latency = alone(put("mec", OPEN, [(-50, 0, 50), (50, 0, 50)], users, 20, **options), 20)
    assert len(latency) > 50
    np.testing.assert_allclose(latency, 1e6 / RATES[access] + COMPUTED, rtol=1e-9)


def gained(rates, distances):
    """Antenna gains, dBi, that explain rates (U,) Mbit/s in 10 MHz in free space."""
    received = (2 ** (rates * 1e6 / BAND) - 1) * NOISE
    return 10 * np.log10(received / [friis(distance) for distance in distances])


BELOW = np.array([(0, 0, 1.5), (-48.5, 0, 1.5), (0, 48.5, 1.5), (48.5, 0, 1.5), (90, 0, 1.5)])


def test_antennas_look_down_by_hand(put):
    """8 dBi below; 12 (45 / 65)^2 dB less at 45 degrees, and 12 (61.7 / 65)^2 at 61.7."""
    aviary = put(
        "mec_advanced", OPEN, [(0, 0, 50)], BELOW, observation=("link_rates",), bandwidth=BAND
    )
    gain = gained(
        fly(aviary, STAY).observations[0, 0].astype(float),
        np.linalg.norm(BELOW - (0, 0, 50), axis=1),
    )
    aside = 8 - 12 * (45 / 65) ** 2
    far = 8 - 12 * (math.degrees(math.atan2(90, 48.5)) / 65) ** 2
    np.testing.assert_allclose(gain, (8, aside, aside, aside, far), atol=1e-4)
    isotropic = put("mec", OPEN, [(0, 0, 50)], BELOW, observation=("link_rates",))
    even = gained(
        fly(isotropic, STAY).observations[0, 0].astype(float),
        np.linalg.norm(BELOW - (0, 0, 50), axis=1),
    )
    np.testing.assert_allclose(even, 0, atol=1e-4)


NEAR = np.array([(0, 0, 1.5), (-20, 0, 1.5), (20, 0, 1.5)])


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_antennas_tilt_with_the_drone(put, dynamics):
    """Who speeds up to the east looks to the west.

    The gain is that of the angle between the body's -z and the way to a user in its plane.
    """
    options = {
        "observation": ("link_rates",),
        "bandwidth": BAND,
        "dynamics": dynamics,
        "decision_hz": 10,
    }
    aviary = put("mec_advanced", OPEN, [(0, 0, 50)], NEAR, **options)
    for _ in range(4):
        observation = fly(aviary, EAST).observations[0, 0].astype(float)
    way = NEAR - aviary.swarm.position[0, 0]
    down = Rotation.from_quat(aviary.swarm.quaternion[0, 0]).apply((0, 0, -1))
    distance = np.linalg.norm(way, axis=1)
    angle = np.degrees(np.arccos(way @ down / distance))
    tilt = math.degrees(math.asin(-down[0]))
    assert tilt > 5
    assert angle[1] < angle[0] < angle[2] < 85
    np.testing.assert_allclose(gained(observation, distance), 8 - 12 * (angle / 65) ** 2, atol=0.02)


def test_who_hovers_well_can_do_the_advanced_task(put):
    """By its defaults, in the open: three drones over ten users."""
    rng = np.random.default_rng(0)
    users = np.column_stack([rng.uniform(-100, 100, (10, 2)), np.full(10, 1.5)])
    for height in (30, 100):
        step = hovered(
            put(
                "mec_advanced", OPEN, [(-60, 0, height), (0, 60, height), (60, 0, height)], users, 3
            )
        )
        assert step.info["success"].all()
        assert step.info["completed"].min() > 0.85
