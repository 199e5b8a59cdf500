"""Functions that give the same bits everywhere, against those of many digits."""

import math

import mpmath
import numpy as np
import pytest

from bulletuav.compiled import functions
from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.lanes import WIDTH, lane_zeros, lanes_of

mpmath.mp.prec = 200
RNG = np.random.default_rng(0)
SMALL = np.exp(RNG.uniform(-40, 0, 500)) * RNG.choice([-1, 1], 500)
CASES = {
    "exp": (np.concatenate([RNG.uniform(-708, 709, 2000), RNG.uniform(-2, 2, 2000), SMALL]), 1.0),
    "expm1": (np.concatenate([RNG.uniform(-40, 700, 2000), RNG.uniform(-1, 1, 2000), SMALL]), 4.0),
    "log": (np.concatenate([np.exp(RNG.uniform(-700, 700, 2000)), RNG.uniform(0, 3, 2000)]), 1.0),
    "log10": (np.concatenate([np.exp(RNG.uniform(-700, 700, 2000)), RNG.uniform(0, 3, 2000)]), 4.0),
    "log1p": (np.concatenate([RNG.uniform(-0.999, 3, 2000), SMALL, abs(SMALL) * 1e17]), 4.0),
    "tan": (np.concatenate([RNG.uniform(-1.5, 1.5, 2000), SMALL]), 4.0),
    "atan": (np.concatenate([RNG.uniform(-3, 3, 2000), 1 / SMALL, SMALL]), 4.0),
    "acos": (RNG.uniform(-1, 1, 2000), 4.0),
    "tanh": (np.concatenate([RNG.uniform(-25, 25, 2000), SMALL]), 4.0),
}


def errors(got, exact):
    """Errors in units in the last place."""
    places = zip(got, exact, strict=True)
    return [abs(float((mpmath.mpf(float(g)) - e) / np.spacing(abs(float(e))))) for g, e in places]


@pytest.mark.parametrize("name", CASES)
def test_the_error_is_below_units_in_the_last_place(name):
    given, most = CASES[name]
    got = getattr(functions, name)(given)
    exact = [getattr(mpmath, name)(mpmath.mpf(float(x))) for x in given]
    assert max(errors(got, exact)) < most


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sine_and_cosine_are_good_to_a_unit_up_to_a_turn_and_absolutely_beyond(name):
    near, far = RNG.uniform(-6, 6, 3000), RNG.uniform(-1e5, 1e5, 3000)
    function, exact = getattr(functions, name), getattr(mpmath, name)
    truth = np.array([float(exact(mpmath.mpf(float(x)))) for x in np.concatenate([near, far])])
    error = abs(function(np.concatenate([near, far])) - truth)
    assert error.max() < 2.5e-16
    assert abs(function(np.array([1e6, 1e9, 1e15, 1e300, -1e18]))).max() <= 1.0
    assert abs(function(1e6) - float(exact(mpmath.mpf(10**6)))) < 1e-10
    inside = near[abs(near) < 0.78]
    assert max(errors(function(inside), [exact(mpmath.mpf(float(x))) for x in inside])) < 1.0
    assert max(abs(functions.sin(far) ** 2 + functions.cos(far) ** 2 - 1)) < 5e-16


def test_angles_of_points_in_all_quarters():
    y, x = RNG.normal(size=(2, 3000))
    exact = [
        mpmath.atan2(mpmath.mpf(float(a)), mpmath.mpf(float(b))) for a, b in zip(y, x, strict=True)
    ]
    assert max(errors(functions.atan2(y, x), exact)) < 4.0


@pytest.mark.parametrize(
    ("y", "x"), [(a, b) for a in (0.0, -0.0, 1.0, -2.0) for b in (0.0, -0.0, 3.0, -1.0)]
)
def test_angles_on_the_axes_are_those_of_ieee(y, x):
    got, expected = functions.atan2(y, x), math.atan2(y, x)
    assert got == pytest.approx(expected, abs=1e-15)
    assert math.copysign(1, got) == math.copysign(1, expected)


def test_angles_of_points_near_an_axis_do_not_overflow():
    assert functions.atan2(4.0, 2.2e-308) == math.pi / 2
    assert functions.atan2(2.2e-308, -4.0) == math.pi
    assert functions.atan2(1e308, 1e308) == math.pi / 4


def test_powers():
    x, y = np.exp(RNG.uniform(-20, 20, 3000)), RNG.uniform(-5, 5, 3000)
    got = functions.power(x, y)
    for one, a, b in zip(got, x, y, strict=True):
        exact = mpmath.mpf(float(a)) ** mpmath.mpf(float(b))
        assert abs(one / exact - 1) < 1e-15 * (1 + abs(b * math.log(a)))
    assert functions.power(0.0, 2.0) == 0.0
    assert functions.power(0.0, -2.0) == math.inf
    assert functions.power(0.0, 0.0) == 1.0


