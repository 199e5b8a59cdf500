"""Path loss models between a drone and a user on the ground, by name, and what each is meant for.

`PATHLOSS_MODELS` are all called alike: with the distance over ground, the heights of drone and
user, and the frequency. Frequencies are in GHz, lengths in m, losses in dB. Their formulas are in
`propagation`, `tr38901` and `tr36777`.

No standard has drones for base stations. TR 38.901 is taken with the drone as the base and the
user as the terminal. TR 36.777 is taken with the drone as the terminal and the user as the base.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import elementwise
from bulletuav.errors import choose, numbers_of
from bulletuav.network.propagation import (
    NLOS_EXPONENT,
    antenna_distance,
    free_space,
    log_distance,
)
from bulletuav.network.tr36777 import uma_av_los, uma_av_nlos, umi_av_los, umi_av_nlos
from bulletuav.network.tr38901 import uma_los, uma_nlos, umi_los, umi_nlos


@elementwise
def log_distance_los(
    ground_distance: float, drone_height: float, user_height: float, frequency: float
) -> float:
    """Return the path loss of `log_distance` with line of sight, dB: that of free space."""
    return free_space(antenna_distance(ground_distance, drone_height, user_height), frequency)


@elementwise
def log_distance_nlos(
    ground_distance: float, drone_height: float, user_height: float, frequency: float
) -> float:
    """Return the path loss of `log_distance` without line of sight, dB.

    The exponent is 3.19, that of the close-in law in TR 38.901.
    """
    distance = antenna_distance(ground_distance, drone_height, user_height)
    return log_distance(distance, frequency, NLOS_EXPONENT)


class Shadowing(NamedTuple):
    """Parameters of `tr36777.shadowing`, the standard deviation of the path loss.

    Attributes:
        low: Standard deviation for drones up to 22.5 m, dB.
        high: Standard deviation above, before it decays with the height h as exp(-`decay` h), dB.
        decay: Rate of that decay, 1/m.
        least: Lowest standard deviation above 22.5 m, dB.
    """

    low: float
    high: float
    decay: float = 0.0
    least: float = 0.0


class Validity(NamedTuple):
    """Ranges that a standard makes a model for; one of no width where the standard has its base.

    Attributes:
        source: Name of the standard, for messages.
        frequency: Lowest and highest carrier frequency, GHz.
        distance: Least and greatest distance over ground, m.
        drone: Least and greatest height of the drone, m.
        user: Least and greatest height of the user, m.
    """

    source: str
    frequency: tuple[float, float]
    distance: tuple[float, float] = (0.0, math.inf)
    drone: tuple[float, float] = (0.0, math.inf)
    user: tuple[float, float] = (0.0, math.inf)


# From VLF to the end of radio (ITU Radio Regulations, 1.5)
RADIO = Validity("log-distance", frequency=(3e-6, 3000.0))
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

PathLoss = Callable[[float, float, float, float], float]
"""Loss (dB) by distance over ground (m), height of drone, height of user (m), frequency (GHz)"""


@dataclass(frozen=True)
class PathLossModel:
    """A path loss model: its losses, how they scatter, and what it is meant for.

    Attributes:
        los: Path loss with line of sight.
        nlos: Path loss without line of sight.
        shadowing_los: Scatter about `los`.
        shadowing_nlos: Scatter about `nlos`.
        validity: Ranges that the standard makes the model for, see `check_validity`.
    """

    los: PathLoss
    nlos: PathLoss
    shadowing_los: Shadowing
    shadowing_nlos: Shadowing
    validity: Validity


PATHLOSS_MODELS = {
    "log_distance": PathLossModel(
        los=log_distance_los,
        nlos=log_distance_nlos,
        shadowing_los=Shadowing(low=0.0, high=0.0),
        shadowing_nlos=Shadowing(low=0.0, high=0.0),
        validity=RADIO,
    ),
    "umi": PathLossModel(
        los=umi_los,
        nlos=umi_nlos,
        shadowing_los=Shadowing(low=4.0, high=4.0),
        shadowing_nlos=Shadowing(low=7.82, high=7.82),
        validity=UMI,
    ),
    "uma": PathLossModel(
        los=uma_los,
        nlos=uma_nlos,
        shadowing_los=Shadowing(low=4.0, high=4.0),
        shadowing_nlos=Shadowing(low=6.0, high=6.0),
        validity=UMA,
    ),
    "umi_av": PathLossModel(
        los=umi_av_los,
        nlos=umi_av_nlos,
        shadowing_los=Shadowing(low=4.0, high=5.0, decay=0.01, least=2.0),
        shadowing_nlos=Shadowing(low=7.82, high=8.0),
        validity=UMI_AV,
    ),
    "uma_av": PathLossModel(
        los=uma_av_los,
        nlos=uma_av_nlos,
        shadowing_los=Shadowing(low=4.0, high=4.64, decay=0.0066),
        shadowing_nlos=Shadowing(low=6.0, high=6.0),
        validity=UMA_AV,
    ),
}
"""Path loss models by name, all with the same arguments"""

Values = float | np.ndarray | None
"""A number, an array of numbers, or None where there is nothing to check"""


def check_validity(
    name: str, frequency: Values, distance: Values = None, drone: Values = None, user: Values = None
) -> PathLossModel:
    """Return the path loss model of a name, if it is meant for these values.

    Args:
        name: One of `PATHLOSS_MODELS`.
        frequency: Carrier frequencies, GHz.
        distance: Distances over ground, m.
        drone: Heights of drones, m.
        user: Heights of users, m.

    Returns:
        The model.

    Raises:
        ValueError: There is no such model, or a value is outside of the range of the standard.

    Warns:
        UserWarning: A drone or user stands for the base of the standard at another height. Drones
            do so for TR 38.901, users for TR 36.777.
    """
    model: PathLossModel = choose("path loss model", name, PATHLOSS_MODELS)
    given = {"frequency": frequency, "distance": distance, "drone": drone, "user": user}
    for quantity, value in given.items():
        if value is None:
            continue
        low, high = getattr(model.validity, quantity)
        # Finite values in range are fine; comparisons with NaN are false
        values = numbers_of(f"{quantity} is", value)
        if ((values >= low) & (values <= high) & (values < math.inf)).all():
            continue
        # A range of no width is the height of the base: another one only deserves a warning
        source = model.validity.source
        if low == high and np.isfinite(values).all():
            message = (
                f"{quantity} is {value!r}: it stands for the base, which {source} has at {low:g} m"
            )
            warnings.warn(message, stacklevel=2)
            continue
        unit = "GHz" if quantity == "frequency" else "m"
        raise ValueError(
            f"{quantity} is {value!r}: {source} is for {low:g} to {high:g} {unit}; "
            f"take another of {list(PATHLOSS_MODELS)}"
        )
    return model
