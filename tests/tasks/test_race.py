"""The task `race`: gates, who passes them, tracks and what is refused, order, times and faults."""

import itertools

import numpy as np
import pytest
from matplotlib.path import Path as Polygon
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.tasks.parts.gates import (
    BAR,
    Gate,
    bar_poses,
    compute_remaining_distances,
    cross_gates,
    gate_axes,
    rank_drones,
)
from bulletuav.tasks.parts.tracks import (
    RandomTrack,
    draw_track,
    find_track_error,
    list_tracks,
    load_track,
    place_start_blocks,
)
from bulletuav.tasks.race import Race

POINTS = {"dynamics": "single_integrator", "randomization": {}, "difficulty": "easy"}
USUAL = RandomTrack(6, 25.0, (2.0, 5.0), 0.0, "square", 2.0)
RNG = np.random.default_rng(0)


def track_file(folder, *gates):
    """Write a track of tables of gates."""
    path = folder / "track.toml"
    tables = ["[[gates]]\n" + "".join(f"{k} = {v!r}\n" for k, v in gate.items()) for gate in gates]
    path.write_text("\n".join(tables))
    return str(path)


@pytest.fixture
def straight(tmp_path):
    """Two upright gates 20 m apart, flown to the east at 5 m."""
    there, on = {"position": [0.0, 0.0, 5.0]}, {"position": [20.0, 0.0, 5.0]}
    return track_file(tmp_path, there, on)


def made(track, worlds=1, task="race", **options):
    usual = {"num_drones": 1, "take_off": False, **POINTS}
    aviary = bulletuav.Aviary(task, worlds, **{**usual, "track": track, **options})
    aviary.reset(seeds=0)
    return aviary


def jump_to(aviary, place):
    """Fly drone 0 of world 0 straight to a place; give the last step."""
    for _ in range(300):
        way = (np.asarray(place) - aviary.swarm.position[0, 0]) / 0.05 / aviary.options.max_speed
        action = np.zeros((*aviary.alive.shape, 3))
        action[0, 0] = way / max(1.0, np.linalg.norm(way))
        step = aviary.step(action)
        if not aviary.alive[0, 0] or np.abs(place - aviary.swarm.position[0, 0]).max() < 1e-9:
            return step
    raise AssertionError("never there")


def gates(step):
    return int(step.info["gates"][0, 0])


# Gates


def test_axes_of_gates_are_those_of_their_angles():
    gate = Gate((0.0, 0.0, 5.0), yaw=30.0, pitch=20.0, roll=-40.0)
    turn = Rotation.from_euler("ZYX", [30.0, -20.0, -40.0], degrees=True)
    np.testing.assert_allclose(gate_axes([gate])[0], turn.as_matrix().T, atol=1e-15)
    assert gate_axes([gate])[0, 0, 2] == pytest.approx(np.sin(np.radians(20.0)))  # upwards


@pytest.mark.parametrize(("shape", "sides"), [("square", 4), ("round", 12)])
def test_bars_leave_the_opening_free_and_close_everything_about_it(shape, sides):
    gate = Gate((0.0, 0.0, 9.0), 50.0, 25.0, 10.0, shape, 2.4)
    gate_index, offset, turn = bar_poses([gate])
    assert (gate_index == 0).all()
    assert len(offset) == sides
    # Points of the gate's plane in the axes of each bar: x, y outwards, z along it.
    plane = RNG.uniform(-1.6, 1.6, (4000, 2))
    world = plane @ gate_axes([gate])[0, 1:]
    half = np.array((BAR, BAR, 2 * (1.2 + BAR) * np.tan(np.pi / sides))) / 2
    hit = np.zeros(len(plane), dtype=bool)
    for place, quaternion in zip(offset, turn, strict=True):
        seen = Rotation.from_quat(quaternion).inv().apply(world - place)
        hit |= (np.abs(seen) <= half + 1e-12).all(axis=1)
    corner = np.pi / sides
    steps = corner + 2 * corner * np.arange(sides)
    ring = np.stack([np.cos(steps), np.sin(steps)], axis=1) / np.cos(corner)
    inside = Polygon(1.2 * ring).contains_points(plane)
    frame = Polygon(1.4 * ring).contains_points(plane)
    np.testing.assert_array_equal(hit & frame, frame & ~inside)
    assert not (hit & inside).any()
    assert gate.reach == pytest.approx(1.4 / np.cos(corner))


