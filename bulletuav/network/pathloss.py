"""Path loss between a drone and the ground, dB: free space, log-distance, and the models of 3GPP as options.

Frequencies in GHz, lengths in m. Antennas nearer than 1 m to each other count as 1 m apart, so that all losses are finite.
`PATHLOSS_MODELS` are all called alike, with the distance over ground, the heights of drone and user, and the frequency. No standard
has drones for base stations: TR 38.901 is taken with the drone as the base and the user as the terminal, TR 36.777 with the
drone as the terminal and the user in the place of the base.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bulletuav.errors import choose, numbers_of
from bulletuav.kernel import elementwise, func

SPEED_OF_LIGHT = 299792458.0  # m/s
NLOS_EXPONENT = 3.19
EXPONENTS = {"urbanmarl": 3.5, "umi_ci": NLOS_EXPONENT}
"""For `log_distance` without a line of sight: of UrbanMARL 0.3.1, and of `umi_close_in_nlos`"""
EXCESS = {
    "suburban": (0.1, 21.0),
    "urban": (1.0, 20.0),
    "dense": (1.6, 23.0),
    "high_rise": (2.3, 34.0),
}
"""dB beyond free space with a line of sight and without, for `mean_path_loss`: the customary values for 2 GHz
(I. Bor-Yaliniz, A. El-Keyi, H. Yanikomeroglu, IEEE ICC 2016)"""
LOW = 22.5  # m, up to which TR 36.777 leaves drones to TR 38.901


@func
def _span(distance, height, other):
    """Distance between two antennas at heights, at least 1 m."""
    return max(math.hypot(distance, height - other), 1.0)


@elementwise
def free_space(distance, frequency):
    """Free-space path loss (dB): 20 log10(4 pi d f / c) (H. T. Friis, 1946)."""
    return 20.0 * math.log10(4e9 * math.pi * max(distance, 1.0) * frequency / SPEED_OF_LIGHT)


@elementwise
def log_distance(distance, frequency, exponent):
    """Path loss (dB) that grows with a power of the distance: that of free space at 1 m, and 10 n log10(d)."""
    return free_space(1.0, frequency) + 10.0 * exponent * math.log10(max(distance, 1.0))


@elementwise
def mean_path_loss(distance, frequency, chance, excess_los, excess_nlos):
    """Path loss (dB) in the mean over places with a line of sight and without: that of free space and the mean excess.

    `chance` of a line of sight (`bulletuav.city.sight_probability`), dB beyond free space with and without it (`EXCESS`).
    A. Al-Hourani, S. Kandeepan, S. Lardner, IEEE Wireless Communications Letters 3 (2014).
    """
    return free_space(distance, frequency) + chance * excess_los + (1.0 - chance) * excess_nlos


@elementwise
def log_distance_los(distance, drone, user, frequency):
    """`log_distance` with a line of sight: free space."""
    return free_space(_span(distance, drone, user), frequency)


@elementwise
def log_distance_nlos(distance, drone, user, frequency):
    """`log_distance` without a line of sight, with the exponent 3.19 of TR 38.901."""
    return log_distance(_span(distance, drone, user), frequency, NLOS_EXPONENT)


# TR 38.901, table 7.4.1-1


@func
def _dual_slope(distance, base, user, frequency, intercept, slope):
    """Loss with a line of sight: 40 dB a decade from the breakpoint on.

    The environment has an effective height of 1 m (UMa draws it at random for users above 13 m: not here); antennas below
    count as at it.
    """
    breakpoint = (
        4.0 * max(base - 1.0, 0.0) * max(user - 1.0, 0.0) * frequency * 1e9 / 3e8
    )  # c as the standard has it
    near, span = intercept + 20.0 * math.log10(frequency), math.log10(_span(distance, base, user))
    if distance <= breakpoint:
        return near + slope * span
    return (
        near
        + 40.0 * span
        - (20.0 - 0.5 * slope) * math.log10(max(breakpoint**2 + (base - user) ** 2, 1.0))
    )


@elementwise
def umi_los(distance, base, user, frequency):
    """TR 38.901 UMi street canyon, line of sight (dB)."""
    return _dual_slope(distance, base, user, frequency, 32.4, 21.0)


@elementwise
def umi_nlos(distance, base, user, frequency):
    """TR 38.901 UMi street canyon, no line of sight (dB)."""
    loss = (
        22.4
        + 35.3 * math.log10(_span(distance, base, user))
        + 21.3 * math.log10(frequency)
        - 0.3 * (user - 1.5)
    )
    return max(umi_los(distance, base, user, frequency), loss)


@elementwise
def umi_close_in_nlos(distance, frequency):
    """TR 38.901 UMi street canyon, no line of sight, the optional close-in law (dB) of the distance between the antennas.

    All but `log_distance` with 3.19, which has 32.448 for 32.4. Shadowing 8.2 dB.
    """
    return 32.4 + 20.0 * math.log10(frequency) + 31.9 * math.log10(max(distance, 1.0))


@elementwise
def uma_los(distance, base, user, frequency):
    """TR 38.901 UMa, line of sight (dB)."""
    return _dual_slope(distance, base, user, frequency, 28.0, 22.0)


@elementwise
def uma_nlos(distance, base, user, frequency):
    """TR 38.901 UMa, no line of sight (dB)."""
    loss = (
        13.54
        + 39.08 * math.log10(_span(distance, base, user))
        + 20.0 * math.log10(frequency)
        - 0.6 * (user - 1.5)
    )
    return max(uma_los(distance, base, user, frequency), loss)


@func
def _sight(distance, certain, fade):
    """Chance of a line of sight that is certain up to a distance and then falls off."""
    if distance <= certain:
        return 1.0
    return certain / distance + math.exp(-distance / fade) * (1.0 - certain / distance)


@elementwise
def umi_los_probability(distance):
    """TR 38.901 UMi street canyon, table 7.4.2-1: chance of a line of sight at a distance over ground."""
    return _sight(distance, 18.0, 36.0)


@elementwise
def uma_los_probability(distance, user):
    """TR 38.901 UMa, table 7.4.2-1: chance of a line of sight at a distance over ground, to a user at a height."""
    high = (max(user - 13.0, 0.0) / 10.0) ** 1.5
    more = 1.25 * high * (distance / 100.0) ** 3 * math.exp(-distance / 150.0)
    return _sight(distance, 18.0, 63.0) * (1.0 + more) if distance > 18.0 else 1.0


# TR 36.777, tables B-1 to B-3


@elementwise
def umi_av_los(distance, drone, base, frequency):
    """TR 36.777 UMi-AV, line of sight (dB); up to 22.5 m as TR 38.901."""
    if drone <= LOW:
        return umi_los(distance, base, drone, frequency)
    span = _span(distance, drone, base)
    loss = (
        30.9 + (22.25 - 0.5 * math.log10(drone)) * math.log10(span) + 20.0 * math.log10(frequency)
    )
    return max(free_space(span, frequency), loss)


@elementwise
def umi_av_nlos(distance, drone, base, frequency):
    """TR 36.777 UMi-AV, no line of sight (dB); up to 22.5 m as TR 38.901."""
    if drone <= LOW:
        return umi_nlos(distance, base, drone, frequency)
    slope = 43.2 - 7.6 * math.log10(drone)
    loss = 32.4 + slope * math.log10(_span(distance, drone, base)) + 20.0 * math.log10(frequency)
    return max(umi_av_los(distance, drone, base, frequency), loss)


@elementwise
def uma_av_los(distance, drone, base, frequency):
    """TR 36.777 UMa-AV, line of sight (dB); up to 22.5 m as TR 38.901."""
    if drone <= LOW:
        return uma_los(distance, base, drone, frequency)
    return 28.0 + 22.0 * math.log10(_span(distance, drone, base)) + 20.0 * math.log10(frequency)


@elementwise
def uma_av_nlos(distance, drone, base, frequency):
    """TR 36.777 UMa-AV, no line of sight (dB); up to 22.5 m as TR 38.901.

    Above 100 m, where the standard has no blocked links, the law of 100 m (our choice).
    """
    if drone <= LOW:
        return uma_nlos(distance, base, drone, frequency)
    slope = 46.0 - 7.0 * math.log10(min(drone, 100.0))
    return (
        -17.5
        + slope * math.log10(_span(distance, drone, base))
        + 20.0 * math.log10(40.0 * math.pi * frequency / 3.0)
    )


@elementwise
def umi_av_los_probability(distance, drone):
    """TR 36.777 UMi-AV: chance of a line of sight at a distance over ground; up to 22.5 m as TR 38.901."""
    if drone <= LOW:
        return umi_los_probability(distance)
    height = math.log10(drone)
    return _sight(distance, max(294.05 * height - 432.94, 18.0), 233.98 * height - 0.95)


@elementwise
def uma_av_los_probability(distance, drone):
    """TR 36.777 UMa-AV: chance of a line of sight at a distance over ground; up to 22.5 m as TR 38.901; 1 above 100 m."""
    if drone <= LOW:
        return uma_los_probability(distance, drone)
    height = math.log10(drone)
    return (
        1.0
        if drone > 100.0
        else _sight(distance, max(460.0 * height - 700.0, 18.0), 4300.0 * height - 3800.0)
    )


@elementwise
def shadowing(drone, low, high, decay, least):
    """Standard deviation (dB) of the path loss about a model: of the height of the drone and the numbers of a `Shadowing`.

    TR 38.901, table 7.4.1-1; TR 36.777, table B-3.
    """
    return low if drone <= LOW else max(high * math.exp(-decay * drone), least)


class Shadowing(NamedTuple):
    """dB for drones up to 22.5 m: `low`; above: `high` exp(-`decay` h), at least `least`."""

    low: float
    high: float
    decay: float = 0.0
    least: float = 0.0


class Validity(NamedTuple):
    """Ranges that a standard makes a model for: GHz, m over ground, m of height; of no width where it has its base."""

    source: str
    frequency: tuple[float, float]
    distance: tuple[float, float] = (0.0, math.inf)
    drone: tuple[float, float] = (0.0, math.inf)
    user: tuple[float, float] = (0.0, math.inf)


RADIO = Validity(
    "log-distance", frequency=(3e-6, 3000.0)
)  # VLF to the end of radio (ITU Radio Regulations, 1.5)
UMI = Validity(
    "TR 38.901 UMi",
    frequency=(0.5, 100.0),
    distance=(10.0, 5000.0),
    drone=(10.0, 10.0),
    user=(1.5, 22.5),
)
UMA = Validity(
    "TR 38.901 UMa",
    frequency=(0.5, 100.0),
    distance=(10.0, 5000.0),
    drone=(25.0, 25.0),
    user=(1.5, 22.5),
)
# TR 36.777 leaves the frequency open: its subject is LTE, so below 6 GHz (our choice)
UMI_AV = Validity(
    "TR 36.777 UMi-AV",
    frequency=(0.5, 6.0),
    distance=(0.0, 4000.0),
    drone=(1.5, 300.0),
    user=(10.0, 10.0),
)
UMA_AV = Validity(
    "TR 36.777 UMa-AV",
    frequency=(0.5, 6.0),
    distance=(0.0, 4000.0),
    drone=(1.5, 300.0),
    user=(25.0, 25.0),
)


@dataclass(frozen=True)
class Model:
    """Losses (dB) of (distance over ground, height of the drone, height of the user, frequency), in sight and not."""

    los: Callable
    nlos: Callable
    shadowing_los: Shadowing
    shadowing_nlos: Shadowing
    validity: Validity


PATHLOSS_MODELS = {
    "log_distance": Model(
        log_distance_los, log_distance_nlos, Shadowing(0.0, 0.0), Shadowing(0.0, 0.0), RADIO
    ),
    "umi": Model(umi_los, umi_nlos, Shadowing(4.0, 4.0), Shadowing(7.82, 7.82), UMI),
    "uma": Model(uma_los, uma_nlos, Shadowing(4.0, 4.0), Shadowing(6.0, 6.0), UMA),
    "umi_av": Model(
        umi_av_los, umi_av_nlos, Shadowing(4.0, 5.0, 0.01, 2.0), Shadowing(7.82, 8.0), UMI_AV
    ),
    "uma_av": Model(
        uma_av_los, uma_av_nlos, Shadowing(4.0, 4.64, 0.0066), Shadowing(6.0, 6.0), UMA_AV
    ),
}

Values = float | np.ndarray | None


def check_validity(
    name: str, frequency: Values, distance: Values = None, drone: Values = None, user: Values = None
) -> Model:
    """The model of this name, if it is meant for these values (GHz, m), one or several of each; None is not looked at.

    Raises ValueError for an unknown name and for values outside of the range of the standard. Only warns (UserWarning) where
    a drone or user stands for its base at another height: drones do that for TR 38.901, users for TR 36.777.
    """
    model = choose("path loss model", name, PATHLOSS_MODELS)
    for quantity, value in (
        ("frequency", frequency),
        ("distance", distance),
        ("drone", drone),
        ("user", user),
    ):
        if value is None:
            continue
        low, high = getattr(model.validity, quantity)
        values = numbers_of(f"{quantity} is", value)
        if ((values >= low) & (values <= high) & (values < math.inf)).all():
            continue
        if low == high and np.isfinite(values).all():
            message = f"{quantity} is {value!r}: it stands for the base, which {model.validity.source} has at {low:g} m"
            warnings.warn(message, stacklevel=2)
            continue
        span = f"{low:g} to {high:g} {'GHz' if quantity == 'frequency' else 'm'}"
        raise ValueError(
            f"{quantity} is {value!r}: {model.validity.source} is for {span}; take another of {list(PATHLOSS_MODELS)}"
        )
    return model
