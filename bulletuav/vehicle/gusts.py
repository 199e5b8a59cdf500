"""Gusts: one turbulence field for each world, in which all drones of the world fly.

Intensities and length scales are those of MIL-F-8785C at low altitude (altitude h in feet, clamped
to 10 and 1000), with Dryden spectra. The field is a sum of plane waves with random phases, so that
a gust is a function of position and time.

In isotropic turbulence with the longitudinal correlation f = exp(-r / L) of the gusts at a
separation r, the lateral correlation is g = (1 - r / 2L) exp(-r / L). These are Dryden's, and
E = x^4 / (1 + x^2)^3 is their energy spectrum, with x = k L for the wave number k. Amplitudes
follow this spectrum, with L_u = L_v for horizontal and L_w for vertical gusts. The waves are the
same at all heights and the amplitudes change continuously with height, so the field has no steps.

By Taylor's hypothesis the steady wind carries the field. Each wave also drifts with its own speed,
so that a drone that hovers in still air feels changing gusts. Buildings cast no wind shadows.

References:
    R. H. Kraichnan, Diffusion by a random velocity field, Physics of Fluids 13 (1970).
    G. K. Batchelor, The theory of homogeneous turbulence (1953).
"""

import math

import numpy as np

from bulletuav.compiled.functions import PI, cos, exp, power, sin
from bulletuav.compiled.kernel import func, kernel

FOOT = 0.3048
"""One foot, m"""
DRIFT_SPEED = 1.0
"""Maximum drift speed of a wave along its direction, m/s"""
NUM_WAVES = 64
"""Number of waves in a field; a power of 2"""
MIN_WAVELENGTH = 0.3
"""Minimum wavelength, m: a drone averages shorter waves by its size"""
LOG_WAVELENGTH_STEP = 0.155
"""Logarithm of the ratio of consecutive wavelengths; the longest one is 6.1 km"""
NUM_DRAWS = NUM_WAVES + 4
"""Number of random numbers of a field"""
NUM_WAVE_ROWS = 7
"""Number of values of a wave"""
FREQUENCY, COSINE, SINE, STEEPNESS, FLATNESS, DRIFT, PHASE = range(NUM_WAVE_ROWS)
"""Rows of a wave: waves per metre, negative if left-handed; cosine and sine of the heading;
vertical and horizontal part of the direction; drift along it, m/s; phase at the origin, turns
"""
GOLDEN = 1.2207440846057596
SPREAD = (1.0 / GOLDEN, 1.0 / (GOLDEN * GOLDEN), 1.0 / (GOLDEN * GOLDEN * GOLDEN))
"""Steps of a quasi-random sequence with even coverage of three dimensions: powers of the root of
x^4 = x + 1 (M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018)
"""


@func
def dryden_scales(altitude: float, wind20: float) -> tuple[float, float, float, float]:
    """Return the length scales and intensities of the turbulence by MIL-F-8785C.

    Args:
        altitude: Height above the ground, m.
        wind20: Wind speed at 20 feet, m/s.

    Returns:
        L_u = L_v and L_w, m; s_u = s_v and s_w, m/s.
    """
    h = min(max(altitude / FOOT, 10.0), 1000.0)
    ratio = power(0.177 + 0.000823 * h, 0.4)
    s_w = 0.1 * wind20
    return h / ratio**3 * FOOT, h * FOOT, s_w / ratio, s_w


@func
def _fractional_part(number: float) -> float:
    """Return the fractional part of a number."""
    return number - math.floor(number)


@kernel
def draw_waves(draws: np.ndarray, waves: np.ndarray) -> None:
    """Compute the waves of a turbulence field from random numbers.

    The logarithms of the wavelengths, the directions on the sphere and the drifts are evenly
    distributed. All are shifted by random numbers, so that every wave is equally likely.

    Args:
        draws: (NUM_DRAWS,) random numbers, uniform from 0 to 1.
        waves: (NUM_WAVE_ROWS, NUM_WAVES) waves to write, see `FREQUENCY`.
    """
    for j in range(NUM_WAVES):
        length = MIN_WAVELENGTH * exp(LOG_WAVELENGTH_STEP * (j + draws[0]))
        heading = 2.0 * PI * _fractional_part(draws[1] + j * SPREAD[0])
        steepness = 2.0 * _fractional_part(draws[2] + j * SPREAD[1]) - 1.0
        drift = 2.0 * _fractional_part(draws[3] + j * SPREAD[2]) - 1.0
        # One random number gives the handedness and the phase.
        turn = 2.0 * draws[4 + j]
        waves[FREQUENCY, j] = (1.0 if turn < 1.0 else -1.0) / length
        waves[COSINE, j] = cos(heading)
        waves[SINE, j] = sin(heading)
        waves[STEEPNESS, j] = steepness
        waves[FLATNESS, j] = math.sqrt(1.0 - steepness * steepness)
        waves[DRIFT, j] = DRIFT_SPEED * drift
        waves[PHASE, j] = _fractional_part(turn)


