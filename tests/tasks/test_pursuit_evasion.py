"""Task `pursuit_evasion`: teams, captures, payoffs that add up to zero, sight and speeds."""

import numpy as np
import placing
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.tasks.parts.teams import NO_OPPONENT, measure_chase, nearest_opponents, zero_sum

POINTS = {"dynamics": "single_integrator", "difficulty": "easy", "evader_speed": 1.0}
STILL = (0.0, 0.0, 0.0)
EAST = (1.0, 0.0, 0.0)
DOWN = (0.0, 0.0, -1.0)


@pytest.fixture
def game():
    """Builds started aviaries of drones at given places, and closes them."""
    made = []

    def make(start, teams, **options):
        given = {"num_drones": sum(teams), "teams": teams, "start": start}
        given |= {} if "city" in options else {"area": 100.0}
        made.append(bulletuav.Aviary("pursuit_evasion", **{**POINTS, **given, **options}))
        made[-1].reset(seeds=0)
        return made[-1]

    yield make
    for one in made:
        one.close()


def told(step, *terms):
    """Weighted reward terms of the drones of the only world."""
    return [step.info[f"reward/{term}"][0].tolist() for term in terms]


def test_every_fourth_drone_is_an_evader_unless_teams_are_given():
    for drones, evaders in ((1, 0), (2, 1), (4, 1), (8, 2), (11, 2)):
        aviary = bulletuav.Aviary("pursuit_evasion", num_drones=drones, **POINTS)
        assert aviary.task.team.tolist() == [0] * (drones - evaders) + [1] * evaders
        aviary.close()
    aviary = bulletuav.Aviary("pursuit_evasion", num_drones=5, teams=(2, 3), **POINTS)
    assert aviary.task.team.tolist() == [0, 0, 1, 1, 1]
    aviary.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"teams": (3, 2)}, r"teams is \(3, 2\), 5 drones, and num_drones is 4: they must add up"),
        ({"teams": (5, -1)}, "they must add up"),
        ({"teams": 4}, "teams is 4: two whole numbers are needed"),
        ({"capture_radius": 0.5}, "capture_radius is 0.5 m: more than .* where drones touch"),
        ({"head_start": 2.0}, "head_start is 2 m: more than the capture_radius of 2 m"),
        ({"evader_speed": 1.5}, "evader_speed is 1.5: a fraction above 0 and at most 1"),
        ({"chaser_speed": 0.0}, "chaser_speed is 0: a fraction"),
        ({"chaser_speed": 0.5, "action": "rpm"}, "action 'rpm' does not command velocities"),
    ],
)
def test_options_that_cannot_be_are_refused(options, said):
    given = {**POINTS, "dynamics": "rigid_body", **options}
    with pytest.raises(ValueError, match=said):
        bulletuav.Aviary("pursuit_evasion", **given)


def test_a_head_start_without_room_is_refused():
    aviary = bulletuav.Aviary("pursuit_evasion", head_start=140.0, **POINTS)
    with pytest.raises(ValueError, match="head_start is 140 m: there is no room"):
        aviary.reset(seeds=0)
    aviary.close()


def test_chasers_start_on_one_side_with_the_head_start():
    aviary = bulletuav.Aviary("pursuit_evasion", 20, num_drones=8, head_start=20.0, **POINTS)
    aviary.reset(seeds=0)
    place, team = aviary.swarm.position, aviary.task.team
    gap = np.linalg.norm(place[:, team == 0][:, :, None] - place[:, team == 1][:, None], axis=-1)
    assert gap.min() >= 20
    assert not aviary.swarm.velocity.any()
    aviary.close()


def test_a_capture_by_hand(game):
    """Two chasers, one of which flies 1 m a decision at an evader that hovers 19.5 m away."""
    aviary = game([(0, 0, 20), (0, 10, 20), (19.5, 0, 20)], (2, 1))
    step = placing.fly(aviary, EAST, STILL, STILL)
    assert told(step, "capture") == [[0, 0, 0]]
    assert told(step, "closing") == [[0.03125, 0.03125, -0.0625]]
    assert told(step, "energy")[0] == pytest.approx([-0.01, 0, 0])
    assert told(step, "time")[0] == pytest.approx([-0.02, -0.02, 0])
    for _ in range(16):
        step = placing.fly(aviary, EAST, STILL, STILL)
        assert not step.terminated.any()
    step = placing.fly(aviary, EAST, STILL, STILL)
    assert step.terminated.all()
    assert told(step, "capture") == [[15, 15, -30]]
    assert told(step, "time")[0] == pytest.approx([0, 0, -0.02 * (300 - 18)])
    assert step.info["success"][0].tolist() == [True, True, False]
    assert step.info["captured"][0].tolist() == [1, 1, 1]
    assert step.info["captures"][0].tolist() == [1, 0, 0]
    assert step.info["capture_time"][0] == pytest.approx([1.8] * 3)
    assert not step.info["collision"].any()


