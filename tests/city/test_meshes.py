"""Objects of OBJ files that are not convex, not closed, or not on the ground."""

import itertools
import re
import subprocess
import sys

import numpy as np
import pytest
from city.meshes import ELL, OPEN_BOX, podium, prism, written
from scipy.spatial import ConvexHull

from bulletuav.city.import_report import MendedWarning
from bulletuav.city.imports import from_obj
from bulletuav.geometry import decomposer
from bulletuav.geometry.mesh import components, find_crossing, make_mesh, outside, outward, volume

SQUARE = [(50, 50), (60, 50), (60, 60), (50, 60)]
CUBE = make_mesh(*prism([(0, 0), (10, 0), (10, 10), (0, 10)], 10))


def volumes(city):
    """Volume of each piece of a city, m^3."""
    boxes = [np.ptp(box, axis=0).prod() for box in city.solids.boxes]
    return boxes + [ConvexHull(hull).volume for hull in city.solids.hulls]


def turned(points, angle=0.4):
    """Points turned about z."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def test_a_cube_by_hand():
    assert (outward(CUBE).triangles == CUBE.triangles).all()
    assert volume(CUBE) == pytest.approx(1000)
    assert volume(CUBE._replace(triangles=CUBE.triangles[:, ::-1])) == pytest.approx(-1000)
    assert volume(CUBE._replace(points=CUBE.points + 1e6)) == pytest.approx(1000)
    assert outward(CUBE._replace(triangles=CUBE.triangles[1:])) is None
    # Inside; beyond a side, an edge and a corner: 1, sqrt(2) and sqrt(3) m
    points = np.array([[5.0, 5, 5], [11, 5, 5], [11, 11, 5], [11, 11, 11], [-3, 5, 14]])
    assert outside(CUBE, points) == pytest.approx([0, 1, 2**0.5, 3**0.5, 5], abs=1e-9)


def test_distances_against_those_of_a_ball():
    hull = ConvexHull(np.random.default_rng(0).normal(size=(400, 3)))
    unit = hull.points / np.linalg.norm(hull.points, axis=1)[:, None]
    ball = ConvexHull(unit)
    mesh = outward(make_mesh(unit, ball.simplices.tolist()))  # which SciPy gives either way
    assert volume(mesh) == pytest.approx(ball.volume)
    normal = np.cross(*(unit[mesh.triangles[:, k]] - unit[mesh.triangles[:, 0]] for k in (1, 2)))
    assert ((normal * unit[mesh.triangles[:, 0]]).sum(axis=1) > 0).all()
    points = np.random.default_rng(1).normal(size=(50, 3)) * 2
    radius = np.linalg.norm(points, axis=1)
    # The mesh is inside of the ball, by less than its deepest facet
    depth = 1 + ball.equations[:, 3].max()
    found = outside(mesh, points)
    assert (found >= np.maximum(radius - 1, 0) - 1e-12).all()
    assert (found <= np.maximum(radius - 1 + depth, 0) + 1e-12).all()


def test_corners_that_faces_do_not_share_are_joined():
    points, faces = prism(ELL, 12)
    apart = [points[list(face)] for face in faces]
    numbers = itertools.count()
    mesh = make_mesh(np.concatenate(apart), [[next(numbers) for _ in face] for face in faces])
    assert volume(outward(mesh)) == pytest.approx(6000)
    assert len(mesh.points) == 12
    assert [len(part.points) for part in components(mesh)] == [12]


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_house_of_an_ell_is_cut_and_not_filled(obj, angle):
    points, faces = prism(ELL, 12)
    city = from_obj(obj(written(("house", turned(points, angle), faces))), side=100.0)
    assert sum(volumes(city)) == pytest.approx(6000)  # its hull has 8400
    assert city.building.tolist() == [0, 0]
    corner = turned(np.array([[20.0, 20, 0], [5, 20, 0], [20, 5, 0]]), angle)
    assert city.roof(corner) == pytest.approx([0, 12, 12])
    (split,) = city.report.splits
    assert (split.where, split.pieces) == ("object house", 2)
    assert split.mesh_volume == pytest.approx(6000)
    assert split.pieces_volume == pytest.approx(6000)
    assert split.beyond < 1e-9
    assert city.report.notes == ()


def test_a_house_inside_out_is_the_same_house(obj):
    points, faces = prism(ELL, 12)
    inward = [face[::-1] for face in faces]
    city = from_obj(obj(written(("house", points, inward))))
    assert sum(volumes(city)) == pytest.approx(6000)


@pytest.mark.parametrize("seed", range(4))
def test_faces_may_come_either_way(seed, obj):
    points, faces = prism(ELL, 12)
    rng = np.random.default_rng(seed)
    mixed = [face[::-1] if rng.random() < 0.5 else face for face in faces]
    city = from_obj(obj(written(("house", points, mixed))))
    assert sum(volumes(city)) == pytest.approx(6000)
    assert city.report.notes == ()
    found = outward(make_mesh(points, mixed))
    assert volume(found) == pytest.approx(6000)
    ways = {tuple(way) for way in found.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()}
    assert {way[::-1] for way in ways} == ways
    assert len(ways) == 3 * len(found.triangles)


def test_a_surface_of_one_side_has_no_inside():
    """The real projective plane of six points: each side is that of two triangles."""
    triangles = ["012", "023", "034", "045", "051", "124", "235", "341", "452", "513"]
    rows = [[int(k) for k in one] for one in triangles]
    points = np.random.default_rng(0).normal(size=(6, 3))
    assert outward(make_mesh(points, rows)) is None


def test_two_houses_that_touch_in_a_corner_are_two(obj):
    one, faces = prism([(0, 0), (10, 0), (10, 10), (0, 10)], 5)
    more = [tuple(k + len(one) for k in face) for face in faces]
    both = np.concatenate([one, one + [10, 10, 5]])
    assert [len(part.points) for part in components(make_mesh(both, faces + more))] == [8, 8]
    city = from_obj(obj(written(("twins", both, faces + more))), side=100.0)
    assert volumes(city) == pytest.approx([500, 500])
    assert components(CUBE._replace(triangles=CUBE.triangles[:0])) == []


def test_a_tower_on_a_podium_is_split_by_coacd(obj):
    points, faces = podium()
    text = written(("tower", points, faces), ("shop", *prism(SQUARE, 5)))
    city = from_obj(obj(text))
    (split,) = city.report.splits
    assert split.where == "object tower"
    assert split.mesh_volume == pytest.approx(15968)
    assert split.pieces_volume == pytest.approx(15968, rel=2e-3)
    assert split.pieces_volume == pytest.approx(sum(volumes(city)) - 500)
    assert 0 <= split.beyond < 0.1
    assert city.heights == pytest.approx([30, 5], abs=0.01)
    middle = -np.array([30.0, 30])
    assert city.roof(middle + [[15, 15], [35, 35]]) == pytest.approx([30, 8], abs=0.05)
    # What is above the podium does not cover the ground a second time
    assert city.coverage == pytest.approx(1700 / 3600, rel=2e-3)
    again = from_obj(obj(text))
    for one, two in zip(city.solids.hulls, again.solids.hulls, strict=True):
        np.testing.assert_array_equal(one, two)


def test_parts_of_an_object_that_share_no_corner_are_pieces_by_themselves(obj):
    one, faces = prism([(0, 0), (10, 0), (10, 10), (0, 10)], 5)
    both = np.concatenate([one, one + [30, 0, 0]])
    more = [tuple(k + len(one) for k in face) for face in faces]
    city = from_obj(obj(written(("twins", both, faces + more))))
    assert volumes(city) == pytest.approx([500, 500])
    assert city.building.tolist() == [0, 0]
    assert city.report.splits == ()


def test_meshes_that_are_not_closed_are_filled(obj):
    points, faces = prism(ELL, 12)
    path = obj(written(("house", points, faces[1:])))
    with pytest.warns(MendedWarning, match=r"1 meshes that are not closed.*\(object house\)"):
        city = from_obj(path)
    assert volumes(city) == pytest.approx([700 * 12])
    with pytest.raises(ValueError, match=r"town.obj, object house: its mesh is not closed"):
        from_obj(path, strict=True)


def test_plates_are_left_out(obj):
    plate = np.array([[0.0, 0, 0], [90, 0, 0], [90, 90, 0], [0, 90, 0]])
    path = obj(written(("ground", plate, [(0, 1, 2, 3)]), ("shop", *prism(SQUARE, 5))))
    with pytest.warns(MendedWarning, match=r"1 without a usable shape.*\(object ground\)"):
        city = from_obj(path, side=200.0)
    assert volumes(city) == [500]
    with pytest.raises(ValueError, match="object ground: it has no volume"):
        from_obj(path, strict=True)


@pytest.mark.parametrize("lift", [(412.0, 412.0), (400.0, 412.0)])
def test_absolute_elevations_do_not_float(obj, lift):
    one, faces = prism([(0, 0), (10, 0), (10, 10), (0, 10)], 6)
    two = one + [40, 0, 0]
    path = obj(written(("a", one + [0, 0, lift[0]], faces), ("b", two + [0, 0, lift[1]], faces)))
    city = from_obj(path)
    assert city.solids.bounds[..., 2].tolist() == [[0, 6], [0, 6]]
    assert city.report.counts == {"moved": 2}
    assert city.report.notes[0].what == f"it is moved by {-lift[0]:g} m"
    kept = from_obj(path, elevation="keep")
    assert kept.solids.bounds[:, 0, 2].tolist() == list(lift)
    assert kept.report.counts == {"above": 2}


def test_a_model_that_stands_on_the_ground_keeps_what_hangs(obj):
    house, faces = prism([(0, 0), (10, 0), (10, 10), (0, 10)], 6)
    bridge = house + [40, 0, 8]
    path = obj(written(("house", house, faces), ("bridge", bridge, faces)))
    city = from_obj(path)
    assert city.solids.bounds[:, 0, 2].tolist() == [0, 8]
    assert city.report.counts == {"above": 1}
    assert from_obj(path, elevation="ground").solids.bounds[:, 0, 2].tolist() == [0, 0]
    with pytest.raises(ValueError, match="unknown elevation 'sea'"):
        from_obj(path, elevation="sea")


def test_splitting_without_the_extra(obj, monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(ImportError, match=r"not convex needs the extra .*\[city\]'"):
        from_obj(obj(written(("tower", *podium()))))
    # What is convex needs nothing
    assert volumes(from_obj(obj(written(("shop", *prism(SQUARE, 5)))), side=200.0)) == [500]


def test_a_mesh_that_crashes_the_native_code_is_one_error_with_its_name(obj):
    """Its lower corner goes through the floor: CoACD 1.0.14 dies with SIGSEGV."""
    path = obj(f"o moved\n{OPEN_BOX}")
    with pytest.raises(
        ValueError,
        match=rf"^{re.escape(str(path))}, object moved: CoACD.*; its faces intersect each "
        r"other, for example at \(8\.88889.*repair the mesh",
    ):
        from_obj(path)


CHILDREN = {
    "hangs": ("import time; time.sleep(1000)", 0.2, "took longer than 0.2 s"),
    "fills": ("b'x' * 2**50", 60, r"needs more memory than [\d.]+ GiB"),
    "raises": ("raise SystemError('strange')", 60, r"failed \(SystemError: strange\)"),
    "aborts": ("import os; os.kill(os.getpid(), 6)", 60, "crashed with SIGABRT"),
    "dies": ("import os; os.kill(os.getpid(), 40)", 60, "crashed with signal 40"),
    "finds none": (
        "import sys, time; sys.stdout.buffer.write(bytes(8)); sys.stdout.flush(); sys.stdin.read()",
        60,
        "returned no pieces",
    ),
}


@pytest.mark.parametrize("way", CHILDREN)
def test_however_the_decomposition_ends_it_is_one_error(way, obj, tmp_path, monkeypatch):
    code, seconds, said = CHILDREN[way]
    (tmp_path / "child.py").write_text(code)
    monkeypatch.setattr(decomposer, "CHILD", tmp_path / "child.py")
    monkeypatch.setattr(decomposer, "MAX_SECONDS", seconds)
    with pytest.raises(ValueError, match=rf"town\.obj, object tower: CoACD.* {said}: repair"):
        from_obj(obj(written(("tower", *podium()))))


@pytest.mark.parametrize("crosses", [False, True])
def test_a_mesh_that_crosses_itself_has_less_time(crosses, obj, tmp_path, monkeypatch):
    """The other limit is never reached in the test, or is the one that counts."""
    (tmp_path / "child.py").write_text("import time; time.sleep(1000)")
    monkeypatch.setattr(decomposer, "CHILD", tmp_path / "child.py")
    monkeypatch.setattr(decomposer, "MAX_SECONDS_CROSSING", 0.1)
    monkeypatch.setattr(decomposer, "MAX_SECONDS", 600 if crosses else 0.3)
    text = f"o tower\n{OPEN_BOX}" if crosses else written(("tower", *podium()))
    said = (
        "0.1 s; its faces intersect each other, for example at .8.88889"
        if crosses
        else "0.3 s: repair"
    )
    with pytest.raises(ValueError, match=rf"town\.obj, object tower: CoACD.* longer than {said}"):
        from_obj(obj(text))


def test_objects_share_one_process_and_it_ends_with_them(monkeypatch):
    started = []

    class Popen(subprocess.Popen):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            started.append(self)

    monkeypatch.setattr(decomposer.subprocess, "Popen", Popen)
    mesh = outward(make_mesh(*podium()))
    with decomposer.Decomposer() as decompose:
        first, second = decompose(mesh, "a"), decompose(mesh, "b")
    assert [piece.tolist() for piece in first] == [piece.tolist() for piece in second]
    (process,) = started
    assert process.returncode is not None
    assert int(process.args[-1]) >= decomposer.MIN_MEMORY
    with decomposer.Decomposer():  # no mesh, no process
        pass
    assert len(started) == 1


def test_the_process_limits_its_memory():
    """To half of the machine's memory; the limit is that of the process alone."""
    code = (
        "import resource; from bulletuav.geometry import coacd_child as child;"
        "child.limit_memory(3 * 2**30); print(resource.getrlimit(resource.RLIMIT_AS)[0])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) == 3 * 2**30


def test_the_process_ends_with_a_parent_that_is_killed():
    """CoACD may never return, and then nothing else would end it."""
    child = (
        "import time; from bulletuav.geometry import coacd_child as child;"
        "child.end_with_parent(0.01); print('ready', flush=True); time.sleep(600)"
    )
    # The child has the standard error of both, which ends with the last of them
    parent = (
        "import os, subprocess, sys;"
        f"child = subprocess.Popen([sys.executable, '-c', {child!r}], stdout=subprocess.PIPE);"
        "child.stdout.readline(); os.kill(os.getpid(), 9)"
    )
    done = subprocess.run([sys.executable, "-c", parent], stderr=subprocess.PIPE, timeout=120)
    assert done.returncode == -9


def test_a_mesh_larger_than_a_world_never_reaches_coacd(obj, monkeypatch):
    """Of huge meshes CoACD makes pieces for minutes, which no world could hold."""
    monkeypatch.setattr(decomposer.Decomposer, "__call__", lambda *_: pytest.fail("it did"))
    points, faces = podium()
    with pytest.raises(ValueError, match=r"town\.obj has buildings.* less than 4096 m is needed"):
        from_obj(obj(written(("tower", 1e6 * np.asarray(points), faces))))


def test_where_a_mesh_crosses_itself():
    assert find_crossing(CUBE) is None
    assert find_crossing(outward(make_mesh(*podium()))) is None
    points, faces = prism([(0, 0), (10, 0), (10, 10), (0, 10)], 10)
    points[6] = [-5, 5, 5]  # a corner of the roof goes out through the wall x = 0
    place = find_crossing(make_mesh(points, faces))
    assert place is not None
    assert place[0] == pytest.approx(0)
    assert (place[1:] > 0).all()
    assert (place[1:] < 10).all()
