import math
import os
import sys
import types
from dataclasses import replace

import bench
import numpy as np
import pytest

from bulletuav import Airframe, available_airframes, load_airframe, registry
from bulletuav.engine.drones import require_loadable
from bulletuav.geometry.shapes import HULL, Shape
from bulletuav.vehicle.parameters import EFFECTS, parameter_rows
from bulletuav.vehicle.scaling import scaled_constants
from bulletuav.vehicle.urdf import UrdfFile

# Computed by hand from published constants: hover speed (rad/s), most thrust (N), thrust to weight,
# drag at hover (N s/m).
FIGURES = {
    "cf2p": (1739.16, 0.5952, 2.25, (0.01113, 0.00974)),
    "racer": (1623.14, 33.94, 4.17, (0.266, 0.422)),
    "iris": (660.25, 24.013, 1.611, (0.2130, 0.0)),
    "firefly": (540.86, 36.019, 2.401, (0.2617, 0.0)),
    "cf2x": (1739.16, 0.5952, 2.25, (0.01113, 0.00974)),
    "cf2x_L250": (1985.98, 0.48, 1.5343, (0.01472, 0.01277)),
    "cf21B": (1664.35, 0.8, 1.8806, (0.02149, 0.0236)),
    "hummingbird": (453.15, 24.013, 3.420, (0.1462, 0.0)),
}


@pytest.mark.parametrize("name", FIGURES)
def test_published_figures(name):
    airframe = load_airframe(name)
    hover, thrust, ratio, drag = FIGURES[name]
    assert airframe.hover_speed() == pytest.approx(hover, rel=1e-5)
    assert airframe.max_thrust == pytest.approx(thrust, rel=1e-4)
    assert airframe.max_thrust / (airframe.mass * 9.80665) == pytest.approx(ratio, rel=1e-3)
    total = len(airframe.rotors) * airframe.hover_speed()
    assert airframe.drag_xy * total == pytest.approx(drag[0], rel=1e-3)
    assert airframe.drag_z * total == pytest.approx(drag[1], rel=1e-3)


# Rotors that spin counter-clockwise seen from above, by where they sit (m): RotorS' xacro files for
# hummingbird, iris and firefly (front left, back left, right), Bitcraze's motor map for the
# Crazyflie (M1, M3), Betaflight's quad X for the racer.
COUNTER_CLOCKWISE = {
    "cf2p": {(0.046, 0.0), (-0.046, 0.0)},
    "cf2x": {(0.03253, -0.03253), (-0.03253, 0.03253)},
    "cf2x_L250": {(0.03253, -0.03253), (-0.03253, 0.03253)},
    "cf21B": {(0.035355, -0.035355), (-0.035355, 0.035355)},
    "firefly": {(0.186195, 0.1075), (-0.186195, 0.1075), (0.0, -0.215)},
    "hummingbird": {(0.0, 0.17), (0.0, -0.17)},
    "iris": {(0.13, -0.22), (-0.13, 0.2)},
    "racer": {(0.085, -0.0675), (-0.085, 0.0675)},
}


@pytest.mark.parametrize("name", bench.MULTIROTORS)
def test_rotors_spin_as_published(name):
    """A mirrored set flies as well, and yaws logged rotor speeds the wrong way."""
    airframe = load_airframe(name)
    assert {(x, y) for x, y, turn in airframe.rotors if turn < 0} == COUNTER_CLOCKWISE[name]
    assert sum(turn for _, _, turn in airframe.rotors) == 0


def test_crazyflie_constants_are_those_of_the_stand():
    """Bitcraze's stand: all four rotors lift 57.9 g at 23,882 rpm and 27 g at 16,700 rpm."""
    cf2x = load_airframe("cf2x")
    for grams, rpm in ((57.9, 23882), (27.0, 16700)):
        lift = 4 * cf2x.thrust_coefficient * (rpm * 2 * math.pi / 60) ** 2
        assert lift / 9.80665e-3 == pytest.approx(grams, rel=0.04)
    assert cf2x.torque_ratio == 0.00596
    assert cf2x.arm == pytest.approx(0.046, abs=5e-5)
    assert cf2x.hover_speed() * 60 / (2 * math.pi) == pytest.approx(16608, abs=1)
    # Foerster's map from PWM, stretched so that its thrust at a PWM stays with the smaller k_f
    stretch = math.sqrt(3.16e-10 / 2.40e-10)
    assert cf2x.pwm.slope == pytest.approx(0.2685 * stretch, rel=1e-4)
    assert cf2x.pwm.intercept == pytest.approx(4070.3 * stretch, rel=1e-4)


