"""Ways through a substep: what is checked for touches is what is flown."""

import numpy as np
import pytest
from contact.rig import Rig, random_attitudes, random_directions
from scipy.spatial.transform import Rotation

from bulletuav.compiled.kernel import allocating
from bulletuav.contact.motion import advance_motion, start_motion, start_segment
from bulletuav.vehicle.swarm import Swarm

FASTEST = 400.0
"""Spin, rad/s: far more than a turn in a substep of 60 Hz"""


@allocating
def _ends(motions, before, after, rows, dt):  # type: ignore[no-untyped-def]
    """Take the first drone of each world to the end of its way; return its legs (W,)."""
    legs = np.ones(len(motions))
    for w in range(len(motions)):
        motion, row = motions[w], rows[w, 0]
        start_motion(motion, before, after, w, 0, row, dt)
        while motion.end_time < 1.0:
            advance_motion(motion, motion.end_time, row)
            start_segment(motion, dt, row)
            legs[w] += 1
        advance_motion(motion, 1.0, row)
    return legs


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_ways_end_where_the_dynamics_took_drones(dynamics: str) -> None:
    """However fast they spin; no drone whose path was clear ends within a wall."""
    rng = np.random.default_rng(1)
    with Rig(["firefly"], dynamics=dynamics, worlds=100, hz=60) as rig:
        swarm = rig.swarm
        swarm.velocity[:] = rng.normal(size=swarm.velocity.shape)
        swarm.quaternion[:] = random_attitudes(rng, *rig.alive.shape)
        fast = FASTEST * rng.random((*rig.alive.shape, 1))
        swarm.rates[:] = fast * random_directions(rng, *rig.alive.shape)
        before = Swarm(*(array.copy() for array in swarm))
        rig.place().fly()
        motions = np.repeat(rig.dynamics.contact.space.motions, len(rig.alive))
        legs = _ends(motions, before, swarm, rig.rows, rig.dt)
        assert legs.max() > 5
        assert np.abs(motions["position"] - swarm.position[:, 0]).max() < 1e-12
        off = Rotation.from_quat(motions["quaternion"]).inv()
        assert (off * Rotation.from_quat(swarm.quaternion[:, 0])).magnitude().max() < 1e-7
