"""Multiple access: how users share the band of the drones that serve them, and their uplink rates.

All drones use the same band.
"""

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.network.link import capacity

OFDMA, TDMA, SHARED = range(3)
ACCESS = {"ofdma": OFDMA, "tdma": TDMA, "shared": SHARED}
"""Codes of the schemes by name, see `uplink_rates`"""
NOBODY = -1
"""Index in place of a drone for users that no drone serves"""


@allocating
def uplink_rates(
    power: np.ndarray,
    assignment: np.ndarray,
    bandwidth: float,
    noise: float,
    access: int,
    activity: float,
) -> np.ndarray:
    """Compute the rates from users to the drones that serve them.

    P is the received power of a user, B the bandwidth, and "other" users are those of other drones.

    - OFDMA: a drone with n users gives each 1/n of the band. Other users hop over the whole band,
      so each part gets its share of their power: B/n log2(1 + n P / (noise + sum of other P)).
    - TDMA: a drone with n users gives each all of the band 1/n of the time. Of every other drone
      the user heard best sends meanwhile: B/n log2(1 + P / (noise + sum of these greatest P)).
    - SHARED: everybody sends in all of the band: B log2(1 + P / (noise + sum of all other P)).

    So one more user of another drone never raises a rate.

    Args:
        power: Power (W, N, U) of each user as each drone receives it, W.
        assignment: Drone (W, U) that serves each user, or `NOBODY`.
        bandwidth: Bandwidth, Hz.
        noise: Noise power in all of the band, W.
        access: Scheme, one of `ACCESS`.
        activity: Share of the time in which a user sends; scales the power of interference.

    Returns:
        Rates (W, U), bit/s; 0 for users of `NOBODY`.
    """
    worlds, drones, users = power.shape
    rates = np.zeros((worlds, users))
    count = np.zeros(drones)
    strongest = np.zeros(drones)
    for w in range(worlds):
        # Count the users of each drone
        count[:] = 0.0
        for j in range(users):
            if assignment[w, j] != NOBODY:
                count[assignment[w, j]] += 1.0
        for i in range(drones):
            if count[i] == 0.0:
                continue
            # Add up what the drone hears, and find the strongest user of every other drone
            strongest[:] = 0.0
            total = 0.0
            others = 0.0
            for j in range(users):
                server = assignment[w, j]
                if server == NOBODY:
                    continue
                total += power[w, i, j]
                if server != i:
                    others += power[w, i, j]
                    strongest[server] = max(strongest[server], power[w, i, j])
            simultaneous = 0.0
            for k in range(drones):
                simultaneous += strongest[k]
            # Rates of the drone's own users against that interference
            for j in range(users):
                if assignment[w, j] != i:
                    continue
                signal = power[w, i, j]
                if access == OFDMA:
                    sinr = count[i] * signal / (noise + activity * others)
                    rates[w, j] = capacity(bandwidth / count[i], sinr)
                elif access == TDMA:
                    sinr = signal / (noise + activity * simultaneous)
                    rates[w, j] = capacity(bandwidth, sinr) / count[i]
                else:
                    sinr = signal / (noise + activity * (total - signal))
                    rates[w, j] = capacity(bandwidth, sinr)
    return rates
