"""A sensor with a rate, a delay, noise and losses of its own."""

from typing import ClassVar

import numpy as np
import pytest

import bulletuav
from bulletuav.sensors import Label, Sensor, Uncertain
from bulletuav.sensors.imperfect import Imperfect

PERIOD = 0.1
DRONES = 2


class East(Sensor):
    """How far east a drone is, m."""

    name = "east"
    numbers = (Label("east", "m", -1000.0, 1000.0),)

    def measure(self, moment):
        return {"east": moment.after.position[..., 0]}


class Noisy(East):
    """The same with noise of its own, drawn at a reset."""

    name = "noisy"
    numbers = (Label("noisy", "m", -1000.0, 1000.0),)
    uncertain: ClassVar = {"noise": Uncertain(0.0, 10.0)}

    def attach(self, setup, engine):
        super().attach(setup, engine)
        self._bias = np.zeros(setup.shape)

    def reset(self, world, swarm, known, rng):
        self._bias[world] = self.noise[world] * rng.standard_normal(DRONES)

    def measure(self, moment):
        return {"noisy": moment.after.position[..., 0] + self._bias}


@pytest.fixture
def fly():
    """Flies east in two worlds; gives true and measured places in world 0, (decisions + 1, N)."""
    made = []

    def flown(sensor, resets=(), decisions=8, **uncertain):
        aviary = bulletuav.Aviary(
            "hover",
            2,
            num_drones=DRONES,
            sensors=(sensor,),
            observation=("velocity", sensor.name),
            action="velocity",
            dynamics="single_integrator",
            decision_hz=10,
            randomization={f"{sensor.name}_{key}": value for key, value in uncertain.items()},
        )
        made.append(aviary)
        rows = [(aviary.swarm.position, aviary.reset(seeds=0))]
        rows[0] = (aviary.swarm.position[0, :, 0].copy(), rows[0][1][0, :, -1])
        for k in range(decisions):
            observations = aviary.step(np.full((2, DRONES, 3), (0.5, 0.0, 0.0))).observations
            if k in resets:
                observations = aviary.reset(np.array([False, True]))
            rows.append((aviary.swarm.position[0, :, 0].copy(), observations[0, :, -1]))
        true, measured = zip(*rows, strict=True)
        return np.array(true), np.array(measured)

    yield flown
    for one in made:
        one.close()


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_readings_come_late_and_stand_still_before_the_first(delay, fly):
    true, measured = fly(Imperfect(East(), delay=delay * PERIOD))
    np.testing.assert_allclose(measured[delay:], true[: len(true) - delay], atol=1e-5)
    np.testing.assert_allclose(measured[:delay], np.tile(true[0], (delay, 1)), atol=1e-5)


def test_a_reset_of_another_world_does_not_make_them_come_earlier(fly):
    _, alone = fly(Imperfect(East(), delay=3 * PERIOD))
    _, beside = fly(Imperfect(East(), delay=3 * PERIOD), resets=(2, 4, 5))
    np.testing.assert_array_equal(alone, beside)


def test_between_measurements_the_last_one_stays(fly):
    true, measured = fly(Imperfect(East(), rate=5))
    np.testing.assert_allclose(measured, np.repeat(true[::2], 2, axis=0)[: len(true)], atol=1e-5)


def test_lost_measurements_leave_the_last_one_but_the_first_always_comes(fly):
    true, measured = fly(Imperfect(East(), loss=1.0))
    np.testing.assert_allclose(measured, np.tile(true[0], (len(true), 1)), atol=1e-5)


def test_noise_is_of_the_size_that_was_given_or_drawn(fly):
    for sensor, drawn in ((Imperfect(East(), noise=0.5), {}), (Imperfect(East()), {"noise": 0.5})):
        true, measured = fly(sensor, decisions=200, **drawn)
        assert np.std(measured - true) == pytest.approx(0.5, rel=0.15)


def test_what_a_sensor_has_itself_stays_its_own_from_the_first_episode_on(fly):
    true, measured = fly(Imperfect(Noisy(), delay=0.0), noise=2.0)
    bias = measured - true
    assert (np.abs(bias) > 0.01).all()
    np.testing.assert_allclose(bias, np.tile(bias[0], (len(bias), 1)), atol=1e-4)
    with pytest.raises(ValueError, match="sensor 'noisy' has its own noise: set it there"):
        Imperfect(Noisy(), noise=0.1)


def test_it_passes_the_check_of_sensors():
    bulletuav.check_sensor(Imperfect(East(), rate=5, delay=0.3, noise=0.1, loss=0.3))


def test_numbers_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match=r"sensor is <class .*East'>: an object derived from"):
        Imperfect(East)
    for name, value in (("rate", 0.0), ("delay", -1.0), ("noise", -0.1), ("loss", 1.1)):
        with pytest.raises(ValueError, match=f"^{name} is "):
            Imperfect(East(), **{name: value})