ENDS = [
    ("exp", 0.0, 1.0),
    ("exp", math.inf, math.inf),
    ("exp", -math.inf, 0.0),
    ("exp", 710.0, math.inf),
    ("exp", -746.0, 0.0),
    ("exp", -745.0, 5e-324),
    ("expm1", 0.0, 0.0),
    ("expm1", -math.inf, -1.0),
    ("expm1", math.inf, math.inf),
    ("log", 1.0, 0.0),
    ("log", 0.0, -math.inf),
    ("log", math.inf, math.inf),
    ("log", 5e-324, math.log(5e-324)),
    ("log10", 1.0, 0.0),
    ("log1p", -1.0, -math.inf),
    ("log1p", 0.0, 0.0),
    ("log1p", math.inf, math.inf),
    ("sin", 0.0, 0.0),
    ("cos", 0.0, 1.0),
    ("atan", math.inf, math.pi / 2),
    ("atan", -math.inf, -math.pi / 2),
    ("acos", 1.0, 0.0),
    ("acos", -1.0, math.pi),
    ("tanh", math.inf, 1.0),
    ("tanh", -math.inf, -1.0),
]


@pytest.mark.parametrize(("name", "x", "expected"), ENDS)
def test_values_at_the_ends(name, x, expected):
    assert getattr(functions, name)(x) == expected


NAMES = (*CASES, "sin", "cos")


@pytest.mark.parametrize("name", NAMES)
def test_nan_stays_nan(name):
    assert math.isnan(getattr(functions, name)(math.nan))


@pytest.mark.parametrize(("name", "x"), [("log", -1.0), ("sin", math.inf), ("cos", -math.inf)])
def test_there_is_no_value_outside_the_domain(name, x):
    assert math.isnan(getattr(functions, name)(x))


def test_symmetries_hold_to_the_bit():
    x = RNG.uniform(-50, 50, 1000)
    np.testing.assert_array_equal(functions.sin(-x), -functions.sin(x))
    np.testing.assert_array_equal(functions.cos(-x), functions.cos(x))
    np.testing.assert_array_equal(functions.atan(-x), -functions.atan(x))


@kernel
def fill(given, out):
    for k in range(out.shape[0]):
        out[k] = functions.exp(given[k]) + functions.atan2(given[k], 2.0)


def test_compiled_code_gets_the_bits_of_arrays():
    given, out = RNG.uniform(-5, 5, 100), np.zeros(100)
    fill(given, out)
    np.testing.assert_array_equal(out, functions.exp(given) + functions.atan2(given, 2.0))


def test_the_length_of_a_vector():
    assert functions.hypot(3.0, -4.0) == 5.0


def test_fma_rounds_once():
    """(1 + h) (1 - h) - 1 = -h^2 exactly, which products lose: 1 - 2^-60 rounds to 1."""
    h = 2.0**-30

    @kernel
    def compiled(x, y, z):
        return functions.fma(x, y, z)

    @kernel
    def in_lanes(given, result):
        numbers, results = lanes_of(given, 0), lanes_of(result, 0)
        results[0] = functions.fma(numbers[0], numbers[1], numbers[2])
        results[1] = functions.fma(numbers[0], 0.1, numbers[2])

    assert (1 + h) * (1 - h) - 1 == 0.0
    assert functions.fma(1 + h, 1 - h, -1.0) == compiled(1 + h, 1 - h, -1.0) == -(h**2)
    cases = RNG.normal(size=(200, 3)) * 2.0 ** RNG.integers(-40, 40, (200, 3))
    special = (0.0, -0.0, 1.0, -1.0, 1e308, -1e308, 5e-324, math.inf, -math.inf, math.nan)
    corners = [(x, y, z) for x in special for y in special for z in special]
    for x, y, z in [*cases.tolist(), *corners]:
        got, expected = compiled(x, y, z), functions.fma(x, y, z)
        assert got == expected or (math.isnan(got) and math.isnan(expected)), (x, y, z)
        assert math.copysign(1, got) == math.copysign(1, expected) or math.isnan(got), (x, y, z)
    for x, y, z in cases.tolist():
        exact = mpmath.mpf(x) * mpmath.mpf(y) + mpmath.mpf(z)
        assert functions.fma(x, y, z) == float(exact)
    given, result = lane_zeros(1, 3), lane_zeros(1, 2)
    given[0] = cases[:WIDTH].T
    in_lanes(given, result)
    assert result[0, 0].tolist() == [functions.fma(*one) for one in cases[:WIDTH].tolist()]
    assert result[0, 1].tolist() == [functions.fma(x, 0.1, z) for x, _, z in cases[:WIDTH].tolist()]
