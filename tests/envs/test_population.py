"""Episodes with a number of drones that is drawn at each reset."""

import numpy as np
import pytest

import bulletuav
from bulletuav.adapters.pymarl import PymarlEnv
from bulletuav.adapters.sb3 import DroneVecEnv
from bulletuav.adapters.torchrl import DroneTensorEnv
from bulletuav.analysis.metrics.meter import Meter
from bulletuav.analysis.recorded import outcomes, summarize_infos
from bulletuav.analysis.recording import fly_episode
from bulletuav.envs.gymnasium import CentralAviary, CentralVectorAviary
from bulletuav.policies import find_policy

SOME = {"num_drones": (2, 6), "dynamics": "point_mass", "difficulty": "easy", "horizon": 30}


def made(worlds=1, task="free_flight", **options):
    return bulletuav.Aviary(task, worlds, **SOME | options)


def ahead(aviary):
    """Actions with which all drones fly to their goals."""
    way = aviary.scene.goal - aviary.swarm.position
    return way / np.linalg.norm(way, axis=-1, keepdims=True)


def test_numbers_are_drawn_from_the_range_with_any_drones():
    aviary = made(400)
    aviary.reset(seeds=0)
    counts = aviary.alive.sum(axis=1)
    assert set(counts) == {2, 3, 4, 5, 6}
    np.testing.assert_allclose(np.bincount(counts)[2:] / 400, 0.2, atol=0.06)
    np.testing.assert_allclose(aviary.alive.mean(axis=0), 4 / 6, atol=0.07)
    np.testing.assert_array_equal(aviary.members, aviary.alive)
    aviary.close()


def test_starts_are_those_of_the_maximum_and_follow_from_the_seed():
    """The draw comes after those of the starts, which therefore stay the same."""
    positions, members = [], []
    for options in ({}, {}, {"num_drones": 6}):
        aviary = made(5, **options)
        aviary.reset(seeds=3)
        positions.append(aviary.swarm.position.copy())
        members.append(aviary.members.copy())
        aviary.close()
    np.testing.assert_array_equal(positions[0], positions[2])
    np.testing.assert_array_equal(members[0], members[1])
    assert members[2].all()
    # A world alone has the same drones
    alone = made()
    alone.reset(seeds=5)
    np.testing.assert_array_equal(alone.members[0], members[0][2])
    alone.close()


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_absent_drones_are_not_seen_and_cause_no_conflict(dynamics):
    """A drone flies through the place of an absent one."""
    options = {"num_drones": (1, 2), "observation": ("neighbours", "lidar"), "dynamics": dynamics}
    aviary = made(observation_format="dict", **options)
    seed = next(
        seed
        for seed in range(20)
        if aviary.reset(seeds=seed) is not None and aviary.members[0].tolist() == [True, False]
    )
    aviary.reset(seeds=seed)
    aviary.swarm.position[0, 1] = aviary.swarm.position[0, 0] + (1.0, 0, 0)
    step = aviary.step(np.zeros((1, 2, 3)))
    assert not step.observations["neighbours"][0, 0].any()
    assert (step.observations["lidar"][0, 0] == aviary.options.max_range).all()
    assert step.info["separation"][0, 0] == np.inf
    assert not step.info["conflicts"].any()
    assert not step.info["collision"].any()
    assert not step.rewards[0, 1]
    aviary.close()


def test_only_drones_of_the_episode_are_agents():
    env = bulletuav.parallel_env("free_flight", **SOME)
    numbers = set()
    for seed in range(8):
        observations, infos = env.reset(seed=seed)
        present = env.aviary.members[0]
        assert env.agents == [f"drone_{i}" for i in np.flatnonzero(present)]
        assert observations.keys() == infos.keys() == set(env.agents)
        numbers.add(len(env.agents))
        while env.agents:
            agents = env.agents[:]
            actions = {agent: env.action_space(agent).sample() for agent in agents}
            _, rewards, *_ = env.step(actions)
            assert rewards.keys() == set(agents)
    assert len(numbers) > 2
    assert len(env.possible_agents) == 6
    env.close()


@pytest.mark.parametrize("workers", [1, 2])
def test_batches_have_a_mask_and_continue_with_other_drones(workers):
    env = bulletuav.batch_env("free_flight", 4, workers=workers, **SOME)
    env.reset(seed=0)
    first = env.alive
    assert not first.all()
    for _ in range(31):
        env.step(np.zeros((4, 6, 3)))
    assert not np.array_equal(env.alive, first)
    assert (env.alive.sum(axis=1) >= 2).all()
    env.close()


def test_a_snapshot_continues_with_the_same_drones():
    aviary = made(3)
    aviary.reset(seeds=1)
    aviary.step(ahead(aviary))
    saved, members = aviary.save_state(), aviary.members.copy()
    results = []
    for _ in range(2):
        for _ in range(5):
            step = aviary.step(ahead(aviary))
        results.append((step.observations, step.rewards, aviary.state_hash()))
        aviary.reset(seeds=9)
        assert not np.array_equal(aviary.members, members)
        aviary.load_state(saved)
        np.testing.assert_array_equal(aviary.members, members)
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])
    assert results[0][2] == results[1][2]
    aviary.close()


def test_metrics_are_those_of_the_drones_of_the_episode():
    """Drones far apart fly straight to their goals: all of an episode succeed."""
    options = SOME | {"horizon": 600, "num_obstacles": 0, "area": 400.0, "d_safe": 1.0}
    result = bulletuav.evaluate("free_flight", "straight", episodes=6, **options)
    throughputs = set()
    for row in result.rows:
        assert row["drone_success"] == row["success"] == row["safe_success"] == 1
        throughputs.add(round(row["throughput"] * row["length"] / 60))
    assert len(throughputs) > 1
    assert throughputs <= {2, 3, 4, 5, 6}


