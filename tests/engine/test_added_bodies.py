"""Bodies that users add: sources, poses, rays, contacts, pictures and the table of what stands."""

import sys
import warnings

import numpy as np
import pytest
from city.meshes import OPEN_BOX
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.engine.calls import bullet
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.scenery import NOWHERE
from bulletuav.geometry.shapes import BOX, CYLINDER, HALF_SPACE, HULL, SPHERE
from bulletuav.geometry.solids import Solids, box_corners
from bulletuav.geometry.view import OBSTACLE, CameraMatrices, projection_matrix, view_matrix
from bulletuav.sensors.sight import clearances
from bulletuav.vehicle.swarm import FIRST_OBSTACLE

LEVEL = (0.0, 0.0, 0.0, 1.0)
QUARTER = tuple(Rotation.from_euler("z", 90, degrees=True).as_quat().tolist())
CUBE = box_corners(np.array([(-1.0, -1, -1), (1, 1, 1)]))
GATE = """<robot name="gate"><link name="gate">
  <collision><origin xyz="0 2 1.5" rpy="0 0 0"/>
    <geometry><box size="0.2 0.2 3"/></geometry></collision>
  <collision><origin xyz="0 -2 1.5"/>
    <geometry><cylinder radius="0.1" length="3"/></geometry></collision>
  <collision><origin xyz="0 0 3.1" rpy="1.5707963267948966 0 0"/>
    <geometry><cylinder radius="0.1" length="4"/></geometry></collision>
  <collision><origin xyz="0 0 4"/><geometry><sphere radius="0.5"/></geometry></collision>
  <collision><origin xyz="9 0 1" rpy="0 0 1.5707963267948966"/>
    <geometry><mesh filename="ridge.obj"/></geometry></collision>
</link></robot>"""
RIDGE = "v 0 -1 -1\nv 0 1 -1\nv 4 -1 -1\nv 4 1 -1\nv 0 0 1\nv 4 0 1\n"
RIDGE += "f 1 2 4 3\nf 1 5 2\nf 3 4 6\nf 1 3 6 5\nf 2 5 6 4\n"
"""A roof of 4 m along x, from x = 0 on"""


@pytest.fixture
def gate(tmp_path):
    (tmp_path / "ridge.obj").write_text(RIDGE)
    (tmp_path / "gate.urdf").write_text(GATE)
    return tmp_path / "gate.urdf"


def cast(engine, start, end, world=0):
    start, end = np.atleast_2d(np.asarray(start, float)), np.atleast_2d(np.asarray(end, float))
    return engine.cast_rays(start, end, np.full(len(start), world))


@pytest.mark.parametrize("rays", ["compiled", "bullet"])
def test_a_gate_by_hand(make_bench, gate, rays):
    """Turned by a quarter about z its posts stand at x = -2 and 2 of (100, 50)."""
    one = make_bench("bullet", rays=rays)
    one.engine.add_body(gate, (100.0, 50.0, 0.0), QUARTER)
    place = np.array((100.0, 50.0, 0.0))
    starts = [(-2, -5, 1), (2, -5, 1), (0, -5, 1), (0, -5, 3.1), (0, -5, 4)]
    ends = [(-2, 5, 1), (2, 5, 1), (0, 5, 1), (0, 5, 3.1), (0, 5, 4)]
    # Posts, nothing between them, the beam above, and the ball on it.
    expected = (4.9 / 10, 4.9 / 10, 1, 4.9 / 10, 4.5 / 10)
    share = cast(one.engine, place + starts, place + ends)
    near = 1e-12 if rays == "compiled" else 1e-3
    np.testing.assert_allclose(share, expected, atol=near)
    # The ridge begins at (0, 9, 1) in the turned gate, and its own quarter turns it to -x. Half a
    # metre beside its top, 2 m high, it is 1 m high.
    ridge = cast(one.engine, place + [(-1, 9.5, 5), (1, 9, 5)], place + [(-1, 9.5, 0), (1, 9, 0.1)])
    np.testing.assert_allclose(ridge, (4 / 5, 1), atol=near)


