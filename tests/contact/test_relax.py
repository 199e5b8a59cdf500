"""Impulses at a point obey Coulomb's law, for any pair of bodies."""

import numpy as np
import pytest
from contact.rig import random_attitudes
from scipy.spatial.transform import Rotation

from bulletuav.compiled.kernel import kernel
from bulletuav.contact.constraint import CONTACT_POINT, set_inverse_mass
from bulletuav.contact.energy_limit import accumulate_impulses, reopen_impulses
from bulletuav.contact.manifold import fill_constraint
from bulletuav.contact.motion import MOTION
from bulletuav.contact.solver import (
    COLD_START,
    MAX_ITERATIONS,
    RESUME,
    SINGLE_BODY_TOLERANCE,
    TIGHT_TOLERANCE,
    solve_constraints,
)
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.parameters import parameter_rows

HITS = 300
STILL = (0.0, 0.0, 0.0)


@kernel
def prepare(motions, points, row, surface):
    """Fill in points of drone 0 as contacts do."""
    set_inverse_mass(motions[0], row)
    for k in range(points.shape[0]):
        fill_constraint(motions, points[k], surface)


def touches(friction):
    """What a surface is that does not move: see `Surface`."""
    return (0, -1, STILL, STILL, friction, 0.0, 0.0, STILL, (0.0, 0.0, 1.0))


def tumbling(rng, count):
    """A drone that moves at random, with points that are not filled in; gives its attitude, too."""
    motions = np.zeros(1, dtype=MOTION).view(np.recarray)
    points = np.zeros(count, dtype=CONTACT_POINT).view(np.recarray)
    turn = Rotation.from_quat(random_attitudes(rng, 1)[0])
    motions.quaternion[0] = turn.as_quat()
    motions.velocity[0], motions.spin[0] = rng.normal(0, 1, 3), rng.normal(0, 10, 3)
    return motions, points, turn


def hit(airframe, friction, seed):
    """Let the lowest point of a drone's rim hit the ground; gives point, drone and sweeps."""
    found = load_airframe(airframe)
    motions, points, turn = tumbling(np.random.default_rng(seed), 1)
    motions.velocity[0, 2] -= 1.0
    axis, (radius, _, half) = turn.apply([0, 0, 1]), found.shape.half
    out = np.array([0.0, 0.0, -1.0]) + axis[2] * axis
    out *= radius / np.linalg.norm(out)
    points.arm_a[0], points.normal[0] = out - half * np.sign(axis[2]) * axis, (0, 0, 1)
    prepare(motions, points, parameter_rows([found], [])[0], touches(friction))
    sweeps = solve_constraints(points, 1, motions, 1 / 240, TIGHT_TOLERANCE, COLD_START)
    return points[0], motions[0], sweeps


def outcome(airframe, friction, seed):
    """Return how a hit ended, after a check of Coulomb's law."""
    point, drone, sweeps = hit(airframe, friction, seed)
    slip = drone.velocity + np.cross(drone.spin, point.arm_a)
    pressed, rubbed = point.impulse[0], point.impulse[1:] @ point.tangent
    if pressed == 0.0:
        assert slip[2] >= 0.0
        assert not rubbed.any()
        return "parts"
    if sweeps == MAX_ITERATIONS:
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


@pytest.mark.parametrize("count", [2, 4, 6])
@pytest.mark.parametrize("friction", [0.7, 1.0, 2.0])
def test_energy_of_a_drone_that_is_wedged_does_not_grow(friction, count):
    """Points drive each other on by their friction there; with seeds over 100 they did."""
    found = load_airframe("cf2x")
    row = parameter_rows([found], [])[0]
    radius, _, half = found.shape.half
    for seed in (*range(100), 929, 1039, 1473):
        rng = np.random.default_rng(seed)
        motions, points, turn = tumbling(rng, count)
        for k in range(count):
            # Normals lean between the axis and the radius, as those of a rim may
            angle, lean, side = rng.uniform(0, 6.3), rng.uniform(0, 1.6), rng.choice([-1, 1])
            out, up = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, side])
            points.arm_a[k] = turn.apply(radius * out + half * up)
            points.normal[k] = turn.apply(-np.cos(lean) * out - np.sin(lean) * up)

        def energy(motions=motions, turn=turn):
            rates = turn.inv().apply(motions.spin[0])
            return row["mass"] * (motions.velocity[0] ** 2).sum() + row["inertia"] @ rates**2

        prepare(motions, points, row, touches(friction))
        before = energy()
        solve_constraints(points, count, motions, 1 / 240, SINGLE_BODY_TOLERANCE, COLD_START)
        assert energy() <= 1.001 * before


