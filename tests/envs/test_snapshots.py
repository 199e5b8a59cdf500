"""Snapshots: the same bits go on from them, here, in another process, and in another world."""

import copy
import dataclasses
import pickle
import subprocess
import sys

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import bulletuav
from bulletuav.envs.bodies import Body, as_bodies
from bulletuav.envs.descriptions import WITHOUT_EFFECT, canonical_text, describe_parts
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.events import as_events
from bulletuav.envs.gymnasium import CentralAviary, CentralVectorAviary
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.snapshot import EnvironmentSnapshot, Form, Snapshot, checksum_of
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.sensors.imperfect import Imperfect
from bulletuav.sensors.imu import Imu
from bulletuav.sensors.messages import Channel
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.thermals import as_thermals

UNCERTAIN = {
    "mass": (0.8, 1.2),
    "thrust": (0.9, 1.1),
    "battery": (0.0, 0.1),
    "gps_noise": (0.1, 1.0),
    "gps_walk": (0.0, 0.1),
    "gps_dropout": (0.0, 0.2),
    "accelerometer_noise": 0.1,
    "gyroscope_walk": 0.01,
    "wind": (-2.0, 2.0),
    "radio_delay": (0.005, 0.2),
    "radio_loss": (0.0, 0.3),
}
CASES = {
    "crossing": {"difficulty": "extreme", "num_drones": 6},
    "obstacles": {"num_drones": 4, "area": 120.0, "num_obstacles": 8, "num_moving": 4, "leg": 30.0},
    "uncertain": {
        "task": "converge",
        "num_drones": 3,
        "randomization": UNCERTAIN,
        "turbulence": "light",
        "observation": ("velocity", "goal", "neighbours", "imu", "all_neighbours"),
    },
    "late": {
        "task": "converge",
        "num_drones": 2,
        "take_off": True,
        "sensors": (Imperfect(Imu(), delay=0.3, noise=0.1),),
        "observation": ("velocity", "imu"),
    },
    "aeroplanes": {
        "task": "crossing",
        "num_drones": 3,
        "airframe": ("trainer", "quadplane", "hummingbird"),
        "turbulence": "light",
    },
    "hover": {"controller": "pid", "effects": ("downwash", "voltage"), "num_drones": 2},
    "mec_advanced": {"difficulty": "hard", "num_layouts": 1, "area": 250.0},
    "mobile_users": {"num_layouts": 1, "area": 250.0},
    "transport": {"num_drones": 2, "wind": (1.0, 0.0, 0.0)},
    "patrol": {"area": 150.0, "num_layouts": 1, "battery_capacity": 1.0},
    "pads": {
        "task": "coverage",
        "num_drones": 4,
        "city": "open",
        "area": 40.0,
        "min_separation": 2.5,
        "height": (1.0, 3.0),
        "charging_pads": 2,
        "pad_radius": 5.0,
        "battery_capacity": 0.5,
    },
    "lidar_navigation": {"num_layouts": 2, "area": 250.0, "leg": 60.0},
    "pursuit_evasion": {"difficulty": "hard"},
    "flocking": {"difficulty": "extreme", "num_drones": 6, "leader_turn": 0.5},
    "formation": {"num_drones": 4, "change_every": 2.0, "assignment": "free"},
    "interception": {"difficulty": "extreme", "num_layouts": 2},
    "race": {"difficulty": "extreme", "num_drones": 3, "contact_ends": "nothing"},
    "pad_landing": {
        "difficulty": "extreme",
        "num_drones": 3,
        "observation": ("velocity", "pad_clue", "lidar", "claimed_pads"),
    },
    "search": {"difficulty": "extreme", "num_drones": 3, "num_victims": 2, "num_layouts": 2},
}
DYNAMICS = ("single_integrator", "point_mass", "rigid_body", "bullet")
BOUND = {"hover": ("rigid_body", "bullet"), "transport": ("rigid_body",)}
"""Dynamics of tasks that command rotors, or have cables"""
FLOWN = [(case, one) for case in CASES for one in BOUND.get(case, DYNAMICS)]


def made(case, worlds=3, **options):
    given = {"task": case, **CASES[case], **options}
    aviary = bulletuav.Aviary(given.pop("task"), worlds, **given)
    aviary.reset(seeds=7)
    return aviary


def random_actions(aviary, rng):
    """Actions that crash some: half at random, half downwards."""
    actions = rng.uniform(
        aviary.action.low, aviary.action.high, (*aviary.alive.shape, aviary.action.low.shape[-1])
    )
    actions[:, ::2] = np.where(rng.uniform() < 0.5, actions[:, ::2], aviary.action.low[::2])
    return actions


def flown(aviary, decisions, seed, worlds=slice(None)):
    """Fly, with resets of worlds that are over; list all that is told of some worlds."""
    rng, reported = np.random.default_rng(seed), []
    for _ in range(decisions):
        step = aviary.step(random_actions(aviary, rng))
        parts = [step.rewards, step.terminated, step.truncated, *step.info.values()]
        reported += [np.array(part[worlds]) for part in parts]
        over = ~aviary.alive.any(axis=1)
        seen = aviary.reset(over) if over.any() else step.observations
        reported.append(np.array(seen[worlds]))
    return reported


def sent(snapshot):
    """As another process takes it: with a checksum, and checked against all bounds."""
    return pickle.loads(pickle.dumps(snapshot))


