"""Gusts: one field of turbulence for each world, the same for all that fly in it.

Intensities and scale lengths are those of MIL-F-8785C at low altitude (altitude h in feet, kept
within 10 and 1000), with the spectra of Dryden. The field is a sum of plane waves with random
phases (R. H. Kraichnan, Diffusion by a random velocity field, Physics of Fluids 13, 1970), so that
a gust follows from place and time alone.

In isotropic turbulence whose gusts along a separation r have the correlation f = exp(-r / L), those
across it have g = (1 - r / 2L) exp(-r / L) (G. K. Batchelor, The theory of homogeneous turbulence,
1953). These are Dryden's two, and E = x^4 / (1 + x^2)^3 is their energy spectrum, with x = k L for
the wave number k. Amplitudes follow it, for horizontal gusts with L_u = L_v and for vertical ones
with L_w. Waves are the same at every height, and amplitudes change with it: the field has no steps.

By Taylor's hypothesis the steady wind carries the field. Each wave also drifts by itself, so that
gusts change for a drone that hovers in still air. Buildings cast no wind shadows.
"""

import math

import numpy as np

from bulletuav.compiled.functions import PI, cos, exp, power, sin
from bulletuav.compiled.kernel import func, kernel

FOOT = 0.3048
"""One foot, m"""
DRIFT_SPEED = 1.0
"""Speed with which waves drift, each in a direction of its own, m/s"""
NUM_WAVES = 64
"""Number of waves in a field; a power of 2"""
MIN_WAVELENGTH = 0.3
"""Shortest wavelength, m: over shorter ones a drone takes the mean by its size"""
LOG_WAVELENGTH_STEP = 0.155
"""Logarithm of the ratio of neighbours' wavelengths; the longest is 6.1 km"""
NUM_DRAWS = NUM_WAVES + 4
"""How many random numbers make a field"""
NUM_WAVE_ROWS = 7
"""How many numbers make a wave"""
FREQUENCY, COSINE, SINE, STEEPNESS, FLATNESS, DRIFT, PHASE = range(NUM_WAVE_ROWS)
"""Waves per metre, below 0 if left-handed; cosine and sine of the heading; vertical and horizontal
part of the direction; drift along it, m/s; phase at the origin, turns"""
GOLDEN = 1.2207440846057596
SPREAD = (1.0 / GOLDEN, 1.0 / (GOLDEN * GOLDEN), 1.0 / (GOLDEN * GOLDEN * GOLDEN))
"""Steps that spread points evenly over three dimensions: powers of the root of x^4 = x + 1 (M.
Roberts, The unreasonable effectiveness of quasirandom sequences, 2018)"""


@func
def dryden_scales(altitude: float, wind20: float) -> tuple[float, float, float, float]:
    """Return scale lengths and intensities of the turbulence by MIL-F-8785C.

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
    """Return what a number is beyond the next lower whole one."""
    return number - math.floor(number)


@kernel
def draw_waves(draws: np.ndarray, waves: np.ndarray) -> None:
    """Make the waves of a field.

    The logarithms of wavelengths are spread evenly, and so are directions over the sphere, and
    drifts. All are shifted by what is drawn, so that any wave is as likely as any other.

    Args:
        draws: (DRAWS,) random numbers, uniform from 0 to 1.
        waves: (ROWS, WAVES) what to write, see `FREQUENCY`.
    """
    for j in range(NUM_WAVES):
        length = MIN_WAVELENGTH * exp(LOG_WAVELENGTH_STEP * (j + draws[0]))
        heading = 2.0 * PI * _fractional_part(draws[1] + j * SPREAD[0])
        steepness = 2.0 * _fractional_part(draws[2] + j * SPREAD[1]) - 1.0
        drift = 2.0 * _fractional_part(draws[3] + j * SPREAD[2]) - 1.0
        # One number tells the hand by its half, and the phase by where in it.
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

    By Taylor's series, without branches and quotients: so compiled code takes several waves at
    once, which it cannot with `bulletuav.compiled.functions.sin`.
    """
    x = 2.0 * PI * turns
    q = x * x
    series = 1.0 / 362880.0 + q * (-1.0 / 39916800.0 + q * (1.0 / 6227020800.0))
    return x * (1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q * series))))


@func
def _amplitude(x: float) -> float:
    """Return the amplitude of a wave of x radians in a scale length, but for a factor.

    As the logarithms of x are spread evenly, a wave's energy is x E.
    """
    y = 1.0 / (1.0 + x * x)
    return x * x * y * math.sqrt(x * y)


@func
def _gain(length: float) -> float:
    """Return the factor of amplitudes that makes the variance of a gust 1, for a scale length.

    Amplitudes a give the variance sum a^2 / 3, for directions are random and a wave's squares are
    1 / 2 on average. The integral of E is 3 pi / 16, less what lies beyond the shortest wave.
    """
    beyond = MIN_WAVELENGTH / (2.0 * PI * length)
    return math.sqrt(3.0 * LOG_WAVELENGTH_STEP / (3.0 * PI / 16.0 - beyond))


@func
def _sum_columns(parts: np.ndarray) -> None:
    """Add the columns of parts (3, WAVES) into the first, halves onto each other."""
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
    """Add the gusts at some places to the wind.

    Args:
        waves: (W, ROWS, WAVES) waves of each world, see `draw_waves`.
        parts: (3, WAVES) room for what each wave adds.
        position: (W, N, 3) the places, m.
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
                # Sine and cosine by quarters, without branches
                turns -= np.floor(turns + 0.5)
                size = abs(turns)
                c = _sine(0.25 - size)
                s = math.copysign(_sine(0.25 - abs(0.25 - size)), turns)
                # The gust turns across the wave: to its left, then ahead and down
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