def test_the_term_approach_pays_each_drone_for_its_own_motion(game):
    """A chaser 3 m south and 4 m west of an evader that flies east at 10 m/s, both for 0.1 s."""
    aviary = game([(0, 0, 20), (4, 3, 20)], (1, 1), weights={"approach": 2.0}, head_start=3.0)
    step = placing.fly(aviary, EAST, EAST)
    # Chaser: from 5 m to sqrt(3^2 + 3^2) m. Evader: from 5 m to sqrt(5^2 + 3^2) m
    paid = [2 * (5 - np.sqrt(18)), 2 * (np.sqrt(34) - 5)]
    assert told(step, "approach")[0] == pytest.approx(paid, abs=1e-6)


def test_chasers_go_on_until_all_are_captured(game):
    start = [(0, 0, 20), (0, 12, 20), (5, 0, 20), (30, 0, 20)]
    aviary = game(start, (2, 2))
    for _ in range(3):
        step = placing.fly(aviary, EAST, STILL)
    assert step.terminated[0].tolist() == [False, False, True, False]
    assert step.info["captured"][0, 0] == 0.5
    assert step.info["capture_time"][0, 0] == pytest.approx((0.3 + 30) / 2)
    # The chaser's next goal is the evader that is left, seen from the observation, too.
    np.testing.assert_array_equal(aviary.scene.goal[0, 0], start[3])
    assert step.info["goal_distance"][0, 0] == pytest.approx(27.0)
    for _ in range(25):
        step = placing.fly(aviary, EAST, STILL)
    assert step.terminated[0].tolist() == [True, True, False, True]
    assert told(step, "capture") == [[15, 15, 0, -30]]


def test_whoever_flies_past_within_a_decision_captures():
    """Closest approach within a decision, by hand: from (-5, 1) to (5, 1) past the origin."""
    before = np.array([[(-5.0, 1.0, 9.0), (40.0, 0.0, 9.0), (0.0, 0.0, 9.0)]])
    after = np.array([[(5.0, 1.0, 9.0), (30.0, 0.0, 9.0), (0.0, 0.0, 9.0)]])
    least, closing = np.empty((2, 1, 3))
    by = np.empty((1, 3), dtype=np.int64)
    team = np.array([0, 0, 1])
    measure_chase(before, after, np.ones((1, 3), dtype=bool), team, least, by, closing)
    assert least[0].tolist() == [np.inf, np.inf, 1.0]
    assert by[0].tolist() == [NO_OPPONENT, NO_OPPONENT, 0]
    assert closing[0].tolist() == [0, 0, 0]
    measure_chase(before, after, np.array([[False, True, True]]), team, least, by, closing)
    assert (least[0, 2], by[0, 2], closing[0, 2]) == (30.0, 1, 10.0)


def test_nearest_opponents_by_hand():
    place = np.array([[(0.0, 0, 0), (1, 0, 0), (5, 0, 0), (7, 0, 0)]])
    nearest = np.empty((1, 4), dtype=np.int64)
    team = np.array([0, 0, 1, 1])
    nearest_opponents(place, np.ones((1, 4), dtype=bool), team, nearest)
    assert nearest[0].tolist() == [2, 2, 1, 1]
    nearest_opponents(place, np.array([[True, False, False, False]]), team, nearest)
    assert nearest[0].tolist() == [NO_OPPONENT, NO_OPPONENT, 0, 0]


def test_payoffs_add_up_to_zero_in_any_order():
    rng = np.random.default_rng(0)
    for drones in (2, 4, 7, 13):
        paying = rng.random((50, drones)) < 0.4
        paid = ~paying & (rng.random((50, drones)) < 0.7)
        payoff = zero_sum(rng.normal(size=paid.shape), paid, paying)
        assert payoff.any()
        for order in (slice(None), slice(None, None, -1), rng.permutation(drones)):
            assert not payoff[:, order].sum(axis=1).any()
    by_hand = zero_sum(np.array([[0, 0, 1.0]]), *np.array([[[1, 1, 0]], [[0, 0, 1]]], dtype=bool))
    assert by_hand.tolist() == [[0.5, 0.5, -1.0]]


@pytest.mark.parametrize("chasers", ["lead", "random"])
def test_the_game_is_zero_sum_at_every_decision(chasers):
    """To the last bit, also after captures, crashes and ends of chasers."""
    options = {"num_drones": 7, "teams": (4, 3), "horizon": 150, "area": 60.0, "ceiling": 30.0}
    options |= {"height": (3.0, 25.0), "head_start": 5.0}
    aviary = bulletuav.Aviary("pursuit_evasion", 3, **{**POINTS, **options})
    policy = find_policy(f"{chasers} vs crash")(aviary)
    observations = aviary.reset(seeds=1)
    policy.reset(np.ones(3, dtype=bool))
    while aviary.alive.any():
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations = step.observations
        for term in ("capture", "closing"):
            assert not step.info[f"reward/{term}"].sum(axis=1).any()
    assert step.info["captures"].sum() > 0 or chasers == "random"
    aviary.close()