def same(one, other):
    assert len(one) == len(other)
    for mine, theirs in zip(one, other, strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize(("case", "dynamics"), FLOWN)
def test_flights_go_on_from_a_snapshot_to_the_last_bit(case, dynamics):
    aviary = made(case, dynamics=dynamics)
    flown(aviary, 15, 0)
    saved, before = sent(aviary.save_state()), aviary.state_hash()
    seen, state = aviary.observations(), aviary.state()
    first = flown(aviary, 15, 1)
    assert aviary.state_hash() != before
    flown(aviary, 10, 2)
    again = aviary.load_state(saved)
    np.testing.assert_array_equal(again, seen)
    np.testing.assert_array_equal(aviary.state(), state)
    assert aviary.state_hash() == before
    same(flown(aviary, 15, 1), first)
    aviary.close()


@pytest.mark.slow
@pytest.mark.parametrize(("case", "dynamics"), FLOWN)
def test_any_moment_of_any_flight_can_be_gone_back_to(case, dynamics):
    """10,000 moments in all; half of the drones dive, so there are contacts."""
    aviary, rng, touched = made(case, dynamics=dynamics), np.random.default_rng(0), 0
    for k in range(240):
        flown(aviary, int(rng.integers(1, 12)), k)
        which = rng.permutation(3)[: rng.integers(1, 4)]
        saved, after = sent(aviary.save_state(which)), int(rng.integers(1, 6))
        first = flown(aviary, after, 1000 + k, which)
        hashes = aviary.state_hash(which)
        flown(aviary, int(rng.integers(0, 8)), k)
        aviary.load_state(saved, which)
        # Other worlds may reset at other times, which draws from the same random actions.
        same(flown(aviary, after, 1000 + k, which), first)
        assert aviary.state_hash(which) == hashes
        touched += int((aviary.contacts.world >= 0).sum())
    assert touched or "bullet" not in dynamics
    aviary.close()


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
@pytest.mark.parametrize("case", ["crossing", "uncertain", "late", "mec_advanced", "race"])
def test_a_world_goes_on_in_the_place_of_another(case, dynamics):
    aviary, other = (made(case, dynamics=dynamics) for _ in range(2))
    flown(aviary, 12, 0)
    flown(other, 9, 5)
    other.load_state(aviary.save_state([0, 2]), [2, 1])
    assert other.state_hash([2, 1]) == aviary.state_hash([0, 2])
    rng = np.random.default_rng(3)
    for _ in range(12):
        actions = random_actions(aviary, rng)
        mine = aviary.step(actions)
        theirs = other.step(actions[[1, 2, 0]])
        for a, b in ((0, 2), (2, 1)):
            np.testing.assert_array_equal(mine.observations[a], theirs.observations[b])
            np.testing.assert_array_equal(mine.rewards[a], theirs.rewards[b])
    aviary.close()
    other.close()


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_what_lies_in_contact_goes_on_lying(dynamics):
    """Drones on the ground and on each other: contacts, their memory, and sleep."""
    aviary = bulletuav.Aviary(
        "race", 2, difficulty="medium", dynamics=dynamics, contact_ends="nothing", horizon=2000
    )
    aviary.reset(seeds=0)
    down = np.zeros((2, 4, 3))
    down[..., 2] = -1.0
    for _ in range(60):
        aviary.step(down)
    saved = sent(aviary.save_state())
    first = [aviary.step(down).info["impulse"] for _ in range(40)]
    aviary.load_state(saved)
    same([aviary.step(down).info["impulse"] for _ in range(40)], first)
    aviary.close()


PROGRAM = """
import pickle, sys
import numpy as np
import bulletuav

snapshot = pickle.load(open(sys.argv[1], "rb"))
aviary = bulletuav.Aviary("crossing", 2, dynamics="bullet", num_drones=4)
aviary.load_state(snapshot)
for k in range(20):
    aviary.step(np.full((2, 4, 3), 0.1 * k - 1.0))
print(*aviary.state_hash())
"""


def test_flights_go_on_in_another_process(tmp_path):
    aviary = bulletuav.Aviary("crossing", 2, dynamics="bullet", num_drones=4)
    aviary.reset(seeds=3)
    aviary.step(np.ones((2, 4, 3)))
    path = tmp_path / "state.pickle"
    path.write_bytes(pickle.dumps(aviary.save_state()))
    for k in range(20):
        aviary.step(np.full((2, 4, 3), 0.1 * k - 1.0))
    reported = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path)], capture_output=True, text=True, check=True
    )
    assert tuple(reported.stdout.split()) == aviary.state_hash()
    aviary.close()


def test_hashes_tell_states_apart_and_nothing_else():
    aviary, other = (made("crossing", dynamics="rigid_body") for _ in range(2))
    flown(other, 40, 9)
    other.reset(seeds=7)
    assert other.state_hash() == aviary.state_hash()  # whatever flew before
    assert len(set(aviary.state_hash())) == 3
    aviary.swarm.velocity[1, 0, 2] = np.nextafter(aviary.swarm.velocity[1, 0, 2], 1.0)
    mine, theirs = aviary.state_hash(), other.state_hash()
    assert [a == b for a, b in zip(mine, theirs, strict=True)] == [True, False, True]
    other.rng[2].random()
    assert other.state_hash([2]) != theirs[2:]


