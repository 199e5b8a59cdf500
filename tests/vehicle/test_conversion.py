"""URDFs of other simulators become airframes: numbers, reports, flights and errors."""

import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav import SetpointLevel, load_airframe
from bulletuav.cli import main
from bulletuav.vehicle.conversion import convert_urdf
from bulletuav.vehicle.links import join_links, place_links
from bulletuav.vehicle.urdf import UrdfFile

PROPERTIES = (
    '<properties arm="0.0397" kf="3.16e-10" km="7.94e-12" thrust2weight="2.25" '
    'max_speed_kmh="30" gnd_eff_coeff="11.36859" prop_radius="2.31348e-2" '
    'drag_coeff_xy="9.1785e-7" drag_coeff_z="10.311e-7" dw_coeff_1="2267.18"/>'
)
GYM_PLACES = ((0.028, -0.028), (-0.028, -0.028), (-0.028, 0.028), (0.028, 0.028))
"""Numbers of the Crazyflie of gym-pybullet-drones"""
NO_INERTIA = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
BASE = """<inertial><mass value="{mass}"/>
  <inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>"""


def joint(name, parent, place="0 0 0", turn="0 0 0", kind="fixed", more=""):
    return (
        f'<joint name="{name}_joint" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{name}"/><origin xyz="{place}" rpy="{turn}"/>{more}</joint>'
    )


def gym(
    places=GYM_PLACES, properties=PROPERTIES, collision='<cylinder radius=".06" length=".025"/>'
):
    """A quadrotor in the form of gym-pybullet-drones: places in the inertial of massless links."""
    text = f'<robot name="cf2">{properties}<link name="base_link">'
    text += BASE.format(mass=0.027, xx=1.4e-5, yy=1.4e-5, zz=2.17e-5)
    text += f"<collision><geometry>{collision}</geometry></collision>"
    text += '<visual><geometry><mesh filename="./cf2.dae"/></geometry></visual></link>'
    for k, (x, y) in enumerate(places):
        text += f'<link name="prop{k}_link"><inertial><origin xyz="{x} {y} 0"/>'
        text += f'<mass value="0"/>{NO_INERTIA}</inertial></link>'
        text += joint(f"prop{k}_link", "base_link")
    return text + "</robot>"


def rotors(spins=("cw", "ccw", "cw", "ccw")):
    """A quadrotor in the form of RotorS, with numbers of its hummingbird."""
    text = '<robot name="hb"><link name="hb/base_link"/>'
    text += '<link name="hb/base_link_inertia">' + BASE.format(
        mass=0.68, xx=0.007, yy=0.007, zz=0.012
    )
    text += '<collision><geometry><box size="0.1 0.1 0.12"/></geometry></collision></link>'
    text += joint("hb/base_link_inertia", "hb/base_link")
    places = ("0.17 0 0.01", "0 0.17 0.01", "-0.17 0 0.01", "0 -0.17 0.01")
    for k, (place, spin) in enumerate(zip(places, spins, strict=True)):
        text += f'<link name="hb/rotor_{k}">'
        text += BASE.format(mass=0.009, xx="1.755e-06", yy="7.50675e-05", zz="7.66875e-05")
        text += (
            '<collision><geometry><cylinder length="0.005" radius="0.1"/></geometry></collision>'
        )
        text += '<visual><geometry><mesh filename="package://x/propeller.dae"/></geometry></visual>'
        text += "</link>" + joint(f"hb/rotor_{k}", "hb/base_link", place, kind="continuous")
        text += f"""<gazebo><plugin name="motor{k}" filename="motor.so">
          <jointName>hb/rotor_{k}_joint</jointName><linkName>hb/rotor_{k}</linkName>
          <turningDirection>{spin}</turningDirection><timeConstantUp>0.0125</timeConstantUp>
          <timeConstantDown>0.025</timeConstantDown><maxRotVelocity>838</maxRotVelocity>
          <motorConstant>8.54858e-06</motorConstant><momentConstant>0.016</momentConstant>
          <motorNumber>{k}</motorNumber><rotorDragCoefficient>8.06428e-05</rotorDragCoefficient>
          <rollingMomentCoefficient>1e-06</rollingMomentCoefficient>
          <rotorVelocitySlowdownSim>10</rotorVelocitySlowdownSim></plugin></gazebo>"""
    text += '<link name="hb/imu"/>'
    limit = '<limit lower="0" upper="0" effort="0" velocity="0"/>'
    return text + joint("hb/imu", "hb/base_link", kind="revolute", more=limit) + "</robot>"