def test_all_sources_make_the_same_cube(make_bench, tmp_path):
    """A box, its corners, and a file of two objects, the second of which is far."""
    far = CUBE + (50, 0, 0)
    near_lines, far_lines = (
        [f"v {x} {y} {z}" for x, y, z in cube.tolist()] for cube in (CUBE, far)
    )
    sides = (1, 2, 4, 3), (5, 6, 8, 7), (1, 2, 6, 5), (3, 4, 8, 7), (1, 3, 7, 5), (2, 4, 8, 6)
    faces = [[f"f {a} {b}//1 {c}/2/3 {d}" for a, b, c, d in sides]]
    faces += [[f"f {a - 9} {b - 9} {c - 9} {d - 9}" for a, b, c, d in sides]]
    each = ["o near", *near_lines, *faces[0], "o far", *far_lines, *faces[1]]
    (tmp_path / "each.obj").write_text("\n".join(each))
    last = [*near_lines, *far_lines, "o near", *faces[0], "o empty", "o far", *faces[1]]
    (tmp_path / "last.obj").write_text("# all corners first\n\n" + "\n".join(last))
    rng = np.random.default_rng(0)
    start = rng.uniform((-8, -8, 1), (8, 8, 20), (500, 3))
    end = (0, 0, 10) + rng.uniform(-1.5, 1.5, (500, 3))
    turn = Rotation.random(rng=rng).as_quat()
    shares = []
    for source in (
        Obstacle("box", (2.0, 2.0, 2.0)),
        Obstacle("hull", corners=CUBE),
        CUBE,
        CUBE.tolist(),
        tmp_path / "each.obj",
        str(tmp_path / "last.obj"),
    ):
        engine = make_bench("point_mass").engine
        engine.add_body(source, (0, 0, 10), turn)
        shares.append(cast(engine, start, end))
        if isinstance(source, str) or str(source).endswith("obj"):
            assert engine.scenery.place.shape == (1, 2, 3)
            apart = engine.scenery.place[0, 1] - engine.scenery.place[0, 0]
            np.testing.assert_allclose(
                apart, Rotation.from_quat(turn).apply((50, 0, 0)), atol=1e-12
            )
        np.testing.assert_allclose(shares[-1], shares[0], atol=1e-12)
    assert 0.1 < (shares[0] < 1).mean() < 0.9


