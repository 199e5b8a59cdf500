"""Rays and shapes by hand, beside the engine's rays at bodies that rest, and point by point."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.engine.calls import bullet
from bulletuav.geometry.convex import make_shape_table
from bulletuav.geometry.raycast import cast_drone_rays
from bulletuav.geometry.shapes import BOX, CYLINDER, SPHERE, intersect_primitive
from bulletuav.vehicle.swarm import Swarm

HALF = {SPHERE: (0.5, 0.5, 0.5), CYLINDER: (0.5, 0.5, 0.2), BOX: (0.5, 0.3, 0.2)}


@pytest.mark.parametrize(
    ("kind", "start", "change", "shares"),
    [
        (SPHERE, (-2, 0, 0), (4, 0, 0), (0.375, 0.625)),  # from x = -0.5 to 0.5
        (CYLINDER, (-2, 0.3, 0), (4, 0, 0), (0.4, 0.6)),  # the chord at y = 0.3 ends at x = 0.4
        (CYLINDER, (0.1, 0, 1), (0, 0, -2), (0.4, 0.6)),  # through both faces
        # the faces at z = 0.2 are nearer than the side
        (CYLINDER, (-2, 0, -2), (4, 0, 4), (0.45, 0.55)),
        (BOX, (0, -1, 0), (0, 2, 0), (0.35, 0.65)),
        (BOX, (0, 0, 0), (1, 0, 0), (-0.5, 0.5)),  # from inside
    ],
)
def test_lines_through_shapes_by_hand(kind, start, change, shares):
    np.testing.assert_allclose(
        intersect_primitive(kind, HALF[kind], tuple(map(float, start)), tuple(map(float, change))),
        shares,
        atol=1e-12,
    )


@pytest.mark.parametrize("kind", HALF)
def test_lines_that_miss(kind):
    for start, change in (
        ((-2, 0.6, 0), (4, 0, 0)),
        ((0.6, 0, -1), (0, 0, 2)),
        ((-2, 0, 0.6), (4, 0, 0)),
        ((9, 9, 9), (0, 0, 0)),
    ):
        enters, leaves = intersect_primitive(
            kind, HALF[kind], tuple(map(float, start)), tuple(map(float, change))
        )
        assert enters > leaves


@pytest.mark.parametrize("kind", HALF)
def test_points_between_are_inside_and_the_others_outside(kind):
    rng = np.random.default_rng(0)
    half = np.array(HALF[kind])
    for start, change in zip(rng.uniform(-1, 1, (300, 3)), rng.normal(size=(300, 3)), strict=True):
        enters, leaves = intersect_primitive(kind, tuple(half), tuple(start), tuple(change))
        share = rng.uniform(-2, 2, 50)
        share = share[np.minimum(abs(share - enters), abs(share - leaves)) > 1e-6]
        point = start + share[:, None] * change
        within = {
            SPHERE: (point**2).sum(axis=1) < half[0] ** 2,
            CYLINDER: (np.hypot(point[:, 0], point[:, 1]) < half[0]) & (abs(point[:, 2]) < half[2]),
            BOX: (abs(point) < half).all(axis=1),
        }[kind]
        np.testing.assert_array_equal(within, (share > enters) & (share < leaves))


@pytest.mark.parametrize(
    "geometry",
    [
        '<cylinder radius="0.3" length="0.2"/>',
        '<box size="0.6 0.4 0.2"/>',
        '<sphere radius="0.3"/>',
    ],
)
def test_the_engine_sees_bodies_at_rest_the_same(urdf, geometry):
    text = bulletuav.load_airframe("hummingbird").urdf.read_text()
    old = re.search(r"<collision>.*?</collision>", text, re.DOTALL).group()
    airframe = bulletuav.load_airframe(
        urdf("hummingbird", (old, f"<collision><geometry>{geometry}</geometry></collision>"))
    )
    rng = np.random.default_rng(1)
    swarm, turn = Swarm.zeros(1, 1, 4), Rotation.random(rng=rng).as_quat()
    swarm.position[:], swarm.quaternion[:] = (1, 2, 3), turn
    client = bullet.connect(bullet.DIRECT)
    flags = bullet.URDF_USE_IMPLICIT_CYLINDER
    bullet.loadURDF(
        str(airframe.urdf), (1, 2, 3), turn.tolist(), flags=flags, physicsClientId=client
    )
    start = np.array((1, 2, 3)) + 2 * Rotation.random(2000, rng=rng).apply((1, 0, 0))
    end = 2 * np.array((1, 2, 3)) - start + rng.uniform(-0.4, 0.4, start.shape)
    hits = bullet.rayTestBatch(start, end, physicsClientId=client)
    reference = np.array([hit[2] for hit in hits])
    bullet.disconnect(client)
    fraction = np.ones(len(start))
    cast_drone_rays(
        fraction,
        start,
        end,
        np.zeros(len(start), dtype=int),
        swarm,
        np.ones((1, 1), dtype=bool),
        make_shape_table([airframe.shape]),
    )
    assert 0.2 < (fraction < 1).mean() < 1
    # The engine rounds edges, and iterates to its own tolerance.
    assert (np.abs(fraction - reference) > 1e-3).mean() < 0.01
