"""Radio uplink from ground users to drones: options and received power."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from bulletuav.compiled.functions import hypot
from bulletuav.compiled.kernel import allocating, func
from bulletuav.compiled.program import Program
from bulletuav.errors import find_choice, finite
from bulletuav.geometry.rotation import quat4, to_body
from bulletuav.network.antenna import PEAK, gain_towards
from bulletuav.network.fading import rician_gain
from bulletuav.network.link import noise_power, ratio
from bulletuav.network.pathloss import check_validity
from bulletuav.network.propagation import log_distance
from bulletuav.network.tr36777 import uma_av_los, uma_av_nlos, umi_av_los, umi_av_nlos
from bulletuav.network.tr38901 import uma_los, uma_nlos, umi_los, umi_nlos


@dataclass(frozen=True)
class RadioConfig:
    """Options of the radio link from users to drones.

    Attributes:
        frequency: Carrier frequency, GHz.
        bandwidth: Bandwidth that all drones share, Hz.
        noise_figure: Noise figure of the drones' receivers, dB.
        user_power: Transmit power of a user, W.
        path_loss: Path loss model: "log_distance"; "umi" or "uma" of TR 38.901; "umi_av" or
            "uma_av" of TR 36.777. The line of sight selects the LOS or NLOS formula.
        n_los: Exponent of "log_distance" with line of sight.
        n_nlos: Exponent of "log_distance" without line of sight.
        antenna: Antenna of the drones: "isotropic", or "downward", the element of TR 38.901 with
            boresight along the body's -z axis.
        access: Multiple access scheme: "ofdma", "tdma" or "shared", see `bulletuav.network.access`.
        activity: Fraction of the time, 0 to 1, in which a user transmits and interferes; or "load",
            the maximum that its tasks can need: arrival rate times deadline.
        fading: Small-scale fading, drawn at every decision: "none"; "rician", which is Rayleigh
            without line of sight; or "rayleigh".
        rician_factor: Ratio of direct to scattered power, linear.
    """

    frequency: float = field(default=29.0, metadata={"most": 1000.0})
    bandwidth: float = field(default=10e6, metadata={"most": 1e12})
    noise_figure: float = field(default=7.0, metadata={"most": 100.0})
    user_power: float = 0.5
    path_loss: Literal["log_distance", "umi", "uma", "umi_av", "uma_av"] = "log_distance"
    n_los: float = field(default=2.0, metadata={"most": 1000.0})
    n_nlos: float = field(default=3.19, metadata={"most": 1000.0})
    antenna: Literal["isotropic", "downward"] = "isotropic"
    access: Literal["ofdma", "tdma", "shared"] = "ofdma"
    activity: float | Literal["load"] = "load"
    fading: Literal["none", "rician", "rayleigh"] = "none"
    rician_factor: float = 10.0


LOG_DISTANCE, UMI, UMA, UMI_AV, UMA_AV = range(5)
CODES = {"log_distance": LOG_DISTANCE, "umi": UMI, "uma": UMA, "umi_av": UMI_AV, "uma_av": UMA_AV}
"""Codes of the path loss models by name, for kernels"""


class LinkParams(NamedTuple):
    """Parameters of `received_power`.

    Attributes:
        model: Path loss model, one of `CODES`.
        frequency: Carrier frequency, GHz.
        n_los: Exponent of the log-distance model with line of sight.
        n_nlos: Exponent of the log-distance model without line of sight.
        power: Transmit power of a user, W.
        directional: Whether the antennas of drones are directional.
    """

    model: int
    frequency: float
    n_los: float
    n_nlos: float
    power: float
    directional: bool


@func
def _path_loss(
    link: LinkParams, sight: bool, ground_distance: float, drone_height: float, user_height: float
) -> float:
    """Return the path loss with or without line of sight, dB."""
    # 3GPP models: street canyon and rooftop (TR 38.901), and aerial vehicles (TR 36.777)
    path = (ground_distance, drone_height, user_height, link.frequency)
    if link.model == UMI:
        return umi_los(*path) if sight else umi_nlos(*path)
    if link.model == UMA:
        return uma_los(*path) if sight else uma_nlos(*path)
    if link.model == UMI_AV:
        return umi_av_los(*path) if sight else umi_av_nlos(*path)
    if link.model == UMA_AV:
        return uma_av_los(*path) if sight else uma_av_nlos(*path)
    # Log-distance model
    distance = hypot(ground_distance, drone_height - user_height)
    exponent = link.n_los if sight else link.n_nlos
    return log_distance(distance, link.frequency, exponent)


@allocating
def received_power(
    link: LinkParams,
    position: np.ndarray,
    quaternion: np.ndarray,
    users: np.ndarray,
    sight: np.ndarray,
) -> np.ndarray:
    """Compute the received power of each user at each drone, without fading.

    Args:
        link: Parameters of the link.
        position: Positions (W, N, 3) of drones, m.
        quaternion: Attitudes (W, N, 4) of drones, (x, y, z, w).
        users: Positions (W, U, 3) of users, m.
        sight: Whether (W, N, U) there is line of sight.

    Returns:
        Received power (W, N, U), W.
    """
    worlds, drones, count = sight.shape
    power = np.empty(sight.shape)
    for w in range(worlds):
        for i in range(drones):
            attitude = quat4(quaternion, w, i)
            drone_height = position[w, i, 2]
            for j in range(count):
                east = users[w, j, 0] - position[w, i, 0]
                north = users[w, j, 1] - position[w, i, 1]
                up = users[w, j, 2] - drone_height
                # Path loss by the line of sight
                ground_distance = hypot(east, north)
                user_height = users[w, j, 2]
                is_clear = sight[w, i, j]
                gain = -_path_loss(link, is_clear, ground_distance, drone_height, user_height)
                # Antenna gain towards the user
                if link.directional:
                    x, y, z = to_body(attitude, (east, north, up))
                    gain += gain_towards(x, y, z, PEAK)
                # From dB to W
                power[w, i, j] = link.power * ratio(gain)
    return power


@allocating
def _receive(
    link: LinkParams,
    position: np.ndarray,
    quaternion: np.ndarray,
    users: np.ndarray,
    sight: np.ndarray,
    power: np.ndarray,
) -> None:
    """Write the result of `received_power` to `power`."""
    received = received_power(link, position, quaternion, users, sight)
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            for j in range(power.shape[2]):
                power[w, i, j] = received[w, i, j]


class Uplink:
    """Radio link from users to drones.

    Attributes:
        config: Options of the link.
        noise: Noise power in the whole band, W.
    """

    def __init__(self, config: RadioConfig) -> None:
        """Validate the options and prepare the link.

        Args:
            config: Options of the link.

        Raises:
            ValueError: If a number is not positive, the activity is not a fraction, or the path
                loss model is not valid for the frequency.
        """
        # Quantities that divide or enter a logarithm
        for name in ("frequency", "bandwidth", "user_power"):
            if getattr(config, name) <= 0:
                raise ValueError(f"{name} is {getattr(config, name):g}: it must be above 0")
        if isinstance(config.activity, str):
            find_choice("activity", config.activity, {"load": None})
        else:
            finite("activity", config.activity, 0, 1)
        # Each model of the standards has a frequency range
        if config.path_loss != "log_distance":
            check_validity(config.path_loss, config.frequency)
        # Constants of all decisions
        self.config = config
        self.noise = float(noise_power(config.bandwidth, config.noise_figure))
        self._link = LinkParams(
            model=CODES[config.path_loss],
            frequency=config.frequency,
            n_los=config.n_los,
            n_nlos=config.n_nlos,
            power=config.user_power,
            directional=config.antenna == "downward",
        )

    def received(
        self,
        position: np.ndarray,
        quaternion: np.ndarray,
        users: np.ndarray,
        sight: np.ndarray,
        rng: Sequence[np.random.Generator | None],
        flying: np.ndarray,
    ) -> np.ndarray:
        """Compute the received power of each user at each drone, with fading if enabled.

        Args:
            position: Positions (W, N, 3) of drones, m.
            quaternion: Attitudes (W, N, 4) of drones, (x, y, z, w).
            users: Positions (W, U, 3) of users, m.
            sight: Whether (W, N, U) there is line of sight.
            rng: Generator of each of the W worlds; may be None for worlds that do not fly.
            flying: Whether (W,) an episode of each world is running; only these draw fading.

        Returns:
            Received power (W, N, U), W.
        """
        power = received_power(self._link, position, quaternion, users, sight)
        self.fade(power, sight, rng, flying)
        return power

    def add_received(
        self,
        program: Program,
        position: np.ndarray,
        quaternion: np.ndarray,
        users: np.ndarray,
        sight: np.ndarray,
        power: np.ndarray,
    ) -> None:
        """Add the computation of the received power to a program, with the result in `power`.

        Fading is applied separately; see `received` for the arguments, and `fade`.
        """
        program.call(_receive, self._link, position, quaternion, users, sight, power)

    def fade(
        self,
        power: np.ndarray,
        sight: np.ndarray,
        rng: Sequence[np.random.Generator | None],
        flying: np.ndarray,
    ) -> None:
        """Apply fading to the received power (W, N, U) in worlds that fly, if enabled."""
        if self.config.fading == "none":
            return
        # Without a direct path the factor is 0, which is Rayleigh fading
        direct = self.config.rician_factor if self.config.fading == "rician" else 0.0
        for w in np.flatnonzero(flying).tolist():
            generator = rng[w]
            assert generator is not None  # set by the reset of the world
            factor = np.where(sight[w], direct, 0.0)
            power[w] *= rician_gain(factor, generator, sight[w].shape)
