"""Messages as parts of actions and observations, in every environment."""

import numpy as np
import pytest

import bulletuav
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.sensors.messages import Channel

OPTIONS = {"num_drones": 3, "dynamics": "point_mass", "seed": 0, "horizon": 100}
LOSSY = {"size": 2, "range": 200.0, "loss": 0.2, "delay": 0.2}


def made(task="crossing", worlds=1, communication=LOSSY, **options):
    return bulletuav.Aviary(task, worlds, communication=communication, **{**OPTIONS, **options})


def random_actions(aviary, decisions, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(aviary.action.low, aviary.action.high, (decisions, *aviary.given.shape))


def flown(aviary, actions):
    """Positions and observations after each decision."""
    steps = [(aviary.step(one), aviary.swarm.position.copy()) for one in actions]
    return np.array([place for _, place in steps]), np.array([one.observations for one, _ in steps])


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("crossing", {}),
        ("hover", {"dynamics": "rigid_body", "action": "rotor"}),
        ("hover", {"dynamics": "rigid_body", "action": ["rates", "rotor", "attitude"]}),
        ("hover", {"dynamics": "rigid_body", "action": "hover_rpm"}),
    ],
)
def test_messages_do_not_change_the_flight(task, options):
    # Losses would be draws of the generator that GPS errors come from, too
    clear = {**LOSSY, "loss": 0.0}
    aviary, silent = made(task, 1, clear, **options), made(task, 1, None, **options)
    aviary.reset(seeds=5)
    silent.reset(seeds=5)
    actions = random_actions(aviary, 15)
    width = silent.given.shape[-1]
    assert actions.shape[-1] == width + 2
    place, seen = flown(aviary, actions)
    other, own = flown(silent, actions[..., :width])
    np.testing.assert_array_equal(place, other)
    np.testing.assert_array_equal(seen[..., : own.shape[-1]], own)
    assert (seen[..., own.shape[-1] :] != 0).any()


