"""Power of many drones at once."""

import numpy as np

from bulletuav.compiled.gather import pack_numbers
from bulletuav.compiled.lanes import WIDTH, lane_zeros
from bulletuav.envs.energy import _fill_propulsion
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.power import ROTARY_WING, W20, W100, airframe_wing, propulsion


def test_power_in_lanes_has_the_bits_of_drones_one_by_one():
    wings = np.array([[W20, W100, airframe_wing(load_airframe("cf2x"))]] * 7, dtype=ROTARY_WING)
    packed = lane_zeros(-(-wings.size // WIDTH), len(ROTARY_WING))
    pack_numbers(wings.view(float).reshape(7, 3, -1), packed)
    rng = np.random.default_rng(0)
    before, after, wind = rng.normal(0, 6, (3, 7, 3, 3))
    # Hover, and each way to climb and to descend: the vortex ring, and the windmill brake
    before[:4] = after[:4] = wind[:4] = 0.0
    before[1:4, :, 2] = after[1:4, :, 2] = np.array([2.0, -4.0, -40.0])[:, None]
    power = np.full((7, 3), np.nan)
    _fill_propulsion(before, after, wind, wings, packed, power)
    np.testing.assert_array_equal(power, propulsion((before + after) / 2 - wind, wings))
