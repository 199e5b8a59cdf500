"""The task `formation`: leaders, places, exchanges, measures and what is refused."""

import itertools

import numpy as np
import pytest
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.tasks.parts.formation_plan import FormationConfig
from bulletuav.tasks.parts.formations import Course, assign_places, in_world, off_places, off_shape

POINTS = {"dynamics": "single_integrator", "randomization": {}, "jitter": 0.0}
DIAMOND = np.array([(8.0, 0.0, 0.0), (0.0, 8.0, 0.0), (0.0, -8.0, 0.0), (-8.0, 0.0, 4.0)])
RNG = np.random.default_rng(0)


def made(worlds=1, **options):
    usual = {"num_drones": 4, "difficulty": "easy", "exchange": 0.0}
    aviary = bulletuav.Aviary("formation", worlds, **{**POINTS, **usual, **options})
    aviary.reset(seeds=0)
    return aviary


def still(aviary):
    return aviary.step(np.zeros((*aviary.alive.shape, 3)))


def jump_to(aviary, places):
    """Fly all drones to places (W, N, 3) in as many decisions as it takes."""
    for _ in range(200):
        ways = places - aviary.swarm.position
        if np.abs(ways).max() < 1e-9:
            return
        speed = ways / aviary.task.context.period / aviary.options.max_speed
        norm = np.linalg.norm(speed, axis=-1, keepdims=True)
        aviary.step(speed / np.maximum(norm, 1.0))
    raise AssertionError("never there")


def in_leaders_frame(aviary):
    """Goals (W, N, 3) as seen from the leader: forward, left, up."""
    leader = aviary.scene.memory["leader"]
    seen = [
        Rotation.from_euler("z", -row[3]).apply(goal - row[:3])
        for row, goal in zip(leader, aviary.scene.goal, strict=True)
    ]
    return np.array(seen)


# The leader and the places about it


@pytest.mark.parametrize("turn", [0.0, 0.3, -0.3])
def test_the_leader_flies_the_integral_of_its_velocity(turn):
    course = Course(speed=5.0, turn=abs(turn), altitude=40.0, duration=30.0, period=0.1)
    time = np.linspace(0.0, 30.0, 30_001)
    leader = course.at(time, np.full(len(time), 0.7), np.full(len(time), turn))
    np.testing.assert_allclose(np.linalg.norm(leader.velocity, axis=1), 5.0)
    np.testing.assert_allclose(leader.yaw, 0.7 + turn * time)
    # The trapezium rule with steps of 1 ms.
    means = (leader.velocity[1:] + leader.velocity[:-1]) / 2
    flown = leader.position[0] + np.cumsum(means * 1e-3, axis=0)
    np.testing.assert_allclose(leader.position[1:], flown, atol=1e-5)
    # Its way lies about the origin: a straight one of 150 m, a circle of 5 / 0.3 m.
    reach = np.linalg.norm(leader.position[:, :2], axis=1).max()
    assert reach == pytest.approx(75.0 if turn == 0.0 else 5 / 0.3, rel=2e-4)
    assert course.radius == pytest.approx(reach, rel=2e-4)


def test_a_quarter_turn_by_hand():
    """At 90 degrees a place 10 m ahead and 2 m to the left is 10 m north and 2 m west."""
    course = Course(speed=0.0, turn=np.pi / 2, altitude=30.0, duration=2.0, period=1.0)
    leader = course.at(np.ones(1), np.zeros(1), np.full(1, np.pi / 2))
    position, velocity = in_world(np.array([[(10.0, 2.0, 1.0)]]), leader)
    np.testing.assert_allclose(position[0, 0], (-2.0, 10.0, 31.0), atol=1e-12)
    # turn x r, with 90 degrees a second
    np.testing.assert_allclose(velocity[0, 0], np.pi / 2 * np.array((-10.0, -2.0, 0)), atol=1e-12)


