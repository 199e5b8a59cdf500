import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bulletuav.compiled.kernel import allocating
from bulletuav.network.antenna import (
    INDOOR_PEAK,
    PEAK,
    element_gain,
    gain_towards,
    indoor_gain,
    local_azimuth,
    local_zenith,
)

ELEMENT = {
    (90, 0): 8,
    (90, 32.5): 5,
    (90, 65): -4,
    (57.5, 0): 5,
    (122.5, 0): 5,
    (25, 0): -4,
    (60, 45): -0.3077,
    (0, 0): -15.0059,
    (140, 90): -22,
    (90, 180): -22,
}
TURNED = {  # zenith, azimuth, bearing, downtilt -> local zenith, local azimuth, gain
    (90, 0, 0, 0): (90, 0, 8),
    (102, 0, 0, 12): (90, 0, 8),
    (180, 0, 0, 90): (90, 0, 8),
    (180, 123, 0, 90): (90, 0, 8),
    (170, 0, 0, 90): (80, 0, 7.7160),
    (170, 90, 0, 90): (90, 10, 7.7160),
    (170, 180, 0, 90): (100, 0, 7.7160),
    (135, 37, 0, 90): (55.6171, 31.0402, 1.9058),
    (120, 200, 30, 90): (148.5251, 16.7396, -2.5242),
}
NADIR = {0: 8, 10: 7.716, 30: 5.4438, 45: 2.2485, 65: -4, 90: -15.006}
components = st.floats(-1e3, 1e3)


def directions(count, seed):
    vectors = np.random.default_rng(seed).standard_normal((3, count))
    return vectors / np.linalg.norm(vectors, axis=0)


@pytest.mark.parametrize("direction", ELEMENT)
def test_element(direction):
    assert element_gain(*direction, PEAK) == pytest.approx(ELEMENT[direction], abs=6e-5)


@pytest.mark.parametrize(
    ("direction", "gain"),
    [((90, 0), 5), ((90, 45), 2), ((45, 45), -1), ((90, 180), -20), ((0, 90), -19)],
)
def test_indoor_element(direction, gain):
    assert indoor_gain(*direction, INDOOR_PEAK) == pytest.approx(gain, abs=1e-12)


@pytest.mark.parametrize("direction", TURNED)
def test_turned_antennas(direction):
    zenith, azimuth = local_zenith(*direction), local_azimuth(*direction)
    assert (zenith, azimuth, element_gain(zenith, azimuth, PEAK)) == pytest.approx(
        TURNED[direction], abs=6e-5
    )


@given(st.floats(1, 179), st.floats(-179, 179), st.floats(-90, 90))
def test_bearing_turns_about_the_vertical(zenith, azimuth, bearing):
    assert local_zenith(zenith, azimuth, bearing, 0.0) == pytest.approx(zenith, abs=1e-6)
    turned = local_azimuth(zenith, azimuth, bearing, 0.0) - (azimuth - bearing)
    assert math.remainder(turned, 360) == pytest.approx(0, abs=1e-6)


def test_rounding_at_the_ends_of_the_local_axis_gives_numbers():
    angle = np.linspace(0, 180, 1801)
    np.testing.assert_allclose(local_zenith(angle, 0.0, 0.0, angle), 0, atol=2e-6)
    np.testing.assert_allclose(local_zenith(180 - angle, 180.0, 0.0, angle), 180, atol=2e-6)


def test_local_frames_keep_angles_between_directions():
    x, y, z = directions(200, 1)
    zenith, azimuth = np.degrees(np.arccos(z)), np.degrees(np.arctan2(y, x))
    theta = np.radians(local_zenith(zenith, azimuth, 40.0, 25.0))
    phi = np.radians(local_azimuth(zenith, azimuth, 40.0, 25.0))
    local = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    before = np.stack([x, y, z])
    np.testing.assert_allclose(local.T @ local, before.T @ before, atol=1e-9)


@pytest.mark.parametrize("psi", NADIR)
@pytest.mark.parametrize(("east", "north"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_looking_down_in_the_principal_planes(psi, east, north):
    if psi == 90 and north:  # local azimuth 90: the same loss, no pole
        assert gain_towards(0.0, north, 0.0, PEAK) == pytest.approx(NADIR[psi], abs=6e-4)
        return
    aside, down = math.sin(math.radians(psi)), math.cos(math.radians(psi))
    assert gain_towards(east * aside, north * aside, -down, PEAK) == pytest.approx(
        NADIR[psi], abs=6e-4
    )


def test_looking_down_is_a_downtilt_of_90_degrees():
    x, y, z = directions(20_000, 2)
    zenith, azimuth = np.degrees(np.arccos(z)), np.degrees(np.arctan2(y, x))
    turned = element_gain(
        local_zenith(zenith, azimuth, 0.0, 90.0), local_azimuth(zenith, azimuth, 0.0, 90.0), PEAK
    )
    np.testing.assert_allclose(gain_towards(x, y, z, PEAK), turned, atol=1e-5)


def test_no_cliff_below_the_drone():
    around = np.linspace(0, 2 * math.pi, 73)
    gain = gain_towards(0.5 * np.cos(around), 0.5 * np.sin(around), -50.0, PEAK)
    assert gain_towards(0.0, 0.0, -50.0, PEAK) == PEAK
    assert (gain < PEAK).all()
    assert (gain > PEAK - 0.01).all()


def test_gain_never_jumps_in_the_lower_half():
    x, y = np.meshgrid(np.linspace(-100, 100, 801), np.linspace(-100, 100, 801))
    gain = gain_towards(x, y, -50.0, PEAK)
    assert max(np.abs(np.diff(gain, axis=axis)).max() for axis in (0, 1)) < 0.15


@given(components, components, components)
def test_mirror_images_and_lengths_do_not_matter(x, y, z):
    gain = gain_towards(x, y, z, PEAK)
    assert gain == gain_towards(-x, y, z, PEAK) == gain_towards(x, -y, z, PEAK)
    assert gain == gain_towards(8 * x, 8 * y, 8 * z, PEAK)


@given(st.floats(0, 89))
def test_ahead_and_aside_are_alike(psi):
    aside, down = math.sin(math.radians(psi)), math.cos(math.radians(psi))
    assert gain_towards(aside, 0.0, -down, PEAK) == pytest.approx(
        gain_towards(0.0, aside, -down, PEAK), abs=1e-9
    )


@given(components, components, components)
def test_most_straight_below_and_never_more_than_30_less(x, y, z):
    assert PEAK - 30 <= gain_towards(x, y, z, PEAK) <= PEAK
    assert gain_towards(x, y, z, 0.0) == pytest.approx(
        gain_towards(x, y, z, PEAK) - PEAK, abs=1e-12
    )


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_above_at_the_horizon_and_nowhere(zero):
    assert gain_towards(zero, zero, 1.0, PEAK) == PEAK - 30
    assert gain_towards(zero, zero, -1.0, PEAK) == PEAK
    assert gain_towards(zero, zero, zero, PEAK) == PEAK
    for ahead in (1.0, -1.0):
        assert gain_towards(ahead, zero, zero, PEAK) == pytest.approx(-15.0059, abs=6e-5)


def test_in_kernels_too():
    @allocating
    def gains(vectors):
        found = np.empty(len(vectors))
        for i in range(len(vectors)):
            found[i] = gain_towards(vectors[i, 0], vectors[i, 1], vectors[i, 2], PEAK)
        return found

    vectors = directions(50, 3)
    np.testing.assert_array_equal(gains(vectors.T.copy()), gain_towards(*vectors, PEAK))