def test_the_table_of_what_stands(make_bench, gate):
    """Drones, obstacles, bodies in the order in which they came, the city, and the ground."""
    ramp = np.array([(10.0, -5, 0), (20, -5, 0), (20, -5, 10), (10, 5, 0), (20, 5, 0), (20, 5, 10)])
    towers = Solids(np.array([[(20.0, -5, 0), (40, 5, 60)]]), (ramp,))
    other_tower = Solids(np.array([[(0.0, 0, 0), (2, 4, 6)]]))
    obstacles = (Obstacle("sphere", (2.0,), friction=0.7), Obstacle("cylinder", (1.0, 4.0)))
    one = make_bench(
        "bullet", worlds=2, drones=2, obstacles=obstacles, layouts=(towers, other_tower)
    )
    place = np.array([[(1.0, 2, 3), (4, 5, 6)]] * 2)
    turn = np.tile(QUARTER, (2, 2, 1))
    one.engine.set_obstacles(place, turn, np.array([True, False]))
    assert one.engine.add_body(CUBE, (7, 8, 9), world=1, friction=2) == FIRST_OBSTACLE - 2
    assert one.engine.add_body(gate, (0, 0, 0), restitution=0.5) == FIRST_OBSTACLE - 3
    scenery = one.engine.scenery
    assert (scenery.first_body, scenery.first_piece, scenery.ground) == (2, 10, 13)
    kinds = [CYLINDER] * 2 + [SPHERE, CYLINDER, HULL, BOX, CYLINDER, CYLINDER, SPHERE, HULL]
    kinds += [BOX, HULL, BOX, HALF_SPACE]
    assert scenery.table.kind.tolist() == kinds
    assert scenery.other.tolist() == [-3, -4, -5, *[-6] * 5]
    np.testing.assert_array_equal(scenery.friction, [0.7, 0.5, 2, *[0.5] * 5])
    np.testing.assert_array_equal(scenery.restitution, [0, 0, 0, *[0.5] * 5])
    np.testing.assert_array_equal(scenery.place[0, :2], place[0])
    np.testing.assert_array_equal(scenery.quaternion[0, :2], turn[0])
    np.testing.assert_array_equal(scenery.place[1, :2], NOWHERE)
    np.testing.assert_array_equal(scenery.place[:, 2], [(NOWHERE,) * 3, (7, 8, 9)])
    np.testing.assert_array_equal(scenery.piece_place, [(30, 0, 30), (15, 0, 5), (1, 2, 3)])
    np.testing.assert_array_equal(scenery.table.half[10], (10, 5, 30))
    assert scenery.city_grid is one.engine.city_grid
    # Corners and faces stay with their hulls: the city's came first, and stand last.
    for s, half, faces in ((4, (1, 1, 1), 6), (9, (2, 1, 1), 5), (11, (5, 5, 5), 5)):
        first, last = scenery.table.vertex_range[s]
        corners = scenery.table.vertices[first:last]
        np.testing.assert_allclose(np.abs(corners).max(axis=0), half)
        np.testing.assert_allclose(scenery.table.half[s], half)
        planes = slice(*scenery.table.face_range[s])
        equation = scenery.table.face_planes[planes]
        assert len(equation) == faces
        assert (corners @ equation[:, :3].T - equation[:, 3] < 1e-9).all()
        for (begin, end), plane in zip(
            scenery.table.face_vertex_range[planes], equation, strict=True
        ):
            ring = scenery.table.vertices[scenery.table.face_vertices[begin:end]]
            np.testing.assert_allclose(ring @ plane[:3], plane[3], atol=1e-9)


def test_a_body_stands_in_one_world_or_in_all(make_bench):
    one = make_bench("point_mass", worlds=3)
    one.engine.add_body(CUBE, (0, 0, 5), world=1)
    assert [float(cast(one.engine, (-5, 0, 5), (5, 0, 5), w)[0]) for w in range(3)] == [1, 0.4, 1]
    one.engine.add_body(CUBE, (-3, 0, 5))
    shares = [float(cast(one.engine, (-9, 0, 5), (1, 0, 5), w)[0]) for w in range(3)]
    assert shares == pytest.approx([0.5] * 3)


def test_sensors_dynamics_and_the_ground_effect_know_it(make_bench):
    one = make_bench("bullet")
    other = one.engine.add_body(Obstacle("cylinder", (1.0, 2.0)), (0, 0, 1))
    one.swarm.position[:] = (0, 0, 3)
    one.place()
    half = one.airframe.thinnest / 2
    assert clearances(one.engine, one.swarm, one.alive, 50.0)[0] == pytest.approx(1 - half)
    assert one.engine.surface_below(one.swarm.position, one.alive)[0] == pytest.approx(2)
    touched = [one.fly(SetpointLevel.ROTOR, np.zeros(4)).other.tolist() for _ in range(10)]
    assert {other} == {who for found in touched for who in found}


