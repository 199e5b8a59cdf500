"""Rates of uplinks that share a band, who serves whom, and what drones receive."""

import numpy as np
import pytest

from bulletuav.network.access import ACCESS, NO_DRONE, OFDMA, SHARED, TDMA, uplink_rates
from bulletuav.network.antenna import PEAK, element_gain
from bulletuav.network.assignment import (
    DTLCM,
    MAX_RATE,
    NEAREST,
    STRATEGIES,
    assign_users,
    dtlcm_score,
)
from bulletuav.network.link import decibel, noise_power, ratio
from bulletuav.network.pathloss import PATHLOSS_MODELS
from bulletuav.network.propagation import log_distance
from bulletuav.network.uplink import RadioConfig, Uplink

BAND = 10e6
NOISE = float(noise_power(BAND, 7.0))
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def rates(power, servers, access, activity=1.0):
    """(U,) of one world."""
    return uplink_rates(
        np.array([power], dtype=float), np.array([servers]), BAND, NOISE, access, activity
    )[0]


def scattered(seed, drones=3, users=20):
    """Received powers over six decades and servers, some users without one."""
    rng = np.random.default_rng(seed)
    return 10 ** rng.uniform(-14, -8, (drones, users)), rng.integers(-1, drones, users)


# Access


def test_two_users_on_the_same_channel():
    received = 0.5 * ratio(-log_distance(np.array([[100.0, 200.0]]), 29.0, 2.0))
    rate = rates(received, [0, 0], SHARED)
    assert rate[0] == pytest.approx(22.949330e6, abs=0.5)
    assert decibel(received[0, 0] / (NOISE + received[0, 1])) == pytest.approx(5.918781, abs=5e-7)


def test_a_single_user_has_all_of_the_band_however_it_is_shared():
    received = [[0.5 * float(ratio(-log_distance(100.0, 29.0, 2.0)))]]
    for access in ACCESS.values():
        assert rates(received, [0], access)[0] == pytest.approx(74.061800e6, abs=0.5)


def test_shares_of_one_drone_by_hand():
    power = [[8 * NOISE, 3 * NOISE]]
    assert rates(power, [0, 0], OFDMA) == pytest.approx(
        [BAND / 2 * np.log2(17), BAND / 2 * np.log2(7)]
    )
    assert rates(power, [0, 0], TDMA) == pytest.approx(
        [BAND / 2 * np.log2(9), BAND / 2 * np.log2(4)]
    )
    assert rates(power, [0, 0], SHARED) == pytest.approx(
        [BAND * np.log2(1 + 8 / 4), BAND * np.log2(1 + 3 / 9)]
    )


def test_interference_from_another_drone_by_hand():
    power = [[8 * NOISE, 1 * NOISE, 3 * NOISE], [NOISE, 6 * NOISE, 2 * NOISE]]
    servers = [0, 1, 1]
    assert rates(power, servers, OFDMA) == pytest.approx(
        [BAND * np.log2(1 + 8 / 5), BAND / 2 * np.log2(1 + 12 / 2), BAND / 2 * np.log2(1 + 4 / 2)]
    )
    assert rates(power, servers, TDMA) == pytest.approx(
        [BAND * np.log2(1 + 8 / 4), BAND / 2 * np.log2(1 + 6 / 2), BAND / 2 * np.log2(1 + 2 / 2)]
    )
    assert rates(power, servers, OFDMA, 0.25)[0] == pytest.approx(BAND * np.log2(1 + 8 / 2))


@pytest.mark.parametrize("access", [OFDMA, TDMA])
@pytest.mark.parametrize("seed", range(10))
def test_no_drone_gives_more_than_its_band(access, seed):
    power, servers = scattered(seed)
    alone = np.array([rates(power[:, [j]], servers[[j]], access)[0] for j in range(len(servers))])
    shared = rates(power, servers, access)
    for drone in range(3):
        own = servers == drone
        band = np.divide(shared[own], alone[own])
        # OFDMA: 1/n of the band at up to n times the density, which gains log2(n) bit/s/Hz at most
        gain = np.log2(own.sum()) * BAND / alone[own] if access == OFDMA else 0.0
        assert (band <= 1 / own.sum() * (1 + gain) + 1e-9).all()
    assert (shared[servers == NO_DRONE] == 0).all()


