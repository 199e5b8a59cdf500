"""Impulses at a point obey Coulomb's law, whoever it is that hits whatever."""

import numpy as np
import pytest
from contact.rig import random_attitudes
from scipy.spatial.transform import Rotation

from bulletuav.contact.impulses import POINT, set_ease
from bulletuav.contact.motion import MOTION
from bulletuav.contact.points import fill
from bulletuav.contact.relax import FIRM, SWEEPS, relax
from bulletuav.kernel import kernel
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.parameters import parameter_rows

HITS = 300


@kernel
def prepare(motions, points, row, surface):
    """Fill in a point of drone 0 as contacts do."""
    set_ease(motions[0], row)
    fill(motions, points[0], surface)


def hit(airframe, friction, seed):
    """Let the lowest point of a drone's rim hit the ground; gives point, drone and sweeps."""
    found, rng = load_airframe(airframe), np.random.default_rng(seed)
    motions = np.zeros(1, dtype=MOTION).view(np.recarray)
    points = np.zeros(1, dtype=POINT).view(np.recarray)
    turn = Rotation.from_quat(random_attitudes(rng, 1)[0])
    motions.quaternion[0] = turn.as_quat()
    motions.velocity[0] = rng.normal(0.0, 1.0, 3) - (0.0, 0.0, 1.0)
    motions.spin[0] = rng.normal(0.0, 10.0, 3)
    axis, (radius, _, half) = turn.apply([0, 0, 1]), found.shape.half
    out = np.array([0.0, 0.0, -1.0]) + axis[2] * axis
    out *= radius / np.linalg.norm(out)
    points.arm_a[0], points.normal[0] = out - half * np.sign(axis[2]) * axis, (0, 0, 1)
    still = (0.0, 0.0, 0.0)
    surface = (0, -1, still, friction, 0.0, 0.0, still, (0.0, 0.0, 1.0))
    prepare(motions, points, parameter_rows([found], [])[0], surface)
    sweeps = relax(points, 1, motions, 1 / 240, FIRM)
    return points[0], motions[0], sweeps


def outcome(airframe, friction, seed):
    """Tell how a hit ended, after a check of what Coulomb's law asks for then."""
    point, drone, sweeps = hit(airframe, friction, seed)
    slip = drone.velocity + np.cross(drone.spin, point.arm_a)
    pressed, rubbed = point.impulse[0], point.impulse[1:] @ point.tangent
    if pressed == 0.0:
        assert slip[2] >= 0.0
        assert not rubbed.any()
        return "parts"
    if sweeps == SWEEPS:
        return "open"
    assert pressed > 0.0
    assert slip[2] == pytest.approx(0.0, abs=1e-7)
    if np.linalg.norm(slip) < 1e-7:
        assert np.linalg.norm(rubbed) <= friction * pressed * (1 + 1e-9)
        return "sticks"
    along = -slip / np.linalg.norm(slip)
    np.testing.assert_allclose(rubbed, friction * pressed * along, atol=1e-6 * pressed)
    return "slides"


@pytest.mark.parametrize("airframe", ["cf2x", "racer"])
@pytest.mark.parametrize("friction", [0.1, 0.5, 0.9])
def test_a_point_parts_sticks_or_slides_against_its_slip(airframe, friction):
    ends = [outcome(airframe, friction, seed) for seed in range(HITS)]
    assert {"parts", "sticks", "slides"} == set(ends)
    assert ends.count("slides") > 30


def test_friction_that_presses_harder_than_it_slows_is_found_too():
    """There the normal hardly yields to both: they are solved for one after the other."""
    ends = [outcome("cf2x", 2.0, seed) for seed in range(HITS)]
    assert ends.count("slides") + ends.count("sticks") > 0.5 * HITS
    assert "open" not in ends
