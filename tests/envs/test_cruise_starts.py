"""Episodes and airspaces in which aircraft that cannot hover start in flight."""

import numpy as np
import pytest

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import DYNAMICS
from bulletuav.envs.airspace import Airspace
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.rotation import axes, heading
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.cruise import cruise_trim, turn_radius
from bulletuav.vehicle.envelope import find_envelope

TRAINER = load_airframe("trainer")
TRIM = cruise_trim(TRAINER)
CRUISE = find_envelope(TRAINER).cruise_speed


@pytest.fixture
def make_aviary():
    """Builds aviaries and closes them."""
    made = []

    def make(task, num_worlds=1, **options):
        made.append(Aviary(task, num_worlds, **options))
        made[-1].reset()
        return made[-1]

    yield make
    for one in made:
        one.close()


def require_cruise(swarm, w, i, direction):
    """Check that a drone flies level in a direction, in trim."""
    course = np.append(direction[:2], 0.0) / np.linalg.norm(direction[:2])
    np.testing.assert_allclose(swarm.velocity[w, i], CRUISE * course, atol=1e-12)
    forward = np.array(axes(tuple(swarm.quaternion[w, i]))[0])
    assert np.arcsin(forward[2]) == pytest.approx(TRIM.pitch, abs=1e-12)
    nose = np.arctan2(course[0] * forward[1] - course[1] * forward[0], course @ forward)
    assert nose == pytest.approx(TRIM.sideslip, abs=1e-12)
    np.testing.assert_array_equal(swarm.rotor_speed[w, i, :1], TRIM.speed)
    np.testing.assert_array_equal(swarm.rotor_speed[w, i, 1:], 0.0)
    np.testing.assert_array_equal(swarm.deflection[w, i, :4], TRIM.deflection)
    np.testing.assert_array_equal(swarm.rates[w, i], 0.0)


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_episodes_start_in_cruise_at_all_levels(make_aviary, dynamics):
    aviary = make_aviary("crossing", 2, airframe="trainer", dynamics=dynamics, seed=3)
    for w, i in np.ndindex(2, 8):
        require_cruise(aviary.swarm, w, i, aviary.scene.goal[w, i] - aviary.swarm.position[w, i])
    np.testing.assert_array_equal(aviary.commanded, aviary.swarm.velocity)


def test_a_start_follows_the_direction_of_flight_of_the_task(make_aviary):
    aviary = make_aviary("free_flight", airframe="trainer", heading=90.0, seed=0)
    for i in range(aviary.options.num_drones):
        require_cruise(aviary.swarm, 0, i, (0.0, 1.0))


def test_a_start_at_rest_is_towards_the_goal(make_aviary):
    aviary = make_aviary("free_flight", airframe="trainer", start_speed=(0.0, 0.0), seed=0)
    for i in range(aviary.options.num_drones):
        to_goal = aviary.scene.goal[0, i] - aviary.swarm.position[0, i]
        require_cruise(aviary.swarm, 0, i, to_goal)


def require_airspeed(swarm, w, i, wind, track):
    """Check that a drone flies at cruise speed through the air, along a track over ground."""
    air = swarm.velocity[w, i] - wind
    assert air[2] == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(air) == pytest.approx(CRUISE, rel=1e-12)
    across = track[0] * swarm.velocity[w, i, 1] - track[1] * swarm.velocity[w, i, 0]
    assert across == pytest.approx(0.0, abs=1e-9 * np.linalg.norm(track))
    assert swarm.velocity[w, i, :2] @ track[:2] > 0
    nose = np.array(axes(tuple(swarm.quaternion[w, i]))[0])
    turned = np.arctan2(air[0] * nose[1] - air[1] * nose[0], air[:2] @ nose[:2])
    assert turned == pytest.approx(TRIM.sideslip, abs=1e-12)


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body", "bullet"])
@pytest.mark.parametrize("angle", range(0, 360, 45))
def test_a_start_has_the_airspeed_of_cruise_in_any_wind(make_aviary, dynamics, angle):
    wind = 8.0 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.1])
    options = {"dynamics": dynamics, "num_drones": 4, "seed": 3}
    aviary = make_aviary("converge", airframe="trainer", wind=tuple(wind), **options)
    for i in range(4):
        track = aviary.scene.goal[0, i] - aviary.swarm.position[0, i]
        require_airspeed(aviary.swarm, 0, i, wind, track)
    np.testing.assert_array_equal(aviary.commanded, aviary.swarm.velocity)


