"""Race courses of users: files of all formats, gates that are flown twice, and close gates."""

import itertools
import json

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.policies.race_pilot import RacePilot
from bulletuav.tasks.parts.gate_frames import do_intersect, find_frames
from bulletuav.tasks.parts.gates import Gate, gate_axes, reverse_gate
from bulletuav.tasks.parts.tracks import (
    RandomTrack,
    find_track_error,
    load_track,
    place_start_blocks,
)

USUAL = RandomTrack(6, 25.0, (2.0, 5.0), 0.0, "mixed", 1.6)
RNG = np.random.default_rng(0)
OUT, BACK = {"position": [0.0, 0.0, 3.0]}, {"position": [20.0, 5.0, 3.0], "yaw": 180.0}

DOUBLE = {
    "gates": [
        {"name": "start", "position": [0, 0, 2.0], "yaw": 0},
        {"name": "far", "position": [20, 4, 2.0], "yaw": 30},
        {"name": "upper", "position": [38, 14, 4.4], "yaw": 30},
        {"name": "lower", "position": [38, 14, 2.0], "yaw": 30},
        {"name": "turn", "position": [-12, -10, 2.0], "yaw": 270},
    ],
    "order": ["start", "far", "upper", {"gate": "lower", "reverse": True}]
    + [{"gate": "far", "reverse": True}, "turn"],
}
"""A double gate, flown outwards above and back below (a split-S), and a gate flown both ways"""


def write(folder, name, content):
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_all_formats_are_the_same_track(tmp_path):
    gates = [{**OUT, "size": 1.5, "shape": "round"}, {**BACK, "pitch": 10.0}]
    expected = (
        Gate((0.0, 0.0, 3.0), shape="round", size=1.5),
        Gate((20.0, 5.0, 3.0), 180.0, 10.0, shape="round", size=1.6),
    )
    toml = "".join("[[gates]]\n" + "".join(f"{k} = {v!r}\n" for k, v in g.items()) for g in gates)
    rows = "# comment\nx,y,z,yaw,pitch,shape,size\n0,0,3,,,round,1.5\n20,5,3,180,10,,\n"
    files = {
        "a.toml": toml,
        "a.json": {"gates": gates},
        "list.JSON": json.dumps(gates),
        "a.yaml": yaml.safe_dump({"gates": gates}),
        "a.yml": yaml.safe_dump(gates),
        "a.csv": rows,
        "case.csv": rows.replace("x,y,z,yaw,pitch,shape,size", "X,Y,Z,Yaw,PITCH,Shape,Size"),
        "semicolons.csv": "\ufeff" + rows.replace(",", ";").replace("\n", "\r\n"),
    }
    for name, content in files.items():
        assert load_track(write(tmp_path, name, content), USUAL) == expected, name


def test_directions_of_all_kinds(tmp_path):
    turn = Rotation.from_euler("ZYX", [40.0, -20.0, 35.0], degrees=True)
    forward = turn.apply([1.0, 0.0, 0.0])
    given = [
        {"yaw": 40.0, "pitch": 20.0, "roll": 35.0},
        {"heading": 50.0, "pitch": 20.0, "roll": 35.0},
        {"direction": (3 * forward).tolist(), "roll": 35.0},
        {"quaternion": turn.as_quat().tolist()},
        {"quaternion": (-turn.as_quat()).tolist()},
    ]
    gates = [{"position": [0.0, 30.0 * k, 5.0], **one} for k, one in enumerate(given)]
    track = load_track(write(tmp_path, "t.json", gates), USUAL)
    for gate in track:
        np.testing.assert_allclose(gate_axes([gate])[0], turn.as_matrix().T, atol=1e-12)
    columns = "x,y,z,qx,qy,qz,qw\n" + "".join(
        f"{30 * k},0,5,{','.join(map(repr, turn.as_quat().tolist()))}\n" for k in range(2)
    )
    for gate in load_track(write(tmp_path, "t.csv", columns), USUAL):
        np.testing.assert_allclose(gate_axes([gate])[0], turn.as_matrix().T, atol=1e-12)


@pytest.mark.parametrize("pitch", [90.0, -90.0])
def test_quaternions_of_vertical_gates(tmp_path, pitch):
    turn = Rotation.from_euler("ZYX", [30.0, -pitch, 25.0], degrees=True)
    gates = [{"position": [0, 9.0 * k, 5], "quaternion": turn.as_quat().tolist()} for k in (0, 1)]
    gate, _ = load_track(write(tmp_path, "t.json", gates), USUAL)
    np.testing.assert_allclose(gate_axes([gate])[0], turn.as_matrix().T, atol=1e-7)