def test_constants_that_a_file_leaves_out_are_those_of_the_crazyflie_scaled():
    """Twice the lengths, weight and thrust per disc area kept: 4 times the mass, 1/2 the speed."""
    file = load_airframe("racer")
    disc = 4 * math.pi * file.propeller_radius**2
    assert file.body_drag == pytest.approx((0.075 * disc, 0.52 * disc))
    assert file.ground_effect_reach == pytest.approx(6.2 * 0.0635)
    assert (file.ground_effect_gain, file.wake_share, file.wake_spread) == (0.27, 0.32, 0.1)
    assert file.wake_radius == file.arm
    assert file.rotor_inertia > 0
    # By hand: 7.2 * 7.7237e-7 * 1623.14 / 0.0635 = 0.142149 N for each m/s along the axis
    assert file.damping[0] == pytest.approx(0.142149 * 4 * 0.0675**2 / 0.003113, rel=1e-4)
    assert file.damping[1] == pytest.approx(0.142149 * 4 * 0.085**2 / 0.003113, rel=1e-4)
    radius = 4 * (0.0675**2 + 0.085**2)
    assert file.damping[2] == pytest.approx(4.1e-5 * 1623.14 * radius / 0.005, rel=1e-4)


def test_the_scaled_law_gives_back_the_crazyflie():
    cf2x = load_airframe("cf2x")
    usual = scaled_constants(
        cf2x.inertia,
        cf2x.rotors,
        cf2x.thrust_coefficient,
        cf2x.drag_xy,
        cf2x.propeller_radius,
        cf2x.hover_speed(),
    )
    assert usual.damping[:2] == pytest.approx(cf2x.damping[:2], rel=0.02)
    assert usual.damping[2] < cf2x.damping[2]
    assert usual.body_drag == pytest.approx(cf2x.body_drag, rel=0.02)


def test_all_shipped_airframes_load_and_are_frozen():
    assert {"cf2x", "hummingbird"} <= set(available_airframes())
    for name in available_airframes():
        airframe = load_airframe(name)
        assert airframe.name == name
        assert load_airframe(airframe) is airframe
        hash(airframe)
        with pytest.raises(AttributeError):
            airframe.mass = 1.0
        assert airframe.collision_radius >= airframe.arm


def test_own_urdf_with_six_rotors(urdf):
    rotors = ""
    for k, spin in enumerate(["cw", "ccw"] * 3):
        x, y = 0.2 * math.cos(k * math.pi / 3), 0.2 * math.sin(k * math.pi / 3)
        rotors += f'<rotor x="{x:.6f}" y="{y:.6f}" spin="{spin}"/>'
    text = load_airframe("hummingbird").urdf.read_text()
    first, last = text.index("<rotor x"), text.rindex("<rotor x")
    own = urdf(
        "hummingbird",
        (text[first : text.index("/>", last) + 2], rotors),
        ('robot name="hummingbird"', 'robot name="six"'),
    )
    airframe = load_airframe(own)
    assert (airframe.name, len(airframe.rotors), airframe.urdf) == ("six", 6, own.resolve())
    assert parameter_rows([airframe])["num_rotors"] == 6
    assert isinstance(airframe, Airframe)