def test_environment_classes_save_and_load():
    parallel = bulletuav.parallel_env("crossing", num_drones=3, dynamics="point_mass")
    seen, _ = parallel.reset(seed=1)
    fly = lambda: parallel.step({one: np.ones(3) for one in parallel.agents})  # noqa: E731
    fly()
    saved, hashed, agents = parallel.save_state(), parallel.state_hash(), list(parallel.agents)
    first = fly()
    while parallel.agents:
        fly()
    again = parallel.load_state(saved)
    assert parallel.agents == agents == list(again)
    assert parallel.state_hash() == hashed
    assert again["drone_0"].shape == seen["drone_0"].shape
    for mine, theirs in zip(first[:4], fly()[:4], strict=True):
        for one in agents:
            np.testing.assert_array_equal(mine[one], theirs[one])

    batch = bulletuav.batch_env("crossing", num_envs=3, num_drones=2, horizon=5)
    batch.reset(seed=0)
    actions = np.zeros((3, 2, 3))
    for _ in range(5):
        batch.step(actions)
    assert batch.ended.all()
    saved = batch.save_state()
    rewards = [batch.step(actions)[1] for _ in range(3)]
    observations = batch.load_state(saved)
    assert batch.ended.all()
    assert observations.shape[:2] == (3, 2)
    same([batch.step(actions)[1] for _ in range(3)], rewards)
    batch.load_state(saved[1], 2)
    assert batch.state_hash(2) == (saved_hash := batch.state_hash([2]))
    assert len(saved_hash) == 1

    one = CentralAviary("hover")
    first, _ = one.reset(seed=0)
    saved = one.save_state()
    after = one.step(one.action_space.low)[0]
    np.testing.assert_array_equal(one.load_state(saved), first)
    np.testing.assert_array_equal(one.step(one.action_space.low)[0], after)
    assert len(one.state_hash()) == 32


def test_vector_environments_save_and_load():
    env = CentralVectorAviary("converge", 2, AutoresetMode.SAME_STEP, num_drones=2)
    env.reset(seed=0)
    saved = env.save_state()
    actions = np.zeros(env.action_space.shape)
    rewards = [env.step(actions)[1] for _ in range(4)]
    env.load_state(saved)
    same([env.step(actions)[1] for _ in range(4)], rewards)
    assert len(env.state_hash()) == 2
    env.close()


def test_worlds_of_several_processes_save_and_load():
    options = {"num_drones": 2, "dynamics": "rigid_body", "horizon": 12}
    alone = bulletuav.batch_env("crossing", num_envs=3, **options)
    spread = bulletuav.batch_env("crossing", num_envs=3, workers=2, **options)
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 3, 2, 3))
    for env in (alone, spread):
        env.reset(seed=0)
        env.step(actions[0])
    assert spread.state_hash() == alone.state_hash()
    assert spread.state_hash([2, 0]) == alone.state_hash([2, 0])
    assert spread.state_hash([]) == ()
    saved = alone.save_state([2, 0])
    np.testing.assert_array_equal(spread.save_state([2, 0]).data, saved.data)
    first = [alone.step(one)[:4] for one in actions]
    for one in actions[:14]:
        spread.step(one)
    # Those of one process go on in worlds of another.
    alone.load_state(saved, [1, 2])
    seen = spread.load_state(saved, [1, 2])
    assert spread.state_hash([1, 2]) == alone.state_hash([1, 2])
    np.testing.assert_array_equal(seen[1:], alone.aviary.observations()[1:])
    for mine, one in zip(first, actions, strict=True):
        reported = spread.step(one[[1, 2, 0]])[:4]
        for a, b in zip(mine, reported, strict=True):
            np.testing.assert_array_equal(a[[2, 0]], b[1:])
    with pytest.raises(ValueError, match="has 2 worlds, and 3"):
        spread.load_state(saved)
    before = spread.state_hash()
    with pytest.raises(ValueError, match="damaged"):
        spread.load_state(Snapshot(saved.data, saved.form), [0, 2])
    # The part that is damaged belongs to one process, and no other one has loaded its own
    bad = written(alone.aviary, saved, "steps", -1, world=1)
    with pytest.raises(ValueError, match="steps -1"):
        spread.load_state(bad, [0, 2])
    assert spread.state_hash() == before
    assert spread.step(actions[0])[0].shape[:2] == (3, 2)
    alone.close()
    spread.close()


def test_turns_go_on_from_a_snapshot():
    def flown(env, turns):
        reported = []
        for _ in env.agent_iter(turns):
            seen, reward, ended, cut, info = env.last()
            reported += [seen, reward, ended, cut, info.get("success", -1.0)]
            env.step(None if ended or cut else np.full(3, 0.5))
        return reported

    options = {"num_drones": 3, "dynamics": "point_mass", "horizon": 6}
    env = bulletuav.aec_env("crossing", **options)
    env.reset(seed=4)
    flown(env, 4)  # between two decisions
    saved, hashed = pickle.loads(pickle.dumps(env.save_state())), env.state_hash()
    first = flown(env, 30)
    assert not env.agents
    for other in (env, bulletuav.aec_env("crossing", **options)):
        other.load_state(saved)
        assert other.state_hash() == hashed
        same([np.array(one) for one in flown(other, 30)], [np.array(one) for one in first])
    with pytest.raises(ValueError, match="a result of save_state is needed"):
        env.load_state(saved.flight)
    env.close()


