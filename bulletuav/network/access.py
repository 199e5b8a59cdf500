"""How users share the band of the drones that serve them: rates of their uplinks.

All drones use the same band.
"""

import numpy as np

from bulletuav.kernel import kernel
from bulletuav.network.link import capacity

OFDMA, TDMA, SHARED = range(3)
ACCESS = {"ofdma": OFDMA, "tdma": TDMA, "shared": SHARED}
NOBODY = -1
"""In place of a drone: the user has none"""


@kernel
def uplink_rates(power, assignment, bandwidth, noise, access, activity):
    """(W, U) bit/s from users to the drones (W, U) that serve them; 0 for users of NOBODY.

    power (W, N, U) of each user as each drone receives it, W; bandwidth Hz; noise power in all of it, W; `activity`, the
    share of the time in which a user sends, by which the power of those who interfere counts.

    OFDMA   a drone with n users gives each 1/n of the band; the users of other drones hop over the whole band, so that each
            part gets its share of their power: B/n log2(1 + n P / (noise + sum of P of those of other drones))
    TDMA    a drone with n users gives each all of the band 1/n of the time, while of every other drone the user heard best
            sends: B/n log2(1 + P / (noise + sum over other drones of the greatest P of theirs))
    SHARED  everybody sends in all of the band: B log2(1 + P / (noise + sum of P of all others))

    So one more user of another drone never raises a rate.
    """
    worlds, drones, users = power.shape
    rates = np.zeros((worlds, users))
    count, loudest = np.zeros(drones), np.zeros(drones)
    for w in range(worlds):
        count[:] = 0.0
        for j in range(users):
            if assignment[w, j] != NOBODY:
                count[assignment[w, j]] += 1.0
        for i in range(drones):
            if count[i] == 0.0:
                continue
            loudest[:] = 0.0
            everybody, others = 0.0, 0.0
            for j in range(users):
                server = assignment[w, j]
                if server == NOBODY:
                    continue
                everybody += power[w, i, j]
                if server != i:
                    others += power[w, i, j]
                    loudest[server] = max(loudest[server], power[w, i, j])
            slots = loudest.sum()
            for j in range(users):
                if assignment[w, j] != i:
                    continue
                signal = power[w, i, j]
                if access == OFDMA:
                    rates[w, j] = capacity(
                        bandwidth / count[i], count[i] * signal / (noise + activity * others)
                    )
                elif access == TDMA:
                    rates[w, j] = (
                        capacity(bandwidth, signal / (noise + activity * slots)) / count[i]
                    )
                else:
                    rates[w, j] = capacity(
                        bandwidth, signal / (noise + activity * (everybody - signal))
                    )
    return rates