@func
def _sine(turns: float) -> float:
    """Return the sine of at most a quarter turn, with an error below 1e-9.

    A Taylor series without branches and divisions, which the compiler vectorises. It does not
    vectorise `bulletuav.compiled.functions.sin`.
    """
    x = 2.0 * PI * turns
    q = x * x
    series = 1.0 / 362880.0 + q * (-1.0 / 39916800.0 + q * (1.0 / 6227020800.0))
    return x * (1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q * series))))


@func
def _amplitude(x: float) -> float:
    """Return the amplitude of a wave of x radians per length scale, up to a constant factor.

    As the logarithms of x are evenly distributed, the energy of a wave is x E.
    """
    y = 1.0 / (1.0 + x * x)
    return x * x * y * math.sqrt(x * y)


@func
def _gain(length: float) -> float:
    """Return the factor of the amplitudes that makes the variance of a gust 1, for a length scale.

    Amplitudes a give the variance sum a^2 / 3, because directions are random and the mean square of
    a wave is 1 / 2. The integral of E is 3 pi / 16, minus the part beyond the shortest wave.
    """
    beyond = MIN_WAVELENGTH / (2.0 * PI * length)
    return math.sqrt(3.0 * LOG_WAVELENGTH_STEP / (3.0 * PI / 16.0 - beyond))


@func
def _sum_columns(parts: np.ndarray) -> None:
    """Sum the columns of parts (3, NUM_WAVES) into the first one, by pairwise summation."""
    left = parts.shape[1]
    while left > 1:
        left //= 2
        for j in range(left):
            parts[0, j] += parts[0, j + left]
            parts[1, j] += parts[1, j + left]
            parts[2, j] += parts[2, j + left]


@kernel
def add_gusts(
    waves: np.ndarray,
    parts: np.ndarray,
    position: np.ndarray,
    time: np.ndarray,
    steady: np.ndarray,
    wind20: float,
    wind: np.ndarray,
) -> None:
    """Add the gusts at given positions to the wind.

    Args:
        waves: (W, NUM_WAVE_ROWS, NUM_WAVES) waves of each world, see `draw_waves`.
        parts: (3, NUM_WAVES) scratch array for the contribution of each wave.
        position: (W, N, 3) positions, m.
        time: (W,) time of each world, s.
        steady: (W, 3) steady wind, which carries the field, m/s.
        wind20: Wind speed at 20 feet, m/s.
        wind: (W, N, 3) wind, m/s, to which the gusts are added in place.
    """
    east, north, up = parts[0], parts[1], parts[2]
    for w in range(position.shape[0]):
        t = time[w]
        frequency, phase, drift = waves[w, FREQUENCY], waves[w, PHASE], waves[w, DRIFT]
        cosine, sine = waves[w, COSINE], waves[w, SINE]
        steepness, flatness = waves[w, STEEPNESS], waves[w, FLATNESS]
        for i in range(position.shape[1]):
            length_u, length_w, s_u, s_w = dryden_scales(position[w, i, 2], wind20)
            turn_u, turn_w = 2.0 * PI * length_u, 2.0 * PI * length_w
            # Where this air was at time 0
            x = position[w, i, 0] - t * steady[w, 0]
            y = position[w, i, 1] - t * steady[w, 1]
            z = position[w, i, 2] - t * steady[w, 2]
            for j in range(NUM_WAVES):
                level = cosine[j] * x + sine[j] * y
                along = flatness[j] * level + steepness[j] * z - drift[j] * t
                turns = frequency[j] * along + phase[j]
                # Sine and cosine by symmetry, without branches
                turns -= np.floor(turns + 0.5)
                size = abs(turns)
                c = _sine(0.25 - size)
                s = math.copysign(_sine(0.25 - abs(0.25 - size)), turns)
                # The gust rotates in the plane across the wave
                number = abs(frequency[j])
                size_u = _amplitude(number * turn_u)
                across, ahead = size_u * c, size_u * steepness[j] * s
                east[j] = ahead * cosine[j] - across * sine[j]
                north[j] = ahead * sine[j] + across * cosine[j]
                up[j] = -_amplitude(number * turn_w) * flatness[j] * s
            _sum_columns(parts)
            flat = s_u * _gain(length_u)
            wind[w, i, 0] += flat * east[0]
            wind[w, i, 1] += flat * north[0]
            wind[w, i, 2] += s_w * _gain(length_w) * up[0]
