"""The radio link from users on the ground to drones: options, received power and uplink rates."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from bulletuav.compiled.functions import hypot
from bulletuav.compiled.kernel import allocating, func
from bulletuav.compiled.program import Program
from bulletuav.errors import choose, finite
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
        user_power: Power that a user sends with, W.
        path_loss: Path loss model: "log_distance"; "umi" or "uma" of TR 38.901; "umi_av" or
            "uma_av" of TR 36.777. Whether there is a line of sight tells which of its laws holds.
        n_los: Exponent of "log_distance" with line of sight.
        n_nlos: Exponent of "log_distance" without line of sight.
        antenna: Antenna of the drones: "isotropic", or "downward", the element of TR 38.901
            that looks along the body's -z axis.
        access: How users share the band: "ofdma", "tdma" or "shared", see
            `bulletuav.network.access`.
        activity: Share of the time, from 0 to 1, in which a user sends, for the interference that
            others have of it; or "load", that which its tasks can take at most: arrival rate times
            deadline.
        fading: Small-scale fading, drawn anew at every decision: "none"; "rician", which without
            line of sight is Rayleigh; or "rayleigh".
        rician_factor: Power of the direct path over that of all others, not in dB.
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
    """Options of the link that `received_power` needs.

    Attributes:
        model: Path loss model, one of `CODES`.
        frequency: Carrier frequency, GHz.
        n_los: Exponent of the log-distance model with line of sight.
        n_nlos: Exponent of the log-distance model without line of sight.
        power: Power that a user sends with, W.
        directional: Whether the antennas of drones have a pattern.
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
    # Laws of 3GPP by scene: streets and roofs (TR 38.901), and aerial vehicles (TR 36.777)
    path = (ground_distance, drone_height, user_height, link.frequency)
    if link.model == UMI:
        return umi_los(*path) if sight else umi_nlos(*path)
    if link.model == UMA:
        return uma_los(*path) if sight else uma_nlos(*path)
    if link.model == UMI_AV:
        return umi_av_los(*path) if sight else umi_av_nlos(*path)
    if link.model == UMA_AV:
        return uma_av_los(*path) if sight else uma_av_nlos(*path)
    # Else the log-distance model, along the straight way
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
    """Compute the power that each drone receives from each user, without fading.

    Args:
        link: Options of the link.
        position: Positions (W, N, 3) of drones, m.
        quaternion: Attitudes (W, N, 4) of drones, (x, y, z, w).
        users: Positions (W, U, 3) of users, m.
        sight: Whether (W, N, U) there is a line of sight.

    Returns:
        Received power (W, N, U), W.
    """
    worlds, drones, count = sight.shape
    power = np.empty(sight.shape)
    # Every pair of a drone and a user is a link
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
    """Write what `received_power` computes."""
    received = received_power(link, position, quaternion, users, sight)
    for w in range(power.shape[0]):
        for i in range(power.shape[1]):
            for j in range(power.shape[2]):
                power[w, i, j] = received[w, i, j]


class Uplink:
    """The radio link from users to drones that a `RadioConfig` describes.

    Attributes:
        config: Options of the link.
        noise: Noise power in all of the band, W.
    """

    def __init__(self, config: RadioConfig) -> None:
        """Check the options and prepare the link.

        Args:
            config: Options of the link.

        Raises:
            ValueError: A number is not above 0, the activity is no share, or the path loss model is
                not meant for the frequency.
        """
        # Quantities that divide or enter a logarithm
        for name in ("frequency", "bandwidth", "user_power"):
            if getattr(config, name) <= 0:
                raise ValueError(f"{name} is {getattr(config, name):g}: it must be above 0")
        if isinstance(config.activity, str):
            choose("activity", config.activity, {"load": None})
        else:
            finite("activity", config.activity, 0, 1)
        # The standards' models are each for a range of frequencies
        if config.path_loss != "log_distance":
            check_validity(config.path_loss, config.frequency)
        # What does not change from decision to decision
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
        """Draw the power that each drone receives from each user, with fading where it is on.

        Args:
            position: Positions (W, N, 3) of drones, m.
            quaternion: Attitudes (W, N, 4) of drones, (x, y, z, w).
            users: Positions (W, U, 3) of users, m.
            sight: Whether (W, N, U) there is a line of sight.
            rng: Generator of each of the W worlds; None is possible where a world does not fly.
            flying: Whether (W,) fading is drawn in each world: an episode is under way.

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
        """Add to a program that what drones receive from users is written to `power`.

        Fading comes after it; see `received` for the arguments, and `fade`.
        """
        program.call(_receive, self._link, position, quaternion, users, sight, power)

    def fade(
        self,
        power: np.ndarray,
        sight: np.ndarray,
        rng: Sequence[np.random.Generator | None],
        flying: np.ndarray,
    ) -> None:
        """Let received power (W, N, U) fade in worlds that fly, where fading is on."""
        if self.config.fading == "none":
            return
        # Without a direct path the factor is 0, which is Rayleigh fading
        direct = self.config.rician_factor if self.config.fading == "rician" else 0.0
        for w in np.flatnonzero(flying).tolist():
            generator = rng[w]
            assert generator is not None  # a world that flies has one
            factor = np.where(sight[w], direct, 0.0)
            power[w] *= rician_gain(factor, generator, sight[w].shape)