PYFLYT = """motor_params:
  total_thrust: 40
  thrust_coef: 3.0e-7
  torque_coef: 3.0e-7
  noise_ratio: 0.003
  tau: 0.01
drag_params: {drag_coef_xyz: 2.0, drag_area_xyz: 0.08, drag_coef_pqr: 1.0e-4}
control_params: {}
"""


def pyflyt():
    """A quadrotor in the form of PyFlyt's primitive drone."""
    text = '<robot name="drone"><material name="green"><color rgba="0 0.8 0 1"/></material>'
    text += '<link name="base"><visual><geometry><box size="0.2 0.1 0.05"/></geometry></visual>'
    text += '<collision><geometry><box size="0.2 0.1 0.05"/></geometry></collision>'
    text += BASE.format(mass=1, xx=0.01, yy=0.01, zz=0.016) + "</link>"
    for name, x, y in (("a", 1, -1), ("b", -1, 1), ("c", 1, 1), ("d", -1, -1)):
        disc = '<geometry><cylinder length="0.01" radius="0.12"/></geometry>'
        text += f'<link name="{name}_prop"><visual>{disc}<material name="green"/></visual>'
        text += f"<collision>{disc}</collision></link>"
        text += joint(f"{name}_prop", "base", f"{0.16 * x} {0.16 * y} 0")
    return text + "</robot>"


@pytest.fixture
def convert(tmp_path):
    """Writes and converts a text: convert(text, yaml) -> airframe, {(kind, name): value}."""

    def run(text, yaml=None):
        (tmp_path / "own.urdf").write_text(text)
        if yaml is not None:
            (tmp_path / "own.yaml").write_text(yaml)
        airframe, entries = convert_urdf(tmp_path / "own.urdf", tmp_path / "new" / "made.urdf")
        return airframe, {(entry.kind, entry.what): entry.value for entry in entries}

    return run


def assert_hovers(airframe, rpm):
    """Fly to a place in 15 s, and hold it at the hover speed, rpm."""
    with bulletuav.Airspace([(0.0, 0.0, 1.5)], airframe, decision_hz=48) as airspace:
        airspace.command(0, SetpointLevel.POSITION, (0.3, 0.2, 1.8), yaw=0.3)
        for _ in range(15 * 48):
            airspace.step()
        np.testing.assert_allclose(airspace.swarm.position.reshape(3), (0.3, 0.2, 1.8), atol=0.02)
        found = airspace.swarm.rotor_speed.reshape(-1)[:4] * 60 / (2 * math.pi)
        np.testing.assert_allclose(found, rpm, rtol=1e-3)