def test_an_evader_that_crashes_is_lost_as_if_captured(game):
    aviary = game([(0, 0, 20), (20, 0, 0.5), (20, 20, 20)], (1, 2))
    step = placing.fly(aviary, STILL, DOWN, STILL)
    assert step.info["collision"][0].tolist() == [False, True, False]
    assert step.terminated[0].tolist() == [False, True, False]
    assert told(step, "capture") == [[30, -30, 0]]
    assert told(step, "collision") == [[0, -10, 0]]
    assert told(step, "time")[0] == pytest.approx([-0.02, -0.02 * 299, 0])
    assert not step.info["captured"].any()
    assert not step.info["captures"].any()


def test_evaders_win_when_the_last_chaser_has_crashed(game):
    aviary = game([(0, 0, 0.5), (20, 0, 20)], (1, 1))
    step = placing.fly(aviary, DOWN, STILL)
    assert step.terminated.all()
    assert step.info["success"][0].tolist() == [False, True]
    assert told(step, "capture") == [[0, 0]]
    assert told(step, "collision") == [[-10, 0]]
    assert told(step, "time")[0] == pytest.approx([-0.02 * 300, 0])


def test_evaders_win_at_the_horizon(game):
    aviary = game([(0, 0, 20), (20, 0, 20)], (1, 1), horizon=3)
    success = [placing.fly(aviary, STILL).info["success"][0].tolist() for _ in range(3)]
    assert success == [[False, False], [False, False], [False, True]]


def test_one_drone_flies_alone_until_the_horizon(game):
    aviary = game([(0, 0, 20)], (1, 0), horizon=2)
    assert not placing.fly(aviary, EAST).terminated.any()
    step = placing.fly(aviary, EAST)
    assert step.truncated.all()
    assert not step.info["success"].any()


def test_capture_by_contact_takes_a_touch(game):
    start = [(0, 0, 20), (5, 0, 20), (40, 0, 20)]
    aviary = game(start, (1, 2), capture="contact")
    for k in range(5):
        step = placing.fly(aviary, EAST, STILL)
        assert step.terminated[0, 1] == (k == 4)
    assert step.terminated[0].tolist() == [False, True, False]
    assert step.info["collision"][0].tolist() == [True, True, False]
    assert told(step, "capture", "collision") == [[30, -30, 0], [0, 0, 0]]
    assert step.info["captures"][0].tolist() == [1, 0, 0]


def test_drones_stop_at_the_bounds_or_end_there(game):
    start = [(0, 0, 20), (49.5, 0, 20)]
    aviary = game(start, (1, 1))
    step = placing.fly(aviary, STILL, EAST)
    assert not step.terminated.any()
    assert aviary.swarm.position[0, 1, 0] == 50
    assert told(step, "out_of_bounds")[0] == pytest.approx([0, -0.1])
    aviary = game(start, (1, 1), boundary="end")
    step = placing.fly(aviary, STILL, EAST)
    assert step.terminated.all()
    assert told(step, "capture") == [[30, -30]]


@pytest.mark.parametrize("action", ["velocity", "velocity_increment"])
def test_teams_have_speeds_of_their_own(game, action):
    options = {"chaser_speed": 0.5, "evader_speed": 0.2, "action": action}
    aviary = game([(0, 0, 20), (30, 0, 20)], (1, 1), **options)
    for _ in range(12):
        placing.fly(aviary, (1.0, 1.0, 0.0), (-1.0, 0.0, 1.0))
    speed = np.linalg.norm(aviary.swarm.velocity[0], axis=-1)
    np.testing.assert_allclose(speed, (5.0, 2.0), rtol=1e-12)
    direction = aviary.swarm.velocity[0, 0] / 5
    np.testing.assert_allclose(direction, np.array((1, 1, 0)) / np.sqrt(2), atol=1e-12)


def test_goals_are_the_nearest_opponents(game):
    start = np.array([(0, 0, 20), (40, 0, 20), (15, 0, 20), (30, 0, 25)], dtype=float)
    aviary = game(start, (2, 2))
    np.testing.assert_array_equal(aviary.scene.goal[0], start[[2, 3, 0, 1]])
    placing.fly(aviary, STILL, STILL, (0.0, 1.0, 0.0), STILL)
    place = aviary.swarm.position[0]
    np.testing.assert_array_equal(aviary.scene.goal[0], place[[2, 3, 0, 1]])
    np.testing.assert_array_equal(aviary.scene.goal_velocity[0, 0], (0, 10, 0))