def test_it_stays_through_resets_and_is_seen_in_pictures(gate):
    aviary = bulletuav.Aviary("hover", num_drones=1, render_mode="rgb_array")
    assert aviary.add_body(gate, (6.0, 0.0, 0.0)) == FIRST_OBSTACLE
    aviary.reset(seeds=0)
    aviary.render(collision=True)
    aviary.reset(seeds=0)
    assert not aviary.line_of_sight((0, 0, 4), (9, 0, 4))[0]
    view = view_matrix(np.array((0.0, 0, 4)), np.array((6.0, 0, 4)))
    shot = CameraMatrices(view, projection_matrix(1.0, 60.0), (80, 80))
    picture = aviary.worlds.engine.picture(0, shot)
    ball = picture.labels[40, 40], float(picture.depth[40, 40])
    assert ball == (OBSTACLE, pytest.approx(5.5, abs=0.05))
    aviary.close()


def test_who_makes_bodies_behind_our_back_is_told_of_add_body():
    aviary = bulletuav.Aviary("hover", num_drones=1)
    for count in (1, 2):
        bullet.createMultiBody(0, -1, -1, physicsClientId=aviary.worlds.engine._bullet.client)
        with pytest.warns(UserWarning, match=f"that bulletuav did not create: {count};.*add_body"):
            aviary.reset(seeds=0)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            aviary.reset(seeds=0)
    aviary.close()


@pytest.mark.parametrize(
    ("source", "options", "said"),
    [
        ("x.stl", {}, "body is 'x.stl': pass the path of a URDF"),
        (np.zeros((3, 3)), {}, "corners of a body: .* spans no volume"),
        ("text", {}, "body is 'text'"),
        (3, {}, "corners of a body is 3"),
        (CUBE * 1e4, {}, "farther out than 4096 m"),
        (CUBE, {"position": (0, 0)}, r"position is \(0, 0\)"),
        (CUBE, {"position": (0, 0, 1e9)}, "position is 1e.09: at most 4096"),
        (CUBE, {"quaternion": (0, 0, 0, 2)}, "quaternion is .*: a length of 1 is needed"),
        (CUBE, {"friction": 11}, "friction is 11: at most 10"),
        (CUBE, {"restitution": -1}, "restitution is -1: at least 0"),
        (CUBE, {"world": 1}, "world is 1"),
    ],
)
def test_bodies_that_cannot_be(source, options, said):
    aviary = bulletuav.Aviary("hover", num_drones=1)
    with pytest.raises(ValueError, match=said):
        aviary.add_body(source, **{"position": (0, 0, 0), **options})
    aviary.close()
    with pytest.raises(RuntimeError, match="closed"):
        aviary.add_body(CUBE, (0, 0, 0))


def test_files_that_cannot_be(make_bench, tmp_path):
    engine = make_bench("point_mass").engine
    with pytest.raises(FileNotFoundError, match="gone.urdf"):
        engine.add_body(tmp_path / "gone.urdf", (0, 0, 0))
    for text, said in (
        ('<link name="a"/>', "<collision> is missing: a body needs one shape or more"),
        ('<link name="a"/><link name="b"/>', "exactly one link without a parent"),
        (
            '<link name="a"><collision><origin xyz="0 0 x"/><geometry><sphere radius="1"/>'
            "</geometry></collision></link>",
            "<origin xyz> is 0 0 x: three numbers",
        ),
    ):
        (tmp_path / "own.urdf").write_text(f"<robot>{text}</robot>")
        with pytest.raises(ValueError, match=said):
            engine.add_body(tmp_path / "own.urdf", (0, 0, 0))
    objects = [
        f"o {k}\nv 0 0 {k}\nv 1 0 {k}\nv 0 1 {k}\nv 0 0 {k + 1}\n"
        "f -1 -2 -3\nf -1 -2 -4\nf -1 -3 -4\nf -2 -3 -4"
        for k in range(1025)
    ]
    (tmp_path / "many.obj").write_text("\n".join(objects))
    with pytest.raises(ValueError, match="1025 pieces: at most 1024"):
        engine.add_body(tmp_path / "many.obj", (0, 0, 0))


