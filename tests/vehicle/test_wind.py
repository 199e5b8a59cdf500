"""Dryden turbulence against the tables of MIL-F-8785C and its closed-form statistics."""

import numpy as np
import pytest
from scipy.linalg import expm

import bulletuav
from bulletuav.vehicle.swarm import Swarm
from bulletuav.vehicle.wind import TURBULENCE, Wind, dryden_scales, first_order, second_order

W20 = 7.7167


@pytest.mark.parametrize(
    ("altitude", "figures"),
    [
        (10.0, (67.366, 10.0, 1.45739, 0.77167)),
        (50.0, (202.290, 50.0, 1.22960, 0.77167)),
        (304.8, (304.8, 304.8, 0.77167, 0.77167)),
        (1000.0, (304.8, 304.8, 0.77167, 0.77167)),
    ],
)
def test_scales_and_intensities(altitude, figures):
    np.testing.assert_allclose(dryden_scales(altitude, W20), figures, rtol=2e-5)


def test_low_altitudes_are_those_of_ten_feet():
    assert dryden_scales(-1.0, W20) == dryden_scales(3.048, W20) == dryden_scales(0.5, W20)


def test_named_levels():
    assert TURBULENCE["light"] == pytest.approx(W20, abs=5e-5)
    assert TURBULENCE["severe"] == pytest.approx(23.15, abs=0.01)


def ensemble(dt, lag_steps, airspeed=10.0, worlds=4000, altitude=50.0):
    """Gusts of 4,000 independent drones now and `lag_steps` later.

    The standard error of a variance is 2.2 %.
    """
    wind = Wind((0.0, 0.0, 0.0), W20, (worlds, 1), dt)
    rngs = [np.random.default_rng(k) for k in range(worlds)]
    for k, rng in enumerate(rngs):
        wind.reset(k, rng)
    swarm = Swarm.zeros(worlds, 1, 4)
    swarm.position[..., 2] = altitude
    swarm.velocity[..., 0] = airspeed
    flying = np.ones(worlds, dtype=bool)
    samples = [
        wind.sample(swarm, np.zeros(worlds), rngs, flying)[:, 0] for _ in range(lag_steps + 1)
    ]
    return samples[0], samples[-1]


@pytest.mark.parametrize(("dt", "steps"), [(0.01, 100), (0.1, 10), (5.0, 3), (100.0, 2)])
def test_variance_is_right_for_every_step(dt, steps):
    _, _, s_u, s_w = dryden_scales(50.0, W20)
    for sample in ensemble(dt, steps):
        np.testing.assert_allclose(sample.var(axis=0), (s_u**2, s_u**2, s_w**2), rtol=0.09)
        np.testing.assert_allclose(sample.mean(axis=0), 0, atol=0.08)


@pytest.mark.parametrize(("dt", "steps"), [(0.5, 2), (1.0, 8), (2.0, 10)])
def test_autocorrelation(dt, steps):
    """e^-r along the wind, e^-r (1 - r / 2) across it, with r = elapsed airspeed / length."""
    length_u, length_w, s_u, s_w = dryden_scales(50.0, W20)
    first, last = ensemble(dt, steps)
    measured = (first * last).mean(axis=0) / (s_u**2, s_u**2, s_w**2)
    r = steps * dt * 10.0 / np.array((length_u, length_u, length_w))
    np.testing.assert_allclose(measured, np.exp(-r) * (1 - np.array((0, 0.5, 0.5)) * r), atol=0.06)


