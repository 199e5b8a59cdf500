import numpy as np
import pytest

from bulletuav import available_airframes, load_airframe
from bulletuav.geometry.shapes import BOX, CYLINDER
from bulletuav.vehicle.visuals import DEFAULT_COLOUR, read_visual_shapes


def test_the_crazyflie_looks_as_its_file_tells():
    parts = read_visual_shapes(load_airframe("cf2x"))
    assert [part.shape.kind for part in parts] == [BOX] * 3 + [CYLINDER] * 4
    assert parts[0].shape.half == (0.017, 0.015, 0.009)
    assert parts[0].colour == (0.12, 0.13, 0.16, 1.0)
    # The second arm is turned by -45 degrees, and refers to the material of the first.
    half = np.sin(np.pi / 8)
    np.testing.assert_allclose(parts[2].quaternion, (0, 0, -half, np.cos(np.pi / 8)), atol=1e-6)
    assert parts[2].colour == parts[1].colour == (0.25, 0.27, 0.3, 1.0)
    np.testing.assert_allclose(parts[3].position, (0.0325, -0.0325, 0.011))


@pytest.mark.parametrize("name", available_airframes())
def test_every_airframe_has_looks_near_its_body(name):
    airframe = load_airframe(name)
    for part in read_visual_shapes(airframe):
        assert np.linalg.norm(part.position) < 1.2 * airframe.collision_radius
        assert all(0 <= share <= 1 for share in part.colour)


def test_what_is_not_read_is_left_out(urdf, tmp_path):
    mesh = '<mesh filename="body.stl"/>'
    (tmp_path / "body.stl").write_bytes(bytes(84))
    changes = (
        ('<box size="0.034 0.03 0.018"/>', mesh),
        ("0.95 0.45 0.1 1", "orange"),
        ('<material name="arm"/>', ""),
    )
    parts = read_visual_shapes(load_airframe(urdf("cf2x", *changes)))
    assert [part.shape.kind for part in parts] == [BOX] * 2 + [CYLINDER] * 4
    assert parts[1].colour == parts[2].colour == DEFAULT_COLOUR


def test_without_looks_it_is_the_collision_shape(urdf):
    path = urdf("cf2x", ("<visual>", "<unseen>"), ("</visual>", "</unseen>"))
    airframe = load_airframe(path)
    (part,) = read_visual_shapes(airframe)
    assert part.shape == airframe.shape
    assert part.colour == DEFAULT_COLOUR