def test_bodies_that_are_made_at_the_first_picture_look_like_those_made_before():
    """Until then obstacles and bodies are only noted, so that flights need no PyBullet."""
    pictures = []
    for early in (False, True):
        obstacles = [Obstacle("sphere", (0.5,))]
        options = {"dynamics": "point_mass", "obstacles": obstacles}
        with bulletuav.Airspace([(0.0, 0.0, 1.0)], **options) as airspace:
            if early:
                airspace.world.engine.make_bodies()
            airspace.place_obstacle(0, (3.0, 1.0, 1.0))
            airspace.add_body(
                np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 2)]), (3.0, -1.0, 0)
            )
            assert airspace.world.engine._is_made == early
            shot = airspace.shot(None, (-1.0, 0, 2), (0, 0, 0, 1), (3.0, 0, 1), (64, 48), 60.0)
            pictures.append(airspace.world.engine.picture_by_bullet(0, shot))
    assert (pictures[0].labels == OBSTACLE).sum() > 100
    for one, other in zip(*pictures, strict=True):
        np.testing.assert_array_equal(one, other)


def ring(radius=1.0, thick=0.15, sides=16, round_sides=8):
    """Corners and faces of a torus about the x axis, m."""
    around, across = (2 * np.pi * np.arange(n) / n for n in (sides, round_sides))
    a, b = np.meshgrid(around, across, indexing="ij")
    far = radius + thick * np.cos(b)
    points = np.stack([thick * np.sin(b), far * np.cos(a), far * np.sin(a)], -1).reshape(-1, 3)
    faces = [
        (i * n + j, k * n + j, k * n + m, i * n + m)
        for n in [round_sides]
        for i, k in zip(range(sides), np.roll(range(sides), -1), strict=True)
        for j, m in zip(range(n), np.roll(range(n), -1), strict=True)
    ]
    return points, faces


def format_obj(points, faces):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(points, float).tolist()]
    return "\n".join([*lines, *("f " + " ".join(str(k + 1) for k in face) for face in faces), ""])


@pytest.mark.parametrize("kind", ["obj", "urdf"])
def test_a_ring_has_a_hole(make_bench, tmp_path, kind):
    """Rays pass its hole and hit its rim; a drone flies through, and touches the rim."""
    (tmp_path / "ring.obj").write_text(format_obj(*ring()))
    mesh = '<geometry><mesh filename="ring.obj" scale="2 2 2"/></geometry>'
    (tmp_path / "ring.urdf").write_text(
        f'<robot name="r"><link name="l"><collision concave="yes">{mesh}</collision></link></robot>'
    )
    size = 2.0 if kind == "urdf" else 1.0
    one = make_bench("bullet")
    middle = np.array((0.0, 0.0, 10.0))
    other = one.engine.add_body(tmp_path / f"ring.{kind}", middle)
    assert one.engine.scenery.place.shape[1] > 5
    turn = np.radians(np.arange(0, 360, 15))
    around = size * np.stack([np.zeros(24), np.cos(turn), np.sin(turn)], axis=1)
    for radius, is_hit in ((0.0, False), (0.7, False), (0.95, True), (1.3, False)):
        start = middle + radius * around - (2, 0, 0)
        assert ((cast(one.engine, start, start + (4, 0, 0)) < 1) == is_hit).all()
    # At the middle of the rim the torus begins 0.15 m before it, within CoACD's tolerance
    start = middle + (0.0, size * np.cos(np.pi / 16), size * np.sin(np.pi / 16)) - (2, 0, 0)
    share = cast(one.engine, start, start + (4, 0, 0))
    assert 4 * share[0] == pytest.approx(2 - 0.15 * size, abs=0.03 * size)
    if kind == "urdf":
        contacts = []
        for y in (0.0, 2.0):
            one.swarm.position[:] = middle + (-1, y, 0)
            one.swarm.velocity[:] = (5, 0, 0)
            one.swarm.quaternion[:] = (0, 0, 0, 1)
            one.place()
            contacts.append(set())
            for _ in range(5):
                contacts[-1] |= set(one.fly(SetpointLevel.ROTOR, np.zeros(4)).other.tolist())
        assert contacts[0] == set()
        assert contacts[1] == {other}