def test_the_crab_angle_of_a_start_is_that_of_the_wind_triangle():
    # sin(crab) = 8 / 11.29, towards the wind from the north
    wind = (0.0, -8.0, 0.0)
    with Airspace([(0, 0, 100)], "trainer", dynamics="rigid_body", wind=wind) as air:
        require_airspeed(air.world.state.swarm, 0, 0, wind, (1.0, 0.0, 0.0))
        along = np.sqrt(CRUISE * CRUISE - 64.0)
        np.testing.assert_allclose(air.swarm.velocity[0], (along, 0, 0), atol=1e-12)
        yaw = heading(tuple(air.swarm.quaternion[0]))
        assert yaw == pytest.approx(np.arcsin(8.0 / CRUISE) + TRIM.sideslip, abs=1e-3)


def test_a_crosswind_above_the_cruise_speed_carries_a_start_away():
    wind = (0.0, CRUISE + 5.0, 0.0)
    with Airspace([(0, 0, 100)], "trainer", dynamics="point_mass", wind=wind) as air:
        np.testing.assert_allclose(air.swarm.velocity[0], (0, 5.0, 0), atol=1e-12)


@pytest.mark.parametrize("dynamics", ["single_integrator", "double_integrator"])
def test_a_start_ignores_the_wind_where_the_dynamics_does(make_aviary, dynamics):
    aviary = make_aviary("crossing", airframe="trainer", wind=(0.0, 8.0, 0.0), dynamics=dynamics)
    for i in range(8):
        require_cruise(aviary.swarm, 0, i, aviary.scene.goal[0, i] - aviary.swarm.position[0, i])


def test_a_start_knows_the_gusts_and_thermals_of_its_episode(make_aviary):
    options = {"turbulence": "severe", "thermals": {}, "dynamics": "rigid_body", "seed": 5}
    aviary = make_aviary("crossing", 2, airframe="trainer", wind=(3.0, 0.0, 0.0), **options)
    for mask in ([True, True], [False, True]):
        aviary.reset(np.array(mask))
        swarm = aviary.swarm
        wind = aviary.worlds.wind.sample(swarm.position, np.zeros(2))
        assert np.ptp(wind[..., 2]) > 0.1
        for w, i in np.ndindex(2, 8):
            require_airspeed(
                swarm, w, i, wind[w, i], aviary.scene.goal[w, i] - swarm.position[w, i]
            )


def test_a_given_motion_stays_in_wind(make_aviary):
    aviary = make_aviary("crossing", airframe="trainer", wind=(0.0, 8.0, 0.0), num_drones=2)
    velocity = np.array([(12.0, 0.0, 0.0), (0.0, 13.0, 0.0)])
    aviary.reset(velocity=velocity)
    np.testing.assert_array_equal(aviary.swarm.velocity[0], velocity)
    np.testing.assert_array_equal(aviary.commanded[0], velocity)


def test_a_start_after_a_crash_is_in_cruise(make_aviary):
    wind = np.array([6.0, -4.0, 0.0])
    options = {
        "at_goal": "respawn",
        "horizon": 100,
        "num_drones": 3,
        "seed": 1,
        "wind": tuple(wind),
    }
    aviary = make_aviary("free_flight", airframe="trainer", dynamics="point_mass", **options)
    aviary.swarm.position[0, 0] = 0.0, 0.0, -1.0  # outside the arena
    still = np.zeros((1, 3, 3))
    aviary.step(still)
    aviary.step(still)
    memory = aviary.scene.memory
    assert memory["restarts"][0, 0] == 1.0
    speed = np.hypot(*(aviary.swarm.velocity[0, 0] - wind)[:2])
    # One decision of a loiter after the start, which slows down towards its speed
    assert find_envelope(TRAINER).min_speed <= speed <= CRUISE
    assert aviary.swarm.position[0, 0, 2] > 10.0


def test_only_aircraft_that_cannot_hover_start_in_cruise(make_aviary):
    fleet = ("trainer", "hummingbird", "quadplane", "trainer")
    aviary = make_aviary("crossing", airframe=fleet, num_drones=4, seed=2)
    swarm = aviary.swarm
    for i in (0, 3):
        require_cruise(swarm, 0, i, aviary.scene.goal[0, i] - swarm.position[0, i])
    hover = load_airframe("hummingbird").hover_speed()
    np.testing.assert_array_equal(swarm.rotor_speed[0, 1, :4], hover)
    np.testing.assert_array_equal(swarm.quaternion[0, 1:3], [(0, 0, 0, 1)] * 2)
    np.testing.assert_array_equal(swarm.deflection[0, 1:3], 0.0)