def seen(aviary):
    """Rows (N, slots, 8) of the block `opponents`."""
    parts = aviary.observer.split(aviary.observations()[0])
    return parts["opponents"].reshape(aviary.num_drones, -1, 8)


def test_opponents_are_seen_within_range(game):
    start = [(0, 0, 20), (-40, 0, 20), (30, 0, 20), (0, 40, 20), (-41, 20, 20)]
    aviary = game(start, (2, 3), sight_range=40.0, num_neighbours=3)
    placing.fly(aviary, STILL, STILL, (0.0, -1.0, 0.0), STILL)
    rows = seen(aviary)
    away = np.hypot(30, 1)
    np.testing.assert_allclose(rows[0, 0], (1, away, 30, -1, 0, 0, -10, 0), rtol=1e-6)
    np.testing.assert_allclose(rows[0, 1], (1, 40, 0, 40, 0, 0, 0, 0), rtol=1e-6)
    assert not rows[0, 2].any()
    assert rows[1, :, 0].tolist() == [1, 0, 0]
    # Evaders see chasers; teammates are known at any distance.
    assert rows[2, :, 0].tolist() == [1, 0, 0]
    mates = aviary.observer.split(aviary.observations()[0])["teammates"].reshape(5, 3, 7)
    np.testing.assert_allclose(mates[0, 0, :4], (40, -40, 0, 0))
    assert not mates[0, 1:].any()


def test_buildings_and_obstacles_hide_opponents(game):
    start = [(0, 0, 20), (30, 0, 20), (0, 30, 20)]
    aviary = game(start, (1, 2), city=placing.WALL, ceiling=80.0)
    placing.fly(aviary, STILL)
    rows = seen(aviary)
    assert rows[:, :, 0].tolist() == [[1, 0, 0], [0, 0, 0], [1, 0, 0]]
    np.testing.assert_allclose(rows[0, 0, 1:5], (30, 0, 30, 0))
    aviary = game(start, (1, 2), city=placing.WALL, ceiling=80.0, observation=("drone_sight",))
    placing.fly(aviary, STILL)
    sight = aviary.observations()[0]
    assert sight.tolist() == [[1, 0, 1], [0, 1, 0], [1, 0, 1]]


def test_captured_opponents_are_seen_no_more(game):
    aviary = game([(0, 0, 20), (2.5, 0, 20), (30, 0, 20)], (1, 2))
    placing.fly(aviary, EAST, STILL)
    rows = seen(aviary)
    assert rows[0, :, 0].tolist() == [1, 0, 0]
    assert rows[0, 0, 1] == pytest.approx(29)


def test_the_open_city_is_bare_ground(game):
    aviary = game([(0, 0, 20), (30, 0, 20)], (1, 1), area=(80.0, 120.0))
    np.testing.assert_array_equal(aviary.task.arena_high, (40, 60, 50))
    assert not len(aviary.task.city_layouts.cities[0].footprints)
    assert aviary.line_of_sight((-39, -59, 0.1), (39, 59, 0.1)).all()


@pytest.mark.parametrize(
    ("task", "options", "groups"),
    [
        ("pursuit_evasion", {}, {"chasers": [0, 1, 2], "evaders": [3]}),
        ("pursuit_evasion", {"num_drones": 1}, {"chasers": [0]}),
        ("crossing", {"num_drones": 3}, {"north": [0, 1], "east": [2]}),
        ("converge", {"num_drones": 2}, {"drones": [0, 1]}),
    ],
)
def test_environments_tell_the_groups_that_trainers_ask_for(task, options, groups):
    env = bulletuav.parallel_env(task, dynamics="single_integrator", **options)
    told = {team: [f"drone_{i}" for i in rows] for team, rows in groups.items()}
    assert env.group_map == told
    assert env.metadata["group_map"] == told
    env.close()


@pytest.mark.parametrize("limit", [np.ones(3), np.zeros(4)])
def test_a_task_with_wrong_speed_limits_is_refused(limit):
    from bulletuav.tasks.crossing import Crossing

    class Limited(Crossing):
        speed_limit = limit

    with pytest.raises(
        ValueError, match="speed_limit of task 'crossing' is .*: a speed above 0 fo"
    ):
        bulletuav.Aviary(Limited, num_drones=4)


def test_teams_without_names_are_numbered():
    from bulletuav.tasks.crossing import Crossing

    class Nameless(Crossing):
        team_names = ()

    env = bulletuav.parallel_env(Nameless, num_drones=2, dynamics="single_integrator")
    assert env.group_map == {"team_0": ["drone_0"], "team_1": ["drone_1"]}
    env.close()
