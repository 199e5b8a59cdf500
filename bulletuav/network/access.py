"""Multiple access: sharing of the band among users, and the resulting uplink rates.

All drones use the same band.
"""

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.network.link import capacity

OFDMA, TDMA, SHARED = range(3)
ACCESS = {"ofdma": OFDMA, "tdma": TDMA, "shared": SHARED}
"""Codes of the access schemes by name, see `uplink_rates`"""
NO_DRONE = -1
"""Drone index of users that no drone serves"""


@allocating
def uplink_rates(
    power: np.ndarray,
    assignment: np.ndarray,
    bandwidth: float,
    noise: float,
    access: int,
    activity: float,
) -> np.ndarray:
    """Compute the uplink rates from users to their serving drones.

    P is the received power of a user, B the bandwidth, and "other" users are those of other drones.

    - OFDMA: a drone with n users assigns each 1/n of the band. Other users hop over the whole band,
    so that each part receives its fraction of their power: B/n log2(1 + n P / (noise + sum of other
    P)).
    - TDMA: a drone with n users assigns each the whole band for 1/n of the time. The interference
    from each other drone is that of its strongest user: B/n log2(1 + P / (noise + sum of these
    maximum P)).
    - SHARED: all users transmit in the whole band: B log2(1 + P / (noise + sum of all other P)).

    An additional user of another drone therefore never increases a rate.

    Args:
        power: Received power (W, N, U) of each user at each drone, W.
        assignment: Serving drone (W, U) of each user, or `NO_DRONE`.
        bandwidth: Bandwidth, Hz.
        noise: Noise power in the whole band, W.
        access: Access scheme, one of `ACCESS`.
        activity: Fraction of the time in which a user transmits; scales the interference.

    Returns:
        Rates (W, U), bit/s; 0 for users of `NO_DRONE`.
    """
    worlds, drones, users = power.shape
    rates = np.zeros((worlds, users))
    count = np.zeros(drones)
    strongest = np.zeros(drones)
    for w in range(worlds):
        # Count the users of each drone
        count[:] = 0.0
        for j in range(users):
            if assignment[w, j] != NO_DRONE:
                count[assignment[w, j]] += 1.0
        for i in range(drones):
            if count[i] == 0.0:
                continue
            # Total received power, and strongest user of every other drone
            strongest[:] = 0.0
            total = 0.0
            others = 0.0
            for j in range(users):
                server = assignment[w, j]
                if server == NO_DRONE:
                    continue
                total += power[w, i, j]
                if server != i:
                    others += power[w, i, j]
                    strongest[server] = max(strongest[server], power[w, i, j])
            simultaneous = 0.0
            for k in range(drones):
                simultaneous += strongest[k]
            # Rates of the drone's own users
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
