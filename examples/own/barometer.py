"""A custom sensor, a barometer, and an observation block with the altitude from it.

The package also has a barometer, with the errors of a real chip. This sensor replaces it when it is
given to an environment.

Run it:

    python examples/own/barometer.py

The standard atmosphere below 11 km is that of ISO 2533:1975 (the same as the U.S. Standard
Atmosphere, 1976): 1013.25 hPa and 288.15 K at sea level, and 6.5 K less per kilometre. It is
defined in geopotential heights; at 1000 m these differ from heights by 0.16 m, which is neglected
here.
"""

from collections.abc import Mapping
from typing import ClassVar, TypeVar

import numpy as np

import bulletuav
from bulletuav.sensors import Label, Moment, Sensor, Uncertain
from bulletuav.tasks import block

SEA_LEVEL_PRESSURE = 101_325.0  # Pa
SEA_LEVEL_TEMPERATURE = 288.15  # K
LAPSE = 0.0065  # K/m
GRAVITY = 9.80665  # m/s^2
GAS_CONSTANT = 287.05287  # J/(kg K), of dry air
EXPONENT = GRAVITY / (LAPSE * GAS_CONSTANT)  # 5.2559
LOWEST, HIGHEST = -500.0, 11_000.0  # m


Height = TypeVar("Height", float, np.ndarray)


def pressure_at(height: Height) -> Height:
    """Return the pressure at a height, or at an array of heights (m), Pa."""
    share = 1.0 - LAPSE / SEA_LEVEL_TEMPERATURE * height
    pressure: Height = SEA_LEVEL_PRESSURE * share**EXPONENT
    return pressure


class Barometer(Sensor):
    """Static pressure, with white noise and a slow drift.

    Attributes:
        noise: (W, N) standard deviation of a reading, Pa; good sensors have 1 Pa, which is 8 cm.
        drift: (W, N) random walk, standard deviation after one second, Pa; it grows as sqrt(t).
    """

    name = "barometer"
    numbers = (Label("pressure", "Pa", pressure_at(HIGHEST), pressure_at(LOWEST)),)
    uncertain: ClassVar = {"noise": Uncertain(0.0, 1000.0), "drift": Uncertain(0.0, 1000.0)}

    noise: np.ndarray
    drift: np.ndarray
    _drifted: np.ndarray | float = 0.0

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Return the pressure readings; the drift is reset to zero at the start of an episode."""
        normal, _ = moment.draw(width=2)
        walked = self._drifted + np.sqrt(self.setup.period) * self.drift * normal[..., 0]
        fresh = moment.mask & (moment.steps == 0)[:, None]
        self._drifted = np.where(fresh, 0.0, walked)
        pressure = pressure_at(moment.after.position[..., 2])
        return {"barometer": pressure + self._drifted + self.noise * normal[..., 1]}


@block([Label("pressure altitude", "m", LOWEST, HIGHEST)])
def pressure_altitude(barometer: float) -> float:
    """Return the altitude that corresponds to the measured pressure, m."""
    share: float = (barometer / SEA_LEVEL_PRESSURE) ** (1.0 / EXPONENT)
    return SEA_LEVEL_TEMPERATURE / LAPSE * (1.0 - share)


def main() -> None:
    """Check the sensor, then compare measured with true altitudes."""
    bulletuav.check_sensor(Barometer())
    aviary = bulletuav.Aviary(
        "crossing",
        dynamics="point_mass",
        sensors=(Barometer(),),
        observation=("velocity", pressure_altitude),
        randomization={"barometer_noise": 2.0, "barometer_drift": 5.0},
    )
    observations = aviary.reset(seeds=0)
    for k in range(101):
        if k % 50 == 0:
            known = aviary.observer.split(observations)["pressure_altitude"][0, 0, 0]
            true = aviary.swarm.position[0, 0, 2]
            print(f"after {k / 10:.0f} s: {known:.2f} m by pressure, {true:.2f} m above ground")
        observations = aviary.step(np.full((1, 8, 3), (0.0, 0.0, 0.2))).observations
    aviary.close()


if __name__ == "__main__":
    main()