def test_the_crazyflie_of_gym_pybullet_drones(convert):
    """Its hover speed is sqrt(9.8 * 0.027 / (4 * 3.16e-10)) = 14468.4 rpm, at gravity 9.8."""
    airframe, report = convert(gym())
    assert airframe.mass == 0.027
    assert airframe.inertia == (1.4e-5, 1.4e-5, 2.17e-5)
    assert airframe.hover_speed() * 60 / (2 * math.pi) == pytest.approx(14468.43, rel=1e-3)
    assert airframe.hover_speed(9.8) * 60 / (2 * math.pi) == pytest.approx(14468.43, rel=1e-6)
    # By hand: 3.16e-10 * 91.18907; 7.94 / 316; 14468.43 * 1.5 * 0.10471976
    assert airframe.thrust_coefficient == pytest.approx(2.881575e-8, rel=1e-6)
    assert airframe.torque_ratio == pytest.approx(0.02512658, rel=1e-6)
    assert airframe.max_rotor_speed == pytest.approx(2272.695, rel=1e-5)
    assert airframe.max_speed == pytest.approx(8.333333, rel=1e-6)
    assert (airframe.drag_xy, airframe.drag_z, airframe.lag_up) == (9.1785e-7, 10.311e-7, 0)
    assert airframe.propeller_radius == 0.0231348
    assert airframe.shape.half == (0.06, 0.06, 0.0125)
    # Reaction torque about z there: -t0 + t1 - t2 + t3
    assert airframe.rotors == tuple(
        (x, y, turn) for (x, y), turn in zip(GYM_PLACES, (-1, 1, -1, 1), strict=True)
    )
    for name in ("arm", "gnd_eff_coeff", "dw_coeff_1"):
        assert ("not used", f"properties {name}") in report
    assert report["not used", "visual mesh of base_link"] == "./cf2.dae"
    assert report["default", "ground_effect"] == "0.1434, 0.27"  # 6.2 R
    assert_hovers(airframe, 14468.43 * math.sqrt(9.80665 / 9.8))


def test_the_first_rotor_from_the_nose_rightwards_is_ccw(convert):
    """As the signs in gym-pybullet-drones: +t0 - t1 + t2 - t3 for its racer, -t0... for a plus."""
    racer = tuple((x, -y) for x, y in GYM_PLACES)
    assert [turn for *_, turn in convert(gym(racer))[0].rotors] == [1, -1, 1, -1]
    plus = ((0.0397, 0), (0, 0.0397), (-0.0397, 0), (0, -0.0397))
    assert [turn for *_, turn in convert(gym(plus))[0].rotors] == [-1, 1, -1, 1]


def test_rotors_at_arms(convert):
    text = gym(places=(), properties=PROPERTIES.replace(" arm", ' layout="x" arm'))
    airframe, report = convert(text)
    # By hand: 0.0397 / sqrt(2)
    places = np.array([(x, y) for x, y, _ in airframe.rotors])
    np.testing.assert_allclose(places, 0.0280722 * np.sign(GYM_PLACES), rtol=1e-5)
    assert ("derived", "rotor") in report
    plus = convert(text.replace('layout="x"', 'layout="+"'))[0].rotors
    np.testing.assert_allclose(plus[0][:2], (0.0397, 0), atol=1e-12)
    assert [turn for *_, turn in plus] == [-1, 1, -1, 1]


def test_the_primitive_drone_of_pyflyt(convert):
    airframe, report = convert(pyflyt(), PYFLYT)
    assert (airframe.mass, airframe.inertia) == (1, (0.01, 0.01, 0.016))
    # By hand: sqrt(40 / 1.2e-6) = 5773.503 rpm = 604.5998 rad/s
    assert airframe.max_rotor_speed == pytest.approx(604.5998, rel=1e-6)
    assert airframe.max_thrust == pytest.approx(40)
    assert airframe.torque_ratio == 1
    assert (airframe.lag_up, airframe.lag_down, airframe.drag_xy) == (0.01, 0.01, 0)
    assert airframe.body_drag == (0.16, 0.16)
    assert airframe.propeller_radius == 0.12
    assert [turn for *_, turn in airframe.rotors] == [-1, -1, 1, 1]
    # 0.16 sqrt(2) + 0.12
    assert airframe.shape.half == pytest.approx((0.346274, 0.346274, 0.025), rel=1e-5)
    assert report["not used", "own.yaml motor_params noise_ratio"] == "0.003"
    assert ("not used", "own.yaml control_params") in report
    text = airframe.urdf.read_text()
    assert text.count("<visual>") == 5
    assert 'rgba="0 0.8 0 1"' in text
    # sqrt(9.80665 / 1.2e-6)
    assert_hovers(airframe, 2858.707)


