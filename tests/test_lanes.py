"""Numbers of several drones as one, against floats one by one."""

import contextlib
import itertools
import math

import numpy as np
import pytest

from bulletuav.compiled.dispatcher import plain_kernels
from bulletuav.compiled.functions import exp, moderate_exp, two_to
from bulletuav.compiled.gather import gathered
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.lanes import WIDTH, is_any, lanes_of, lanes_row, where
from bulletuav.vehicle.parameters import PARAMETERS

EDGES = (0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 5e-324, -2e-308, 1e308, 1 / 3)
NUMBERS = 21


@pytest.fixture(params=["compiled", "plain"], autouse=True)
def mode(request):
    with plain_kernels() if request.param == "plain" else contextlib.nullcontext():
        yield


@func
def formulas(a, b, out):
    """Each operation, of floats or of lanes."""
    out[0] = a + b
    out[1] = a - b
    out[2] = a * b
    out[3] = a / b
    out[4] = -a
    out[5] = abs(a)
    out[6] = math.sqrt(abs(a))
    out[7] = max(a, b)
    out[8] = min(a, b)
    out[9] = where(a > b, a, b)
    out[10] = where(a < b, a, 7.0)
    out[11] = where(a >= b, 1, b)
    out[12] = where(a <= b, a, b)
    out[13] = where(a == b, 1.0, 2.0)
    out[14] = where(a != b, 1.0, 2.0)
    total = 0.0
    for _ in range(3):
        total += a
    total *= b
    total -= 1
    total /= 3.0
    out[15] = total
    out[16] = min(max(1 - 2 * a, 0.0), 1.0)
    out[17] = max(0.0, b)
    out[18] = 1.0 / (1 + b)
    out[19] = math.sqrt(a) if is_any(a > math.inf) else a
    out[20] = 0.0 + math.floor(where(abs(a) < 1e9, a, 0.5))


@kernel
def of_floats(given, out):
    for i in range(given.shape[1]):
        formulas(given[0, i, 0], given[0, i, 1], out[i])


@kernel
def of_lanes(given, out):
    for b in range(out.shape[0]):
        first = b * WIDTH
        formulas(gathered(given, first, 0), gathered(given, first, 1), lanes_of(out, b))


def test_lanes_have_the_bits_of_floats():
    pairs = np.array(list(itertools.product(EDGES, EDGES)))
    more = (
        np.random.default_rng(0).normal(size=(200, 2))
        * np.exp(np.linspace(-300, 300, 200))[:, None]
    )
    given = np.concatenate([pairs, more])[None]
    count = given.shape[1]
    one, many = np.zeros((count, NUMBERS)), np.zeros((-(-count // WIDTH), NUMBERS, WIDTH))
    of_floats(given, one)
    of_lanes(given, many)
    together = many.transpose(0, 2, 1).reshape(-1, NUMBERS)
    for name in range(NUMBERS):
        got, expected = together[:count, name], one[:, name]
        nan = np.isnan(expected)
        np.testing.assert_array_equal(np.isnan(got), nan)
        assert got[~nan].tobytes() == expected[~nan].tobytes(), name
    # Lanes that lack stand for the last one
    np.testing.assert_array_equal(
        together[count:], np.tile(together[count - 1], (len(together) - count, 1))
    )


@kernel
def powers(given, out):
    for b in range(out.shape[0]):
        x, lanes = gathered(given, b * WIDTH, 0), lanes_of(out, b)
        lanes[0] = moderate_exp(x)
        lanes[1] = two_to(math.floor(x))


def test_powers_of_lanes_have_the_bits_of_floats():
    """`exp`, and powers of two, which are exact."""
    rng = np.random.default_rng(2)
    few = np.concatenate([rng.uniform(-700, 700, 4000), rng.uniform(-2, 2, 3990), np.arange(10.0)])
    out = np.zeros((few.size // WIDTH, 2, WIDTH))
    powers(few[None], out)
    assert out[:, 0].ravel().tobytes() == exp(few).tobytes()
    np.testing.assert_array_equal(out[:, 1].ravel(), np.ldexp(1.0, np.floor(few).astype(int)))


@kernel
def of_rows(rows, packed, out):
    row = lanes_row(rows, packed, 1)
    lanes = lanes_of(out, 0)
    for r in range(row.num_rotors):
        lanes[r] = row.rotor_y[r] * row.mass


@kernel
def of_pairs(given, out):
    lanes, numbers = lanes_of(out, 0), gathered(given, 3, 0)
    lanes[0] = numbers
    lanes[1] = where(is_any(numbers > 2.0), numbers, 0.0)


def test_rows_of_lanes_have_the_fields_of_rows():
    rng = np.random.default_rng(1)
    rows = np.zeros((2, WIDTH), dtype=PARAMETERS)
    rows["num_rotors"] = 6
    rows["mass"], rows["rotor_y"] = rng.normal(size=(2, WIDTH)), rng.normal(size=(2, WIDTH, 8))
    packed = rows.view(float).reshape(2, WIDTH, -1).transpose(0, 2, 1).copy()
    out = np.zeros((8, WIDTH))
    of_rows(rows, packed, out)
    np.testing.assert_array_equal(out[:6], (rows["rotor_y"] * rows["mass"][..., None])[1, :, :6].T)
    assert not out[6:].any()


@pytest.mark.parametrize("shape", [(5, 4), (5, 4, 1), (20, 1)])
def test_drones_are_counted_on_from_world_to_world(shape):
    given, out = np.arange(20.0).reshape(shape), np.zeros((2, WIDTH))
    of_pairs(given, out)
    np.testing.assert_array_equal(out, np.tile(np.arange(3.0, 3.0 + WIDTH), (2, 1)))


def test_arrays_in_other_orders_are_refused():
    with pytest.raises(Exception, match="gathered"):
        of_pairs(np.zeros((5, 4, 3)).transpose(1, 0, 2), np.zeros((2, WIDTH)))