def test_an_order_has_passages_in_both_directions(tmp_path):
    track = load_track(write(tmp_path, "t.yaml", yaml.safe_dump(DOUBLE)), USUAL)
    assert [gate.position[0] for gate in track] == [0, 20, 38, 38, 20, -12]
    assert find_frames(track).tolist() == [0, 1, 2, 3, 1, 5]
    np.testing.assert_allclose(gate_axes(track)[4, :2], -gate_axes(track)[1, :2], atol=1e-15)
    numbers = {**DOUBLE, "order": [0, 1, 2, {"gate": 3, "reverse": True}, 4]}
    assert load_track(write(tmp_path, "n.json", numbers), USUAL) == track[:4] + track[5:]
    # The same track as a plain list of passages
    listed = [
        {"position": gate.position, "yaw": gate.yaw, "pitch": gate.pitch, "roll": gate.roll}
        for gate in track
    ]
    again = load_track(write(tmp_path, "l.json", listed), USUAL)
    assert find_frames(again).tolist() == [0, 1, 2, 3, 1, 5]


def test_reversed_gates_have_the_same_frame():
    gate = Gate((1.0, 2.0, 5.0), 30.0, 20.0, -35.0)
    forward, left, up = gate_axes([gate])[0]
    np.testing.assert_allclose(
        gate_axes([reverse_gate(gate)])[0], [-forward, -left, up], atol=1e-15
    )
    quarter = Gate((1.0, 2.0, 5.0), 30.0, 20.0, 55.0)
    tenth = Gate((1.0, 2.0, 5.0), 30.0, 20.0, -25.0)
    assert find_frames([gate, reverse_gate(gate), quarter, tenth]).tolist() == [0, 0, 0, 3]


def test_penetration_agrees_with_samples_of_the_bars():
    """Boxes intersect where a linear program finds a common point."""
    from scipy.optimize import linprog

    found = []
    for _ in range(120):
        one, two = (
            (RNG.uniform(-1, 1, (1, 3)), RNG.uniform(-0.6, 0.6, (1, 4, 3))) for _ in range(2)
        )
        # Fractions of all generators that bring both to the same point
        equal = np.concatenate([one[1][0], -two[1][0]]).T
        program = linprog(np.zeros(8), A_eq=equal, b_eq=(two[0] - one[0])[0], bounds=(-1, 1))
        assert do_intersect(*one, *two) == (program.status == 0)
        found.append(program.status == 0)
    assert 20 < sum(found) < 100


def error_of(*gates, motion=0.0):
    return find_track_error(gates, place_start_blocks(gates, 4), 0.15, motion)


def test_frames_may_be_close_until_they_intersect():
    gate = Gate((0.0, 0.0, 5.0))
    far = Gate((40.0, 0.0, 5.0))
    # Size 2 and bars of 0.2 m: frames are 2.4 m high, and 0.2 m thick
    for other in (
        Gate((0.0, 0.0, 7.4)),
        Gate((0.0, 0.0, 7.4), 180.0),
        Gate((0.0, 2.4, 5.0)),
        Gate((0.2, 0.0, 5.0)),
        Gate((4.3, 0.0, 5.0), 40.0),
        Gate((0.0, 0.0, 5.0), size=1.6),  # a frame in the opening of another
    ):
        assert error_of(gate, other, far) is None, other
    for other in (
        Gate((0.0, 0.0, 7.3)),
        Gate((0.1, 0.0, 5.0)),
        Gate((0.0, 0.0, 5.0), 1.0),
        Gate((0.0, 0.0, 5.0), 90.0),
    ):
        assert "overlap" in error_of(gate, other, far), other
    # Beside each other, oscillating ones meet
    beside = Gate((0.0, 3.0, 5.0))
    assert error_of(gate, beside, far, motion=0.29) is None
    assert "overlap" in error_of(gate, beside, far, motion=0.31)


def test_a_gate_may_stand_on_the_ground():
    far = Gate((40.0, 0.0, 5.0))
    assert error_of(Gate((0.0, 0.0, 1.01)), far) is None
    assert "into the ground" in error_of(Gate((0.0, 0.0, 0.99)), far)