def test_friction_that_presses_harder_than_it_slows_is_found_too():
    """There the normal hardly yields to both together."""
    ends = [outcome("cf2x", 2.0, seed) for seed in range(HITS)]
    assert ends.count("slides") + ends.count("sticks") > 0.5 * HITS
    assert "open" not in ends


def test_a_point_that_comes_later_takes_its_share_of_what_another_held():
    """By hand: a drone that falls level onto a point beside its middle, then onto one on each side.

    The first alone has to push more than both together do.
    """
    found = load_airframe("cf2x")
    row = parameter_rows([found], [])[0]
    motions, points, _ = tumbling(np.random.default_rng(0), 2)
    motions.quaternion[0], motions.velocity[0], motions.spin[0] = (0, 0, 0, 1), (0, 0, -1), 0
    points.normal[:] = (0, 0, 1)
    points.arm_a[:] = (0.01, 0, 0), (-0.01, 0, 0)
    prepare(motions, points, row, touches(0.0))
    solve_constraints(points, 1, motions, 1 / 240, TIGHT_TOLERANCE, COLD_START)
    accumulate_impulses(points, 1)
    assert points.total_impulse[0, 0] == pytest.approx(
        1 / (1 / row["mass"] + 0.01**2 / row["inertia"][1])
    )
    assert motions.spin[0, 1] < -1.0
    reopen_impulses(points, 2)
    solve_constraints(points, 2, motions, 1 / 240, TIGHT_TOLERANCE, RESUME)
    accumulate_impulses(points, 2)
    np.testing.assert_allclose(points.total_impulse[:, 0], row["mass"] / 2)
    np.testing.assert_allclose(motions.velocity[0], 0, atol=1e-9)
    np.testing.assert_allclose(motions.spin[0], 0, atol=1e-7)


def test_passes_together_resist_rolling_no_more_than_the_normal_impulse_allows():
    rng = np.random.default_rng(3)
    found = load_airframe("cf2x")
    radius, _, half = found.shape.half
    row = parameter_rows([found], [])[0]
    resist = 0.4 * radius
    surface = (0, -1, STILL, STILL, 0.5, 0.0, 0.0, (resist, 0.0, 0.05 * radius), (0.0, 0.0, 1.0))
    again = 0
    for _ in range(HITS):
        motions, points, _ = tumbling(rng, 2)
        on_its_rim = Rotation.from_euler("x", 90, degrees=True)
        leaning = Rotation.from_rotvec(rng.normal(size=3) * (0.3, 0.3, 0))
        motions.quaternion[0] = (on_its_rim * leaning).as_quat()
        motions.velocity[0] = rng.normal(size=3) * (0.3, 0.3, 0.1) + (0, 0, -0.1)
        motions.spin[0] = 5 * rng.normal(size=3)
        points.normal[:] = (0, 0, 1)
        points.arm_a[:] = (0, half, -radius), (0, -half, -radius)
        prepare(motions, points, row, surface)
        solve_constraints(points, 1, motions, 1 / 60, SINGLE_BODY_TOLERANCE, COLD_START)
        accumulate_impulses(points, 1)
        acted = points.rolling_impulse.copy()
        motions.spin[0] *= 0.7  # as if tipping was damped
        solve_constraints(points, 1, motions, 1 / 60, SINGLE_BODY_TOLERANCE, COLD_START)
        accumulate_impulses(points, 1)
        acted += points.rolling_impulse
        # A second point is foreseen
        points.target_velocity[1] = rng.uniform(0, 0.5)
        reopen_impulses(points, 2)
        before = points.rolling_impulse.copy()
        solve_constraints(points, 2, motions, 1 / 60, SINGLE_BODY_TOLERANCE, RESUME)
        accumulate_impulses(points, 2)
        again += (points.rolling_impulse[0] != before[0]).any()
        acted += points.rolling_impulse - before
        most = points.rolling_limit * points.total_impulse[:, :1]
        assert (abs(acted) <= most + 1e-3 * most.max()).all()
    assert again > HITS / 2
