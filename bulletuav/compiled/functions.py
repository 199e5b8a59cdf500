"""Elementary functions with the same bits on any processor and with any C library.

The functions of C libraries and of NumPy differ in the last bit between processors. These functions
use only sums, products, quotients and square roots, which IEEE 754 rounds correctly. Errors are
below four units in the last place, and below one for `exp` and `log`. The functions take numbers in
compiled code, and also arrays in Python. `fma`, which IEEE 754 rounds correctly, too, is for
numbers and lanes.

Methods: argument reduction by W. J. Cody and W. Waite, Software Manual for the Elementary Functions
(1980), and Taylor series of the reduced argument.
"""

import math
from fractions import Fraction
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from bulletuav.compiled.kernel import elementwise, func
from bulletuav.compiled.lanes import LANES, VECTOR, WIDTH
from bulletuav.compiled.plain import LaneNumbers, in_python

PI = math.pi
LN2 = 0.6931471805599453
LN2_HIGH = 0.693147180369123816490  # of 33 bits: whole multiples are exact
LN2_LOW = 1.90821492927058770002e-10
HALF_PI_HIGH = 1.57079632673412561417  # of 33 bits
HALF_PI_MIDDLE = 6.07710050630396597660e-11  # the next 33
HALF_PI_LOW = 2.02226624879595063154e-21
HALF_PI_REST = 6.123233995736766e-17  # what pi / 2 is beyond its number
LOG10_E = 0.4342944819032518
LARGEST, SMALLEST = 709.782712893384, -745.1332191019412
"""Arguments beyond which `exp` is infinite and 0"""
SQRT_HALF = math.sqrt(0.5)
FAR = 1e5
"""Largest angle whose reduction by multiples of pi / 2 is exact, rad"""


def _ldexp(exponent: Any) -> Any:
    """Python version of `two_to`."""
    return np.ldexp(exponent * 0.0 + 1.0, np.asarray(exponent).astype(np.int32))


@in_python(_ldexp)
@intrinsic  # type: ignore[untyped-decorator]
def two_to(_: Any, exponent: Any) -> Any:
    """Return 2 to the power of an integer from -1022 to 1023, assembled from its bits.

    Lanes are supported, too; their integers are floats. `math.ldexp` would call the C library,
    which takes longer than all of `exp`.
    """

    def generate(_: Any, builder: Any, __: Any, values: Any) -> Any:
        if exponent != LANES:
            biased = builder.add(values[0], ir.IntType(64)(1023))
            return builder.bitcast(builder.shl(biased, ir.IntType(64)(52)), ir.DoubleType())
        words = ir.VectorType(ir.IntType(64), WIDTH)
        biased = builder.add(builder.fptosi(values[0], words), words([1023] * WIDTH))
        return builder.bitcast(builder.shl(biased, words([52] * WIDTH)), values[0].type)

    return (LANES(LANES) if exponent == LANES else types.float64(types.int64)), generate


def _fma_of_numbers(x: float, y: float, z: float) -> np.float64:
    """Return x y + z of numbers, rounded once: `math.fma` needs Python 3.13."""
    if math.isfinite(x) and math.isfinite(y):
        if not math.isfinite(z):
            return np.float64(z)
        exact = Fraction(float(x)) * Fraction(float(y)) + Fraction(float(z))
        try:
            if exact != 0:
                return np.float64(float(exact))
        except OverflowError:
            return np.float64(math.inf if exact > 0 else -math.inf)
    # Infinite and NaN factors, and the sign of 0
    with np.errstate(all="ignore"):
        return np.float64(x) * np.float64(y) + np.float64(z)


def _fma(x: Any, y: Any, z: Any) -> Any:
    """Python version of `fma`."""
    if any(isinstance(one, np.ndarray) for one in (x, y, z)):
        return np.vectorize(_fma_of_numbers, otypes=[np.float64])(x, y, z).view(LaneNumbers)
    return _fma_of_numbers(x, y, z)