def crossed(gate, before, after, moved=(0.0, 0.0, 0.0), passed=0.0, turns=1):
    """Cross a gate, which moves meanwhile, in 0.05 s until 1 s; give passed, split, missing."""
    old, new = (np.array(one, dtype=float).reshape(1, 1, 3) for one in (before, after))
    count, split = np.full((1, 1), passed), np.zeros((1, 1, turns))
    passing, missing = np.zeros((2, 1, 1))
    middle = np.array(gate.position).reshape(1, 1, 3)
    cross_gates(
        old,
        new,
        np.ones((1, 1), dtype=bool),
        np.ones(1),
        0.05,
        middle,
        middle + moved,
        gate_axes([gate])[None],
        np.full((1, 1), gate.size),
        np.array([gate.sides]),
        count,
        split,
        passing,
        missing,
    )
    assert passing[0, 0] == count[0, 0] - passed
    return count[0, 0], split[0, 0], missing[0, 0]


def test_a_gate_is_passed_forwards_alone_and_timed_where_its_plane_is_crossed():
    gate = Gate((1.0, 2.0, 5.0), yaw=90.0)
    there, beyond = (1.2, 1.7, 5.1), (1.0, 2.9, 5.0)
    passed, split, missed = crossed(gate, there, beyond)
    assert (passed, missed) == (1, 0)
    assert split[0] == pytest.approx(1.0 - 0.05 + 0.05 * 0.3 / 1.2)
    assert crossed(gate, beyond, there)[::2] == (0, 0)  # backwards
    assert crossed(gate, there, (1.0, 1.9, 5.0))[::2] == (0, 0)  # not yet there
    assert crossed(gate, (1.0, 2.0, 5.0), beyond)[0] == 0  # from the plane on: it was counted
    assert crossed(gate, there, beyond, passed=1.0)[0] == 1  # nothing is left


def test_a_gate_that_comes_over_a_hovering_drone_is_passed():
    gate = Gate((0.1, 0.0, 5.0))
    assert crossed(gate, (0.0, 0.0, 5.0), (0.0, 0.0, 5.0))[0] == 0
    assert crossed(gate, (0.0, 0.0, 5.0), (0.0, 0.0, 5.0), moved=(-0.2, 0.0, 0.0))[0] == 1
    # It swings aside: where the drone flies straight, it is no longer.
    assert crossed(gate, (0.0, 0.9, 5.0), (0.2, 0.9, 5.0), moved=(0.0, -0.5, 0.0))[::2] == (0, 1)


@pytest.mark.parametrize("shape", ["square", "round"])
def test_what_is_in_the_opening_is_what_a_polygon_says(shape):
    gate = Gate((3.0, -2.0, 6.0), -70.0, 30.0, 20.0, shape, 2.0)
    x, left, up = gate_axes([gate])[0]
    corner = np.pi / gate.sides
    steps = corner + 2 * corner * np.arange(gate.sides)
    ring = np.stack([np.cos(steps), np.sin(steps)], axis=1) / np.cos(corner)
    for y, z in RNG.uniform(-4.5, 4.5, (300, 2)) * RNG.uniform(0, 1, (300, 1)):
        place = np.array(gate.position) + y * left + z * up
        passed, _, missed = crossed(gate, place - 0.4 * x, place + 0.3 * x)
        assert passed == Polygon(ring).contains_point((y, z))
        assert missed == (not passed and np.hypot(y, z) <= 6.0)


# The race