def test_discrete_actions_choose_a_move_and_tokens():
    channel = {"size": 2, "tokens": 3}
    aviary = made(action="discrete", communication=channel)
    silent = made(action="discrete", communication=None)
    assert aviary.action.choices == 7 * 9
    aviary.reset(seeds=5)
    silent.reset(seeds=5)
    choices = np.random.default_rng(0).integers(0, 63, (15, 1, 3, 1)).astype(float)
    place, seen = flown(aviary, choices)
    other, _ = flown(silent, choices // 9)
    np.testing.assert_array_equal(place, other)
    part = aviary.observer.slices["messages"]
    slots = seen[:, 0, :, part].reshape(15, 3, 3, 7)
    # Drones are on a circle: the two others are in the first two slots
    np.testing.assert_array_equal(slots[:, :, :2, 0], 1)
    tokens = np.stack([choices[:, 0, :, 0] % 9 // 3, choices[:, 0, :, 0] % 3], axis=-1)
    for i in range(3):
        heard = slots[:, i, :2, 1:].reshape(15, 2, 2, 3).argmax(axis=-1)
        sent = tokens[:, [j for j in range(3) if j != i]]
        np.testing.assert_array_equal(np.sort(heard, axis=1), np.sort(sent, axis=1))


def test_slots_are_those_of_the_observed_neighbours():
    aviary = made(num_drones=5, communication={"size": 1}, num_neighbours=3)
    aviary.reset(seeds=1)
    actions = random_actions(aviary, 20)
    for one in actions:
        seen = aviary.observer.split(aviary.step(one).observations[0])
        slots = seen["messages"].reshape(5, 3, 2)
        nearest = seen["neighbours"].reshape(5, 3, 7)[..., 1:4]
        place = aviary.swarm.position[0]
        for i in range(5):
            for k in range(3):
                distances = np.linalg.norm(place - place[i] - nearest[i, k], axis=-1)
                assert slots[i, k, 1] == np.float32(one[0, distances.argmin(), -1])


def test_walls_block_messages_that_need_line_of_sight():
    wall = {"source": Obstacle("box", (0.1, 50.0, 50.0)), "position": (1.0, 0.0, 25.0)}
    for sight, heard in ((True, [0, 1, 1]), (False, [2, 2, 2])):
        channel = {"size": 1, "line_of_sight": sight}
        aviary = made("hover", bodies=[wall], communication=channel, start_offset=0.0)
        aviary.reset(seeds=0)
        place = aviary.swarm.position[0, :, 0]
        alone = int(np.argmax([np.sum((place > 1) == (x > 1)) == 1 for x in place]))
        info = aviary.step(np.zeros(aviary.given.shape)).info["messages_heard"][0]
        assert sorted(info.tolist()) == heard
        if sight:
            assert info[alone] == 0
        aviary.close()


def test_snapshots_keep_messages_in_transit():
    aviary = made(worlds=2)
    aviary.reset(seeds=3)
    actions = random_actions(aviary, 30)
    flown(aviary, actions[:10])
    saved = aviary.save_state()
    first = flown(aviary, actions[10:])
    again = made(worlds=2)
    again.load_state(saved)
    for one, other in zip(first, flown(again, actions[10:]), strict=True):
        np.testing.assert_array_equal(one, other)
    other = made(worlds=2, communication={**LOSSY, "loss": 0.3})
    with pytest.raises(ValueError, match="communication"):
        other.load_state(saved)


def test_worlds_are_those_of_a_single_process():
    both, second = made(worlds=2), made(first_world=1, seed=0)
    both.reset(seeds=4)
    second.reset(seeds=5)
    actions = random_actions(both, 20)
    np.testing.assert_array_equal(flown(both, actions)[1][:, 1:], flown(second, actions[:, 1:])[1])


def test_a_new_episode_starts_without_messages():
    aviary = made(communication={"size": 1, "delay": 0.3})
    aviary.reset(seeds=4)
    flown(aviary, random_actions(aviary, 10))
    again = aviary.observer.split(aviary.reset(seeds=4))["messages"]
    np.testing.assert_array_equal(again, 0)
    _, seen = flown(aviary, random_actions(aviary, 5))
    heard = aviary.observer.split(seen)["messages"][..., 0]
    np.testing.assert_array_equal(heard[:3], 0)
    np.testing.assert_array_equal(heard[3:], 1)


def test_agents_have_spaces_with_messages():
    env = bulletuav.parallel_env("crossing", communication=Channel(size=4), **OPTIONS)
    observations, _ = env.reset(seed=0)
    agent = env.agents[0]
    assert env.action_space(agent).shape == (3 + 4,)
    assert env.observation_space(agent).contains(observations[agent])
    *_, infos = env.step({name: env.action_space(name).sample() for name in env.agents})
    assert infos[agent]["messages_heard"] == 2
    assert infos[agent]["message_bits"] == 128
    env.close()


def test_baselines_fly_without_messages():
    results = bulletuav.evaluate(
        "crossing", "orca", episodes=2, communication={"size": 2}, **OPTIONS
    )
    silent = bulletuav.evaluate("crossing", "orca", episodes=2, **OPTIONS)
    assert results.metrics["success"] == silent.metrics["success"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_drones": 1}, "communication needs two drones or more"),
        ({"action": "discrete"}, "give communication tokens, such as 4"),
        (
            {"action": "discrete", "communication": {"size": 8, "tokens": 8}},
            r"8\^8 different messages: with 7 moves",
        ),
        (
            {"task": "hover", "dynamics": "rigid_body", "action": ["rates", "velocity", "rates"]},
            r"same number of numbers in an action, and they have \[3, 4\]",
        ),
        ({"communication": {"size": 2, "rang": 3}}, "'rang': did you mean 'range'"),
    ],
)
def test_invalid_options(options, message):
    with pytest.raises(ValueError, match=message):
        made(**options)


def test_each_team_observes_messages_beside_its_own_blocks():
    mixed = {"chasers": ["velocity", "room"], "evaders": ["velocity"]}
    options = {"observation": mixed, "decision_every": {"chasers": 1, "evaders": 3}}
    aviary = made("pursuit_evasion", num_drones=4, **options)
    alike = made("pursuit_evasion", num_drones=4, observation=["velocity", "room"])
    seen = aviary.reset(seeds=0)
    alike.reset(seeds=0)
    blocks = [list(aviary.observer.of(i).slices) for i in (0, 3)]
    assert blocks == [["velocity", "room", "messages"], ["velocity", "messages"]]
    actions = random_actions(aviary, 5)
    held = actions.copy()
    held[1:3, :, 3], held[4:, :, 3] = actions[0, :, 3], actions[3, :, 3]
    for one, other in zip(actions, held, strict=True):
        # An evader that does not decide sends its last message again
        seen, all_blocks = aviary.step(one).observations, alike.step(other).observations
        parts = alike.observer.split(all_blocks)
        np.testing.assert_array_equal(
            aviary.observer.of(0).split(seen)["messages"][:, :3], parts["messages"][:, :3]
        )
        own = aviary.observer.unpadded(seen, 3)[:, 3]
        np.testing.assert_array_equal(
            aviary.observer.of(3).split(own)["messages"], parts["messages"][:, 3]
        )
    assert parts["messages"].any()
    aviary.close()
    alike.close()