@pytest.mark.parametrize("access", list(ACCESS.values()))
@pytest.mark.parametrize("seed", range(10))
def test_one_more_user_of_another_drone_never_raises_a_rate(access, seed):
    power, servers = scattered(seed)
    before = rates(power, servers, access)
    for newcomer in np.flatnonzero(servers == NO_DRONE):
        for drone in range(3):
            after = rates(
                power, np.where(np.arange(len(servers)) == newcomer, drone, servers), access
            )
            others = (servers != drone) & (servers != NO_DRONE)
            assert (after[others] <= before[others] * (1 + 1e-12)).all()


@pytest.mark.parametrize("access", list(ACCESS.values()))
def test_names_of_drones_and_users_do_not_matter(access):
    power, servers = scattered(3)
    drones, users = np.array([2, 0, 1]), np.random.default_rng(0).permutation(20)
    renamed = np.append(np.argsort(drones), NO_DRONE)[servers]
    expected = rates(power, servers, access)[users]
    assert rates(power[drones][:, users], renamed[users], access) == pytest.approx(expected)


# Assignment


def serving(strategy, position, users, power=None, alive=None, load=None):
    """(U,) of one world of drones of 20 Gcycles/s and tasks of 1.25 Gcycles."""
    position, users = np.array([position], dtype=float), np.array([users], dtype=float)
    shape = (1, position.shape[1])
    power = np.ones((*shape, users.shape[1])) if power is None else np.array([power], dtype=float)
    alive = np.ones(shape, dtype=bool) if alive is None else np.array([alive])
    load = np.zeros(shape) if load is None else np.array([load], dtype=float)
    return assign_users(strategy, position, alive, users, power, 20e9, 1.25e9, load, 0.7)[
        0
    ].tolist()


def test_matching_by_distance_task_and_load():
    assert dtlcm_score(100.0, 20e9, 1.25e9, 0.0, 0.7) == pytest.approx(0.93)
    assert dtlcm_score(200.0, 20e9, 1.25e9, 0.0, 0.7) == pytest.approx(0.86)
    assert dtlcm_score(100.0, 20e9, 1.25e9, 16e9, 0.7) == pytest.approx(0.85)
    drones, user = [(0, 0, 50), (300, 0, 50)], [(100, 0, 1.5)]
    assert serving(DTLCM, drones, user) == [0]
    assert serving(DTLCM, drones, user, load=[16e9, 0]) == [1]


def test_matching_has_its_bounds():
    assert dtlcm_score(5000.0, 20e9, 1.25e9, 0.0, 0.7) == pytest.approx(0.3)
    assert dtlcm_score(0.0, 1e9, 2e9, 0.0, 0.7) == pytest.approx(0.7 + 0.3 / 2)


def test_nearest_counts_height_and_matching_does_not():
    drones, user = [(0, 0, 100), (60, 0, 20)], [(10, 0, 0)]
    assert serving(NEAREST, drones, user) == [1]
    assert serving(DTLCM, drones, user) == [0]


def test_the_best_heard_drone_serves_and_none_where_none_hears():
    drones, users = [(0, 0, 50), (300, 0, 50)], [(0, 0, 0), (0, 0, 0), (0, 0, 0)]
    assert serving(MAX_RATE, drones, users, power=[[1, 2, 0], [3, 1, 0]]) == [1, 0, NO_DRONE]