def test_turns_go_on_from_where_a_drone_leaves_and_the_other_flies_on():
    options = {"num_drones": 2, "dynamics": "point_mass"}
    env, other = (bulletuav.aec_env("crossing", **options) for _ in range(2))
    env.reset(seed=0)
    begin, dive = env.save_state(), {"drone_0": -1.0, "drone_1": 0.0}
    while not env.terminations["drone_0"]:
        env.step(np.array((0.0, 0.0, dive[env.agent_selection])))
    assert env.agent_selection == "drone_0"
    leaves = env.save_state()
    # A turn that is at its end leaves nothing behind
    env.load_state(begin)
    env.load_state(leaves)
    other.load_state(leaves)
    for one in (env, other):
        one.step(None)
        assert (one.agents, one.agent_selection) == (["drone_1"], "drone_1")
        assert one.last()[2:4] == (False, False)
        one.load_state(leaves)
        one.load_state(begin)
        for agent in ("drone_0", "drone_1", "drone_0"):
            assert one.agent_selection == agent
            one.step(np.zeros(3))
        one.close()


def test_curricula_go_on_from_a_snapshot():
    options = {"dynamics": "point_mass", "horizon": 4, "difficulty": "easy"}
    stages = ({"num_drones": 2}, {"num_drones": 3})
    env = bulletuav.curriculum_env("crossing", stages, window=1, up=0.01, down=0.0, **options)
    with pytest.raises(RuntimeError, match="reset"):
        env.save_state()
    env.reset(seed=0)
    saved = env.save_state()

    def flown():
        reported = []
        for _ in range(3):
            while env.agents:
                results = env.step({one: np.ones(3) for one in env.agents})
                reported += [np.array(list(part.values())) for part in results[:4]]
            env.curriculum.record(1.0)  # to the next stage
            reported += [np.array(list(env.reset()[0].values())), np.array(env.curriculum.stage)]
        return reported

    first = flown()
    assert env.curriculum.stage == 1
    late, hashed = env.save_state(), env.state_hash()
    again = env.load_state(saved)
    assert list(again) == env.agents == ["drone_0", "drone_1"]
    assert env.curriculum.stage == 0
    same(flown(), first)
    env.load_state(saved)
    env.load_state(late)
    assert env.state_hash() == hashed
    assert len(env.agents) == 3
    env.close()


@pytest.mark.parametrize("dynamics", ["single_integrator", "rigid_body", "bullet"])
def test_airspaces_go_on_from_a_snapshot(dynamics):
    ball = Obstacle("sphere", (0.3,))

    def made():
        places = [(0.0, 0.0, 0.5), (1.0, 0.0, 0.5), (2.0, 0.0, 1.0)]
        noise = {"accelerometer_noise": 0.1} if dynamics != "single_integrator" else {}
        sensors = ("imu",) if noise else ("gps",)
        return bulletuav.Airspace(
            places,
            dynamics=dynamics,
            obstacles=(ball,),
            sensors=sensors,
            turbulence="light",
            randomization=noise,
            seed=2,
        )

    def flown(airspace, steps):
        reported = []
        for k in range(steps):
            if k == 10:
                airspace.command(0, "velocity", (1.0, 0.2, -0.5), yaw_rate=0.3)
            airspace.step()
            reported += [array.copy() for array in airspace.swarm]
            reported += list(airspace.readings.values())
        return reported

    airspace = made()
    airspace.command(None, "velocity", (0.5, 0.0, 0.0))
    airspace.place_obstacle(0, (1.5, 0.1, 0.6), velocity=(0.3, 0.0, 0.0))
    flown(airspace, 30)
    saved, hashed = sent(airspace.save_state()), airspace.state_hash()
    read = dict(airspace.readings)
    first = flown(airspace, 60)
    kept = {name: array.copy() for name, array in airspace.readings.items()}
    held = dict(airspace.readings)
    airspace.load_state(saved)
    same(list(held.values()), list(kept.values()))
    same(list(airspace.readings.values()), list(read.values()))
    assert airspace.state_hash() == hashed
    same(flown(airspace, 60), first)
    other = made()
    other.load_state(saved)
    same(flown(other, 60), first)
    with pytest.raises(ValueError, match="has form 'other': a result of save_state"):
        other.load_state(Snapshot(saved.data, "other"))
    airspace.close()
    with pytest.raises(RuntimeError, match="closed"):
        airspace.save_state()
    other.close()


def fields_of(environment):
    """The arrays by name of which snapshots consist."""
    is_airspace = isinstance(environment, bulletuav.Airspace)
    return (environment.world if is_airspace else environment.worlds)._layout._fields


def written(environment, snapshot, name, value, world=0):
    """A snapshot with another value in an array, and the checksum that belongs to it."""
    data, at = snapshot.data.copy(), 0
    for key, array in fields_of(environment).items():
        if key == name:
            size = array[0].nbytes
            row = data[world, at : at + size].view(array.dtype)
            row.view(np.uint8)[:] = np.full(row.shape, value).astype(row.dtype).view(np.uint8)
            return Snapshot(data, snapshot.form, checksum_of(data, snapshot.form))
        at += array[0].nbytes if array.size else 0
    raise AssertionError(name)


BEYOND = {
    "layout": (-2, 7, 2**30),
    "steps": (-1, 2**62),
    "slept number": (-1, 17),
    "slept other": (-1, 7),
    "touches number": (-1, 2**30),
    "touches other": (-(2**30), 7),
    "memory number": (-1, 17),
    "radio received": (-1, 3),
    "position": (np.nan, 1e8),
    "velocity": (np.inf, 1e5),
    "rates": (np.nan, -1e5),
    "rotor_speed": (-1.0, np.nan),
}