def test_gates_count_in_turn(straight):
    aviary = made(straight)
    step = jump_to(aviary, (-6.0, 5.0, 5.0))
    assert gates(jump_to(aviary, (15.0, 5.0, 5.0))) == 0  # beside the first one
    assert step.info["missed"][0, 0] == 0
    assert aviary.scene.memory["missed"][0, 0] == 1
    assert gates(jump_to(aviary, (25.0, 0.0, 5.0))) == 0  # through the second one first
    jump_to(aviary, (25.0, 5.0, 5.0))
    jump_to(aviary, (3.0, 5.0, 5.0))
    jump_to(aviary, (3.0, 0.0, 5.0))
    assert gates(jump_to(aviary, (-3.0, 0.0, 5.0))) == 0  # the wrong way through
    step = jump_to(aviary, (3.0, 0.0, 5.0))
    assert gates(step) == 1
    assert step.info["rank"][0, 0] == 1
    np.testing.assert_array_equal(aviary.scene.goal[0, 0], (20.0, 0.0, 5.0))
    assert step.info["goal_distance"][0, 0] == pytest.approx(17.0)
    step = jump_to(aviary, (25.0, 0.0, 5.0))
    assert (gates(step), step.info["success"][0, 0], step.terminated[0, 0]) == (2, True, True)
    at_finish = step.info["race_time"][0, 0] - 2.0 * step.info["missed"][0, 0]
    assert at_finish == pytest.approx(step.info["split"][0, 0])
    assert step.info["lap_time"][0, 0] == step.info["split"][0, 0]


def test_laps_add_up_to_the_race(tmp_path):
    ring = [
        {"position": [0.0, -15.0, 4.0], "yaw": 0.0},
        {"position": [15.0, 0.0, 4.0], "yaw": 90.0},
        {"position": [0.0, 15.0, 4.0], "yaw": 180.0},
    ]
    aviary = made(track_file(tmp_path, *ring), laps=3)
    laps, times = [], []
    for _ in range(3):
        for x, y in ((-4.0, -15.0), (4.0, -15.0), (15.0, -4.0), (15.0, 4.0), (4.0, 15.0)):
            jump_to(aviary, (x, y, 4.0))
        step = jump_to(aviary, (-4.0, 15.0, 4.0))
        laps.append(step.info["lap_time"][0, 0])
        times.append(step.info["split"][0, 0])
    np.testing.assert_allclose(np.cumsum(laps), times)
    assert step.info["success"][0, 0]
    assert step.info["gates"][0, 0] == 9
    assert laps[1] == pytest.approx(laps[2])


def test_bars_are_turned_by_unit_quaternions():
    class Bent(Race):
        name = "bent"

        def spawn(self, rng):
            spawn = super().spawn(rng)
            return spawn._replace(obstacle_quaternion=2.0 * spawn.obstacle_quaternion)

    with pytest.raises(
        ValueError, match="obstacle_quaternion .* of obstacle .* has the norm 2: a un"
    ):
        bulletuav.Aviary(Bent, **POINTS).reset()


def test_rewards_are_ways_and_gates(straight):
    aviary = made(straight)
    first = aviary.scene.memory["remaining_distance"][0, 0]
    assert first == pytest.approx(np.linalg.norm(aviary.swarm.position[0, 0] - (0, 0, 5)) + 20.0)
    totals = dict.fromkeys(("progress", "gate", "finish"), 0.0)
    for place in ((-3.0, 0.0, 5.0), (3.0, 0.0, 5.0), (21.0, 0.0, 5.0)):
        while np.abs(place - aviary.swarm.position[0, 0]).max() > 1e-9 and aviary.alive[0, 0]:
            way = (place - aviary.swarm.position[0, 0]) / 0.05 / 15.0
            step = aviary.step((way / max(1.0, np.linalg.norm(way)))[None, None])
            for name in totals:
                totals[name] += step.info[f"reward/{name}"][0, 0]
    assert totals == {"progress": pytest.approx(first), "gate": 20.0, "finish": 50.0}


def test_order_and_overtaking():
    way = np.array([[5.0, 3.0, 0.0, 9.0, 0.0]])
    split = np.array([[0.0, 0.0, 8.0, 0.0, 7.0]])
    flown, rank, before, overtaken = np.ones((1, 5), dtype=bool), *np.zeros((3, 1, 5))
    rank_drones(way, split, flown, rank, before, overtaken)
    np.testing.assert_array_equal(rank[0], (4, 3, 2, 5, 1))
    assert not overtaken.any()  # nobody was behind anybody before the start
    way = np.array([[2.0, 3.0, 0.0, 1.0, 0.0]])
    rank_drones(way, split, np.array([[1, 1, 0, 1, 0]], dtype=bool), rank, before, overtaken)
    np.testing.assert_array_equal(rank[0], (4, 5, 2, 3, 1))
    np.testing.assert_array_equal(before[0], (4, 3, 2, 5, 1))
    np.testing.assert_array_equal(overtaken[0], (1, 0, 0, 2, 0))
    # Who flies no more is passed without being overtaken.
    crashed = np.array([[0, 1, 0, 1, 0]], dtype=bool)
    rank_drones(np.array([[2.0, 1.5, 0.0, 1.0, 0.0]]), split, crashed, rank, before, overtaken)
    assert not overtaken.any()