REFUSED = [
    ('<mass value="0.027"/>', "", "inertial/mass", "missing"),
    ('<mass value="0.027"/>', '<mass value="-1"/>', "mass value", "-1"),
    ('<mass value="0.027"/>', '<mass value="heavy"/>', "mass value", "heavy"),
    ('<thrust_coefficient value="2.1885e-8"/>', "", "thrust_coefficient", "missing"),
    (
        '<thrust_coefficient value="2.1885e-8"/>',
        '<thrust_coefficient value="nan"/>',
        "thrust_coefficient",
        "nan",
    ),
    (
        '<thrust_coefficient value="2.1885e-8"/>',
        '<thrust_coefficient value="0"/>',
        "thrust_coefficient",
        "0",
    ),
    ('up="0.065"', 'up="-0.1"', "motor_lag up", "-0.1"),
    ('up="0.065"', "", "motor_lag up", "missing"),
    (
        '<max_rotor_speed value="2607.5"/>',
        '<max_rotor_speed value="1000"/>',
        "max_rotor_speed",
        "cannot hover",
    ),
    ('izz="2.93e-5"', 'izz="3.9e-5"', "inertia", "it is not physical"),
    ('izz="2.93e-5"', 'izz="0"', "inertia izz", "0"),
    ('ixy="0"', 'ixy="1e-6"', "inertia ixy", "principal axes"),
    ('ixy="0"', 'ixy="abc"', "inertia ixy", "a number is needed"),
    ('<mass value="0.027"/>', '<mass value="0.02_7"/>', "mass value", "a number is needed"),
    ('<origin xyz="0 0 0" rpy="0 0 0"/>', '<origin xyz="0 a 0"/>', "origin xyz", "0 a 0"),
    ('<origin xyz="0 0 0" rpy="0 0 0"/>', '<origin xyz="0 0"/>', "origin xyz", "0 0"),
    ('<robot name="cf2x">', "<robot>", "robot name", "missing"),
    ('<link name="base">', "<link>", "link name", "missing"),
    (
        '<cylinder radius="0.0691"',
        '<sphere radius="1"/><cylinder radius="0.0691"',
        "collision geometry",
        "one cylinder",
    ),
    (
        '<origin xyz="0 0 0" rpy="0 0 0"/>',
        '<origin xyz="0 0 0.1" rpy="0 0 0"/>',
        "origin xyz",
        "centre of mass",
    ),
    ('spin="ccw"', 'spin="left"', "rotor spin", "left"),
    ('<rotor x="0.03253" y="-0.03253" spin="ccw"/>', "", "rotor", "3 times"),
    ('x="-0.03253"', 'x="0.03253"', "rotor", "cannot control"),
    (
        '<cylinder radius="0.0691" length="0.03"/>',
        '<mesh filename="x"/>',
        "mesh filename",
        "x: the name of a Wavefront OBJ file",
    ),
    (
        '<cylinder radius="0.0691" length="0.03"/>',
        '<box size="1 2"/>',
        "box size",
        "three positive",
    ),
    ("<collision>", '<collision><origin xyz="0 0 1"/>', "collision origin", "centred"),
    ("<collision>", "<collision/><collision>", "collision", "2 times"),
    ("</link>", '</link><link name="prop"/>', "link", "2 links"),
    ('height="0.034"', 'height="tall"', "rotor_drag height", "a number is needed"),
    ('<rotor_inertia value="2.697e-8"/>', "<rotor_inertia/>", "rotor_inertia value", "missing"),
    ('<rate_damping x="3"', '<rate_damping x="-3"', "rate_damping x", "-3"),
    ('<body_drag xy="5e-4"', "<body_drag", "body_drag xy", "missing"),
    ("<max_speed", '<ground_effect gain="1"/><max_speed', "ground_effect reach", "missing"),
    ("<max_speed", '<ground_effect gain="2" reach="0.1"/><max_speed', "ground_effect gain", "2"),
    ("<max_speed", '<wake share="0.3" spread="0.1" radius="0"/><max_speed', "wake radius", "0"),
    ('efficiency="0.43"', 'efficiency="0"', "power efficiency", "0"),
    ('cells="1"', 'cells="1.5"', "battery cells", "a whole number"),
    ('capacity="0.925"', 'capacity="full"', "battery capacity", "a number is needed"),
    ('min="20000"', 'min="70000"', "pwm max", "65535"),
]


@pytest.mark.parametrize(("old", "new", "tag", "said"), REFUSED)
def test_what_is_missing_or_not_physical_is_refused_with_file_tag_and_value(
    urdf, old, new, tag, said
):
    path = urdf("cf2x", (old, new))
    with pytest.raises(ValueError, match="own.urdf") as error:
        load_airframe(path)
    assert f"<{tag}" in str(error.value) or f"{tag}>" in str(error.value)
    assert said in str(error.value)