def test_a_hummingbird_of_rotors(convert):
    airframe, report = convert(rotors())
    shipped = load_airframe("hummingbird")
    assert airframe.mass == pytest.approx(0.716)
    for name in ("thrust_coefficient", "torque_ratio", "max_rotor_speed", "lag_up", "lag_down"):
        assert getattr(airframe, name) == getattr(shipped, name)
    assert (airframe.drag_xy, airframe.drag_z) == (8.06428e-5, 0)
    # By hand: the rotors' 0.036 kg at 0.01 m lift the centre of mass by 0.00036 / 0.716
    lift = 0.000502793
    assert airframe.drag_height == pytest.approx(0.01 - lift, rel=1e-5)
    # xx: body 0.007 + 0.68 lift^2, rotors 4 * 1.755e-6 / 10 + 0.036 * 0.0094972^2 + 0.018 * 0.17^2
    assert airframe.inertia[0] == pytest.approx(0.00753064 - 0.9 * 4 * 1.755e-6, rel=1e-5)
    # zz: 0.012 + 4 * 7.66875e-5 / 10 + 0.036 * 0.17^2
    assert airframe.inertia[2] == pytest.approx(0.012 + 4 * (0.009 * 0.17**2 + 7.66875e-6))
    assert airframe.rotor_inertia == pytest.approx(7.66875e-6)
    assert [turn for *_, turn in airframe.rotors] == [1, -1, 1, -1]
    assert report["taken", "rotor spin"] == "cw ccw cw ccw"
    assert report["not used", "joint hb/imu_joint"] == "revolute"
    assert report["not used", "motor plugin rollingMomentCoefficient"] == "1e-06"
    # sqrt(0.716 * 9.80665 / (4 * 8.54858e-6)) = 453.147 rad/s
    assert_hovers(airframe, 453.147 * 60 / (2 * math.pi))


def test_links_are_joined_like_one_body(tmp_path):
    """Against sums over point masses, which four links with turned frames carry."""
    rng = np.random.default_rng(0)
    text, points, masses = '<robot name="r"><link name="l0"/>', [], []
    turn, place = Rotation.identity(), np.zeros(3)
    for k in range(1, 5):
        angles, shift = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)
        place = place + turn.apply(shift)
        turn = turn * Rotation.from_euler("xyz", angles)
        own_angles, own_shift = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)
        cloud, weight = rng.uniform(-1, 1, (6, 3)), rng.uniform(0.1, 1, 6)
        cloud -= np.average(cloud, axis=0, weights=weight)
        tensor = sum(
            m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(weight, cloud, strict=True)
        )
        names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        pairs = zip(names, tensor[np.triu_indices(3)], strict=True)
        values = " ".join(
            f'{name}="{value!r}"' for name, value in ((n, float(v)) for n, v in pairs)
        )

        def words(v):
            return " ".join(map(repr, v.tolist()))

        text += (
            f'<link name="l{k}"><inertial><origin xyz="{words(own_shift)}" '
            f'rpy="{words(own_angles)}"/><mass value="{float(weight.sum())!r}"/>'
            f"<inertia {values}/></inertial></link>"
        )
        text += joint(f"l{k}", f"l{k - 1}", words(shift), words(angles))
        own = Rotation.from_euler("xyz", own_angles).apply(cloud) + own_shift
        points.append(turn.apply(own) + place)
        masses.append(weight)
    (tmp_path / "r.urdf").write_text(text + "</robot>")
    urdf = UrdfFile(tmp_path / "r.urdf")
    body = join_links(urdf, place_links(urdf))
    points, masses = np.concatenate(points), np.concatenate(masses)
    centre = np.average(points, axis=0, weights=masses)
    assert body.mass == pytest.approx(masses.sum())
    np.testing.assert_allclose(body.centre, centre, atol=1e-12)
    offset = points - centre
    expected = np.einsum("m,mi,mi->", masses, offset, offset) * np.eye(3)
    expected -= np.einsum("m,mi,mj->ij", masses, offset, offset)
    np.testing.assert_allclose(body.inertia, expected, atol=1e-12)


