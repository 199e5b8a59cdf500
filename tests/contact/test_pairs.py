"""Pairs keep their momentum, gain no energy, rebound as they should, and part again."""

import numpy as np
import pytest
from contact.pairs import KINDS, meet_in_pairs


@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_pairs_keep_what_they_must(kind, restitution):
    meetings = meet_in_pairs(kind, restitution=restitution, worlds=30)
    assert not meetings.missed()


@pytest.mark.parametrize("hz", [60, 240, 1000])
@pytest.mark.parametrize("airframes", [("cf2x", "iris"), ("racer", "hummingbird")])
def test_unlike_pairs_keep_what_they_must(airframes, hz):
    meetings = meet_in_pairs("spinning", airframes, hz=hz, worlds=12, speed=(2.0, 20.0))
    assert not meetings.missed()


@pytest.mark.parametrize("restitution", [0.0, 0.25, 1.0])
def test_restitution_is_as_set(restitution):
    meetings = meet_in_pairs("head-on", restitution=restitution, worlds=12)
    np.testing.assert_allclose(meetings.rebound, restitution, atol=1e-8)
