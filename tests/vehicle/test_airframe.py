import math
import sys
import types
from dataclasses import replace

import bench
import numpy as np
import pytest

from bulletuav import Airframe, available_airframes, load_airframe, registry
from bulletuav.geometry.shapes import HULL, Shape
from bulletuav.vehicle.parameters import parameter_rows

# Computed by hand from published constants: hover speed (rad/s), most thrust (N), thrust to weight,
# drag at hover (N s/m).
FIGURES = {
    "cf2p": (1515.64, 0.5958, 2.25, (0.00556, 0.00625)),
    "racer": (1623.14, 33.94, 4.17, (0.266, 0.422)),
    "iris": (660.25, 24.013, 1.611, (0.2130, 0.0)),
    "firefly": (540.86, 36.019, 2.401, (0.2617, 0.0)),
    "cf2x": (1515.64, 0.5958, 2.25, (0.00556, 0.00625)),
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
    "cf2p": {(0.0397, 0.0), (-0.0397, 0.0)},
    "cf2x": {(0.028072, -0.028072), (-0.028072, 0.028072)},
    "firefly": {(0.186195, 0.1075), (-0.186195, 0.1075), (0.0, -0.215)},
    "hummingbird": {(0.0, 0.17), (0.0, -0.17)},
    "iris": {(0.13, -0.22), (-0.13, 0.2)},
    "racer": {(0.085, -0.0675), (-0.085, 0.0675)},
}


@pytest.mark.parametrize("name", available_airframes())
def test_rotors_spin_as_published(name):
    """A mirrored set flies as well, and yaws logged rotor speeds the wrong way."""
    airframe = load_airframe(name)
    assert {(x, y) for x, y, turn in airframe.rotors if turn < 0} == COUNTER_CLOCKWISE[name]
    assert sum(turn for _, _, turn in airframe.rotors) == 0


def test_crazyflie_constants_are_consistent():
    cf2x = load_airframe("cf2x")
    per_rpm = (60 / (2 * math.pi)) ** 2
    assert cf2x.thrust_coefficient == pytest.approx(3.16e-10 * per_rpm, rel=1e-4)
    assert cf2x.torque_ratio == pytest.approx(1.885e-12 / 3.16e-10, rel=1e-3)
    assert cf2x.arm == pytest.approx(0.0397, abs=5e-5)
    assert cf2x.hover_speed() * 60 / (2 * math.pi) == pytest.approx(14473, abs=1)


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
    ('<thrust_coefficient value="2.8816e-8"/>', "", "thrust_coefficient", "missing"),
    (
        '<thrust_coefficient value="2.8816e-8"/>',
        '<thrust_coefficient value="nan"/>',
        "thrust_coefficient",
        "nan",
    ),
    (
        '<thrust_coefficient value="2.8816e-8"/>',
        '<thrust_coefficient value="0"/>',
        "thrust_coefficient",
        "0",
    ),
    ('up="0.065"', 'up="-0.1"', "motor_lag up", "-0.1"),
    ('up="0.065"', "", "motor_lag up", "missing"),
    (
        '<max_rotor_speed value="2273.5"/>',
        '<max_rotor_speed value="1000"/>',
        "max_rotor_speed",
        "cannot hover",
    ),
    ('izz="2.17e-5"', 'izz="2.9e-5"', "inertia", "no body has it"),
    ('izz="2.17e-5"', 'izz="0"', "inertia izz", "0"),
    ('ixy="0"', 'ixy="1e-6"', "inertia ixy", "principal axes"),
    ('ixy="0"', 'ixy="abc"', "inertia ixy", "a number is needed"),
    ('<mass value="0.027"/>', '<mass value="0.02_7"/>', "mass value", "a number is needed"),
    ('<origin xyz="0 0 0" rpy="0 0 0"/>', '<origin xyz="0 a 0"/>', "origin xyz", "0 a 0"),
    ('<origin xyz="0 0 0" rpy="0 0 0"/>', '<origin xyz="0 0"/>', "origin xyz", "0 0"),
    ('<robot name="cf2x">', "<robot>", "robot name", "missing"),
    ('<link name="base">', "<link>", "link name", "missing"),
    (
        '<cylinder radius="0.0628"',
        '<sphere radius="1"/><cylinder radius="0.0628"',
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
    ('<rotor x="0.028072" y="-0.028072" spin="ccw"/>', "", "rotor", "3 times"),
    ('x="-0.028072"', 'x="0.028072"', "rotor", "cannot turn"),
    (
        '<cylinder radius="0.0628" length="0.03"/>',
        '<mesh filename="x"/>',
        "mesh filename",
        "x: the name of a Wavefront OBJ file",
    ),
    (
        '<cylinder radius="0.0628" length="0.03"/>',
        '<box size="1 2"/>',
        "box size",
        "three positive",
    ),
    ("<collision>", '<collision><origin xyz="0 0 1"/>', "collision origin", "centred"),
    ("<collision>", "<collision/><collision>", "collision", "2 times"),
    ("</link>", '</link><link name="prop"/>', "link", "2 links"),
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
            ('ixx="1.4e-5" iyy="1.4e-5" izz="2.17e-5"', f'ixx="{ixx}" iyy="{iyy}" izz="{izz}"'),
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
    with pytest.raises(ValueError, match="not a readable XML"):
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
    airframe = load_airframe(urdf("cf2x", ('<cylinder radius="0.0628" length="0.03"/>', shape)))
    assert airframe.collision_radius == pytest.approx(0.075)


def test_effects_are_switched_off_by_zero_constants():
    cf2x = load_airframe("cf2x")
    full, none = parameter_rows([cf2x])[0], parameter_rows([cf2x], ())[0]
    touched = {
        "lag_up",
        "lag_down",
        "drag_xy",
        "drag_z",
        "ground_effect_gain",
        "downwash_gain",
        "downwash_radius",
    }
    for field in full.dtype.names:
        if field in touched:
            assert full[field] > 0
            assert none[field] == 0
        else:
            np.testing.assert_array_equal(full[field], none[field])
    with pytest.raises(ValueError, match="did you mean 'drag'"):
        parameter_rows([cf2x], ("drags",))


def test_the_height_at_which_a_drone_stands_is_how_far_its_shape_reaches_down():
    assert load_airframe("cf2x").standing_height == pytest.approx(0.015)
    hull = replace(
        load_airframe("cf2x"), shape=Shape(HULL, (0.1, 0.1, 0.3), ((0.1, 0, -0.1), (0, 0.1, 0.3)))
    )
    assert hull.standing_height == 0.1
