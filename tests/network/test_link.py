import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bulletuav.network.fading import rician_gain
from bulletuav.network.link import capacity, decibel, noise_power, packet_error, ratio
from bulletuav.network.propagation import log_distance

BAND = 10e6  # Hz
NOISE = 2.0066946e-13  # W, in 10 MHz with a noise figure of 7 dB
LINKS = {  # W, m, exponent at 29 GHz -> SNR in dB, Mbit/s
    (0.5, 100, 2.0): (22.269144, 74.061800),
    (0.5, 100, 3.5): (-7.730856, 2.248084),
    (0.5, 300, 2.0): (12.726719, 43.027420),
    (0.5, 300, 3.5): (-24.430100, 0.0519257),
    (5.0, 100, 2.0): (32.269144, 107.204329),
}
SAMPLES = 200_000


def received(power, distance, exponent=2.0):
    return power * ratio(-log_distance(distance, 29.0, exponent))


# Links


@given(st.floats(-300, 300))
def test_decibels_there_and_back(gain):
    assert decibel(ratio(gain)) == pytest.approx(gain, abs=1e-11)


def test_decibels_of_round_numbers():
    assert decibel(np.array([0.0, 1e-3, 1, 100])) == pytest.approx([-math.inf, -30, 0, 20])
    assert ratio(np.array([-math.inf, -30, 0, 20])) == pytest.approx([0, 1e-3, 1, 100])
    assert ratio(3.0) == pytest.approx(1.995262, abs=6e-7)


def test_noise():
    assert decibel(1e3 * noise_power(1.0, 0.0)) == pytest.approx(-173.97519, abs=6e-6)
    assert noise_power(BAND, 7.0) == pytest.approx(NOISE, rel=3e-8)
    assert decibel(1e3 * noise_power(BAND, 7.0)) == pytest.approx(-96.975187, abs=6e-7)
    assert decibel(1e3 * noise_power(20e6, 9.0)) == pytest.approx(-91.964887, abs=6e-7)


@pytest.mark.parametrize("link", LINKS)
def test_rates_of_lonely_links(link):
    snr = received(*link) / noise_power(BAND, 7.0)
    assert decibel(snr) == pytest.approx(LINKS[link][0], abs=6e-7)
    rate = LINKS[link][1]
    assert capacity(BAND, snr) / 1e6 == pytest.approx(rate, abs=6e-7 if rate > 1 else 6e-8)


def test_packet_errors():
    # Without a signal each bit is a coin flip; 1 - (1 - exp(-4.5) / 2)^16 by a desk calculator
    assert packet_error(0.0, 8) == pytest.approx(1 - 2.0**-8, rel=1e-15)
    assert packet_error(1e4, 1e4) == 0.0
    assert packet_error(9.0, 16) == pytest.approx(0.085264, abs=6e-7)
    # Small probabilities are not rounded to multiples of 1e-16
    assert packet_error(80.0, 1) == pytest.approx(0.5 * math.exp(-40), rel=1e-12)


def test_rate_against_one_interferer():
    sinr = received(0.5, 100) / (received(0.5, 200) + noise_power(BAND, 7.0))
    assert decibel(sinr) == pytest.approx(5.918781, abs=6e-7)
    assert capacity(BAND, sinr) / 1e6 == pytest.approx(22.949330, abs=6e-7)


def test_capacity():
    assert capacity(BAND, np.array([0.0, 1, 3, 255])) == pytest.approx(
        [0, BAND, 2 * BAND, 8 * BAND]
    )
    assert capacity(BAND, 1e-20) == pytest.approx(BAND * 1e-20 / math.log(2), rel=1e-12)


@given(st.floats(1e3, 1e9), st.floats(1.01, 100), st.floats(1e-20, 1e-6))
def test_more_bandwidth_with_its_noise_carries_more_up_to_a_limit(band, more, power):
    narrow, wide = (capacity(b, power / noise_power(b, 7.0)) for b in (band, band * more))
    limit = power / noise_power(1.0, 7.0) / math.log(2)
    assert narrow <= wide * (1 + 1e-12)
    assert wide <= limit * (1 + 1e-12)


# Fading


@pytest.mark.parametrize(("k", "variance"), [(0, 1), (1, 0.75), (16, 0.114187)])
def test_mean_and_variance_of_fading(k, variance):
    gain = rician_gain(k, np.random.default_rng(1), (SAMPLES,))
    assert gain.mean() == pytest.approx(1, abs=0.01)
    assert gain.var() == pytest.approx(variance, rel=0.02)


def test_fading_without_a_direct_path_is_exponential():
    gain = rician_gain(0, np.random.default_rng(2), (SAMPLES,))
    assert stats.kstest(gain, stats.expon.cdf).pvalue > 0.05


@pytest.mark.parametrize("k", [0.5, 5.0])
def test_fading_is_rician(k):
    gain = rician_gain(k, np.random.default_rng(3), (SAMPLES,))
    amplitude = stats.rice(b=math.sqrt(2 * k), scale=math.sqrt(1 / (2 * (k + 1))))
    assert stats.kstest(np.sqrt(gain), amplitude.cdf).pvalue > 0.05


def test_a_strong_direct_path_does_not_fade():
    assert rician_gain(1e12, np.random.default_rng(4), (100,)) == pytest.approx(1, abs=1e-5)


def test_every_link_can_have_its_own_k():
    gain = rician_gain(np.array([0, 1, 16]), np.random.default_rng(5), (SAMPLES, 3))
    assert gain.shape == (SAMPLES, 3)
    assert gain.var(axis=0) == pytest.approx([1, 0.75, 0.114187], rel=0.03)
    assert np.abs(np.corrcoef(gain.T) - np.eye(3)).max() < 0.01


def test_same_seed_same_fading():
    one, other, third = (
        rician_gain(2.0, np.random.default_rng(seed), (4, 5)) for seed in (6, 6, 7)
    )
    np.testing.assert_array_equal(one, other)
    assert (one != third).all()


@pytest.mark.parametrize("wrong", [-0.1, math.nan, math.inf, [1, -1], "5 dB", [[1, 2]], [1, 2]])
def test_wrong_k_is_refused(wrong):
    with pytest.raises(ValueError, match="the Rician K "):
        rician_gain(wrong, np.random.default_rng(8), (3,))