@in_python(_fma)
@intrinsic  # type: ignore[untyped-decorator]
def fma(_: Any, x: Any, y: Any, z: Any) -> Any:
    """Return x y + z with a single rounding (fused multiply-add), for floats or in each lane.

    Processors from `x86-64-v3` on compute it as fast as a product. Those below have no instruction
    for it, and take many times longer. The compiler never fuses a product and a sum on its own.
    """
    kind = LANES if LANES in (x, y, z) else types.float64
    name, value = (f"v{WIDTH}f64", VECTOR) if kind == LANES else ("f64", ir.DoubleType())

    def generate(context: Any, builder: Any, given: Any, values: Any) -> Any:
        numbers = [
            context.cast(builder, one, part, kind)
            for one, part in zip(values, given.args, strict=True)
        ]
        fused = ir.FunctionType(value, [value] * 3)
        function = cgutils.get_or_insert_function(builder.module, fused, f"llvm.fma.{name}")
        return builder.call(function, numbers)

    return kind(x, y, z), generate


@elementwise
def exp(x: float) -> float:
    """Return e to the power of x."""
    if x != x:
        return x
    if x > LARGEST:
        return math.inf
    if x < SMALLEST:
        return 0.0
    return moderate_exp(x)


@func
def moderate_exp(x: float) -> float:
    """Return e to the power of x, for x from -700 to 700, for a number or in each lane."""
    # x = k ln 2 + r, with |r| below 0.35
    k = math.floor(x / LN2 + 0.5)
    high = x - k * LN2_HIGH
    low = k * LN2_LOW
    r = high - low
    # What the difference lost
    rest = (high - r) - low
    # Taylor series of exp(r) - 1 - r, over r^2
    series = 1.0 / 6227020800.0
    for n in (479001600.0, 39916800.0, 3628800.0, 362880.0, 40320.0, 5040.0, 720.0, 120.0):
        series = series * r + 1.0 / n
    series = ((series * r + 1.0 / 24.0) * r + 1.0 / 6.0) * r + 0.5
    value = 1.0 + (r + (rest + r * r * series))
    # In two steps, so that results below 1e-308 are rounded once
    half = math.floor(0.5 * k)
    scaled: float = value * two_to(half) * two_to(k - half)
    return scaled


@elementwise
def expm1(x: float) -> float:
    """Return e to the power of x, less 1, without cancellation near 0."""
    if not abs(x) < 0.5:
        return exp(x) - 1.0
    # Taylor series of (exp(x) - 1) / x - 1 - x / 2, over x^2
    series = 0.0
    for n in range(17, 2, -1):
        series = (series * x + 1.0) / n
    return x + x * x * (0.5 + 0.5 * x * series)


@elementwise
def log(x: float) -> float:
    """Return the natural logarithm."""
    if x == 0.0:
        return -math.inf
    if not 0.0 < x < math.inf:
        return x if x > 0.0 else math.nan
    # x = m 2^e, with m from sqrt(1/2) to sqrt(2)
    m, e = math.frexp(x)
    if m < SQRT_HALF:
        m *= 2.0
        e -= 1
    # log m = 2 artanh s = 2 s + 2 s^3 / 3 + ...; f = m - 1 is exact, and 2 s = f - s f
    f = m - 1.0
    s = f / (2.0 + f)
    square = s * s
    series = 0.0
    for n in (23.0, 21.0, 19.0, 17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0):
        series = series * square + 2.0 / n
    series *= square
    # 2 s + s series = f - f^2 / 2 + s (f^2 / 2 + series), the largest first
    half = 0.5 * f * f
    small = s * (half + series) + e * LN2_LOW
    return e * LN2_HIGH - ((half - small) - f)


@elementwise
def log10(x: float) -> float:
    """Return the logarithm to base 10."""
    return log(x) * LOG10_E


@elementwise
def log1p(x: float) -> float:
    """Return the natural logarithm of 1 + x, without cancellation near 0."""
    u = 1.0 + x
    if u == 1.0:
        return x
    if not u < math.inf:
        return log(u)
    # The logarithm of what 1 + x was rounded to, put right (W. Kahan)
    return log(u) * (x / (u - 1.0))


@elementwise
def power(x: float, y: float) -> float:
    """Return x to the power of y, for x of at least 0.

    The relative error is below 1e-15 times 1 + |y log x|.
    """
    if y == 0.0:
        return 1.0
    if x == 0.0:
        return 0.0 if y > 0.0 else math.inf
    return exp(y * log(x))


@func
def _sine(r: float) -> float:
    """Return the sine of an angle of at most pi / 4."""
    square = r * r
    series = 0.0
    for n in (272.0, 210.0, 156.0, 110.0, 72.0, 42.0, 20.0, 6.0):
        series = square / n * (1.0 - series)
    return r - r * series