def test_shapes_are_enclosed(convert):
    """A box turned by 45 degrees about y, and a lying cylinder."""
    box = '<box size="0.2 0.02 0.2"/>'
    text = gym(collision=box).replace("<collision>", '<collision><origin rpy="0 0.785398163 0"/>')
    half = convert(text)[0].shape.half
    assert half[2] == pytest.approx(0.1 * math.sqrt(2), rel=1e-6)
    assert half[0] == pytest.approx(math.hypot(0.1 * math.sqrt(2), 0.01), rel=1e-6)
    lying = gym().replace("<collision>", '<collision><origin rpy="1.57079632679 0 0"/>')
    half = convert(lying)[0].shape.half
    # Its rims end at y = 0.0125 and z = 0.06, or up to 0.13 % further out
    assert 0.06 <= half[2] <= 0.0601
    assert math.hypot(0.06, 0.0125) * 0.999 <= half[0] <= 0.0614


def test_a_mesh_that_cannot_be_read_is_replaced(convert):
    box = '<box size="0.02 0.02 0.03"/></geometry></collision><collision><geometry>'
    airframe, report = convert(gym(collision=box + '<mesh filename="cf2.dae"/>'))
    assert ("not used", "collision mesh of base_link") in report
    # Around the discs: 0.028 sqrt(2) + 0.0231348
    assert airframe.shape.half == pytest.approx((0.0627328, 0.0627328, 0.015), rel=1e-5)
    with pytest.raises(ValueError, match="no collision shape that can be read: add"):
        convert(gym(collision='<mesh filename="cf2.dae"/>'))


def test_moments_that_cannot_be(convert):
    """As RotorS' iris has them: 0.0977 > 0.0348 + 0.0459."""
    airframe, report = convert(gym().replace('izz="2.17e-05"', 'izz="3.5e-05"'))
    assert airframe.inertia == (1.4e-5, 1.4e-5, 2.8e-5)
    assert report["derived", "inertia about z"] == "2.8e-05"
    with pytest.raises(ValueError, match="each moment is at most the sum of the other two"):
        convert(gym().replace('izz="2.17e-05"', 'izz="9e-05"'))
    _, report = convert(gym().replace('ixz="0" iyy="1.4', 'ixz="1e-6" iyy="1.4'))
    assert report["not used", "inertia ixz"] == "1e-06"


WRONG = [
    (gym().replace("<robot", "<robot xmlns:xacro='http://ros.org/wiki/xacro'").replace(
        "</robot>", "<xacro:macro/></robot>"), "expand it with `xacro FILE > NAME.urdf`"),
    (gym().replace("<properties", "<airframe/><properties"), "needs no conversion"),
    (gym(properties=""), r"<thrust_coefficient> is missing: add kf=.* to <properties>"),
    (gym(properties=PROPERTIES.replace("3.16e-10", "0")), "<properties kf> is 0"),
    (gym(properties=PROPERTIES.replace("3.16e-10", "x")), "<properties kf> is x: a number"),
    (gym(properties=PROPERTIES.replace(' prop_radius="2.31348e-2"', "")), "add prop_radius="),
    (gym(properties=PROPERTIES.replace("2.25", "0.5")), "cannot hover"),
    (gym(places=()), "<properties layout> is missing: x or [+] is needed"),
    (gym(places=(), properties=""), "no links of rotors: name them prop"),
    (gym(places=GYM_PLACES[:3]), "4 to 8 links of rotors are needed"),
    (gym(places=(*GYM_PLACES, (0, 0.05))), "cannot alternate"),
    (gym().replace('value="0.027"', 'value="-1"'), "<mass value> is -1"),
    (gym().replace('value="0.027"', 'value="0"'), "must be above 0"),
    (gym().replace('type="fixed"', 'type="floating"', 1), "type floating: only joints of type"),
    (gym().replace('<parent link="base_link"/>', '<parent link="gone"/>', 1), "<joint parent> is"),
    (gym().replace('<parent link="base_link"/>', '<parent link="prop0_link"/>', 1), "in a circle"),
    (gym().replace('name="prop1_link"', 'name="prop0_link"'), "name of its own"),
    (gym().replace('rpy="0 0 0"', 'rpy="0.3 0 0"', 1), "its axis leans by 17.2 degrees"),
    (gym().replace('ixz="0" iyy="1.4', 'ixz="1e-5" iyy="1.4'), "principal axes only; turn"),
    (rotors(("cw", "ccw", "cw", "up")), "<turningDirection> is up: cw or ccw"),
    (rotors().replace("0.016", "0.017", 1), "<momentConstant> is .*all motors"),
    (rotors().replace("<motorNumber>1", "<motorNumber>0"), "a number of its own"),
    (rotors().replace("<linkName>hb/rotor_1", "<linkName>hb/rotor_9"), "there is no such link"),
    (rotors().replace('name="hb/imu_joint" type="revolute"', 'name="x" type="continuous"'),
     "only rotors may turn"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "said"), WRONG)
