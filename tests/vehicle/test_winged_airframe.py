"""Airframes with wings, read from URDF files and made in Python."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bulletuav import load_airframe
from bulletuav.vehicle.airframe import ControlSurface, Wing
from bulletuav.vehicle.airframes import helmbold_slope
from bulletuav.vehicle.wings import MAX_PANELS, MAX_SURFACES, wing_rows

TRAINER, QUADPLANE = load_airframe("trainer"), load_airframe("quadplane")


def test_the_trainer_is_read_as_its_file_says():
    left, right, tail, fin = TRAINER.wings
    assert left == Wing(
        name="left wing",
        position=(0.0234, 0.325, 0.07),
        span=0.65,
        chord=0.18,
        dihedral=0.052,
        incidence=0.024,
        aspect_ratio=7.22,
        lift_slope=helmbold_slope(7.22),
        zero_lift=-0.061,
        stall=0.2,
        drag=0.014,
        moment=-0.07,
        efficiency=0.8,
        downwash=0.0,
        slipstream=0.15,
        surface=ControlSurface("left aileron", 0.2, -0.4, 0.4, 4.0),
    )
    assert (right.position[1], right.dihedral) == (-0.325, -0.052)
    assert tail.aspect_ratio == pytest.approx(0.44 / 0.11)
    assert fin.dihedral == math.pi / 2
    assert [one.name for one in TRAINER.surfaces] == [
        "left aileron",
        "right aileron",
        "elevator",
        "rudder",
    ]
    assert (TRAINER.forward_rotors, TRAINER.rotor_heights) == ((0,), (0.0,))
    assert (TRAINER.lift_rotors, TRAINER.max_thrust, TRAINER.can_hover) == ((), 0.0, False)


def test_the_quadplane_hovers_on_its_four_rotors_along_z():
    assert QUADPLANE.forward_rotors == (4,)
    assert QUADPLANE.rotor_heights == (0.05, 0.05, 0.05, 0.05, 0.0)
    assert QUADPLANE.can_hover
    # By hand: 4 * 1.495e-5 * 1068^2 = 68.21 N, and 24.52 N of weight
    assert QUADPLANE.max_thrust == pytest.approx(68.21, rel=1e-4)
    assert QUADPLANE.hover_speed() == pytest.approx(math.sqrt(24.516625 / 5.98e-5))
    assert (QUADPLANE.allocation()[:, 4] == 0).all()
    assert (QUADPLANE.allocation()[0, :4] == 1).all()


def test_lift_slope_by_hand():
    """2 pi 6 / (2 + sqrt(40)) = 4.529; limits 2 pi and pi A / 2."""
    assert helmbold_slope(6.0) == pytest.approx(4.5287, rel=1e-4)
    assert helmbold_slope(1e6) == pytest.approx(2 * math.pi, rel=1e-5)
    assert helmbold_slope(1e-3) == pytest.approx(math.pi * 1e-3 / 2, rel=1e-3)


def lifting_line(aspect_ratio, twist):
    """Solve Prandtl's equation of a rectangular wing by Glauert's series; `twist` of cos(theta)."""
    terms = np.arange(1, 61)
    angle = terms * math.pi / 61
    mu = math.pi / (2 * aspect_ratio)
    matrix = np.sin(np.outer(angle, terms)) * (terms * mu + np.sin(angle)[:, None])
    return np.linalg.solve(matrix, mu * twist(np.cos(angle)) * np.sin(angle))


def test_lift_slope_is_near_that_of_the_lifting_line():
    for aspect_ratio in (5.0, 7.22, 12.0):
        first = lifting_line(aspect_ratio, np.ones_like)[0]
        assert helmbold_slope(aspect_ratio) == pytest.approx(
            math.pi * aspect_ratio * first, rel=0.03
        )


def test_strip_theory_has_more_roll_damping_than_the_lifting_line():
    """-0.797 against -0.567 for the trainer's wing, a limit of the model that its page names."""
    line = math.pi * 7.22 * lifting_line(7.22, lambda place: place)[1] / 4
    assert line == pytest.approx(0.567, abs=1e-3)
    assert helmbold_slope(7.22) / 6 == pytest.approx(1.40 * line, rel=0.01)


def test_strip_theory_has_more_effect_of_ailerons_than_the_lifting_line():
    """Ailerons along the whole span: 1.195 against 0.919 times their shift of the angle."""
    line = math.pi * 7.22 * lifting_line(7.22, np.sign)[1] / 4
    assert line == pytest.approx(0.919, abs=1e-3)
    assert helmbold_slope(7.22) / 4 == pytest.approx(1.30 * line, rel=0.01)


def test_effects_of_multirotors_are_off():
    for airframe in (TRAINER, QUADPLANE):
        assert airframe.damping == (0, 0, 0)
        assert (airframe.ground_effect_gain, airframe.wake_share) == (0, 0)