def test_flat_bodies_are_taken_whatever_the_rounding(urdf):
    """Ixx + Iyy = Izz is a flat body; the engine, which has no tolerance, is given our numbers."""
    for ixx, iyy, izz in (("2.7e-5", "2.8e-5", "5.5e-5"), ("7e-6", "26e-6", "33e-6")):
        path = urdf(
            "cf2x",
            ('ixx="1.68e-5" iyy="1.68e-5" izz="2.93e-5"', f'ixx="{ixx}" iyy="{iyy}" izz="{izz}"'),
        )
        assert load_airframe(path).inertia == (float(ixx), float(iyy), float(izz))
        one = bench.Bench("bullet", path, effects=(), gravity=0.0)
        one.place()
        one.engine.apply_wrenches(
            np.zeros((1, 1, 3)), np.array([[[float(ixx), float(iyy), float(izz)]]]), one.alive
        )
        one.engine.step()
        one.engine.read_states(one.swarm, one.alive)
        np.testing.assert_allclose(one.swarm.rates[0, 0] * 240, 1, rtol=1e-9)
        one.engine.close()


def test_broken_missing_and_unknown(tmp_path):
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot><link>")
    with pytest.raises(ValueError, match="is not valid XML"):
        load_airframe(broken)
    with pytest.raises(FileNotFoundError, match="nowhere.urdf"):
        load_airframe(tmp_path / "nowhere.urdf")
    with pytest.raises(ValueError, match="did you mean 'hummingbird'"):
        load_airframe("humingbird")


def test_airframes_have_names_in_the_registry(urdf, monkeypatch):
    assert set(available_airframes()) <= set(registry.names("airframe"))
    own = urdf("cf2x", ('robot name="cf2x"', 'robot name="own"'))
    module = types.ModuleType("drones")
    module.Own, module.FILE, module.OTHER = load_airframe(own), own, 3
    monkeypatch.setitem(sys.modules, "drones", module)
    assert load_airframe("drones:Own") is module.Own
    assert load_airframe("drones:FILE") == module.Own
    with pytest.raises(ValueError, match="drones:OTHER is 3: that is no airframe"):
        load_airframe("drones:OTHER")
    for one in (module.Own, own, str(own)):
        monkeypatch.setitem(registry._registered["airframe"], "mine", one)
        assert load_airframe("mine") == module.Own
    with pytest.raises(ValueError, match="did you mean 'mine'"):
        load_airframe("min")
    monkeypatch.setitem(registry._registered["airframe"], "mine", 3)
    with pytest.raises(ValueError, match="airframe 'mine' is registered as 3: that is no"):
        load_airframe("mine")


@pytest.mark.parametrize("shape", ['<box size="0.1 0.1 0.05"/>', '<sphere radius="0.075"/>'])
def test_other_collision_shapes(urdf, shape):
    airframe = load_airframe(urdf("cf2x", ('<cylinder radius="0.0691" length="0.03"/>', shape)))
    assert airframe.collision_radius == pytest.approx(0.075)


def test_effects_are_switched_off_by_zero_constants():
    cf2x = load_airframe("cf2x")
    full, none = parameter_rows([cf2x])[0], parameter_rows([cf2x], ())[0]
    switched = {
        "lag": {"lag_up", "lag_down"},
        "drag": {"drag_xy", "drag_z", "drag_height"},
        "body_drag": {"body_drag_xy", "body_drag_z"},
        "damping": {"damping"},
        "rotor_inertia": {"rotor_inertia"},
        "ground_effect": {"ground_effect_gain"},
        "downwash": {"wake_share"},
        "voltage": set(),
    }
    assert tuple(switched) == EFFECTS
    for effect, fields in switched.items():
        one = parameter_rows([cf2x], (effect,))[0]
        for field in full.dtype.names:
            if field in fields:
                assert (full[field] > 0).all()
                assert (none[field] == 0).all()
                np.testing.assert_array_equal(one[field], full[field])
            else:
                np.testing.assert_array_equal(one[field], none[field])
    with pytest.raises(ValueError, match="did you mean 'drag'"):
        parameter_rows([cf2x], ("drags",))


def test_the_height_at_which_a_drone_stands_is_how_far_its_shape_reaches_down():
    assert load_airframe("cf2x").standing_height == pytest.approx(0.015)
    hull = replace(
        load_airframe("cf2x"), shape=Shape(HULL, (0.1, 0.1, 0.3), ((0.1, 0, -0.1), (0, 0.1, 0.3)))
    )
    assert hull.standing_height == 0.1