def test_values_that_no_state_has_are_refused_though_the_checksum_is_right():
    """Each integer of the package is declared: one that is overwritten ends no process."""
    aviary = bulletuav.Aviary("crossing", 2, num_drones=2, dynamics="rigid_body")
    aviary.reset(seeds=0)
    aviary.step(np.full((2, 2, 3), 0.3))
    saved = aviary.save_state()
    arrays = fields_of(aviary)
    integers = {name for name, array in arrays.items() if array.size and array.dtype.kind in "iu"}
    assert integers - BEYOND.keys() == {"bodies"}
    aviary.step(np.full((2, 2, 3), -0.3))
    hashed = aviary.state_hash()
    for name, values in BEYOND.items():
        if name not in arrays:
            continue
        for value in values:
            with pytest.raises(ValueError, match=f"the snapshot has {name} .* is needed"):
                aviary.load_state(written(aviary, saved, name, value))
            assert aviary.state_hash() == hashed
    with pytest.raises(ValueError, match="with other bodies"):
        aviary.load_state(written(aviary, saved, "bodies", 7))
    bad = written(aviary, saved, "steps", 0)
    for at, value in ((-5, 7), (16 - 37, 0)):  # whether a number is kept; an even increment
        data = bad.data.copy()
        data[0, at] = value
        with pytest.raises(ValueError, match="no valid state of a random generator"):
            aviary.load_state(Snapshot(data, bad.form, checksum_of(data, bad.form)))
    for name, array in arrays.items():
        if array.size and array.dtype == bool:
            flipped = written(aviary, saved, name, True).data.copy()
            ones = np.argwhere(flipped[0] != saved.data[0])
            if len(ones):
                flipped[0, ones[0]] = 7
                with pytest.raises(ValueError, match="from 0 to 1 is needed"):
                    aviary.load_state(
                        Snapshot(flipped, saved.form, checksum_of(flipped, saved.form))
                    )
    assert aviary.state_hash() == hashed
    aviary.close()


@pytest.mark.parametrize("mobility", ["manhattan", "hotspot", "waypoint", "gauss_markov"])
def test_memory_from_which_users_walk_is_checked(mobility):
    """Streets are indices of a graph: one beyond it ended the process, an endless speed hung it."""
    aviary = bulletuav.Aviary("mobile_users", 2, num_layouts=1, area=250.0, mobility=mobility)
    aviary.reset(seeds=0)
    aviary.step(np.zeros((2, *aviary.action.low.shape)))
    saved, hashed = aviary.save_state(), aviary.state_hash()
    aviary.load_state(sent(saved))
    kept = [f"memory {name}" for name in aviary.task.users.mobility.state(1)]
    assert set(kept) <= aviary.worlds.bounds().keys()
    for name in kept:
        for value in (1e300, np.nan):
            with pytest.raises(ValueError, match=f"the snapshot has {name} .* is needed"):
                aviary.load_state(written(aviary, saved, name, value))
    assert aviary.state_hash() == hashed
    aviary.close()


def test_bodies_that_were_added_are_within_the_bounds():
    """A drone that lies on the ground touches the shape with the highest number."""
    airspace = bulletuav.Airspace([(0.0, 0.0, 0.05)], dynamics="rigid_body")
    airspace.save_state()
    airspace.add_body(Obstacle("sphere", (0.3,)), (3.0, 0.0, 0.3))
    for _ in range(240):
        airspace.step()
    assert len(airspace.contacts.other)
    airspace.load_state(sent(airspace.save_state()))
    airspace.close()


def test_parameters_and_contacts_are_checked_row_by_row():
    aviary = made("crossing", dynamics="rigid_body")
    saved = pickle.loads(pickle.dumps(aviary.save_state()))
    for name in ("parameters.num_rotors", "memory rows.other"):
        whole, field = name.rsplit(".", 1)
        data, at = saved.data.copy(), 0
        for key, array in fields_of(aviary).items():
            if key == whole:
                size = array[0].nbytes
                data[0, at : at + size].view(array.dtype)[field] = 2**30
            at += array[0].nbytes if array.size else 0
        with pytest.raises(ValueError, match=f"the snapshot has {name} 1.07374e"):
            aviary.load_state(Snapshot(data, saved.form, checksum_of(data, saved.form)))
    aviary.close()