def test_each_drone_of_a_mixed_fleet_has_a_speed_limit_of_its_own(make_aviary):
    fleet = ("trainer", "cf2x")
    aviary = make_aviary("crossing", airframe=fleet, num_drones=2, dynamics="single_integrator")
    own = [find_envelope(TRAINER).max_speed, load_airframe("cf2x").max_speed]
    assert own[1] < own[0] == aviary.options.max_speed
    north = np.zeros((1, 2, 3))
    north[..., 1] = 1.0
    for _ in range(60):
        aviary.step(north)
    np.testing.assert_allclose(np.linalg.norm(aviary.swarm.velocity[0], axis=-1), own)


@pytest.mark.parametrize("task", ["crossing", "converge", "free_flight", "pursuit"])
@pytest.mark.parametrize("difficulty", ["easy", "medium", "hard", "extreme"])
def test_sizes_fit_the_turns_of_an_aeroplane(make_aviary, task, difficulty):
    aviary = make_aviary(task, airframe="trainer", difficulty=difficulty, dynamics="point_mass")
    radius = turn_radius(TRAINER)
    low, high = aviary.task.arena_low, aviary.task.arena_high
    starts, goals = aviary.swarm.position[0], aviary.scene.goal[0]
    for place in (starts, goals):
        assert (place[:, :2] - low[:2]).min() >= 2 * radius
        assert (high[:2] - place[:, :2]).min() >= 2 * radius
    if task != "pursuit":
        assert aviary.task.config.goal_radius >= radius
        distance = np.linalg.norm((goals - starts)[:, :2], axis=1)
        assert distance.max() < CRUISE * aviary.options.horizon / aviary.options.decision_hz


@pytest.mark.parametrize(
    ("task", "options", "distance"),
    [
        ("crossing", {"half_length": 600.0}, 1200.0),
        ("crossing", {"lane_spacing": 200.0}, 494.0),  # two lanes: 2 (200 m + 3 turn radii)
        ("crossing", {"teams": (4, 0), "lane_spacing": 200.0}, 800.0),
        ("converge", {"radius": 600.0}, 1200.0),
        ("free_flight", {"area": 3000.0}, 3000.0),
        ("free_flight", {"leg": 1000.0}, 1000.0),
        ("pursuit", {"radius": 600.0, "laps": 2}, 4 * np.pi * 600.0),
    ],
)
def test_the_horizon_fits_given_sizes(make_aviary, task, options, distance):
    aviary = make_aviary(task, airframe="trainer", dynamics="point_mass", num_drones=4, **options)
    for name, value in options.items():
        assert getattr(aviary.task.config, name) == value
    # In straight flight
    assert aviary.options.horizon / aviary.options.decision_hz > 1.2 * distance / CRUISE


def test_the_horizon_fits_given_speeds(make_aviary):
    aviary = make_aviary("pursuit", airframe="trainer", num_drones=4, speed=(9.6, 12.0))
    duration = aviary.options.horizon / aviary.options.decision_hz
    assert 9.6 * duration > 1.2 * aviary.task.track_length


def test_the_horizon_fits_the_wide_formations_of_a_large_swarm(make_aviary):
    aviary = make_aviary("crossing", airframe="trainer", num_drones=600, dynamics="point_mass")
    apart = np.linalg.norm(aviary.scene.goal - aviary.swarm.position, axis=-1)
    assert aviary.options.horizon / aviary.options.decision_hz > apart.max() / CRUISE


def test_a_given_area_limits_the_distance_of_goals(make_aviary):
    aviary = make_aviary("free_flight", airframe="trainer", area=100.0, num_drones=2)
    assert aviary.task.config.leg == 40.0


@pytest.mark.parametrize(
    ("task", "options", "message"),
    [
        ("crossing", {"lane_spacing": "wide"}, "lane_spacing is 'wide'"),
        ("crossing", {"half_length": -1.0}, "half_length is -1"),
        ("crossing", {"num_drones": 300, "lane_spacing": 0.0}, "lane_spacing 0 m"),
        ("pursuit", {"speed": (0.0, 12.0)}, "speed is 0"),
    ],
)
def test_given_sizes_that_are_impossible_are_errors(task, options, message):
    with pytest.raises(ValueError, match=message):
        Aviary(task, 1, airframe="trainer", **options)


