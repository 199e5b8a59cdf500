"""Airframes whose collision shape is the convex hull of a mesh, and the contact tag."""

import math

import bench
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav import load_airframe
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.geometry.shapes import HULL
from bulletuav.tasks import find_task
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.swarm import GROUND

CYLINDER = '<cylinder radius="0.0691" length="0.03"/>'
WEDGE = [(0.1, 0.06, -0.01), (0.1, -0.06, -0.01), (-0.1, 0.06, -0.01), (-0.1, -0.06, -0.01)]
WEDGE += [(-0.1, 0.06, 0.03), (-0.1, -0.06, 0.03)]
"""A wedge, 4 cm high at its tail and flat at its nose; its roof passes 1 cm over the origin"""


@pytest.fixture
def hull_urdf(tmp_path, urdf):
    """Writes a cf2x whose collision shape is a mesh of corners: hull_urdf(corners, scale)."""

    def write(corners, scale="1 1 1", lines=""):
        text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + lines
        # Faces in which all corners are; which they are does not matter.
        text += "".join(f"f 1 2 {k}\n" for k in range(3, len(corners) + 1))
        (tmp_path / "hull.obj").write_text(text)
        return urdf("cf2x", (CYLINDER, f'<mesh filename="hull.obj" scale="{scale}"/>'))

    return write


def test_a_hull_by_hand(hull_urdf):
    """Points within the hull are no corners of it; the scale counts before all else."""
    airframe = load_airframe(hull_urdf([*WEDGE, (0.01, 0, 0)], "2 2 2"))
    assert airframe.shape.kind == HULL
    corners = np.array(airframe.shape.corners)
    np.testing.assert_allclose(
        corners[np.lexsort(corners.T)], 2 * np.array(WEDGE)[np.lexsort(np.array(WEDGE).T)]
    )
    assert airframe.shape.half == pytest.approx((0.2, 0.12, 0.06))
    assert airframe.collision_radius == pytest.approx(2 * math.hypot(0.1, 0.06, 0.03))
    # The ball about the mean of the corners (-1/30, 0, 1/300) rests on the bottom, or the roof:
    # 0.3 + x - 5 z = 0.25 there, over the length of (1, 0, 5).
    roof = (0.05 + 1 / 30 - 5 / 300) / math.sqrt(26)
    assert airframe.thinnest == pytest.approx(4 * min(1 / 300 + 0.01, roof))
    assert load_airframe(airframe.urdf) == airframe
    hash(airframe)


@pytest.mark.parametrize(
    ("corners", "scale", "lines", "said"),
    [
        (WEDGE, "0 1 1", "", "<mesh scale> is 0 1 1: it must be above 0"),
        (WEDGE, "1 1", "", "<mesh scale> is 1 1: three numbers"),
        (WEDGE, "nan 1 1", "", "<mesh scale> is nan 1 1: three numbers"),
        (WEDGE, "1e4 1 1", "", "its extents must be from 0.0001 to 100 m"),
        (WEDGE, "1 1 1e-5", "", "its extents must be from 0.0001 to 100 m"),
        (WEDGE[:3], "1 1 1", "", "spans no volume"),
        (np.array(WEDGE) + 1, "1 1 1", "", "must be within its convex hull"),
        (WEDGE, "1 1 1", "f 1 2 7\n", "line 7 is 'f 1 2 7': it cannot be read"),
        (WEDGE, "1 1 1", "v 1 2\n", "line 7 is 'v 1 2': it cannot be read"),
        (WEDGE, "1 1 1", "v 1 2 nan\n", "line 7 is 'v 1 2 nan': it cannot be read"),
        ([], "1 1 1", "", "faces are needed"),
        (
            Rotation.random(300, rng=np.random.default_rng(0)).apply((0.1, 0, 0)),
            "1 1 1",
            "",
            "the hull has 300 corners, at most 256 are supported",
        ),
    ],
)
def test_meshes_that_cannot_be(hull_urdf, corners, scale, lines, said):
    with pytest.raises(ValueError, match="own.urdf: <mesh") as error:
        load_airframe(hull_urdf(corners, scale, lines))
    assert said in str(error.value)


@pytest.mark.parametrize("name", ["", "../hull.stl", "gone.obj"])
def test_a_mesh_must_be_an_obj_beside_the_urdf(urdf, name):
    path = urdf("cf2x", (CYLINDER, f'<mesh filename="{name}"/>'))
    with pytest.raises(ValueError, match="next to the URDF is needed"):
        load_airframe(path)