ABOVE_ZERO = (
    "mass",
    "thrust_coefficient",
    "torque_ratio",
    "max_rotor_speed",
    "propeller_radius",
    "ground_effect_reach",
    "wake_radius",
    "efficiency",
    "max_speed",
)
AT_LEAST_ZERO = (
    "lag_up",
    "lag_down",
    "drag_xy",
    "drag_z",
    "rotor_inertia",
    "ground_effect_gain",
    "wake_share",
    "wake_spread",
    "electronics",
    "friction",
    "restitution",
)
OF_SEVERAL = {"inertia": (1e-5, 1e-5, 0.0), "damping": (1.0, -1.0, 1.0), "body_drag": (0.0, np.nan)}


@pytest.mark.parametrize("name", [*ABOVE_ZERO, *AT_LEAST_ZERO, "drag_height"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, "much", None])
def test_airframes_made_in_python_have_physical_constants(name, value):
    may_be = {"drag_height": (0.0, -1.0)}.get(name, () if name in ABOVE_ZERO else (0.0,))
    airframe = replace(load_airframe("cf2x"), **{name: value})
    for ask in (load_airframe, lambda one: parameter_rows([one])):
        if value in may_be:
            ask(airframe)
        else:
            with pytest.raises(ValueError, match=f"{name} of airframe 'cf2x' is .* needed"):
                ask(airframe)


@pytest.mark.parametrize("name", OF_SEVERAL)
def test_each_of_several_numbers_is_looked_at(name):
    airframe = replace(load_airframe("cf2x"), **{name: OF_SEVERAL[name]})
    with pytest.raises(ValueError, match=f"{name} of airframe 'cf2x' is"):
        bench.Bench("rigid_body", airframe=airframe)


@pytest.mark.parametrize(
    ("rotors", "message"),
    [
        ((), "number of rotors .* at least 4"),
        (((0.1, 0.1, 1),) * 9, "number of rotors .* from 4 to 8"),
        (((0.1, 0.1),) * 4, "a rotor of airframe .* 3 values"),
        (((0.1, math.nan, 1),) * 4, "y of a rotor of airframe .* is nan"),
        (((math.inf, 0.1, 1),) * 4, "x of a rotor of airframe .* is inf"),
        (((0.1, 0.1, 0),) * 4, "turn of a rotor of airframe .* is 0: 1 or -1"),
    ],
)
def test_rotors_made_in_python_are_places_and_turns(rotors, message):
    with pytest.raises(ValueError, match=message):
        load_airframe(replace(load_airframe("cf2x"), rotors=rotors))


@pytest.mark.parametrize(
    ("size", "share"),
    [("ground_effect_reach", "ground_effect_gain"), ("wake_radius", "wake_share")],
)
def test_a_size_of_zero_names_the_constant_that_leaves_the_effect_out(size, share):
    cf2x = load_airframe("cf2x")
    with pytest.raises(ValueError, match=f"is 0: .* for none, set {share} to 0"):
        load_airframe(replace(cf2x, **{size: 0.0}))
    assert parameter_rows([load_airframe(replace(cf2x, **{share: 0.0}))])[share] == 0.0


def test_a_mesh_that_is_a_pipe_is_refused_before_anything_waits_for_it(tmp_path):
    os.mkfifo(tmp_path / "pipe.obj")
    path = tmp_path / "drone.urdf"
    path.write_text('<robot><visual><mesh filename="pipe.obj"/></visual></robot>')
    with pytest.raises(ValueError, match=r"<mesh filename> is pipe\.obj: .* not a regular file"):
        UrdfFile(path)


BOX = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"
MORE = 1000
"""Corners that only Python would see"""
MATERIALS = "mtllib own.mtl\nusemtl red\n" + BOX


@pytest.fixture
def visual(urdf, tmp_path):
    """Writes a cf2x with a visual mesh, and files beside it: visual(name, files)."""

    def write(name, files):
        for file, content in files.items():
            (tmp_path / file).write_bytes(content.encode())
        mesh = f'<mesh filename="{name}" scale="0.01 0.01 0.01"/>'
        return urdf("cf2x", ('<box size="0.034 0.03 0.018"/>', mesh))

    return write


