"""Compiled code draws what NumPy's generators draw, and leaves them where NumPy would."""

import numpy as np
import pytest

from bulletuav.kernel import kernel
from bulletuav.tasks.families.draws import source_of, uniform
from bulletuav.tasks.families.headings import directions, draw_velocities


@kernel
def fill(source, low, high, out):
    for k in range(out.shape[0]):
        out[k] = uniform(source, low, high)


@pytest.mark.parametrize("bits", [np.random.PCG64, np.random.Philox, np.random.MT19937])
def test_uniform_numbers_are_those_of_numpy(bits):
    ours, theirs = (np.random.Generator(bits(7)) for _ in range(2))
    drawn = np.empty(50)
    fill(source_of(ours), -2.5, 4.0, drawn)
    np.testing.assert_array_equal(drawn, theirs.uniform(-2.5, 4.0, 50))
    assert ours.random() == theirs.random()


def test_directions_have_length_one_and_point_east_where_there_is_no_way():
    given = np.array([(3.0, 0.0, 4.0), (0.0, 0.0, 0.0), (0.0, -2.0, 0.0)])
    np.testing.assert_array_equal(
        directions(given), [(0.6, 0.0, 0.8), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)]
    )


def test_velocities_are_drawn_along_ways_with_speeds_of_numpy():
    ours, theirs = (np.random.default_rng(7) for _ in range(2))
    ways = np.array([(3.0, 0.0, 4.0), (0.0, 0.0, 0.0), (1.0, -2.0, 0.5)])
    velocity = np.empty(ways.shape)
    draw_velocities(source_of(ours), 2.0, 5.0, ways, velocity)
    speed = theirs.uniform(2.0, 5.0, (3, 1))
    np.testing.assert_array_equal(velocity, directions(ways) * speed)
    assert ours.random() == theirs.random()