def test_rows_have_two_panels_a_wing():
    cf2x = load_airframe("cf2x")
    assert wing_rows([cf2x]) is None
    trainer, none, quadplane = wing_rows([TRAINER, cf2x, QUADPLANE])
    assert (trainer.num_panels, trainer.num_surfaces) == (8, 4)
    assert (none.num_panels, none.num_surfaces) == (0, 0)
    assert (quadplane.num_panels, quadplane.num_surfaces) == (10, 5)
    # Moment about x of a unit force along the normal of the inner panel: its place along the span,
    # 0.325 m from the middle of the wing, and its height, both at a dihedral of 0.052
    along, height = 0.325 - 0.18764 * math.cos(0.052), 0.07 - 0.18764 * math.sin(0.052)
    arm = along * math.cos(0.052) + height * math.sin(0.052)
    assert trainer.normal_arm[0][0] == pytest.approx(arm * math.cos(0.024), rel=1e-4)


AILERON = '<surface name="left aileron" chord="0.2" low="-0.4" high="0.4" rate="4"/>'
LEFT = '<wing name="left wing" x="0.0234" y="0.325"'
REFUSED = [
    (LEFT, '<wing name="left wing" y="0.325"', "wing x", "missing"),
    (LEFT, '<wing x="0.0234" y="0.325"', "wing name", "missing"),
    (LEFT, '<wing name="left wing" chrod="1" x="0.0234" y="0.325"', "wing chrod", "chord"),
    ('span="0.65"', 'span="0"', "wing span", "above 0"),
    ('span="0.65"', 'span="wide"', "wing span", "a number is needed"),
    ('chord="0.18"', 'chord="101"', "wing chord", "101"),
    ('aspect_ratio="7.22"', 'aspect_ratio="-7"', "wing aspect_ratio", "-7"),
    ('incidence="0.024"', 'incidence="2"', "wing incidence", "2"),
    ('zero_lift="-0.061"', 'zero_lift="-0.6"', "wing zero_lift", "-0.6"),
    ('stall="0.2"', 'stall="0"', "wing stall", "above 0"),
    ('stall="0.2"', 'stall="12"', "wing stall", "12"),
    ('stall="0.2"', "", "wing stall", "missing"),
    ('drag="0.014"', 'drag="-0.1"', "wing drag", "-0.1"),
    ('efficiency="0.8"', 'efficiency="1.1"', "wing efficiency", "1.1"),
    ('downwash="0.42"', 'downwash="1.1"', "wing downwash", "1.1"),
    ('slipstream="0.15"', 'slipstream="-0.1"', "wing slipstream", "-0.1"),
    ('name="right wing"', 'name="left wing"', "wing name", "another has the same name"),
    ('name="right aileron"', 'name="left aileron"', "surface name", "another has the same"),
    (AILERON, AILERON.replace('chord="0.2"', 'chord="0"'), "surface chord", "above 0"),
    (AILERON, AILERON.replace('low="-0.4"', 'low="0.1"'), "surface low", "0.1"),
    (AILERON, AILERON.replace('high="0.4"', 'high="2"'), "surface high", "2"),
    (AILERON, AILERON.replace('rate="4"', 'rate="0"'), "surface rate", "above 0"),
    (AILERON, AILERON.replace('rate="4"', ""), "surface rate", "missing"),
    (AILERON, AILERON.replace('rate="4"', 'rate="4" lag="1"'), "surface lag", "unknown attribute"),
    (AILERON, AILERON.replace('name="left aileron"', ""), "surface name", "missing"),
    (AILERON, 2 * AILERON, "surface", "there 2 times"),
    (AILERON, "<flap/>", "wing/flap", "unknown"),
    ('axis="x"', 'axis="y"', "rotor axis", "it must be x or z"),
    ('axis="x" spin="ccw"', 'axis="x" spin="left"', "rotor spin", "left"),
    ('axis="x"', 'axis="x" tilt="1"', "rotor tilt", "unknown attribute"),
    ('<rotor x="0.34" y="0" z="0" axis="x" spin="ccw"/>', "", "rotor", "0 times"),
    ('axis="x"', "", "airframe", "no forward rotor"),
    ("<max_speed", '<rate_damping x="1" y="1" z="1"/><max_speed', "airframe/rate_damping", "wings"),
    ("<max_speed", '<ground_effect gain="1" reach="1"/><max_speed', "airframe/ground", "wings"),
    ("<max_speed", '<wake share="1" spread="1" radius="1"/><max_speed', "airframe/wake", "wings"),
    ('z="5.561e-4"', 'z="5.561e-4" height="0.02"', "rotor_drag height", "0.02: it has no effect"),
    ('max_rotor_speed value="816.8"', 'max_rotor_speed value="400"', "airframe", "cannot fly lev"),
    (
        'max_speed value="17"',
        'max_speed value="9"',
        "airframe> is not able to fly on its wings",
        "",
    ),
    ('thrust_coefficient value="1.495e-5"', 'thrust_coefficient value="1"', "thrust", "1000 times"),
]


@pytest.mark.parametrize(("old", "new", "tag", "said"), REFUSED)
def test_wings_that_are_missing_or_not_physical_name_file_tag_and_value(urdf, old, new, tag, said):
    with pytest.raises(ValueError, match=r"own\.urdf") as error:
        load_airframe(urdf("trainer", (old, new)))
    assert f"<{tag}" in str(error.value)
    assert said in str(error.value)