@pytest.mark.parametrize("options", [{}, {"turn_rate": 6.0}, {"turn_rate": 9.0, "leader_speed": 0}])
def test_goals_move_as_their_velocities_say(options):
    options = {"leader_speed": 5.0, **options}
    options["leader_speed"] = float(options["leader_speed"])
    aviary = made(3, shapes=DIAMOND, decision_hz=80, **options)
    goals, velocities = [aviary.scene.goal.copy()], [aviary.scene.goal_velocity.copy()]
    for _ in range(30):
        still(aviary)
        goals.append(aviary.scene.goal.copy())
        velocities.append(aviary.scene.goal_velocity.copy())
        np.testing.assert_allclose(in_leaders_frame(aviary), [DIAMOND] * 3, atol=1e-9)
    # Central differences over 25 ms are off by no more than the third derivative tells.
    central = (np.array(goals[2:]) - np.array(goals[:-2])) / (2 / 80)
    np.testing.assert_allclose(central, velocities[1:-1], atol=1e-4)
    if options.get("turn_rate"):
        turns = aviary.scene.memory["turn"]
        np.testing.assert_allclose(np.abs(turns), np.radians(options["turn_rate"]))
    aviary.close()


def test_leaders_turn_to_both_sides_and_fly_to_all():
    aviary = made(64, turn_rate=3.0)
    memory = aviary.scene.memory
    assert 0.25 < (memory["turn"] > 0).mean() < 0.75
    quarters = np.floor(memory["course"] / (np.pi / 2))
    assert set(quarters) == {-2, -1, 0, 1}
    aviary.close()


def test_places_are_in_the_arena_at_all_times():
    aviary = made(4, turn_rate=4.0, num_drones=7, horizon=300, boundary="open", margin=5.0)
    for _ in range(300):
        assert (aviary.scene.goal > aviary.task.arena_low).all()
        assert (aviary.scene.goal < aviary.task.arena_high).all()
        still(aviary)
    aviary.close()


def test_drones_start_as_a_block_about_the_leader_in_any_order_and_fly_along():
    aviary = made(8)
    memory, swarm = aviary.scene.memory, aviary.swarm
    offset = swarm.position - memory["leader"][:, None, :3]
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), 12 * np.sqrt(0.5))
    np.testing.assert_allclose(swarm.velocity, np.repeat(memory["leader_velocity"][:, None], 4, 1))
    firsts = {tuple(np.sign(Rotation.from_euler("z", -yaw).apply(row)[0, :2].round(6)))
              for row, yaw in zip(offset, memory["leader"][:, 3], strict=True)}  # fmt: skip
    assert len(firsts) > 1
    aviary.close()


# Who goes where


def test_the_assignment_is_the_best_of_all():
    for _ in range(20):
        position, place = RNG.normal(0, 10, (4, 3)), RNG.normal(0, 10, (6, 3))
        sums = {
            order: ((position - place[list(order)]) ** 2).sum()
            for order in itertools.permutations(range(6), 4)
        }
        assert tuple(assign_places(position, place)) == min(sums, key=sums.get)


def test_fixed_places_are_those_of_the_shape_in_order():
    aviary = made(shapes=[*DIAMOND.tolist(), (-20.0, 0.0, 0.0)])
    np.testing.assert_allclose(in_leaders_frame(aviary)[0], DIAMOND, atol=1e-9)
    aviary.close()


@pytest.mark.parametrize("start", [None, [(9.0, 3, 30), (0, -9.0, 30), (-8.0, 0, 30), (1, 7, 30)]])
def test_free_places_are_the_best_ones_from_where_drones_start(start):
    aviary = made(shapes=DIAMOND, assignment="free", start=start)
    position, goal = aviary.swarm.position[0], aviary.scene.goal[0]
    chosen = ((position - goal) ** 2).sum()
    every = [((position - goal[list(o)]) ** 2).sum() for o in itertools.permutations(range(4))]
    assert chosen == min(every)
    assert max(every) > chosen
    np.testing.assert_array_equal(np.sort(aviary.scene.memory["place"][0]), np.arange(4))
    aviary.close()