def test_damaged_snapshots_are_refused_and_nothing_changes():
    aviary = made("crossing", dynamics="point_mass")
    aviary.step(aviary.action.high + np.zeros((3, 6, 3)))
    saved = aviary.save_state()
    copied = sent(saved)
    aviary.load_state(copied)
    aviary.load_state(copied[[1, 0, 2]])
    hashed = aviary.state_hash()
    with pytest.raises(ValueError, match="read-only"):
        saved.data[0, 0] = 1
    with pytest.raises(ValueError, match="cannot set WRITEABLE"):
        saved.data.setflags(write=True)
    damaged = saved.data.copy()
    damaged[1, 100] ^= 1
    form = saved.form
    others = (
        Snapshot(damaged, form, copied.checksum),
        Snapshot(damaged, form),
        Snapshot(saved.data[:, :-1], form, copied.checksum),
        Snapshot(saved.data.astype(float), form, copied.checksum),
        Snapshot(saved.data.astype(object), form, copied.checksum),
        Snapshot(saved.data[0], form, copied.checksum),
        Snapshot(None, form, copied.checksum),
        Snapshot(saved.data, dataclasses.replace(form, parts={}), copied.checksum),
        dataclasses.replace(saved, data=damaged),
    )
    for one in others:
        with pytest.raises(ValueError, match="damaged|result of save_state of this version"):
            aviary.load_state(one)
        with pytest.raises(ValueError, match="damaged|result of save_state of this version"):
            one[0]
        assert aviary.state_hash() == hashed
    short = saved.data[:, :-64]
    with pytest.raises(ValueError, match="bytes per world, not .*: it is truncated"):
        aviary.load_state(Snapshot(short, form, checksum_of(short, form)))
    assert aviary.state_hash() == hashed
    aviary.close()


BY_HAND = {
    "no attributes": lambda data, form: Snapshot.__new__(Snapshot),
    "no attributes of the form": lambda data, form: Snapshot(data, Form.__new__(Form)),
    "nothing in the form": lambda data, form: Snapshot(data, Form("x", None, None)),
    "numbers as parts": lambda data, form: Snapshot(data, Form("x", {1: 2, "a": 3}, ())),
    "a text for arrays": lambda data, form: Snapshot(data, Form("x", {}, "abc")),
    "names of arrays alone": lambda data, form: Snapshot(data, Form("x", {}, ("a", "b"))),
    "a list in an array": lambda data, form: Snapshot(data, Form("x", {}, (("a", "f8", [1]),))),
    "objects": lambda data, form: Snapshot(data.astype(object), form),
    "a text for the checksum": lambda data, form: Snapshot(data, form, "abc"),
}


@pytest.mark.parametrize("make", BY_HAND.values(), ids=BY_HAND)
def test_snapshots_that_were_put_together_by_hand_are_refused_with_what_is_wrong(make):
    aviary = bulletuav.Aviary("hover", 1, num_drones=1, dynamics="point_mass")
    aviary.reset(seeds=0)
    saved = aviary.save_state()
    forged = make(saved.data, saved.form)
    for use in (aviary.load_state, len, pickle.dumps, lambda snapshot: snapshot[0]):
        with pytest.raises(ValueError, match="^the snapshot has (data|form|checksum) .*save it"):
            use(forged)


def test_snapshots_of_classes_that_were_put_together_by_hand_are_refused():
    env = bulletuav.aec_env("hover", num_drones=2, dynamics="point_mass")
    env.reset(seed=0)
    saved = env.save_state()
    for forged, reported in (
        (EnvironmentSnapshot.__new__(EnvironmentSnapshot), "has of None instead of a str"),
        (
            EnvironmentSnapshot("aec_env", None, saved.beside),
            "has flight None instead of a Snapshot",
        ),
        (EnvironmentSnapshot("aec_env", saved.flight, [1]), "has beside .* instead of a Mapping"),
        (EnvironmentSnapshot("aec_env", saved.flight, {}), "lacks .*'agents'"),
        (
            EnvironmentSnapshot("aec_env", saved.flight, {**saved.beside, "step": 1}),
            "'step'., or must",
        ),
    ):
        with pytest.raises(ValueError, match=reported):
            env.load_state(forged)


def test_snapshots_of_former_versions_are_refused():
    aviary = made("crossing", dynamics="point_mass")
    saved = aviary.save_state()
    for kind, state in (
        (Snapshot, {"data": saved.data, "form": "0123456789abcdef"}),
        (EnvironmentSnapshot, {"of": "aec_env", "flight": saved, "beside": {}}),
    ):
        with pytest.raises(ValueError, match="of another version of bulletuav: save it again"):
            kind.__new__(kind).__setstate__(state)
    face = EnvironmentSnapshot("aec_env", saved, {"agents": ["drone_0"]})
    state = face.__getstate__()
    for key, value in (("beside", {"agents": ["drone_1"]}), ("checksum", b"other")):
        with pytest.raises(ValueError, match="'aec_env' is damaged"):
            kind.__new__(kind).__setstate__({**state, key: value})
    aviary.close()


def test_bodies_that_were_added_have_to_be_the_same():
    def made():
        aviary = bulletuav.Aviary("crossing", 2, num_drones=2, dynamics="point_mass")
        aviary.reset(seeds=0)
        return aviary

    aviary, other = made(), made()
    empty = aviary.save_state()
    ball = Obstacle("sphere", (0.3,))
    aviary.add_body(ball, (1.0, 0.0, 5.0), world=1)
    other.load_state(aviary.save_state([0]), [1])
    for snapshot, worlds in ((aviary.save_state([1]), [0]), (aviary.save_state(), None)):
        with pytest.raises(ValueError, match="with other bodies"):
            other.load_state(snapshot, worlds)
    with pytest.raises(ValueError, match="with other bodies"):
        aviary.load_state(empty)
    other.add_body(ball, (1.0, 0.0, 5.0), world=1)
    other.load_state(aviary.save_state())
    aviary.close()
    other.close()


ANOTHER = "another value"
SAMPLE = ("crossing", "hover", "formation")
"""Tasks that the default suite looks at; the slow one looks at all"""


def changed(source, name, value):
    """A copy of a frozen dataclass with another value, which is not checked."""
    copied = copy.copy(source)
    object.__setattr__(copied, name, value)
    return copied