def test_eight_wings_are_the_limit(urdf):
    more = '<wing name="{}" x="0" y="0" z="0" span="0.01" chord="0.01" zero_lift="0" stall="0.2" '
    more += 'drag="0.01" moment="0" efficiency="0.8"/>'
    several = [more.format(k) for k in range(5)]
    full = load_airframe(urdf("trainer", ("<contact", "".join(several[:4]) + "<contact")))
    assert 2 * len(full.wings) == MAX_PANELS
    assert len(full.surfaces) <= MAX_SURFACES
    with pytest.raises(ValueError, match="<wing> is there 9 times: at most 8"):
        load_airframe(urdf("trainer", ("<contact", "".join(several) + "<contact")))


@pytest.mark.parametrize("attribute", ["z", "axis"])
def test_rotors_without_wings_have_neither_height_nor_axis(urdf, attribute):
    text = f'spin="ccw" {attribute}="0"'
    with pytest.raises(ValueError, match=f"<rotor {attribute}> is 0: it has no effect without"):
        load_airframe(urdf("cf2x", ('spin="ccw"', text)))


def test_rotors_that_lift_a_quadplane_must_control_all_axes(urdf):
    with pytest.raises(ValueError, match="cannot control the torque about all three axes"):
        load_airframe(urdf("quadplane", ('spin="cw"', 'spin="ccw"')))


def test_a_vtol_that_hovers_must_fly_level_as_well(urdf):
    message = "not able to fly on its wings.*max_speed of 10 m/s.*raise max_speed to 11.51 m/s"
    with pytest.raises(ValueError, match=message):
        load_airframe(urdf("quadplane", ('max_speed value="19"', 'max_speed value="10"')))


def test_a_multirotor_with_a_fin_hovers_and_need_not_fly_level(finned):
    airframe = load_airframe(finned)
    assert airframe.can_hover
    assert airframe.rotor_heights == (0.0,) * 4


PYTHON = [
    ({"span": 0.0}, "span of wing 'left wing' of airframe 'trainer' is 0"),
    ({"chord": math.nan}, "chord of wing 'left wing' .* finite"),
    ({"position": (0.0, 0.0)}, "position of wing 'left wing' .* 3 values"),
    ({"position": (0.0, math.inf, 0.0)}, "position of wing 'left wing' .* finite"),
    ({"stall": 0.6}, "stall of wing 'left wing' .* at most 0.5"),
    ({"downwash": -0.1}, "downwash of wing .* at least 0"),
    ({"name": "right wing"}, "names of wings of airframe 'trainer' .* different"),
]


@pytest.mark.parametrize(("change", "message"), PYTHON)
def test_wings_made_in_python_are_physical(change, message):
    left, *others = TRAINER.wings
    with pytest.raises(ValueError, match=message):
        load_airframe(replace(TRAINER, wings=(replace(left, **change), *others)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"chord_fraction": 0.0}, "chord_fraction of control surface 'left aileron' .* is 0"),
        ({"low": 0.1}, "low of control surface 'left aileron' .* at most 0"),
        ({"high": 2.0}, "high of control surface 'left aileron' .* at most 1.5"),
        ({"rate": 0.0}, "rate of control surface 'left aileron' .* is 0"),
        ({"name": "rudder"}, "names of control surfaces .* different"),
    ],
)
def test_surfaces_made_in_python_are_physical(change, message):
    left, *others = TRAINER.wings
    left = replace(left, surface=replace(left.surface, **change))
    with pytest.raises(ValueError, match=message):
        load_airframe(replace(TRAINER, wings=(left, *others)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wings": TRAINER.wings * 3}, "number of wings .* from 1 to 8"),
        ({"forward_rotors": (1,)}, "an index of forward_rotors .* from 0 to 0"),
        ({"rotor_heights": ()}, "rotor_heights .* 1 values"),
        ({"rotor_heights": (math.nan,)}, "z of a rotor .* finite"),
        ({"damping": (1.0, 0.0, 0.0)}, "damping .* no effect next to wings"),
        ({"drag_height": -0.02}, "drag_height .* is -0.02: it has no effect next to wings"),
        ({"ground_effect_gain": 0.1}, "ground_effect_gain .* no effect next to wings"),
        ({"wake_share": 0.1}, "wake_share .* no effect next to wings"),
        ({"rotors": ()}, "number of rotors .* at least 1"),
    ],
)
def test_airframes_with_wings_made_in_python_are_consistent(change, message):
    with pytest.raises(ValueError, match=message):
        load_airframe(replace(TRAINER, **change))


@pytest.mark.parametrize("change", [{"forward_rotors": (0,)}, {"rotor_heights": (0.0,) * 4}])
def test_multirotors_have_no_forward_rotors(change):
    with pytest.raises(ValueError, match=r"it has no wings: leave .* empty"):
        load_airframe(replace(load_airframe("cf2x"), **change))