@pytest.mark.parametrize("share", [1e-8, 1e-6, 5e-6, 7e-6, 1e-4, 9.9e-4, 1.01e-3, 0.03, 1.0, 10.0])
def test_unit_variance_is_stationary_for_any_share(share):
    """M M^T + L L^T = 1 exactly, with M the transition and L the noise of one step.

    Both are read off the filter's answers.
    """
    transition = np.array(
        [second_order(*unit, share, 0.0, 0.0) for unit in ((1.0, 0.0), (0.0, 1.0))]
    ).T
    noise = np.array([second_order(0.0, 0.0, share, *unit) for unit in ((1.0, 0.0), (0.0, 1.0))]).T
    defect = transition @ transition.T + noise @ noise.T - np.eye(2)
    assert np.abs(defect).max() < 1e-12
    exact = expm(share * np.array([(0.0, 1.0), (-1.0, -2.0)]))  # x' = A x with tau = 1
    scale = np.sqrt((0.25, 0.25))
    np.testing.assert_allclose(transition, exact * scale[:, None] / scale, atol=1e-12)
    assert first_order(0.0, share, 1.0) ** 2 + first_order(1.0, share, 0.0) ** 2 == pytest.approx(
        1, abs=1e-14
    )


def test_gusts_turn_with_the_steady_wind():
    """With the wind from the south, `along` is north: the same numbers, turned by 90 degrees."""
    samples = []
    for steady in ((5.0, 0.0, 0.0), (0.0, 5.0, 0.0)):
        wind = Wind(steady, W20, (1, 1), 0.1)
        rng = np.random.default_rng(0)
        wind.reset(0, rng)
        swarm = Swarm.zeros(1, 1, 4)
        swarm.position[..., 2] = 20
        samples.append(wind.sample(swarm, np.zeros(1), [rng], np.ones(1, bool))[0, 0] - steady)
    (x, y, z), turned = samples
    np.testing.assert_allclose(turned, (-y, x, z), rtol=1e-12)


def test_wind_as_a_function_of_place_and_time():
    calls = []

    def field(position, time):
        calls.append((position.shape, time.copy()))
        return np.stack(
            [position[..., 2], 0 * position[..., 0], 0 * position[..., 0] + time[:, None]], axis=-1
        )

    aviary = bulletuav.Aviary(
        "hover", 2, num_drones=2, wind=field, dynamics="point_mass", action="velocity"
    )
    aviary.reset(seeds=0)
    for _ in range(3):
        aviary.step(np.zeros((2, 2, 3)))
    assert calls[0][0] == (2, 2, 3)
    np.testing.assert_allclose([time[0] for _, time in calls], (0, 1 / 30, 2 / 30))
    assert (aviary.swarm.velocity[..., 0] > 0).all()
    aviary.close()


@pytest.mark.parametrize("answer", [np.zeros(3), np.full((1, 1, 3), np.nan)])
def test_a_wind_function_that_answers_wrongly_is_named_and_nothing_is_lost(answer):
    good = [True]
    aviary = bulletuav.Aviary(
        "hover", wind=lambda position, time: np.zeros((1, 1, 3)) if good[0] else answer
    )
    aviary.reset(seeds=0)
    good[0] = False
    with pytest.raises(ValueError, match="the wind function gave shape"):
        aviary.step(np.zeros((1, 1, 4)))
    good[0] = True
    assert aviary.steps[0] == 0
    aviary.step(np.zeros((1, 1, 4)))
    aviary.close()


def test_turbulence_shakes_reproducibly_and_world_by_world():
    ends = []
    for worlds in (1, 3):
        aviary = bulletuav.Aviary(
            "hover", worlds, turbulence="severe", action="velocity", dynamics="rigid_body"
        )
        for _ in range(2):
            aviary.reset(seeds=[7, 8, 9][:worlds])
            for _ in range(30):
                aviary.step(np.zeros((worlds, 1, 3)))
            ends.append(aviary.swarm.position[0, 0].copy())
        aviary.close()
    np.testing.assert_array_equal(ends, [ends[0]] * 4)
    calm = bulletuav.Aviary("hover", action="velocity", dynamics="rigid_body")
    calm.reset(seeds=7)
    for _ in range(30):
        calm.step(np.zeros((1, 1, 3)))
    assert np.abs(calm.swarm.position[0, 0] - ends[0]).max() > 0.01
    calm.close()
