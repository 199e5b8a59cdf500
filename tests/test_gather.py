"""Arrays of drones to lanes and back."""

import contextlib

import numpy as np
import pytest

from bulletuav.compiled.dispatcher import plain_kernels
from bulletuav.compiled.gather import (
    gathered,
    gathered_at,
    lane_numbers,
    pack_numbers,
    scatter,
)
from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.lanes import WIDTH, where


@pytest.fixture(params=["compiled", "plain"], autouse=True)
def mode(request):
    with plain_kernels() if request.param == "plain" else contextlib.nullcontext():
        yield


@kernel
def of_those_who_fly(flies, given, count, out):
    for first in range(0, given.size, WIDTH):
        chosen = where(gathered(flies, first, 0), gathered(given, first, 0), -1.0)
        scatter(out, first, min(count, given.size - first), chosen + lane_numbers())


@pytest.mark.parametrize("kind", [float, int])
@pytest.mark.parametrize("count", [WIDTH, 3, 0])
def test_bools_choose_and_as_many_are_written_as_asked(kind, count):
    rng = np.random.default_rng(0)
    given, flies = np.arange(21.0).reshape(3, 7), rng.random((3, 7)) < 0.5
    out = np.full((3, 7), -9, dtype=kind)
    of_those_who_fly(flies, given, count, out)
    lane = np.arange(21).reshape(3, 7) % WIDTH
    np.testing.assert_array_equal(
        out, np.where(lane < count, np.where(flies, given, -1) + lane, -9)
    )


def test_whole_numbers_are_cut():
    out = np.zeros((1, WIDTH), dtype=int)
    flies = np.ones(out.shape, dtype=bool)
    of_those_who_fly(flies, np.full(out.shape, 1.75), WIDTH, out)
    np.testing.assert_array_equal(out[0], 1 + np.arange(WIDTH))


def test_the_last_drone_stands_for_those_that_lack():
    given, packed = np.arange(30.0).reshape(2, 5, 3), np.zeros((2, 3, WIDTH))
    pack_numbers(given, packed)
    order = np.minimum(np.arange(2 * WIDTH), 9).reshape(2, WIDTH)
    np.testing.assert_array_equal(packed, given.reshape(10, 3)[order].transpose(0, 2, 1))


@kernel
def of_places(given, places, row, offset, out):
    scatter(out, 0, WIDTH, gathered_at(given, places, row, offset))


def test_numbers_from_any_places():
    rng = np.random.default_rng(0)
    given, out = rng.normal(size=(3, 4, 5)), np.zeros((1, WIDTH))
    places = rng.integers(0, 57, (2, WIDTH))
    of_places(given, places, 1, 3, out)
    np.testing.assert_array_equal(out[0], given.reshape(-1)[places[1] + 3])