@pytest.mark.parametrize("strategy", list(STRATEGIES.values()))
def test_only_living_drones_serve_and_the_first_of_equals(strategy):
    drones, user = [(0, 0, 50), (0, 0, 50), (0, 0, 50)], [(100, 0, 1.5)]
    assert serving(strategy, drones, user) == [0]
    assert serving(strategy, drones, user, alive=[False, True, True]) == [1]
    assert serving(strategy, drones, user, alive=[False] * 3) == [NO_DRONE]


# The link


def received(config, position, users, sight, quaternion=LEVEL, rng=None):
    """(U,) W of one drone."""
    position, users = np.array([[position]], dtype=float), np.array([users], dtype=float)
    sight = np.array([[sight]])
    return Uplink(config).received(
        position, np.array([[quaternion]]), users, sight, [rng], np.array([True])
    )[0, 0]


def test_power_falls_with_the_exponent_of_the_sight():
    users = [(0, 0, 0), (0, 0, 0)]
    got = received(RadioConfig(n_nlos=3.5), (0, 0, 100), users, [True, False])
    assert -decibel(got / 0.5) == pytest.approx([101.69574, 131.69574], abs=5e-6)


@pytest.mark.parametrize("model", ["umi", "uma", "umi_av", "uma_av"])
def test_named_models_are_those_of_the_standards(model):
    got = received(
        RadioConfig(path_loss=model, frequency=2.0),
        (0, 0, 50),
        [(300, 0, 1.5), (300, 0, 1.5)],
        [True, False],
    )
    standard = PATHLOSS_MODELS[model]
    expected = [standard.los(300.0, 50.0, 1.5, 2.0), standard.nlos(300.0, 50.0, 1.5, 2.0)]
    assert -decibel(got / 0.5) == pytest.approx(expected)


def test_an_antenna_that_looks_down_gains_below_and_loses_aside():
    users = [(0, 0, 0), (0, 100, 50), (1000, 0, 50)]
    plain, directed = (
        received(RadioConfig(antenna=kind), (0, 0, 50), users, [True] * 3)
        for kind in ("isotropic", "downward")
    )
    assert decibel(directed / plain) == pytest.approx([8.0, -15.005917, -15.005917], abs=1e-6)


def test_the_antenna_tilts_with_the_drone():
    pitch = np.radians(30.0)
    tilted = np.array(
        [0.0, np.sin(pitch / 2), 0.0, np.cos(pitch / 2)]
    )  # nose down: -z of the body turns to the rear
    users = [(50 * np.tan(-pitch), 0, 0), (50 * np.tan(pitch), 0, 0)]
    plain, directed = (
        received(RadioConfig(antenna=kind), (0, 0, 50), users, [True] * 2, tilted)
        for kind in ("isotropic", "downward")
    )
    assert decibel(directed / plain) == pytest.approx([PEAK, element_gain(90.0, 60.0, PEAK)])


def test_fading_keeps_the_mean_and_draws_by_the_sight():
    users = np.tile([30.0, 0, 0], (40000, 1))
    still = received(RadioConfig(), (0, 0, 50), users, np.arange(40000) % 2 == 0)
    faded = received(
        RadioConfig(fading="rician"),
        (0, 0, 50),
        users,
        np.arange(40000) % 2 == 0,
        rng=np.random.default_rng(0),
    )
    gain = faded / still
    assert gain[::2].mean() == pytest.approx(1.0, abs=0.015)
    assert gain[::2].var() == pytest.approx(21 / 121, rel=0.05)  # (1 + 2 K) / (1 + K)^2 with K = 10
    assert gain[1::2].var() == pytest.approx(1.0, rel=0.1)
    all_scattered = received(
        RadioConfig(fading="rayleigh"),
        (0, 0, 50),
        users,
        np.ones(40000, dtype=bool),
        rng=np.random.default_rng(1),
    )
    assert (all_scattered / still[0]).var() == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("name", ["frequency", "bandwidth", "user_power"])
def test_a_link_without_a_carrier_a_band_or_power_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} is 0: it must be above 0"):
        Uplink(RadioConfig(**{name: 0.0}))