def test_frames_keep_clear_of_starting_blocks():
    gate, far = Gate((0.0, 0.0, 3.0)), Gate((40.0, 0.0, 5.0))
    assert error_of(gate, far, Gate((-6.0, 0.0, 3.0))) is None  # its bars are above 1.8 m
    assert "starting block" in error_of(gate, far, Gate((-6.0, 0.0, 2.6)))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("t.json", {"gates": [OUT]}, "two or more are needed"),
        ("t.json", "3", "is 3: a list of gates is needed"),
        ("t.json", {"gates": [OUT, BACK], "laps": 2}, "has 'laps': choose from gates, order"),
        ("t.json", {"gates": [OUT] * 201}, "201 entries: at most 200"),
        ("t.json", [OUT, {**BACK, "rpy": [0, 0, 1]}], "gate 1 .* has 'rpy'"),
        ("t.json", [OUT, {**BACK, "heading": 3}], "yaw and heading are given"),
        ("t.json", [OUT, {**OUT, "direction": [0, 0, 0]}], "direction of a gate is"),
        ("t.json", [OUT, {**OUT, "direction": [1, 0, 0], "pitch": 3}], "pitch has no effect next"),
        ("t.json", [OUT, {**OUT, "quaternion": [0, 0, 0, 3]}], "of length 1 is needed"),
        ("t.json", [OUT, {**OUT, "quaternion": "x"}], "quaternion of a gate is not numbers"),
        ("t.json", {"gates": [OUT, BACK], "order": [0, 2]}, "gate in the order"),
        ("t.json", {"gates": [OUT, BACK], "order": [0, -1]}, "gate in the order"),
        ("t.json", {"gates": [OUT, BACK], "order": [0, True]}, "gate in the order"),
        ("t.json", {"gates": [OUT, BACK], "order": [0, 0]}, "leaves out gate 1"),
        ("t.json", {"gates": [OUT, BACK], "order": 3}, "order of track .* is 3"),
        ("t.json", {**DOUBLE, "order": ["strat"]}, "'strat': did you mean 'start'"),
        ("t.json", {"gates": [OUT, BACK], "order": [0, {"gate": 1, "back": 1}]}, "reverse = true"),
        (
            "t.json",
            {"gates": [OUT, BACK], "order": [0, {"gate": 1, "reverse": 1}]},
            "True or False",
        ),
        (
            "t.json",
            {"gates": [{**OUT, "name": "a"}, {**BACK, "name": "a"}], "order": [0, 1]},
            "gate 1 .* has the name 'a'",
        ),
        (
            "t.json",
            {"gates": [{**OUT, "name": 7}, BACK], "order": [0, 1]},
            "gate 0 .* has the name 7: one text",
        ),
        ("t.yaml", "gates: &a [*a]", "is not valid YAML"),
        ("t.yaml", "[" * 9999, "is not valid YAML"),
        ("t.csv", "0,0,3\n1,2,3\n", "has a column '0': a header"),
        ("t.csv", "x,y,z,x\n1,2,3,4\n", "has a column 'x'"),
        ("t.csv", "x,y,z\n1,2\n", "gate 0 .* has 2 columns: the header has 3"),
        ("t.csv", "x,y,z\n1,2,\n", "gate 0 .* has no z"),
        ("t.csv", "x,y,z\n1,2,high\n", "gate 0 .* has 'high' as z: a finite"),
        ("t.csv", "x,y,z\n1,2,inf\n", "gate 0 .* has 'inf' as z: a finite"),
        ("t.csv", "", "two or more are needed"),
        ("t.txt", "", "track .* is no .toml, .yaml"),
    ],
)
def test_bad_files_name_the_value_and_the_remedy(tmp_path, name, content, message):
    with pytest.raises(ValueError, match=message):
        load_track(str(write(tmp_path, name, content)), USUAL)


def race(track, **options):
    usual = {"num_drones": 1, "difficulty": "medium", "gate_size": 1.6, "randomization": {}}
    return bulletuav.Aviary("race", track=str(track), **{**usual, **options})


def test_gates_with_a_frame_move_together_and_have_one_frame(tmp_path):
    aviary = race(write(tmp_path, "t.json", DOUBLE), gate_motion=0.5, dynamics="single_integrator")
    aviary.reset(seeds=0)
    assert len(aviary.task.obstacles()) == 3 * 4 + 2 * 12  # squares and rounds, in turn
    memory = aviary.scene.memory
    for _ in range(20):
        np.testing.assert_allclose(memory["gate"][0, 1], memory["gate"][0, 4], atol=1e-12)
        aviary.step(np.zeros((1, 1, 3)))
    velocity = memory["gate_velocity"][0]
    np.testing.assert_allclose(velocity[1], velocity[4], atol=1e-12)
    assert np.abs(velocity[1]).max() > 0.01


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_the_pilot_finishes_a_split_s_and_a_gate_flown_both_ways(tmp_path, dynamics):
    aviary = race(write(tmp_path, "t.json", DOUBLE), laps=2, dynamics=dynamics, num_drones=2)
    observations = aviary.reset(seeds=0)
    pilot = RacePilot(aviary)
    pilot.reset(np.ones(1, dtype=bool))
    finished = np.zeros(2, dtype=bool)
    for _ in range(aviary.options.horizon):
        step = aviary.step(pilot.act(observations, aviary.swarm))
        observations = step.observations
        finished |= step.info["gates"][0] == 12
        if not aviary.alive.any():
            break
    assert finished.all()
    assert (step.info["missed"][0] == 0).all()


def test_close_gates_are_passed_in_one_decision(tmp_path):
    gates = [{"position": [0.3 * k, 0.0, 3.0]} for k in range(3)]
    far = {"position": [20.0, 0.0, 3.0]}
    aviary = race(
        write(tmp_path, "t.json", [*gates, far]), dynamics="single_integrator", take_off=False
    )
    aviary.reset(seeds=0)
    counts = [0]
    for k in itertools.count():
        offset = np.array([0.0 if k < 200 else 20.0, 0.0, 3.0]) - aviary.swarm.position[0, 0]
        offset[0] = -1.0 - aviary.swarm.position[0, 0, 0] if k < 100 else offset[0] + 20
        action = np.clip(offset / 0.75, -1, 1)[None, None]
        counts.append(
            int(aviary.step(action / np.sqrt(max(1, (action**2).sum()))).info["gates"][0, 0])
        )
        if counts[-1] == 4 or k > 300:
            break
    assert counts[-1] == 4
    assert max(np.diff(counts)) == 2