@func
def _cosine(r: float) -> float:
    """Return the cosine of an angle of at most pi / 4."""
    square = r * r
    series = 0.0
    for n in (240.0, 182.0, 132.0, 90.0, 56.0, 30.0, 12.0):
        series = square / n * (1.0 - series)
    half = 0.5 * square
    # 1 - half loses what comes back in the bracket
    near = 1.0 - half
    return near + ((1.0 - near - half) + half * series)


@func
def _turned(x: float, quarters: int) -> float:
    """Return the sine of x + `quarters` pi / 2."""
    # Reduce large angles by the remainder; then subtract the nearest multiple of pi / 2
    near = math.copysign(abs(x) % (2.0 * PI), x) if abs(x) > FAR else x
    k = math.floor(near / (0.5 * PI) + 0.5)
    # Subtracted in three parts, so that no bits are lost
    r = ((near - k * HALF_PI_HIGH) - k * HALF_PI_MIDDLE) - k * HALF_PI_LOW
    # Each quarter is a sine or cosine, with one sign or the other
    quarter = (k + quarters) % 4
    value = _cosine(r) if quarter % 2 else _sine(r)
    return -value if quarter > 1 else value


@elementwise
def sin(x: float) -> float:
    """Return the sine; the error is below 1e-15 for angles up to 1e5, and grows beyond."""
    if not abs(x) < math.inf:
        return math.nan
    return _turned(x, 0)


@elementwise
def cos(x: float) -> float:
    """Return the cosine; the error is below 1e-15 for angles up to 1e5, and grows beyond."""
    if not abs(x) < math.inf:
        return math.nan
    return _turned(x, 1)


@elementwise
def tan(x: float) -> float:
    """Return the tangent."""
    return sin(x) / cos(x)


@elementwise
def atan(x: float) -> float:
    """Return the angle from -pi / 2 to pi / 2 whose tangent is x."""
    if x != x:
        return x
    size = abs(x)
    # One division that never is by 0: compiled code may divide before it knows whether it has to
    t = min(size, 1.0) / max(size, 1.0)
    # atan t = atan c + atan u, with c the nearest of 0, 1/4, 1/2, 3/4, 1
    k = math.floor(4.0 * t + 0.5)
    c = 0.25 * k
    u = (t - c) / (1.0 + t * c)
    known = 0.0
    if k == 1:
        known = 0.24497866312686414
    elif k == 2:
        known = 0.4636476090008061
    elif k == 3:
        known = 0.6435011087932844
    elif k == 4:
        known = 0.25 * PI
    # The series of atan u, from its smallest term
    square = u * u
    series = 0.0
    for n in (19.0, 17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0):
        series = square * (1.0 / n - series)
    angle = known + (u - u * series)
    # Beyond 1 it is the rest of a right angle
    if size > 1.0:
        angle = (HALF_PI_REST - angle) + 0.5 * PI
    return math.copysign(angle, x)


@elementwise
def atan2(y: float, x: float) -> float:
    """Return the angle of the point (x, y), from -pi to pi; 0 of the origin, with the sign of y."""
    if x == 0.0:
        if y == 0.0:
            return math.copysign(0.0 if math.copysign(1.0, x) > 0.0 else PI, y)
        return math.copysign(0.5 * PI, y)
    # Of the quotient that cannot overflow
    wide, high = abs(x), abs(y)
    steep = high > wide
    angle = atan((wide if steep else high) / (high if steep else wide))
    if steep:
        angle = (HALF_PI_REST - angle) + 0.5 * PI
    if x < 0.0:
        angle = PI - angle
    return math.copysign(angle, y)


@elementwise
def acos(x: float) -> float:
    """Return the angle from 0 to pi whose cosine is x."""
    if x != x:
        return x
    return atan2(math.sqrt((1.0 - x) * (1.0 + x)), x)


@elementwise
def tanh(x: float) -> float:
    """Return the hyperbolic tangent."""
    if abs(x) > 20.0:
        return math.copysign(1.0, x)
    grown = expm1(2.0 * x)
    return grown / (grown + 2.0)


@elementwise
def hypot(x: float, y: float) -> float:
    """Return the length of the vector (x, y), for lengths from 1e-150 to 1e150."""
    return math.sqrt(x * x + y * y)