def test_rays_meet_a_hull_drone_and_the_engine_loads_it(hull_urdf):
    """The wedge's nose points to the east: from above, its roof is 1 cm over the origin."""
    one = bench.Bench("bullet", hull_urdf(WEDGE), effects=())
    one.place()
    start = np.array([(0, 0, 11.0), (0.0, 0, 9), (1, 0, 9.995), (0, 1, 10.2)])
    end = np.array([(0, 0, 9.0), (0.0, 0, 11), (-1, 0, 9.995), (0, -1, 10.2)])
    share = one.engine.cast_rays(start, end, np.zeros(4, dtype=int), (one.swarm, one.alive))
    # At 5 mm below the origin the roof begins at x = 0.075.
    np.testing.assert_allclose(share, (0.99 / 2, 0.99 / 2, 0.925 / 2, 1), atol=1e-12)
    low, high = bulletuav.engine.engine.bullet.getAABB(
        one.engine._bullet.bodies.drone[0, 0], physicsClientId=one.engine._bullet.client
    )
    np.testing.assert_allclose(np.subtract(high, low), (0.2, 0.12, 0.04), atol=7e-3)
    one.engine.close()


def test_a_hull_falls_to_the_ground(hull_urdf):
    one = bench.Bench("bullet", hull_urdf(WEDGE), effects=())
    one.swarm.position[..., 2] = 0.5
    touched = one.place().spin(0.0, decisions=10)
    for _ in range(20):
        touched = one.fly(SetpointLevel.ROTOR, np.zeros(4))
    assert GROUND in touched.other
    assert one.swarm.position[0, 0, 2] > 0
    one.engine.close()


@pytest.mark.parametrize("attitude", [(0, 0), (0, 40), (180, 0), (25, -70)])
def test_starts_count_the_lowest_corner(hull_urdf, attitude):
    """A start whose lowest corner is a hair below the ground is refused, one above it taken."""
    airframe = load_airframe(hull_urdf(WEDGE))
    turn = Rotation.from_euler("xy", attitude, degrees=True)
    lowest = -turn.apply(WEDGE)[:, 2].min()

    def make(height):
        class Low(find_task("hover")):
            name = "low"

            def spawn(self, rng):
                start = np.array([(0.0, 0, height)])
                goal = np.array([(0.0, 0, 1)])
                return bulletuav.tasks.base.Spawn(start, goal, quaternion=turn.as_quat()[None])

        aviary = bulletuav.Aviary(Low, num_drones=1, airframe=airframe, dynamics="rigid_body")
        try:
            aviary.reset(seeds=0)
        finally:
            aviary.close()

    make(lowest + 1e-5)
    with pytest.raises(ValueError, match=f"reaches {lowest:g} m down"):
        make(lowest - 2e-3)


def test_friction_and_restitution(urdf):
    plain = load_airframe("cf2x")
    assert (plain.friction, plain.restitution) == (0.5, 0.0)
    tag = '<contact friction="0.9" restitution="0.25"/>'
    own = load_airframe(urdf("cf2x", ("<airframe>", f"<airframe>{tag}")))
    assert (own.friction, own.restitution) == (0.9, 0.25)
    rows = parameter_rows([plain, own])
    np.testing.assert_array_equal(rows["friction"], (0.5, 0.9))
    np.testing.assert_array_equal(rows["restitution"], (0, 0.25))
    half = load_airframe(urdf("cf2x", ("<airframe>", '<airframe><contact friction="2"/>')))
    assert (half.friction, half.restitution) == (2, 0)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ('friction="11"', "<contact friction> is 11.0: at most 10 is possible"),
        ('friction="-1"', "<contact friction> is -1: it must be finite and at least 0"),
        ('restitution="1.1"', "<contact restitution> is 1.1: at most 1 is possible"),
        ('restitution="x"', "<contact restitution> is x: a number is needed"),
    ],
)
def test_friction_and_restitution_that_cannot_be(urdf, numbers, said):
    path = urdf("cf2x", ("<airframe>", f"<airframe><contact {numbers}/>"))
    with pytest.raises(ValueError, match="own.urdf") as error:
        load_airframe(path)
    assert said in str(error.value)