@pytest.mark.parametrize("task", ["landing_strip", "crossing"])
def test_aeroplanes_fly_for_the_reward_of_training(make_aviary, task):
    aviary = make_aviary(task, airframe="trainer", reward="training", dynamics="point_mass")
    assert aviary.swarm.velocity[..., :2].any()


def test_given_sizes_stay(make_aviary):
    aviary = make_aviary("crossing", airframe="trainer", goal_radius=3.0, margin=100.0)
    assert aviary.task.config.goal_radius == 3.0
    assert aviary.task.config.margin == 100.0


@pytest.mark.parametrize(
    ("task", "options", "message"),
    [
        ("hover", {}, "'trainer' cannot hover, as task 'hover' needs: choose .* crossing, "),
        ("pad_landing", {}, "'trainer' cannot hover, as task 'pad_landing' needs"),
        ("transport", {}, "'trainer' cannot hover, as task 'transport' needs"),
        ("navigation", {}, "'trainer' cannot hover, as task 'navigation' needs"),
        ("crossing", {"take_off": True}, "take_off is True, and airframe 'trainer' cannot take"),
        ("crossing", {"boundary": "soft"}, "boundary is 'soft', and an airframe of the fleet"),
        ("crossing", {"at_goal": "land"}, "at_goal is 'land', and an airframe of the fleet"),
        ("free_flight", {"at_goal": "hold"}, "at_goal is 'hold', and an airframe of the fleet"),
        ("crossing", {"max_speed": 8.0}, "max_speed is 8 m/s: airframe 'trainer' needs at least"),
        ("crossing", {"max_speed": 18.0}, "max_speed is 18 m/s: it must be above 0 and at most"),
    ],
)
def test_what_an_aeroplane_cannot_fly_is_an_error(task, options, message):
    with pytest.raises(ValueError, match=message):
        Aviary(task, 1, airframe="trainer", **options)


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_an_airspace_starts_aeroplanes_in_cruise(dynamics):
    yaw = (0.0, 0.0, np.sin(0.5), np.cos(0.5))
    position = [(0, 0, 50), (20, 0, 50)]
    with Airspace(position, ["trainer", "hummingbird"], quaternion=yaw, dynamics=dynamics) as air:
        require_cruise(air.world.state.swarm, 0, 0, (np.cos(1.0), np.sin(1.0)))
        np.testing.assert_array_equal(air.swarm.velocity[1], 0.0)
        assert heading(tuple(air.swarm.quaternion[1])) == pytest.approx(1.0)
        # Later, too, at a velocity along which nothing is changed
        air.place(0, (0, 10, 60))
        require_cruise(air.world.state.swarm, 0, 0, (1.0, 0.0))
        air.place(0, (0, 10, 60), velocity=(3.0, 0.0, 0.0))
        np.testing.assert_array_equal(air.swarm.velocity[0], (3.0, 0.0, 0.0))
        np.testing.assert_array_equal(air.swarm.quaternion[0], (0.0, 0.0, 0.0, 1.0))


def test_on_the_ground_an_aeroplane_is_at_rest():
    with Airspace([(0, 0, TRAINER.standing_height)], "trainer", dynamics="rigid_body") as air:
        np.testing.assert_array_equal(air.swarm.velocity[0], 0.0)
        np.testing.assert_array_equal(air.swarm.rotor_speed[0], 0.0)


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_an_aeroplane_that_starts_in_trim_flies_on(make_bench, dynamics):
    bench = make_bench(dynamics, "trainer")
    with Airspace([(0, 0, 100)], "trainer", dynamics=dynamics) as air:
        for array, start in zip(bench.swarm, air.world.state.swarm, strict=True):
            array[:] = start
    bench.place()
    bench.fly(SetpointLevel.ROTOR, (*TRIM.speed, *TRIM.deflection), decisions=20)
    # Level, straight, at cruise speed
    np.testing.assert_allclose(bench.swarm.position[0, 0], (2 * CRUISE, 0, 100), atol=0.05)
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], (CRUISE, 0, 0), atol=0.05)
