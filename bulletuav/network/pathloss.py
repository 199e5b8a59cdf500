"""Path loss models between drones and ground users, by name, and their ranges of validity.

All `PATHLOSS_MODELS` have the same signature: horizontal distance, heights of drone and user, and
frequency. Frequencies are in GHz, lengths in m, losses in dB. Formulas are in `propagation`,
`tr38901` and `tr36777`.

No standard covers drones as base stations. TR 38.901 is used with the drone as the base station and
the user as the terminal, TR 36.777 with the drone as the terminal and the user as the base station.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import elementwise
from bulletuav.errors import find_choice, numbers_of
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
    """Return the path loss of `log_distance` with line of sight, dB: free space."""
    return free_space(antenna_distance(ground_distance, drone_height, user_height), frequency)


@elementwise
def log_distance_nlos(
    ground_distance: float, drone_height: float, user_height: float, frequency: float
) -> float:
    """Return the path loss of `log_distance` without line of sight, dB.

    The exponent is 3.19, as in the close-in model of TR 38.901.
    """
    distance = antenna_distance(ground_distance, drone_height, user_height)
    return log_distance(distance, frequency, NLOS_EXPONENT)


class Shadowing(NamedTuple):
    """Parameters of `tr36777.shadowing`, the standard deviation of the path loss.

    Attributes:
        low: Standard deviation for drones up to 22.5 m, dB.
        high: Standard deviation above 22.5 m before the decay exp(-`decay` h) with the height h,
            dB.
        decay: Decay rate, 1/m.
        minimum: Minimum standard deviation above 22.5 m, dB.
    """

    low: float
    high: float
    decay: float = 0.0
    minimum: float = 0.0


class Validity(NamedTuple):
    """Ranges of validity; a range of zero width is the base station height of the standard.

    Attributes:
        source: Name of the standard, for messages.
        frequency: Minimum and maximum carrier frequency, GHz.
        distance: Minimum and maximum horizontal distance, m.
        drone: Minimum and maximum height of the drone, m.
        user: Minimum and maximum height of the user, m.
    """

    source: str
    frequency: tuple[float, float]
    distance: tuple[float, float] = (0.0, math.inf)
    drone: tuple[float, float] = (0.0, math.inf)
    user: tuple[float, float] = (0.0, math.inf)


# From VLF to the upper limit of radio waves (ITU Radio Regulations, 1.5)
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
# TR 36.777 sets no frequency range; 6 GHz is the limit of LTE (our choice)
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
"""Loss (dB) as a function of horizontal distance (m), drone height, user height (m), frequency
(GHz)"""


@dataclass(frozen=True)
class PathLossModel:
    """Path loss model with its shadowing and range of validity.

    Attributes:
        los: Path loss with line of sight.
        nlos: Path loss without line of sight.
        shadowing_los: Shadowing with line of sight.
        shadowing_nlos: Shadowing without line of sight.
        validity: Ranges of validity by the standard, see `check_validity`.
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
        shadowing_los=Shadowing(low=4.0, high=5.0, decay=0.01, minimum=2.0),
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
"""Number, array of numbers, or None if there is nothing to check"""


def check_validity(
    name: str, frequency: Values, distance: Values = None, drone: Values = None, user: Values = None
) -> PathLossModel:
    """Return a path loss model by name, and check its range of validity.

    Args:
        name: One of `PATHLOSS_MODELS`.
        frequency: Carrier frequencies, GHz.
        distance: Horizontal distances, m.
        drone: Heights of drones, m.
        user: Heights of users, m.

    Returns:
        The model.

    Raises:
        ValueError: If there is no such model, or a value is outside the range of the standard.

    Warns:
        UserWarning: If the drone (TR 38.901) or user (TR 36.777) that takes the role of the base
        station has another height than the base station of the standard.
    """
    model: PathLossModel = find_choice("path loss model", name, PATHLOSS_MODELS)
    given = {"frequency": frequency, "distance": distance, "drone": drone, "user": user}
    for quantity, value in given.items():
        if value is None:
            continue
        low, high = getattr(model.validity, quantity)
        # Comparisons with NaN are false
        values = numbers_of(f"{quantity} is", value)
        if ((values >= low) & (values <= high) & (values < math.inf)).all():
            continue
        # A range of zero width is the base station height: deviations cause a warning only
        source = model.validity.source
        if low == high and np.isfinite(values).all():
            message = (
                f"{quantity} is {value!r}: it acts as the base station, at {low:g} m in {source}"
            )
            warnings.warn(message, stacklevel=2)
            continue
        unit = "GHz" if quantity == "frequency" else "m"
        raise ValueError(
            f"{quantity} is {value!r}: {source} is valid for {low:g} to {high:g} {unit}; "
            f"choose another of {list(PATHLOSS_MODELS)}"
        )
    return model