@pytest.mark.parametrize(
    ("name", "files", "said"),
    [
        ("gone.obj", {}, "gone.obj: .*no such file"),
        ("", {}, "missing: .*no such file"),
        ("body.dae", {"body.dae": "<COLLADA/>"}, "body.dae: .*: convert it to a Wavefront OBJ"),
        ("body.cdf", {"body.cdf": "x"}, "body.cdf: .*: convert it to a Wavefront OBJ"),
        ("body.obj", {"body.obj": BOX + "f 1 2 1_0\n"}, "'f 1 2 1_0': it cannot be read"),
        ("body.obj", {"body.obj": BOX + "f 1 2 \u0663\n"}, "line 9 is .*: it cannot be read"),
        ("body.obj", {"body.obj": BOX + "v 1 2 1_0\n"}, "'v 1 2 1_0': it cannot be read"),
        # What only Python takes for corners, and then a face of such a one
        *(
            (
                "body.obj",
                {"body.obj": BOX + f"{word} 0 0 0\n" * MORE + "f 1 2 900\n"},
                "'f 1 2 900'",
            )
            for word in ("#\rv", "#\x0cv", "#\u2028v", "v\x0c", "v\xa0")
        ),
        (
            "body.obj",
            {"body.obj": MATERIALS, "own.mtl": f"newmtl red\nmap_Kd {'t' * 2000}.png\n"},
            "map_Kd .* makes a path of more than 800 bytes",
        ),
        ("body.obj", {"body.obj": f"mtllib {'t' * 2000}\n{BOX}"}, "mtllib .* more than 800 bytes"),
    ],
)
def test_visual_meshes_that_the_engine_cannot_read_safely_are_refused(visual, name, files, said):
    with pytest.raises(ValueError, match=rf"own\.urdf: <mesh filename> is .*{said}"):
        load_airframe(visual(name, files))


def test_pictures_and_materials_of_visual_meshes_are_not_refused(visual):
    materials = {"own.mtl": "newmtl red\nKd 1 0 0\nmap_Kd own.png\n", "own.png": "no picture"}
    require_loadable([load_airframe(visual("body.obj", {"body.obj": MATERIALS, **materials}))])


@pytest.mark.parametrize("pipe", ["own.mtl", "own.png", "texture.png"])
def test_nothing_waits_for_a_pipe_that_a_mesh_or_urdf_names(visual, pipe, tmp_path):
    files = {"body.obj": MATERIALS, "own.mtl": "newmtl red\nmap_Kd own.png\n"}
    path = visual("body.obj", files)
    path.write_text(
        path.read_text().replace("<color ", '<texture filename="texture.png"/><color ', 1)
    )
    (tmp_path / pipe).unlink(missing_ok=True)
    os.mkfifo(tmp_path / pipe)
    with pytest.raises(ValueError, match=f"{pipe} is not a regular file"):
        load_airframe(path)


def test_digits_that_the_engine_does_not_read_are_refused(tmp_path):
    path = tmp_path / "drone.urdf"
    path.write_text('<robot><mass value="\u0661"/></robot>', encoding="utf-8")
    file = UrdfFile(path)
    with pytest.raises(ValueError, match="a number is needed"):
        file.number(file.element("mass"), "value")


@pytest.mark.parametrize("odd", ["1_0", "\u0661", "nan", "inf", "1e999", "x", ""])
@pytest.mark.parametrize("place", range(3))
def test_odd_numbers_of_three_are_refused(odd, place, tmp_path):
    three = ["1", "1", "1"]
    three[place] = odd
    text = " ".join(three)
    path = tmp_path / "body.urdf"
    path.write_text(
        f'<robot><a><origin xyz="{text}"/><geometry><box size="{text}"/></geometry></a></robot>',
        encoding="utf-8",
    )
    file = UrdfFile(path)
    element = file.element("a")
    with pytest.raises(ValueError, match="<origin xyz> is .*: three numbers"):
        file.origin(element)
    with pytest.raises(ValueError, match="<box size> is .*: three positive numbers"):
        file.shape(element)


@pytest.mark.parametrize(
    ("zero", "is_zero"),
    [("-0.0e5", True), (".0", True), ("e", False), ("--", False), ("\u0660", False)],
)
def test_an_origin_of_zeros_is_made_of_numbers(zero, is_zero, urdf):
    path = urdf("cf2x", ("<collision>", f'<collision><origin xyz="0 0 {zero}"/>'))
    path.write_text(path.read_text(), encoding="utf-8")
    if is_zero:
        load_airframe(path)
        return
    with pytest.raises(ValueError, match="<collision origin xyz> is"):
        load_airframe(path)