def test_a_cup_of_several_links(make_bench, tmp_path):
    """Floor and four walls: links at fixed joints, one of them turned by a quarter."""
    text = '<robot name="cup"><link name="floor"><collision><geometry><box size="2 2 0.1"/>'
    text += "</geometry></collision></link>"
    for k, (x, y, yaw) in enumerate(((1, 0, 0), (-1, 0, 0), (0, 1, 1), (0, -1, 1))):
        text += f'<link name="w{k}"><collision><origin xyz="0 0 0.5"/><geometry>'
        text += '<box size="0.1 2 1"/></geometry></collision></link>'
        text += f'<joint name="j{k}" type="fixed"><parent link="floor"/><child link="w{k}"/>'
        text += f'<origin xyz="{x} {y} 0" rpy="0 0 {yaw * np.pi / 2}"/></joint>'
    (tmp_path / "cup.urdf").write_text(text + "</robot>")
    engine = make_bench("point_mass").engine
    engine.add_body(tmp_path / "cup.urdf", (0, 0, 10))
    starts = [(0, 0, 15), (-5, 0, 10.5), (0, -5, 10.5), (0.5, 0.5, 15), (-5, 0, 11.5)]
    ends = [(0, 0, 5), (5, 0, 10.5), (0, 5, 10.5), (0.5, 0.5, 5), (5, 0, 11.5)]
    share = cast(engine, starts, ends)
    np.testing.assert_allclose(share, (0.495, 0.395, 0.395, 0.495, 1), atol=1e-12)
    (tmp_path / "cup.urdf").write_text((text + "</robot>").replace("fixed", "revolute", 1))
    with pytest.raises(ValueError, match="j0, type revolute: only joints of type fixed"):
        engine.add_body(tmp_path / "cup.urdf", (0, 0, 10))


def test_meshes_that_have_no_inside(make_bench, tmp_path, monkeypatch):
    engine = make_bench("point_mass").engine
    path = tmp_path / "own.obj"

    def add(points, faces):
        path.write_text(format_obj(points, faces))
        engine.add_body(path, (0, 0, 10))

    points, faces = ring()
    with pytest.raises(ValueError, match="own.obj: object 0 is neither convex nor closed"):
        add(points, faces[1:])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    inner = [[k + 8 for k in side[::-1]] for side in sides]
    with pytest.raises(ValueError, match="has a cavity"):
        add(np.concatenate([CUBE, 0.8 * CUBE]), [*sides, *inner])
    with pytest.raises(ValueError, match="cover 83.3 % of its convex hull.*close the mesh"):
        add(CUBE, sides[:5])
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(ImportError, match=r"not convex needs the extra .*\[city\]'"):
        add(1.01 * points, faces)
    add(CUBE, sides)


def test_a_mesh_that_crashes_the_native_code_is_one_error(make_bench, tmp_path):
    (tmp_path / "open_box.obj").write_text(OPEN_BOX)
    engine = make_bench("point_mass").engine
    with pytest.raises(ValueError, match=r"open_box.obj: object 0: CoACD.*intersect.*repair"):
        engine.add_body(tmp_path / "open_box.obj", (0, 0, 10))


def test_a_mesh_of_too_many_objects_is_not_split(make_bench, tmp_path, monkeypatch):
    monkeypatch.setattr("bulletuav.engine.body_source.split_body", lambda *_: pytest.fail("split"))
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "".join(f"o {k}\nf 1 2 3\n" for k in range(1025))
    (tmp_path / "many.obj").write_text(text)
    with pytest.raises(ValueError, match="the body has 1025 pieces: at most 1024"):
        make_bench("point_mass").engine.add_body(tmp_path / "many.obj", (0, 0, 10))
