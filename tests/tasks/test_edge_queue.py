"""The mean response of edge servers instead of a simulation."""

import numpy as np
import pytest
from edge_users import CORE, EQUAL, NOISE, STAY, friis, hover_power, shannon
from placing import OPEN, fly

STEADY = [
    (1, 2.0, 1 / 3),
    (1, 4.0, 1.0),
    (2, 4.0, 0.2 / (1 - 0.4**2)),
    (2, 8.0, 0.2 / (1 - 0.8**2)),
]
"""Cores of 5 tasks/s, tasks/s, and the mean response, s.

That is 1 / (mu - lambda) of one core, and 1 / (mu (1 - rho^2)) of two.
"""


@pytest.mark.parametrize(("cores", "rate", "response"), STEADY)
def test_every_task_takes_its_upload_and_the_mean_response(put, cores, rate, response):
    options = {
        "num_cores": cores,
        "arrival_rate": rate,
        "deadline": 5.0,
        "queue": "erlang",
        **EQUAL,
    }
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], **options)
    for t in range(10):
        step = fly(aviary, STAY)
        work = cores * CORE * rate / (5 * cores) if t > 0 else 0.0
        assert step.info["power"] == pytest.approx(hover_power() + work)
    assert step.info["latency"] == pytest.approx(
        1e6 / shannon(friis(48.5) / NOISE) + response, rel=1e-12
    )
    assert aviary.scene.memory["utilisation"] == pytest.approx(rate / (5 * cores))
    assert aviary.scene.memory["finished"] == aviary.scene.memory["generated"]


@pytest.mark.parametrize(("cores", "rate", "response"), STEADY)
def test_the_mean_queue_is_of_those_who_wait_or_are_computed(put, cores, rate, response):
    """Rate times response (Little's law), as the task's memory has it."""
    options = {
        "num_cores": cores,
        "arrival_rate": rate,
        "deadline": 5.0,
        "queue": "erlang",
        **EQUAL,
    }
    aviary = put("mec", OPEN, [(0, 0, 50)], [(0, 0, 1.5)], observation=("server",), **options)
    assert fly(aviary, STAY).observations[0, 0, 1] == pytest.approx(rate * response, rel=1e-6)


@pytest.mark.parametrize("normalise", [False, True])
@pytest.mark.parametrize("rate", [5.0, 50.0])
def test_a_queue_without_end_completes_nothing(put, rate, normalise):
    """At 5 tasks/s one core is at its limit; the second drone serves nobody."""
    options = {
        "num_cores": 1,
        "arrival_rate": rate,
        "queue": "erlang",
        "normalise": normalise,
        **EQUAL,
    }
    aviary = put("mec", OPEN, [(0, 0, 50), (-90, -90, 100)], [(0, 0, 1.5)], **options)
    low = -1 if normalise else 0
    for t in range(4):
        step = fly(aviary, STAY)
        assert np.isfinite(step.observations).all()
        assert np.isfinite(step.rewards).all()
        np.testing.assert_array_equal(
            step.observations[0, :, -4:], [(1, 1 if normalise else 100, 1, low), (low,) * 4]
        )
        assert step.info["reward/tasks"].tolist() == [[0, 0]]
        assert step.info["reward/latency"].tolist() == [[0, 0]]
        np.testing.assert_allclose(
            step.info["power"][0], (hover_power() + (t > 0) * CORE, hover_power())
        )
    assert (step.info["completed"] == 0).all()
    assert (step.info["latency"] == 1).all()


def test_the_load_of_the_mean_response_is_that_of_the_drones_own_users(put):
    """Two users here, one there, of 2 tasks/s each."""
    users = [(-50, 1, 1.5), (-50, -1, 1.5), (50, 0, 1.5)]
    options = {"num_cores": 1, "arrival_rate": 2.0, "deadline": 5.0, "queue": "erlang", **EQUAL}
    aviary = put("mec", OPEN, [(-50, 0, 50), (50, 0, 50)], users, **options)
    fly(aviary, STAY)
    np.testing.assert_allclose(aviary.scene.memory["utilisation"][0], (0.8, 0.4))
    assert (aviary.scene.memory["latency"][0] > (1, 1 / 3)).all()
    # The tolerance is for the upload.
    np.testing.assert_allclose(aviary.scene.memory["latency"][0], (1, 1 / 3), atol=0.15)
