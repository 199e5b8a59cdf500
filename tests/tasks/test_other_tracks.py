"""Race courses of other programs: gates by roll, pitch and yaw, in each program's axes."""

import json

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from bulletuav.tasks.parts.gate_frames import find_frames
from bulletuav.tasks.parts.gates import gate_axes
from bulletuav.tasks.parts.tracks import RandomTrack, load_track

USUAL = RandomTrack(6, 25.0, (2.0, 5.0), 0.0, "mixed", 1.6)
LSY = """
[controller]
file = "state_controller.py"
[env]
freq = 50
[env.track]
randomize = false
[[env.track.gates]]
pos = [0.5, 0.25, 0.7]
rpy = [0.1, -0.2, -0.78]
[[env.track.gates]]
pos = [-1.0, -0.25, 1.2]
rpy = [0.0, 0.0, 3.14]
[[env.track.obstacles]]
pos = [0.0, 0.75, 1.55]
[[env.track.obstacles]]
pos = [1.0, 0.25, 1.55]
"""
PORTALS = {
    "num_episodes": 5,
    "quadrotor_config": {
        "gates": [[0.5, -2.5, 0, 0, 0, -1.57, 0], [0.0, 0.2, 0.1, 0, 0, 1.57, 1]],
        "obstacles": [[1.5, -2.5, 0, 0, 0, 0]],
    },
}
USED = {"width": 2.4, "height": 2.4, "marginW": 0.0, "length": 0.0, "stationary": True}
TOGT = {
    "initState": {"pos": [-5.0, 4.5, 1.2]},
    "orders": ["a", "ball", "hex", "a"],
    "a": {"type": "RectanglePrisma", "position": [9, 6, 1], "rpy": [0, -90, -20], **USED},
    "ball": {"type": "SingleBall", "position": [0, 0, 2], "radius": 0.3, "margin": 0},
    "hex": {"type": "HexagonPrisma", "position": [5, 9, 1], "rpy": [0, -90, 70], "side": 1.5},
}


def load(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return load_track(path, USUAL)


def test_gates_of_lsy_drone_racing_are_flown_along_x(tmp_path):
    with pytest.warns(UserWarning, match="randomize, 2 obstacles, env.freq, controller"):
        gates = load(tmp_path, "level.toml", LSY)
    expected = Rotation.from_euler("xyz", [[0.1, -0.2, -0.78], [0, 0, 3.14]]).as_matrix()
    np.testing.assert_allclose(gate_axes(gates), np.swapaxes(expected, 1, 2), atol=1e-12)
    assert [gate.position for gate in gates] == [(0.5, 0.25, 0.7), (-1.0, -0.25, 1.2)]
    # 0.72 m wide, with an opening of 0.4 m
    assert {(gate.shape, gate.size, gate.size + 2 * gate.bar) for gate in gates} == {
        ("square", 0.4, 0.72)
    }


def test_gates_of_safe_control_gym_are_flown_along_y(tmp_path):
    with pytest.warns(UserWarning, match="not used: 1 obstacles, num_episodes"):
        gates = load(tmp_path, "level.yaml", yaml.safe_dump(PORTALS))
    # Its example flies the first towards +x, and the second towards -x
    np.testing.assert_allclose(gate_axes(gates)[:, 0], [[1, 0, 0], [-1, 0, 0]], atol=1e-3)
    np.testing.assert_allclose(gate_axes(gates)[:, 2], [[0, 0, 1]] * 2, atol=1e-12)
    # Centres of the tall and of the low gate are at 1 m and 0.525 m
    assert [gate.position for gate in gates] == [(0.5, -2.5, 1.0), (0.0, 0.2, 0.625)]
    assert {(gate.size, gate.bar) for gate in gates} == {(0.4, 0.05)}
    rows = {"gates": PORTALS["quadrotor_config"]["gates"]}
    assert load(tmp_path, "rows.yaml", yaml.safe_dump(rows)) == gates


def test_gates_of_togt_planner_are_flown_along_minus_z_with_x_up(tmp_path):
    with pytest.warns(UserWarning, match="initState, hex.HexagonPrisma beyond the widest circle"):
        gates = load(tmp_path, "race.yaml", yaml.safe_dump(TOGT))
    assert [gate.yaw for gate in gates] == pytest.approx(
        [-20, np.degrees(np.arctan2(3, -4)), 70, -20]
    )
    assert [gate.shape for gate in gates] == ["square", "round", "round", "square"]
    assert [gate.size for gate in gates] == pytest.approx([2.4, 0.6, 1.5 * np.sqrt(3), 2.4])
    assert [gate.pitch for gate in gates] == pytest.approx([0] * 4, abs=1e-9)


@pytest.mark.parametrize("rpy", [[0, -90, 40], [10, -60, 40], [-30, 20, 170]])
def test_any_rotation_of_a_togt_gate(tmp_path, rpy):
    table = {"type": "RectanglePrisma", "position": [1, 2, 3], "rpy": rpy, **USED}
    (gate, _) = load(tmp_path, "t.json", {"orders": ["a", "a"], "a": table})
    turn = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
    expected = [-turn[:, 2], turn[:, 1], turn[:, 0]]
    np.testing.assert_allclose(gate_axes([gate])[0], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("table", "corners"),
    [
        ({"type": "TrianglePrisma", "width": 2.4, "height": 2.0}, [[1, 0], [-1, 1.2], [-1, -1.2]]),
        (
            {"type": "TrianglePrisma", "width": 9.0, "height": 1.0},
            [[0.5, 0], [-0.5, 4.5], [-0.5, -4.5]],
        ),
        (
            {"type": "RectanglePrisma", "width": 2.0, "height": 1.5},
            [[0.75, 1], [0.75, -1], [-0.75, -1], [-0.75, 1]],
        ),
        (
            {"type": "PentagonPrisma", "radius": 2.0},
            [[2 * np.cos(k), 2 * np.sin(k)] for k in np.arange(5) * 2 * np.pi / 5],
        ),
    ],
)
def test_sizes_are_those_of_the_widest_circle_around_the_centre(tmp_path, table, corners):
    first = {"position": [1, 2, 3], "rpy": [0, -90, 0], **table}
    with pytest.warns(UserWarning, match="beyond the widest"):
        (gate, _) = load(tmp_path, "t.json", {"orders": ["a", "a"], "a": first})
    corners = np.array(corners, float)
    after = np.roll(corners, -1, axis=0)
    area = corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]
    radius = (np.abs(area) / np.linalg.norm(after - corners, axis=1)).min()
    assert gate.size == pytest.approx(2 * radius)


