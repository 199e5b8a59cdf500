"""Losses of datagrams between a ground station and vehicles, from the radio model.

The received power is that of `network.uplink`, as for users in tasks: path loss by distance and
line of sight, and fading. Losses of a packet follow from the ratio of signal to noise.
"""

from collections.abc import Sequence

import numpy as np

from bulletuav.envs.airspace import Airspace
from bulletuav.errors import points_of, shown
from bulletuav.network.link import packet_error
from bulletuav.network.uplink import RadioConfig, Uplink

STATION = (0.0, 0.0, 1.5)
"""Default place of the antenna of the ground station: east, north, up, m"""
RADIO = RadioConfig(
    frequency=2.4, bandwidth=2e6, noise_figure=18.0, user_power=0.1, fading="rician"
)
"""Default radio: GFSK with 2 Mbit/s and 100 mW. The noise figure includes all losses of the radio:
with it, a bit in 1,000 is wrong at -82 dBm, the sensitivity of a Crazyflie's nRF24 radio."""
SEED_STREAM = (0, 2)
"""Numbers that select the random numbers of fading; see `LossyLink` for those of its links"""


class RadioLoss:
    """Probability that a datagram to or from a vehicle is lost, at its present place.

    Both directions have the same power. Vehicles do not interfere with each other, and their bodies
    are no obstacles. Fading is drawn in each step in which a datagram is sent.

    Attributes:
        station: (3,) place of the antenna of the ground station, m.
    """

    def __init__(
        self,
        airspace: Airspace,
        station: Sequence[float] = STATION,
        config: RadioConfig = RADIO,
        seed: int | None = None,
    ) -> None:
        """Create the link budget, and compile it.

        Args:
            airspace: Airspace of the vehicles.
            station: East, north and up of the antenna of the ground station, m.
            config: Options of the radio. Those of the access scheme have no effect.
            seed: Seed of the fading; None for a random one.

        Raises:
            ValueError: If the station is not above the ground, or an option is invalid.
        """
        (self.station,) = points_of("station", [station])
        if self.station[2] <= 0:
            raise ValueError(f"station is {shown(list(station))}: a height above 0 m is needed")
        self._airspace, self._uplink = airspace, Uplink(config)
        self._rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=SEED_STREAM))
        self._time = -np.inf
        self._snr = np.zeros(len(airspace.airframes))
        self.probability(0, 1)

    def probability(self, i: int, size: int) -> float:
        """Return the probability that a datagram is lost.

        Args:
            i: Index of the vehicle.
            size: Size of the datagram, bytes.
        """
        if self._airspace.time != self._time:
            self._time, self._snr = self._airspace.time, self._compute_snr()
        return float(packet_error(self._snr[i], 8.0 * size))

    def _compute_snr(self) -> np.ndarray:
        """Return the ratio of signal to noise of each vehicle, (N,)."""
        world = self._airspace.world
        swarm = world.state.swarm
        start = np.tile(self.station, (swarm.position.shape[1], 1))
        fraction = world.engine.cast_rays(start, swarm.position[0], np.zeros(len(start), dtype=int))
        received = self._uplink.received(
            swarm.position,
            swarm.quaternion,
            self.station[None, None],
            (fraction >= 1.0)[None, :, None],
            [self._rng],
            np.ones(1, dtype=bool),
        )
        snr: np.ndarray = received[0, :, 0] / self._uplink.noise
        return snr