def test_files_that_cannot_be_converted(text, said, convert, tmp_path):
    with pytest.raises(ValueError, match=said) as error:
        convert(text)
    assert "own.urdf" in str(error.value)
    assert not (tmp_path / "new" / "made.urdf").exists()


def test_parameters_of_pyflyt_that_cannot_be(convert):
    for old, new, said in (
        ("3.0e-7", "-1", "thrust_coef is -1"),
        ("thrust_coef", "other", "thrust_coef is missing"),
        ("tau: 0.01", "tau: fast", "tau is 'fast'"),
    ):
        with pytest.raises(ValueError, match=rf"own\.yaml: .*{said}"):
            convert(pyflyt(), PYFLYT.replace(old, new, 1))
    both = '<properties prop_radius="0.1" kf="1e-7"/><link name="base">'
    with pytest.raises(ValueError, match="thrust_coefficient is .*delete one"):
        convert(pyflyt().replace('<link name="base">', both), PYFLYT)
    # Of another program
    with pytest.raises(ValueError, match="add kf="):
        convert(pyflyt(), "- 1\n")


def test_entities_do_not_fill_the_memory(convert):
    entities = '<!ENTITY a0 "aaaaaaaaaa">' + "".join(
        f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12)
    )
    text = f"<!DOCTYPE robot [{entities}]>" + gym().replace("</robot>", "&a11;</robot>")
    with pytest.raises(ValueError, match="is not valid XML"):
        convert(text)


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("cf2x.urdf").write_text(gym())
    with pytest.raises(ValueError, match="bulletuav convert FILE --out NAME.urdf"):
        load_airframe("cf2x.urdf")
    main(["convert", "cf2x.urdf", "--out", "mine.urdf"])
    said = capsys.readouterr().out
    assert "wrote mine.urdf" in said
    assert "3.16e-10" in said
    # The report stays in the file
    assert "not used: properties gnd_eff_coeff 11.36859" in Path("mine.urdf").read_text()
    assert load_airframe("mine.urdf").name == "cf2"
    for words, said in (
        (["cf2x.urdf"], "FILE and --out"),
        (["cf2x.urdf", "--out", "cf2x.urdf"], "choose another name"),
        (["cf2x.urdf", "--out", "cf2x.xml"], "must end in .urdf"),
        (["gone.urdf", "--out", "x.urdf"], "no URDF file gone.urdf"),
        (["cf2x.urdf", "--example", "x.urdf"], "leave out FILE and --out"),
        (["mine.urdf", "--out", "x.urdf"], "needs no conversion"),
    ):
        with pytest.raises(SystemExit):
            main(["convert", *words])
        assert said in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif("BULLETUAV_URDFS" not in os.environ, reason="needs a folder of public URDFs")
def test_public_files(tmp_path):
    """BULLETUAV_URDFS=FOLDER: cf2x.urdf, racer.urdf, primitive_drone.urdf (and .yaml), ..."""
    folder = shutil.copytree(os.environ["BULLETUAV_URDFS"], tmp_path / "public")
    files = sorted(folder.glob("*.urdf"))
    assert files
    for path in files:
        airframe, _ = convert_urdf(path, tmp_path / path.name)
        assert_hovers(airframe, airframe.hover_speed() * 60 / (2 * math.pi))