def test_ways_left_are_sums_of_legs():
    gate = RNG.uniform(-20, 20, (1, 3, 3))
    leg = np.linalg.norm(np.roll(gate, -1, axis=1) - gate, axis=-1)
    position, way = RNG.uniform(-20, 20, (1, 7, 3)), np.empty((1, 7))
    passed = np.arange(7.0)[None]
    compute_remaining_distances(position, passed, gate, leg, 6, way)
    for i in range(6):
        turns = [gate[0, turn % 3] for turn in range(i, 6)]
        steps = np.diff([position[0, i], *turns], axis=0)
        assert way[0, i] == pytest.approx(np.linalg.norm(steps, axis=1).sum())
    assert way[0, 6] == 0


def test_a_drone_that_touches_costs_time_once_and_flies_on_where_contacts_end_nothing(straight):
    aviary = made(straight, contact_ends="nothing", dynamics="rigid_body", penalty=3.0)
    assert aviary.step(np.zeros((1, 1, 3))).info["contacts"][0, 0] == 0
    down = np.zeros((1, 1, 3))
    down[..., 2] = -1.0
    for _ in range(60):
        step = aviary.step(down)
    assert aviary.alive.all()
    assert step.info["collision"][0, 0]
    assert step.info["contacts"][0, 0] == 1
    assert step.info["race_time"][0, 0] == pytest.approx(61 * 0.05 + 3.0)


def test_drones_start_on_blocks_before_the_first_gate(straight):
    aviary = made(straight, num_drones=6, take_off=True, dynamics="rigid_body")
    place = aviary.swarm.position[0]
    np.testing.assert_allclose(place[:, 0], [-6.0] * 4 + [-8.5] * 2)
    np.testing.assert_allclose(place[:, 1], (-3, -1, 1, 3, -1, 1))
    np.testing.assert_allclose(place[:, 2], aviary.task.context.standing_height)
    assert (aviary.swarm.rotor_speed == 0).all()
    assert not aviary.step(np.zeros((1, 6, 3))).terminated.any()


@pytest.mark.parametrize(
    "dynamics",
    ["single_integrator", "double_integrator", "point_mass", "rigid_body", "bullet"],
)
@pytest.mark.parametrize("bar", [(0.0, 1.3), (1.3, 0.0), (0.0, -1.3)])
def test_frames_stop_drones_at_20_metres_a_second(straight, dynamics, bar):
    class Shot(Race):
        name = "shot"

        def spawn(self, rng):
            return super().spawn(rng)._replace(velocity=(20.0, 0.0, 0.0))

    start = [(-3.0, bar[0], 5.0 + bar[1])]
    options = {"max_speed": 20.0, "start": start, "contact_ends": "nothing"}
    aviary = made(straight, task=Shot, dynamics=dynamics, **options)
    ahead = np.zeros((1, 1, 3))
    ahead[..., 0] = 1.0
    for _ in range(10):
        speed = aviary.swarm.velocity[0, 0, 0]
        if aviary.step(ahead).info["collision"][0, 0]:
            break
    assert speed > 15.0
    assert aviary.scene.memory["contacts"][0, 0] == 1
    assert aviary.swarm.position[0, 0, 0] < 0.0
    assert aviary.scene.memory["passed"][0, 0] == 0


