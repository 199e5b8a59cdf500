"""The files that Bullet loads drones from: rotors are discs of triangles."""

import re
import tempfile
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from bench import MULTIROTORS

from bulletuav import load_airframe, parallel_env
from bulletuav.engine.drones import ROUND, drawn_files

CYLINDER = '<geometry><cylinder radius="0.02313" length="0.002"/></geometry>'


def triangles(path):
    """Corners (T, 3, 3) of a binary STL file, and the normals (T, 3) that it tells."""
    data = path.read_bytes()
    rows = np.frombuffer(data, [("numbers", "<f4", 12), ("unused", "<u2")], offset=84)
    assert len(rows) == int.from_bytes(data[80:84], "little")
    numbers = rows["numbers"].reshape(-1, 4, 3).astype(float)
    return numbers[:, 1:], numbers[:, 0]


@pytest.mark.parametrize("name", MULTIROTORS)
def test_cylinders_that_are_drawn_become_discs_of_their_size(name):
    urdf = load_airframe(name).urdf
    with drawn_files([load_airframe(name)] * 2) as files:
        (file,) = files.values()
        drawn, told = (ElementTree.parse(path).getroot() for path in (file, urdf))
        sizes = [one.attrib for one in told.iterfind("link/visual/geometry/cylinder")]
        meshes = [one.attrib for one in drawn.iterfind("link/visual/geometry/mesh")]
        assert drawn.find("link/visual/geometry/cylinder") is None
        assert [one["scale"].split() for one in meshes] == [
            [size["radius"], size["radius"], size["length"]] for size in sizes
        ]
        assert len(drawn.findall("link/visual")) == len(told.findall("link/visual"))
        assert drawn.find("link/collision/geometry/cylinder") is not None
        corners, normals = triangles(file.parent / meshes[0]["filename"])
    assert not file.exists()
    assert np.linalg.norm(corners[..., :2], axis=-1) == pytest.approx(1, abs=1e-6)
    assert np.abs(corners[..., 2]) == pytest.approx(0.5)
    # Closed and outwards: by the divergence theorem its volume is that of the prism of ROUND sides.
    volume = np.einsum("ti,ti->t", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(ROUND / 2 * np.sin(2 * np.pi / ROUND), rel=1e-6)
    outwards = np.einsum("ti,ti->t", normals, corners.mean(axis=1))
    assert (outwards > 0.4).all()


def test_a_file_with_meshes_beside_it_stays_as_it_is(urdf, tmp_path):
    (tmp_path / "disc.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = '<geometry><mesh filename="disc.obj" scale="0.02 0.02 0.002"/></geometry>'
    airframe = load_airframe(urdf("cf2x", (CYLINDER, mesh)))
    with drawn_files([airframe]) as files:
        assert files == {airframe.urdf: airframe.urdf}


@pytest.mark.bullet
def test_a_cylinder_without_a_size_is_left_to_bullet_which_refuses_it(urdf):
    path = urdf("cf2x", (CYLINDER, CYLINDER.replace('radius="0.02313"', "")))
    with pytest.raises(ValueError, match=f"{path}: the engine cannot load it"):
        parallel_env("hover", airframe=path)


def test_drones_are_made_where_nothing_can_be_written(monkeypatch):
    def full(*arguments, **keywords):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.mkdtemp", full)
    airframe = load_airframe("cf2x")
    told = re.escape(f"({tempfile.gettempdir()}) cannot be written: [Errno 28]")
    with pytest.warns(UserWarning, match=f"{told}.*TMPDIR"), drawn_files([airframe]) as files:
        assert files == {airframe.urdf: airframe.urdf}