def test_recordings_have_outcomes_of_the_drones_of_the_episode():
    aviary = made()
    recording = fly_episode(aviary, find_policy("straight")(aviary), 0)
    aviary.close()
    flew = np.flatnonzero(recording.alive[0])
    assert 0 < len(flew) < 6
    assert [row.drone for row in outcomes(recording)] == flew.tolist()
    assert len(summarize_infos(recording, ["separation"])) == len(flew)


def test_absent_drones_do_not_lower_the_success():
    """All drones of a world are put at their goals: the fraction is 1, whatever their number."""
    aviary = made(6)
    aviary.reset(seeds=0)
    meter = Meter(aviary)
    aviary.swarm.velocity[:] = 0
    aviary.scene.goal[:] = aviary.swarm.position
    flown = aviary.alive.copy()
    meter.record(aviary.step(np.zeros((6, 6, 3))), flown)
    assert not aviary.members.all()
    for w in range(6):
        row = meter.row(w)
        assert row["drone_success"] == row["success"] == 1
        assert row["throughput"] == pytest.approx(aviary.members[w].sum() * 600)
    aviary.close()


def test_the_reward_of_the_central_agent_is_the_mean_of_the_drones_of_the_episode():
    one, many = CentralAviary("free_flight", **SOME), made()
    one.reset(seed=0)
    many.reset(seeds=0)
    action = np.zeros(18, np.float32)
    reward = one.step(action)[1]
    rewards = many.step(np.zeros((1, 6, 3))).rewards[0]
    assert reward == pytest.approx(rewards[many.members[0]].mean())
    vector = CentralVectorAviary("free_flight", 1, "SameStep", **SOME | {"horizon": 1})
    vector.reset(seed=0)
    members = vector.aviary.members[0].copy()
    _, reward, _, _, infos = vector.step(action[None])
    terms = sum(v for k, v in infos["final_info"].items() if k.startswith("reward/"))
    assert reward[0] == pytest.approx(terms[0, members].mean())
    for env in (one, many, vector):
        env.close()


def test_pymarl_and_stable_baselines_mask_absent_drones():
    env = PymarlEnv("free_flight", **SOME)
    env.reset(seed=0)
    absent = ~env.aviary.members[0]
    assert absent.any()
    assert (np.array(env.get_avail_actions())[absent].sum(axis=1) == 1).all()
    assert not np.array(env.get_obs())[absent].any()
    env.close()
    slots = DroneVecEnv("free_flight", 2, **SOME)
    slots.seed(0)
    slots.reset()
    members = slots.aviary.members.ravel().copy()
    _, rewards, *_ = slots.step(np.zeros((12, 3)))
    np.testing.assert_array_equal(np.isnan(rewards), ~members)
    slots.close()


def test_groups_of_torchrl_have_a_mask_of_the_drones():
    env = DroneTensorEnv("free_flight", 3, **SOME)
    env.set_seed(0)
    flight = env.rollout(40, break_when_any_done=True)
    mask = flight["drones", "mask"][:, 0]
    np.testing.assert_array_equal(mask.sum(-1), env.batch.aviary.members.sum(axis=1))
    assert (flight["next", "truncated"][:, -1] | flight["next", "terminated"][:, -1]).any()
    env.close()


def test_stages_of_a_curriculum_have_ranges_of_their_own():
    stages = [{"num_drones": (2, 4)}, {"num_drones": (5, 6)}]
    options = {**SOME, "horizon": 3, "up": 0.5, "down": 0.0, "window": 1}
    del options["num_drones"]
    env = bulletuav.curriculum_env("free_flight", stages, **options)
    assert len(env.possible_agents) == 6
    for stage, (fewest, most) in enumerate([(2, 4), (5, 6)]):
        env.curriculum.stage = stage
        found = set()
        for seed in range(20):
            observations, _ = env.reset(seed=seed)
            assert list(observations) == env.agents
            found.add(len(env.agents))
        assert found == set(range(fewest, most + 1))
    # Only drones of the episode count: all that there are have reached their goals
    aviary = env._current.aviary
    aviary.scene.goal[:] = aviary.swarm.position
    env.step({agent: np.zeros(3, dtype=np.float32) for agent in env.agents})
    env.reset(seed=1)
    assert env.curriculum.success_rate == 1.0
    env.close()


def test_what_ranges_and_tasks_are_possible():
    for given, message in (
        ((6, 2), "from low to high"),
        ((0, 2), "num_drones is 0"),
        ((2,), "num_drones"),
        ((2, 3.5), "num_drones"),
    ):
        with pytest.raises(ValueError, match=message):
            made(num_drones=given)
    with pytest.raises(ValueError, match="min_drones is 2, and num_drones .* sets it"):
        made(min_drones=2)
    with pytest.raises(ValueError, match="task 'formation' needs all of its drones"):
        bulletuav.Aviary("formation", num_drones=(2, 4))
    for task in ("crossing", "converge", "obstacles", "free_flight"):
        aviary = made(2, task)
        aviary.reset(seeds=0)
        for _ in range(3):
            step = aviary.step(np.zeros((2, 6, 3)))
        assert np.isfinite(step.rewards).all()
        assert not step.rewards[~aviary.members].any()
        aviary.close()