@pytest.mark.parametrize("motion", [0.0, 1.5])
def test_gates_swing_with_their_bars(motion):
    options = {"gate_motion": motion, "gate_period": 4.0, "num_gates": 4, "gate_shape": "mixed"}
    aviary = made("random", worlds=2, **options)
    memory, scene = aviary.scene.memory, aviary.scene
    gates = [memory["gate"].copy()]
    bars = scene.obstacle - memory["gate"][:, aviary.task.course._gate_index]
    speeds = [memory["gate_velocity"].copy()]
    for _ in range(80):  # a whole swing
        aviary.step(np.zeros((2, 1, 3)))
        gates.append(memory["gate"].copy())
        speeds.append(memory["gate_velocity"].copy())
    gates, speeds = np.array(gates), np.array(speeds)
    np.testing.assert_allclose(gates[-1], gates[0], atol=1e-9)
    swing = np.linalg.norm(gates - (gates.max(axis=0) + gates.min(axis=0)) / 2, axis=-1)
    np.testing.assert_allclose(swing.max(axis=0), motion, rtol=1e-3)
    slope = (gates[2:] - gates[:-2]) / 0.1
    np.testing.assert_allclose(slope, speeds[1:-1], atol=2e-3 * motion)
    up = memory["gate_axis"][:, :, 2]
    assert np.abs(((gates - gates[0]) * up).sum(axis=-1)).max() < 1e-9  # to the left and right
    now = scene.obstacle - memory["gate"][:, aviary.task.course._gate_index]
    np.testing.assert_allclose(now, bars, atol=1e-9)
    moving = np.linalg.norm(scene.obstacle_velocity, axis=-1).max() > 0
    assert moving == (motion > 0)


def test_the_next_gates_are_seen_in_body_axes():
    aviary = made("random", num_drones=3, dynamics="rigid_body", gate_motion=0.5, laps=1)
    for _ in range(20):
        aviary.step(RNG.uniform(-1, 1, (1, 3, 3)))
    names = [label.name for label in aviary.observer.labels]
    first = names.index("gate 1 position x")
    seen = aviary.observer.observe(aviary.current_frame(), aviary.alive)[0]
    scene, memory = aviary.scene, aviary.scene.memory
    for i, k in itertools.product(range(3), range(2)):
        turn = Rotation.from_quat(aviary.swarm.quaternion[0, i]).inv()
        told = seen[i, first + 10 * k : first + 10 * (k + 1)]
        vectors = (
            memory["gate"][0, k] - aviary.swarm.position[0, i],
            memory["gate_axis"][0, k, 0],
            memory["gate_velocity"][0, k],
        )
        expected = np.concatenate([*turn.apply(vectors), memory["gate_size"][0, k : k + 1]])
        np.testing.assert_allclose(told, expected, atol=1e-4)
    memory["passed"][:] = 5
    seen = aviary.observer.observe(aviary.current_frame(), aviary.alive)[0]
    assert (seen[:, first + 10 : first + 20] == 0).all()  # after the last one there is none
    assert scene.goal.shape == (1, 3, 3)


def test_drones_aim_beyond_the_next_gate_and_farther_back_beside_its_axis():
    blocks = ("gate_aim", "rank")
    aviary = made("random", num_drones=3, dynamics="rigid_body", laps=1, observation=blocks)
    for _ in range(20):
        aviary.step(RNG.uniform(-1, 1, (1, 3, 3)))
    seen = aviary.observer.observe(aviary.current_frame(), aviary.alive)[0]
    memory = aviary.scene.memory
    for i in range(3):
        turn = Rotation.from_matrix(memory["gate_axis"][0, 0].T)
        _, left, up = turn.inv().apply(aviary.swarm.position[0, i] - memory["gate"][0, 0])
        aim = memory["gate"][0, 0] + turn.apply([2 - 2 * np.hypot(left, up), 0, 0])
        np.testing.assert_allclose(seen[i, :3], aim - aviary.swarm.position[0, i], atol=1e-4)
    assert sorted(seen[:, 3]) == [1, 2, 3]
    memory["passed"][:] = 6
    seen = aviary.observer.observe(aviary.current_frame(), aviary.alive)[0]
    assert (seen[:, :3] == 0).all()  # after the last gate


# Tracks


@pytest.mark.parametrize("name", list_tracks())
def test_our_tracks_can_be_flown_by_eight(name):
    track = load_track(name, USUAL)
    assert find_track_error(track, place_start_blocks(track, 8), 0.2, 0.0) is None
    aviary = made(name, num_drones=8, laps=2)
    assert aviary.task.turns == 2 * len(track)
    assert (aviary.task.arena_low < [gate.position for gate in track]).all()