@pytest.mark.parametrize(
    "task",
    [
        one if one in SAMPLE else pytest.param(one, marks=pytest.mark.slow)
        for one in bulletuav.list_tasks()
    ],
)
def test_every_option_is_among_the_parts_of_a_snapshot_or_without_effect(task):
    """An option that is added later and forgotten is found here."""
    given = {"observation": ("velocity",), "num_drones": 3}
    spec, other = (
        EnvSpec(task, 1, {**given, **more})
        for more in (
            {},
            {
                "airframe": "iris",
                "randomization": {"mass": 1.1},
                "sensors": (Imperfect(Imu(), noise=0.2),),
                "observation": ("velocity", "imu"),
                "reward": {"mine": ("energy", 0.1)},
            },
        )
    )
    parts = describe_parts(spec.options, spec.task)
    values = {one: getattr(other.options, one) for one in ("airframe", "randomization", "sensors")}
    values |= {"observation": other.options.observation, "reward": {"mine": (len, 0.1)}}
    values["bodies"] = as_bodies([Body(Obstacle("sphere", (0.3,)), (0.0, 0.0, 9.0))])
    values["communication"] = Channel(size=3)
    values["thermals"] = as_thermals({})
    values["events"] = as_events({"time": 1.0, "added_mass": 0.01})
    for field in dataclasses.fields(EnvOptions):
        value = values.get(field.name, ANOTHER)
        found = describe_parts(changed(spec.options, field.name, value), spec.task)
        differ = {name for name in parts if parts[name] != found[name]}
        if field.name == "airframe":
            assert {"airframe", "airframe.mass", "airframe.rotors"} <= differ
        else:
            assert differ == {field.name} - WITHOUT_EFFECT
    for field in dataclasses.fields(spec.task.config):
        flown = copy.copy(spec.task)
        flown.config = changed(spec.task.config, field.name, ANOTHER)
        flown.obstacles, flown.layouts = spec.task.obstacles, spec.task.layouts
        found = describe_parts(spec.options, flown)
        assert {name for name in parts if parts[name] != found[name]} == {field.name}
    # Options without effect are options
    assert {field.name for field in dataclasses.fields(EnvOptions)} >= WITHOUT_EFFECT


def test_options_without_effect_leave_the_continuation_as_it_is():
    options = {"num_drones": 2, "dynamics": "point_mass"}
    aviary = bulletuav.Aviary("crossing", 2, **options)
    aviary.reset(seeds=3)
    aviary.step(np.ones((2, 2, 3)))
    saved = pickle.loads(pickle.dumps(aviary.save_state()))
    first = flown(aviary, 5, 1)
    # The values of another difficulty, all of which are overridden
    values = {**vars(aviary.options), **vars(aviary.task.config)}
    kept = {name: values[name] for name in aviary.task.difficulties["hard"]}
    cases = (
        {"seed": 5},
        {"debug": True},
        {"threads": 2},
        {"render_mode": "rgb_array"},
        {"render_size": (32, 16)},
        {"render_address": "127.0.0.1:4321"},
        {**kept, "difficulty": "hard", "randomization": {"gps_noise": (0.5, 1.5)}},
    )
    # crossing has no preset, and masks need discrete actions, see `test_action_masks`
    names = {name for case in cases for name in case} | {"preset", "action_masks"}
    assert names >= WITHOUT_EFFECT
    for case in cases:
        other = bulletuav.Aviary("crossing", 3, **{**options, **case})
        other.load_state(saved, [0, 1])
        # Two drones of one world fly on one thread
        alone = bulletuav.Aviary("crossing", 1, **{**options, **case, "threads": 1})
        alone.load_state(saved[1])
        other.close()
        again = bulletuav.Aviary("crossing", 2, **{**options, **case})
        again.load_state(saved)
        same(flown(again, 5, 1), first)
        assert again.options != aviary.options
        alone.close()
        again.close()
    aviary.close()


DIFFERENCES = (
    ({"gravity": 1.62}, "gravity is 9.80665 in the snapshot and 1.62 here"),
    ({"airframe": "iris"}, "airframe is 'hummingbird' in the snapshot and 'iris' here;"),
    ({"wind": (1.0, 0.0, 0.0)}, r"wind is \(0.0, 0.0, 0.0\) in the snapshot and \(1.0"),
    ({"horizon": 20}, "horizon is 500 in the snapshot and 20 here"),
    ({"weights": {"goal": 3.0}}, "weights is {} in the snapshot and {'goal': 3.0} here"),
    ({"lane_spacing": 12.0}, "lane_spacing is 15.0 in the snapshot and 12.0 here"),
    ({"max_speed": 9.0, "normalise": True}, "max_speed is .*; normalise is False in"),
    ({"dynamics": "double_integrator"}, "dynamics is 'point_mass' in the snapshot and 'double"),
)