def test_shapes_change_in_turn_and_back():
    aviary = made(shapes=("line", "ring", DIAMOND), change_every=0.5, spacing=12.0)
    line = np.array([(0.0, 18.0, 0.0), (0, 6.0, 0), (0, -6.0, 0), (0, -18.0, 0)])
    radius = 12 / np.sqrt(2)
    ring = np.array([(radius, 0.0, 0.0), (0, radius, 0), (-radius, 0, 0), (0, -radius, 0)])
    for k in range(20):
        still(aviary)
        wanted = (line, ring, DIAMOND)[k // 5 % 3]
        np.testing.assert_allclose(in_leaders_frame(aviary)[0], wanted, atol=1e-9)
    aviary.close()


def test_the_new_shape_is_assigned_to_where_drones_are():
    aviary = made(shapes=("line", "ring"), change_every=0.5, assignment="free")
    for _ in range(5):
        still(aviary)
    position = aviary.swarm.position[0].copy()
    still(aviary)
    goal, before = aviary.scene.goal[0], aviary.scene.goal_velocity[0] * 0.1
    sums = [((position - (goal - before)[list(o)]) ** 2).sum()
            for o in itertools.permutations(range(4))]  # fmt: skip
    assert sums[0] == min(sums)
    aviary.close()


def test_an_exchange_leaves_nobody_its_place_and_no_place_empty():
    aviary = made(6, exchange=0.3)
    place = aviary.scene.memory["place"]
    seen = []
    for _ in range(4):
        seen.append(place.copy())
        for _ in range(3):
            np.testing.assert_array_equal(place, seen[-1])
            still(aviary)
        assert (place != seen[-1]).all()
        np.testing.assert_array_equal(np.sort(place), np.tile(np.arange(4), (6, 1)))
    assert len({tuple(row) for row in seen[-1]}) > 1  # worlds differ
    aviary.close()


def test_drones_that_left_are_told_nothing():
    aviary = made(exchange=0.5, start=[(0.0, 0, 40), (9.0, 0, 40), (0, 9.0, 40), (0, 20, 1.0)])
    down = np.zeros((1, 4, 3))
    down[0, 3, 2] = -1.0
    aviary.step(down)
    assert aviary.alive[0].tolist() == [True, True, True, False]
    for _ in range(5):
        still(aviary)
    place = aviary.scene.memory["place"][0]
    assert place[3] == 3
    assert (place[:3] != (0, 1, 2)).all()
    assert set(place[:3]) == {0, 1, 2}
    aviary.close()


# What is measured


def test_errors_by_hand():
    goal = np.zeros((1, 4, 3))
    position = np.array([[(3.0, 0, 0), (0, 4.0, 0), (0, 0, 0), (0, 0, 99.0)]])
    counts = np.array([[True, True, True, False]])
    assert off_places(position, goal, counts)[0] == pytest.approx(np.sqrt((9 + 16) / 3))
    # Two drones 3 m apart instead of 2 m: each is half a metre off.
    pair = np.array([[(0.0, 0, 0), (2.0, 0, 0)]])
    wide = np.array([[(5.0, 5, 5), (5.0, 8, 5)]])
    assert off_shape(wide, pair, np.ones((1, 2), dtype=bool))[0] == pytest.approx(0.5)
    alone = np.array([[True, False, False, False]])
    assert off_shape(position, goal, alone)[0] == 0.0
    nobody = np.zeros((1, 4), dtype=bool)
    assert off_places(position, goal, nobody)[0] == off_shape(position, goal, nobody)[0] == 0.0


@pytest.mark.parametrize("count", [3, 4, 8])
@pytest.mark.parametrize("flat", [True, False])
def test_the_error_of_the_shape_is_that_of_the_best_rotation(count, flat):
    goal = RNG.normal(0, 10, (5, count, 3)) * (1, 1, 0 if flat else 1)
    position = goal + RNG.normal(0, 3, goal.shape)
    off = off_shape(position, goal, np.ones((5, count), dtype=bool))
    for w in range(5):
        to, of = goal[w] - goal[w].mean(axis=0), position[w] - position[w].mean(axis=0)
        _, rssd = Rotation.align_vectors(of, to)
        assert off[w] == pytest.approx(rssd / np.sqrt(count), abs=1e-5)


def test_the_error_of_the_shape_is_that_of_procrustes_where_sizes_agree():
    """SciPy's fits the size, too, to points scaled to unit size: the rest follows from it."""
    goal = RNG.normal(0, 10, (6, 3))
    position = goal + RNG.normal(0, 1, goal.shape)
    _, _, disparity = procrustes(goal, position)
    to, of = (points - points.mean(axis=0) for points in (goal, position))
    first, second = np.linalg.norm(to), np.linalg.norm(of)
    # disparity = 1 - s^2 of unit sizes, where s is the sum of singular values.
    fitted = np.sqrt(1 - disparity)
    rest = first**2 + second**2 - 2 * first * second * fitted
    off = off_shape(position[None], goal[None], np.ones((1, 6), dtype=bool))
    assert off[0] == pytest.approx(np.sqrt(rest / 6), rel=1e-9)


def test_shifts_and_rotations_leave_the_error_of_the_shape_and_mirror_images_do_not():
    goal = RNG.normal(0, 10, (1, 5, 3))
    counts = np.array([[True] * 4 + [False]])
    moved = Rotation.random(rng=1).apply(goal[0])[None] + (5.0, -3.0, 2.0)
    moved[0, 4] = 1000.0  # who does not count
    assert off_shape(moved, goal, counts)[0] < 1e-6
    assert off_places(moved, goal, counts)[0] > 5.0
    assert off_shape(goal * (1, 1, -1), goal, counts)[0] > 1.0


def test_infos_tell_errors_time_in_place_and_time_to_form():
    aviary = made(shapes=("line", "ring"), change_every=3.0, leader_speed=0.0, start_speed=(0, 0))
    told = aviary.first_info()
    first = np.linalg.norm(aviary.swarm.position - aviary.scene.goal, axis=-1)
    assert told["formation_error"][0] == pytest.approx([np.sqrt((first**2).mean())] * 4)
    assert not told["time_to_form"].any()
    jump_to(aviary, aviary.scene.goal.copy())
    info = still(aviary).info
    assert info["formation_error"].max() < 1e-6
    assert info["shape_error"].max() < 1e-5
    taken = info["time_to_form"][0, 0]
    assert 0.1 <= taken <= 2.5
    np.testing.assert_array_equal(info["time_to_form"], taken)
    # In a line and 30 cm beside it all at once: off places, not off shape.
    jump_to(aviary, aviary.scene.goal + (0.3, 0.0, 0.0))
    info = still(aviary).info
    np.testing.assert_allclose(info["formation_error"], 0.3, atol=1e-6)
    assert info["shape_error"].max() < 1e-5
    assert (info["in_place"] > 0).all()
    # At the change the clock starts anew.
    while aviary.steps[0] < 30:
        info = still(aviary).info
    assert not info["time_to_form"].any()
    held = info["in_place"] * 3.0
    info = still(aviary).info
    while info["goal_distance"].max() > 2.0:
        assert info["time_to_form"][0, 0] == pytest.approx(aviary.steps[0] / 10 - 3.0)
        way = aviary.scene.goal - aviary.swarm.position
        info = aviary.step(np.clip(way / 2, -1, 1)).info
    assert info["time_to_form"][0, 0] == pytest.approx(aviary.steps[0] / 10 - 3.0)
    taken = still(aviary).info["time_to_form"]
    np.testing.assert_array_equal(taken, info["time_to_form"])
    assert (info["in_place"] * aviary.steps[0] / 10 > held - 1e-9).all()
    aviary.close()


def test_a_change_at_the_end_takes_nothing_back():
    options = {"leader_speed": 0.0, "start_speed": (0.0, 0.0), "assignment": "free"}
    aviary = made(shapes=("v", "ring"), change_every=3.0, exchange=3.0, horizon=30, **options)
    place = aviary.scene.memory["place"].copy()
    while aviary.alive.any():
        way = aviary.scene.goal - aviary.swarm.position
        info = aviary.step(np.clip(way / 2, -1, 1)).info
    assert (info["time_to_form"] < 3.0).all()
    np.testing.assert_array_equal(aviary.scene.memory["place"], place)
    aviary.close()


def test_rewards_by_hand():
    aviary = made(shapes=DIAMOND, turn_rate=5.0)
    for _ in range(3):
        before = np.linalg.norm(aviary.scene.goal - aviary.swarm.position, axis=-1)
        step = still(aviary)
        info = step.info
        after = np.linalg.norm(aviary.scene.goal - aviary.swarm.position, axis=-1)
        np.testing.assert_allclose(info["reward/progress"], before - after, atol=1e-12)
        np.testing.assert_array_equal(info["reward/holding"], np.where(after <= 2.0, 1.0, 0.0))
        np.testing.assert_array_equal(info["reward/time"], np.where(after <= 2.0, 0.0, -0.5))
        terms = sum(value for name, value in info.items() if name.startswith("reward/"))
        np.testing.assert_allclose(step.rewards, terms, rtol=1e-12)
    assert "reward/goal" not in info
    aviary.close()


def test_nobody_leaves_when_all_are_in_place():
    aviary = made(leader_speed=0.0, start_speed=(0.0, 0.0), assignment="free", min_in_place=0.01)
    jump_to(aviary, aviary.scene.goal.copy())
    for _ in range(5):
        step = still(aviary)
        assert step.info["in_place"].all()
        assert not step.terminated.any()
    aviary.close()


def test_observations_and_state_tell_the_leader():
    aviary = made(2, turn_rate=4.0)
    still(aviary)
    memory = aviary.scene.memory
    seen = aviary.observer.split(still(aviary).observations)["leader"]
    moved = np.column_stack([memory["leader_velocity"][:, :2], memory["turn"]])
    np.testing.assert_allclose(seen, np.repeat(moved[:, None], 4, axis=1), rtol=1e-6)
    state = aviary.global_state.split(aviary.state())["leader"]
    np.testing.assert_allclose(state[:, :3], memory["leader"][:, :3], rtol=1e-5)
    np.testing.assert_allclose(state[:, 3:], moved, rtol=1e-5)
    aviary.close()


def test_same_seed_same_flight_whatever_other_worlds_do():
    flights = []
    for worlds in (1, 3):
        aviary = made(worlds, exchange=0.4, shapes=("v", "ring"), change_every=0.7, turn_rate=3.0)
        rows = []
        for k in range(15):
            action = np.random.default_rng(k).uniform(-1, 1, (1, 4, 3))
            step = aviary.step(
                np.repeat(action, worlds, axis=0) * np.arange(1, worlds + 1)[:, None, None]
            )
            rows += [step.observations[0], aviary.scene.goal[0].copy(), step.rewards[0]]
        flights.append(b"".join(row.tobytes() for row in rows))
        aviary.close()
    assert flights[0] == flights[1]


# What is refused


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"shapes": "wedge"}, "unknown entry of shapes 'wedge'"),
        ({"shapes": ("v", "lime")}, "did you mean 'line'"),
        ({"shapes": ()}, "is no shape"),
        ({"shapes": [(0.0, 0.0)] * 4}, "is no shape"),
        ({"shapes": [(0.0, np.nan, 0.0)] * 4}, "is no shape"),
        ({"shapes": 5}, "is no shape"),
        ({"shapes": DIAMOND[:3]}, "3 places are too few for 4 drones"),
        ({"shapes": DIAMOND / 3}, "are 3.77 m apart, more than 5 m"),
        ({"shapes": "letters", "text": "A!"}, "unknown letter '!'"),
        ({"shapes": "letters", "text": " "}, "at least one letter"),
        ({"shapes": "letters", "text": 5}, "letters, digits and spaces"),
        ({"shapes": "letters", "text": "HI"}, "8 corners and ends.*num_drones is 4"),
        ({"spacing": 6.0, "jitter": 1.0}, "start positions may be in conflict: spacing 6 m"),
        ({"shapes": "line", "spacing": 0.0}, "are 0 m apart"),
        ({"assignment": "best"}, "unknown assignment 'best'"),
        ({"at_goal": "leave"}, "unknown at_goal 'leave'"),
        ({"shapes": ("v", "line"), "change_every": 0.05}, "change_every is 0.05 s: at least 0.1"),
        ({"exchange": 0.01}, "exchange is 0.01 s: at least 0.1"),
        (
            {"turn_rate": 90.0, "shapes": "line"},
            "places move at up to 33.3 m/s, and less than max_speed 20",
        ),
        ({"leader_speed": 20.0}, "places move at up to 20 m/s"),
        ({"shapes": DIAMOND - (0, 0, 39.9)}, "altitude 40 m is too low: the lowest place"),
        ({"altitude": 1.0, "jitter": 1.0}, "altitude 1 m is too low for jitter"),
        ({"goal": DIAMOND}, "goal cannot be given in task 'formation': start can"),
    ],
)
def test_what_cannot_be_is_refused(options, said):
    with pytest.raises(ValueError, match=said):
        made(**options)


def test_arrays_and_lists_give_the_same_options():
    one, other = FormationConfig(shapes=DIAMOND), FormationConfig(shapes=DIAMOND.tolist())
    assert one == other
    assert hash(one.shapes) == hash(other.shapes)


def test_one_drone_flies_alone():
    for shape in ("v", "line", "ring"):
        aviary = made(num_drones=1, shapes=shape, exchange=0.2)
        for _ in range(4):
            still(aviary)
        np.testing.assert_allclose(in_leaders_frame(aviary)[0], np.zeros((1, 3)), atol=1e-9)
        aviary.close()