def test_random_tracks_follow_from_the_seed_and_can_be_flown():
    tilted = RandomTrack(8, 25.0, (2.0, 6.0), 30.0, "mixed", 1.8)
    tracks = [draw_track(np.random.default_rng(k), tilted, 8, 0.2, 1.0) for k in range(20)]
    assert tracks[3] == draw_track(np.random.default_rng(3), tilted, 8, 0.2, 1.0)
    assert len({track[0].position for track in tracks}) == 20
    for track in tracks:
        assert find_track_error(track, place_start_blocks(track, 8), 0.2, 1.0) is None
        assert [gate.shape for gate in track] == ["square", "round"] * 4
        heights = [gate.position[2] for gate in track]
        assert 2.0 <= min(heights) <= max(heights) <= 6.0


SOUTH = {"position": [0.0, -9.0, 4.0]}
NORTH = {"position": [0.0, 9.0, 4.0], "yaw": 180.0}


@pytest.mark.parametrize(
    ("gates", "told"),
    [
        ([SOUTH], "two or more are needed"),
        ([SOUTH, {"yaw": 3.0}], "gate 1 of track .* has no position"),
        ([SOUTH, {**NORTH, "width": 2.0}], "gate 1 of track .* has 'width'"),
        (
            [SOUTH, {**NORTH, "shape": "rond"}],
            "unknown shape of a gate 'rond': did you mean 'round'",
        ),
        ([SOUTH, {**NORTH, "size": 0.0}], "size of a gate is 0 m"),
        ([SOUTH, {**NORTH, "size": "big"}], "gate 1 of track .*size of a gate"),
        ([SOUTH, {**NORTH, "pitch": 95.0}], "pitch of a gate"),
        ([SOUTH, {**NORTH, "position": [0.0, 9.0]}], "position of a gate"),
        ([SOUTH, {**NORTH, "position": [0.1, -9.0, 4.0]}], "gate 0 .* and gate 1 .* overlap"),
        ([SOUTH, {**NORTH, "position": [0.0, 9.0, 1.0]}], "gate 1 .* reaches into the ground"),
        ([SOUTH, {**NORTH, "pitch": -80.0, "position": [0, 9, 3.0]}], "gate 1 .* faces the ground"),
        ([SOUTH, {**NORTH, "size": 0.3}], "gate 1 .* is 0.3 m wide, and a drone is 0.3"),
        ([{**SOUTH, "pitch": 85.0}, NORTH], "gate 0 has a pitch of 85 degrees"),
        ([SOUTH, {"position": [-6.0, -9.0, 1.6]}], "from a starting block"),
        ([SOUTH, {**NORTH, "position": [0.0, 900.0, 4.0]}], "drones fly 450 m in 30 s at most"),
    ],
)
def test_tracks_that_cannot_be_flown_are_refused(tmp_path, gates, told):
    with pytest.raises(ValueError, match=told):
        bulletuav.Aviary("race", track=track_file(tmp_path, *gates), **POINTS)


def test_tracks_that_are_no_tracks_are_refused(tmp_path):
    with pytest.raises(ValueError, match="unknown track 'ovl': did you mean 'oval'"):
        bulletuav.Aviary("race", track="ovl")
    with pytest.raises(FileNotFoundError, match="none.toml"):
        bulletuav.Aviary("race", track=str(tmp_path / "none.toml"))
    path = tmp_path / "bad.toml"
    path.write_text("[[gates\n")
    with pytest.raises(ValueError, match="is not valid TOML"):
        bulletuav.Aviary("race", track=str(path))
    path.write_text("gates = [1, 2]\n")
    with pytest.raises(ValueError, match="gate 0 of track .* is 1: a table"):
        bulletuav.Aviary("race", track=str(path))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"num_gates": 30}, "no random track of 30 gates within 25 m can be flown"),
        ({"gate_height": (5.0, 2.0)}, "gate_height is"),
        ({"gate_motion": 1.0, "gate_period": 0.0}, "gate_period is 0 s"),
        ({"laps": 9}, "track 'random' has 9 laps .* raise horizon"),
        ({"gate_shape": "oval"}, "gate_shape"),
        ({"num_gates": 1}, "num_gates"),
        ({"contact_ends": "world"}, "contact_ends"),
    ],
)
def test_options_that_cannot_be_are_refused(options, told):
    with pytest.raises(ValueError, match=told):
        bulletuav.Aviary("race", **{**POINTS, **options})