def test_a_snapshot_of_another_simulation_is_refused_with_what_differs():
    options = {"num_drones": 2, "dynamics": "point_mass"}

    def made(task="crossing", **more):
        aviary = bulletuav.Aviary(task, 1, **{**options, **more})
        aviary.reset(seeds=0)
        return aviary

    saved = made().save_state()
    for more, reported in DIFFERENCES:
        other = made(**more)
        hashed = other.state_hash()
        with pytest.raises(ValueError, match=f"another simulation than .*: {reported}"):
            other.load_state(saved)
        assert other.state_hash() == hashed
        other.close()
    with pytest.raises(ValueError, match="task is crossing in the snapshot and converge here;"):
        made("converge").load_state(saved)
    # The same name, and another number
    light = dataclasses.replace(load_airframe("hummingbird"), mass=0.5)
    with pytest.raises(ValueError, match=r": airframe.mass is 0.716 in the snapshot and 0.5 here;"):
        made(airframe=light).load_state(saved)
    # Worlds that were never reset refuse it before they begin
    never = bulletuav.Aviary("crossing", 1, **{**options, "gravity": 5.0})
    with pytest.raises(ValueError, match="gravity is"):
        never.load_state(saved)
    with pytest.raises(RuntimeError, match="reset"):
        never.state_hash()


def test_an_airspace_refuses_a_snapshot_of_another_one():
    place, options = [(0.0, 0.0, 1.0)], {"dynamics": "point_mass"}
    ball, box = Obstacle("sphere", (0.3,)), Obstacle("box", (0.3, 0.3, 0.3))
    airspace = bulletuav.Airspace(place, "cf2x", obstacles=(ball,), **options)
    airspace.step()
    saved = airspace.save_state()
    for airframe, obstacle, more, reported in (
        ("iris", ball, {}, "airframe is 'cf2x' in the snapshot and 'iris' here"),
        ("cf2x", box, {}, "obstacles is .* in the snapshot and"),
        ("cf2x", ball, {"gravity": 1.62}, "gravity is 9.80665 in the snapshot and 1.62 here"),
        ("cf2x", ball, {"effects": ()}, "effects is"),
    ):
        other = bulletuav.Airspace(place, airframe, obstacles=(obstacle,), **options, **more)
        hashed = other.state_hash()
        with pytest.raises(ValueError, match=f"another simulation than this airspace: {reported}"):
            other.load_state(saved)
        assert other.state_hash() == hashed
        other.close()
    beyond = written(airspace, saved, "levels", 7)
    with pytest.raises(ValueError, match="the snapshot has levels 7: from 0 to 1 is needed"):
        airspace.load_state(beyond)
    airspace.close()


def test_equal_values_have_equal_texts_in_every_process():
    field = lambda place, time: place * 0.0  # noqa: E731
    again = "from bulletuav.envs import descriptions as d; print(d.canonical_text({'b', 'a', 'c'}))"
    reported = subprocess.run(
        [sys.executable, "-c", again], capture_output=True, text=True, check=True
    )
    assert reported.stdout.strip() == canonical_text({"c", "a", "b"})
    assert canonical_text(Imperfect(Imu(), noise=0.1)) == canonical_text(
        Imperfect(Imu(), noise=0.1)
    )
    assert " at 0x" not in canonical_text((Imperfect(Imu(), noise=0.1), field, np.zeros))
    assert canonical_text(Imperfect(Imu(), noise=0.1)) != canonical_text(
        Imperfect(Imu(), noise=0.2)
    )
    made = [lambda speed=speed: speed for speed in (1.0, 2.0)]
    assert canonical_text(made[0]) != canonical_text(made[1])
    loop = []
    loop.append(loop)
    assert canonical_text(loop) == "(itself)"


def test_snapshots_that_do_not_fit_are_refused():
    aviary = made("crossing", dynamics="point_mass")
    saved, hashed = aviary.save_state(), aviary.state_hash()
    refused = (
        ({"snapshot": b"bytes"}, "snapshot is b'bytes': a result of save_state is needed"),
        ({"snapshot": saved[:2]}, "has 2 worlds, and 3 are to be written"),
        ({"snapshot": saved[0], "worlds": 3}, "world is 3"),
        ({"snapshot": saved[[0, 0]], "worlds": [1, 1]}, "each one once"),
        ({"snapshot": saved[0], "worlds": 0.5}, "worlds is 0.5"),
        ({"snapshot": Snapshot(saved.data, "other")}, "result of save_state of this version"),
    )
    for keywords, reported in refused:
        with pytest.raises(ValueError, match=reported):
            aviary.load_state(**keywords)
        assert aviary.state_hash() == hashed
    with pytest.raises(RuntimeError, match="reset"):
        bulletuav.Aviary("crossing", dynamics="point_mass").save_state()
    of_bullet = bulletuav.Aviary("crossing", contacts="bullet", dynamics="bullet")
    of_bullet.reset(seeds=0)
    airspace = bulletuav.Airspace([(0.0, 0.0, 1.0)], contacts="bullet", dynamics="bullet")
    for environment in (of_bullet, airspace):
        with pytest.raises(ValueError, match="contacts='bullet' has no snapshots"):
            environment.save_state()
    aviary.rng[1] = np.random.Generator(np.random.MT19937(0))
    with pytest.raises(ValueError, match="MT19937.*default_rng is needed"):
        aviary.save_state()


@pytest.mark.parametrize(
    "worlds", [True, np.True_, None, np.array(0), np.zeros((1, 1), int)], ids=repr
)
def test_worlds_of_a_snapshot_are_whole_numbers(worlds):
    """What numpy makes other axes of is no snapshot."""
    aviary = bulletuav.Aviary("hover", 1, num_drones=1, dynamics="point_mass")
    aviary.reset(seeds=0)
    with pytest.raises(IndexError, match="a whole number"):
        aviary.save_state()[worlds]
