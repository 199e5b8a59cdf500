"""The radio link from users on the ground to drones: its options, what drones receive, and at which rates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from bulletuav.geometry.rotation import quat4, to_body
from bulletuav.kernel import func, kernel
from bulletuav.network.access import ACCESS, uplink_rates
from bulletuav.network.antenna import PEAK, gain_towards
from bulletuav.network.fading import rician_gain
from bulletuav.network.link import noise_power, ratio
from bulletuav.network.pathloss import (
    check_validity,
    log_distance,
    uma_av_los,
    uma_av_nlos,
    uma_los,
    uma_nlos,
    umi_av_los,
    umi_av_nlos,
    umi_los,
    umi_nlos,
)


@dataclass(frozen=True)
class RadioConfig:
    """Options of the radio link.

    frequency     carrier, GHz
    bandwidth     Hz
    noise_figure  of the drones' receivers, dB
    user_power    that a user sends with, W
    path_loss     "log_distance", "umi" or "uma" (TR 38.901), "umi_av" or "uma_av" (TR 36.777); by the line of sight there is
    n_los, n_nlos  exponents of log_distance with and without line of sight
    antenna       of the drones: "isotropic", or "downward", the element of TR 38.901 that looks along the body's -z
    access        how users share the band: "ofdma", "tdma" or "shared", see `bulletuav.network.access`
    fading        "none", "rician" (with line of sight; Rayleigh without) or "rayleigh", drawn anew at every decision
    rician_factor  power of the direct path over that of all others
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
    fading: Literal["none", "rician", "rayleigh"] = "none"
    rician_factor: float = 10.0


LOG_DISTANCE, UMI, UMA, UMI_AV, UMA_AV = range(5)
CODES = {"log_distance": LOG_DISTANCE, "umi": UMI, "uma": UMA, "umi_av": UMI_AV, "uma_av": UMA_AV}


class Link(NamedTuple):
    """What `received_power` needs of the options: path loss model, GHz, exponents, W, whether antennas have a pattern."""

    model: int
    frequency: float
    n_los: float
    n_nlos: float
    power: float
    directional: bool


@func
def path_loss(link, seen, ground, drone, user):
    """Path loss (dB) over `ground`, m, between heights of drone and user, m, with a line of sight or without."""
    frequency = link.frequency
    if link.model == UMI:
        return (
            umi_los(ground, drone, user, frequency)
            if seen
            else umi_nlos(ground, drone, user, frequency)
        )
    if link.model == UMA:
        return (
            uma_los(ground, drone, user, frequency)
            if seen
            else uma_nlos(ground, drone, user, frequency)
        )
    if link.model == UMI_AV:
        return (
            umi_av_los(ground, drone, user, frequency)
            if seen
            else umi_av_nlos(ground, drone, user, frequency)
        )
    if link.model == UMA_AV:
        return (
            uma_av_los(ground, drone, user, frequency)
            if seen
            else uma_av_nlos(ground, drone, user, frequency)
        )
    return log_distance(
        math.hypot(ground, drone - user), frequency, link.n_los if seen else link.n_nlos
    )


@kernel
def received_power(link, position, quaternion, users, sight):
    """(W, N, U) W that drones at (W, N, 3) m, turned by (W, N, 4), receive from users (W, U, 3) m, by `sight` (W, N, U)."""
    worlds, drones, count = sight.shape
    power = np.empty(sight.shape)
    for w in range(worlds):
        for i in range(drones):
            turn = quat4(quaternion, w, i)
            for j in range(count):
                east, north = users[w, j, 0] - position[w, i, 0], users[w, j, 1] - position[w, i, 1]
                height = users[w, j, 2] - position[w, i, 2]
                gain_db = -path_loss(
                    link, sight[w, i, j], math.hypot(east, north), position[w, i, 2], users[w, j, 2]
                )
                if link.directional:
                    x, y, z = to_body(turn, (east, north, height))
                    gain_db += gain_towards(x, y, z, PEAK)
                power[w, i, j] = link.power * ratio(gain_db)
    return power


class Uplink:
    """The radio link that the options tell of; `noise` W in all of the band."""

    def __init__(self, config: RadioConfig):
        """Raises ValueError for a number that cannot be, or a frequency that the path loss is not meant for."""
        for name in ("frequency", "bandwidth", "user_power"):
            if getattr(config, name) <= 0:
                raise ValueError(f"{name} is {getattr(config, name):g}: it must be above 0")
        if config.path_loss != "log_distance":
            check_validity(config.path_loss, config.frequency)
        self.config = config
        self.noise = float(noise_power(config.bandwidth, config.noise_figure))
        self._link = Link(
            CODES[config.path_loss],
            config.frequency,
            config.n_los,
            config.n_nlos,
            config.user_power,
            config.antenna == "downward",
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
        """`received_power`, with fading in the worlds `flying` (W,), drawn from the generator of each."""
        power = received_power(self._link, position, quaternion, users, sight)
        if self.config.fading != "none":
            direct = self.config.rician_factor if self.config.fading == "rician" else 0.0
            for w in np.flatnonzero(flying).tolist():
                generator = rng[w]
                assert generator is not None  # a world that flies has one
                power[w] *= rician_gain(np.where(sight[w], direct, 0.0), generator, sight[w].shape)
        return power

    def rates(self, power: np.ndarray, servers: np.ndarray, activity: float) -> np.ndarray:
        """`uplink_rates` (W, U), bit/s, of users whose drones (W, U) receive `power` (W, N, U) W."""
        config = self.config
        return uplink_rates(
            power, servers, config.bandwidth, self.noise, ACCESS[config.access], activity
        )