def test_margins_make_gates_smaller(tmp_path):
    first = {**TOGT["a"], "marginW": 0.8, "marginH": 0.8}
    assert load(tmp_path, "t.json", {"orders": ["a", "a"], "a": first})[0].size == 2.4 - 0.8


def test_balls_at_one_place_are_one_gate(tmp_path):
    """Flown along +x, and back with an offset in y."""
    places = {"a": [0, 0, 3], "b": [5, 0, 3], "c": [9, 4, 3], "d": [5, 0, 3]}
    balls = {k: {"type": "SingleBall", "position": v, "radius": 0.5} for k, v in places.items()}
    gates = load(tmp_path, "t.json", {"orders": list("abcd"), **balls})
    np.testing.assert_allclose(gate_axes(gates)[1, 0], np.array([9, 4, 0]) / np.sqrt(97))
    np.testing.assert_allclose(gate_axes(gates)[3, 0], np.array([-9, -4, 0]) / np.sqrt(97))
    assert find_frames(gates).tolist() == [0, 1, 2, 1]


def test_what_has_no_counterpart_is_listed(tmp_path):
    first = {**TOGT["a"], "length": 16.0, "midpoints": 1, "stationary": False}
    with pytest.warns(UserWarning, match="not used: a.length, a.midpoints, a.stationary: false$"):
        load(tmp_path, "t.json", {"orders": ["a", "a"], "a": first})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"env": {"track": {}}}, "gates of track .* is None"),
        ({"env": {"track": {"gates": [{"pos": [0, 0, 1]}]}}}, "gate 0 .*: pos and rpy are needed"),
        (
            {"env": {"track": {"gates": [{"pos": 1, "rpy": [0, 0]}]}}},
            "roll, pitch and yaw of gate 0",
        ),
        ({"gates": [[0, 0, 0, 0, 0, 0]]}, r"gate 0 .*type, 0 \(tall\) or 1 \(low\), are needed"),
        ({"gates": [[0, 0, 0, 0, 0, 0, 2]]}, "gate 0 .*are needed"),
        ({"gates": [[0, 0, "a", 0, 0, 0, 1]]}, "position of gate 0"),
        ({"orders": ["a"], "b": {}}, "has 'a': choose from"),
        ({"orders": ["a"], "a": {"type": "Cube"}}, "type of gate 'a' .*'Cube'"),
        ({"orders": ["a"], "a": {"type": "SingleBall"}}, "radius of gate 'a'"),
        ({"orders": ["a"], "a": {"type": "SingleBall", "radius": 1}}, "position next to gate 'a'"),
        ({"orders": ["a"], "a": {**TOGT["a"], "rpy": None}}, "roll, pitch and yaw of gate 'a'"),
        ({"orders": ["a"] * 500, "a": TOGT["a"]}, "orders of track"),
    ],
)
def test_bad_courses_give_one_error(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        load(tmp_path, "t.json", content)
