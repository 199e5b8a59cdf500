"""Compiled code draws what NumPy's generators draw, and leaves them where NumPy would."""

import numpy as np
import pytest

import bulletuav
from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.rotation import exp_map
from bulletuav.tasks.hover import Hover
from bulletuav.tasks.parts.draws import draw_integer, draw_uniform, get_random_source
from bulletuav.tasks.parts.headings import draw_velocities, unit_directions


@kernel
def fill(source, low, high, out):
    for k in range(out.shape[0]):
        out[k] = draw_uniform(source, low, high)


@pytest.mark.parametrize("bits", [np.random.PCG64, np.random.Philox, np.random.MT19937])
def test_uniform_numbers_are_those_of_numpy(bits):
    ours, theirs = (np.random.Generator(bits(7)) for _ in range(2))
    drawn = np.empty(50)
    fill(get_random_source(ours), -2.5, 4.0, drawn)
    np.testing.assert_array_equal(drawn, theirs.uniform(-2.5, 4.0, 50))
    assert ours.random() == theirs.random()


@kernel
def fill_integers(source, count, out):
    for k in range(out.shape[0]):
        out[k] = draw_integer(source, count)


@pytest.mark.parametrize("count", [1, 2, 7, 1000, 2**31 - 1, 2**31])
@pytest.mark.parametrize("bits", [np.random.PCG64, np.random.Philox, np.random.MT19937])
def test_integers_are_those_of_numpy(bits, count):
    ours, theirs = (np.random.Generator(bits(7)) for _ in range(2))
    drawn = np.empty(50, dtype=np.int64)
    fill_integers(get_random_source(ours), count, drawn)
    np.testing.assert_array_equal(drawn, theirs.integers(count, size=50))
    assert ours.integers(10) == theirs.integers(10)
    assert ours.random() == theirs.random()


@kernel
def fill_mixed(source, out):
    for k in range(out.shape[0]):
        out[k] = draw_integer(source, 5) + draw_uniform(source, 0.0, 1.0)


def test_integers_and_uniform_numbers_take_turns_as_in_numpy():
    ours, theirs = (np.random.default_rng(3) for _ in range(2))
    drawn = np.empty(9)
    fill_mixed(get_random_source(ours), drawn)
    assert drawn.tolist() == [theirs.integers(5) + theirs.uniform() for _ in range(9)]


def test_directions_have_length_one_and_point_east_where_there_is_no_way():
    given = np.array([(3.0, 0.0, 4.0), (0.0, 0.0, 0.0), (0.0, -2.0, 0.0)])
    np.testing.assert_array_equal(
        unit_directions(given), [(0.6, 0.0, 0.8), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)]
    )


def test_velocities_are_drawn_along_ways_with_speeds_of_numpy():
    ours, theirs = (np.random.default_rng(7) for _ in range(2))
    ways = np.array([(3.0, 0.0, 4.0), (0.0, 0.0, 0.0), (1.0, -2.0, 0.5)])
    velocity = np.empty(ways.shape)
    draw_velocities(get_random_source(ours), 2.0, 5.0, ways, velocity)
    speed = theirs.uniform(2.0, 5.0, (3, 1))
    np.testing.assert_array_equal(velocity, unit_directions(ways) * speed)
    assert ours.random() == theirs.random()


def by_numpy(hover, rng):
    """Draw a start of `hover` by NumPy's own distributions."""
    config, shape = hover.config, hover.target.shape
    offset = rng.uniform(-config.start_offset, config.start_offset, shape)
    axis = rng.normal(size=shape)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = np.radians(config.start_tilt) * rng.uniform(0, 1, (len(axis), 1)) * axis
    scales = (config.start_speed, config.start_rates)
    motion = [rng.uniform(-1, 1, shape) / np.sqrt(3) * scale for scale in scales]
    quaternion = np.array([exp_map(one) for one in turn])
    return hover.target + offset, hover.target, motion[0], quaternion, motion[1]


@pytest.mark.parametrize("difficulty", ["easy", "extreme"])
@pytest.mark.parametrize("drones", [1, 5])
def test_starts_of_worlds_that_are_drawn_together_are_those_of_numpy(difficulty, drones):
    options = {"num_drones": drones, "difficulty": difficulty}
    hover = bulletuav.Aviary("hover", 3, **options).task
    ours, theirs = ([np.random.default_rng(k) for k in range(3)] for _ in range(2))
    for spawn, rng in zip(hover.spawn_many(ours), theirs, strict=True):
        for got, expected in zip(spawn[:5], by_numpy(hover, rng), strict=True):
            np.testing.assert_array_equal(got, expected)
    assert [rng.random() for rng in ours] == [rng.random() for rng in theirs]


class Moving(Hover):
    """Starts that move."""

    name = "moving"

    def spawn(self, rng):
        return super().spawn(rng)._replace(velocity=np.full(self.target.shape, 0.25))


def test_a_task_with_starts_of_its_own_gives_them_for_many_worlds_too():
    task = bulletuav.Aviary(Moving, 2).task
    for spawn in task.spawn_many([np.random.default_rng(k) for k in range(2)]):
        assert (spawn.velocity == 0.25).all()
