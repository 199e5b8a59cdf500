"""The batched core: determinism, independence of worlds, and refused input."""

import numpy as np
import pytest

import bulletuav

CASES = [
    ("hover", "bullet", "rotor"),
    ("hover", "rigid_body", "rpm"),
    ("hover", "bullet", "target_position"),
    ("crossing", "bullet", "velocity"),
    ("crossing", "rigid_body", "velocity"),
]


def fly(aviary, seed, steps=40, action_seed=0):
    """Bytes of every observation, reward, flag and state over a flight with random actions."""
    rng = np.random.default_rng(action_seed)
    seen = [aviary.reset(seeds=seed).tobytes()]
    for _ in range(steps):
        actions = rng.uniform(
            aviary.action.low,
            aviary.action.high,
            (*aviary.alive.shape, aviary.action.low.shape[-1]),
        )
        step = aviary.step(actions)
        seen += [
            array.tobytes()
            for array in (*step[:4], *step.info.values(), *aviary.swarm, aviary.state())
        ]
    return b"".join(seen)


@pytest.mark.parametrize(("task", "dynamics", "action"), CASES)
def test_same_seed_same_bits_whatever_ran_before(task, dynamics, action):
    options = {"dynamics": dynamics, "action": action, "num_drones": 4}
    aviary = bulletuav.Aviary(task, **options)
    first = fly(aviary, 0)
    assert fly(aviary, 0) == first
    fly(aviary, 5, steps=17, action_seed=3)
    assert fly(aviary, 0) == first
    aviary.close()
    fresh = bulletuav.Aviary(task, seed=0, **options)
    assert fly(fresh, None) == first
    assert fly(fresh, 1) != first
    assert fly(fresh, 0, action_seed=1) != first
    fresh.close()


def test_the_bits_hold_through_contacts():
    """Drones fall on each other and on the ground, and dead ones leave in between."""
    start = [(0.02 * i, 0.0, 0.12 + 0.14 * i) for i in range(6)]
    for dynamics in ("bullet", "rigid_body"):
        aviary = bulletuav.Aviary(
            "hover", num_drones=6, start=start, dynamics=dynamics, action="rotor"
        )
        runs = []
        for _ in range(3):
            aviary.reset(seeds=0)
            bits, hits = [], 0
            for _ in range(20):
                step = aviary.step(np.full((1, 6, 4), -0.9))
                hits += int(step.info["collision"].sum())
                bits += [array.tobytes() for array in (*step[:4], *aviary.swarm)]
            runs.append(b"".join(bits))
            assert hits >= 6
        assert runs[0] == runs[1] == runs[2]
        aviary.close()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
@pytest.mark.parametrize("task", ["hover", "crossing"])
def test_world_k_does_not_feel_the_others_and_starts_like_seed_plus_k(task, dynamics):
    runs = []
    for others in (0.3, -0.7):
        aviary = bulletuav.Aviary(task, 3, dynamics=dynamics, num_drones=3)
        first = aviary.reset(seeds=10)
        rng, bits = np.random.default_rng(0), []
        for k in range(40):
            actions = np.full((*aviary.alive.shape, aviary.action.low.shape[-1]), others)
            actions[1] = rng.uniform(-1, 1, actions[1].shape)
            step = aviary.step(actions)
            bits += [array[1].tobytes() for array in (*step[:4], *aviary.swarm)]
            if k == 20 and others > 0:
                aviary.reset(np.array([True, False, True]))
        runs.append(b"".join(bits))
        aviary.close()
    assert runs[0] == runs[1]
    alone = bulletuav.Aviary(task, dynamics=dynamics, num_drones=3)
    np.testing.assert_array_equal(alone.reset(seeds=11)[0], first[1])
    alone.close()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_a_world_agrees_with_the_same_world_alone(dynamics):
    """Until contact: to 1e-9 m in `bullet`, whose tiles round differently, else bit for bit."""
    many, alone = (bulletuav.Aviary("crossing", worlds, dynamics=dynamics) for worlds in (3, 1))
    many.reset(seeds=0)
    alone.reset(seeds=2)
    for k in range(50):
        action = np.random.default_rng(k).uniform(-1, 1, (1, 8, 3))
        many.step(np.repeat(action, 3, axis=0))
        alone.step(action)
    tolerance = {"bullet": 1e-9, "rigid_body": 0}[dynamics]
    np.testing.assert_allclose(
        many.swarm.position[2], alone.swarm.position[0], rtol=0, atol=tolerance
    )
    many.close()
    alone.close()


def test_pictures_do_not_change_the_flight():
    for dynamics in ("bullet", "rigid_body"):
        runs = []
        for look in (False, True):
            aviary = bulletuav.Aviary(
                "hover",
                num_drones=2,
                dynamics=dynamics,
                render_mode="rgb_array",
                render_size=(32, 32),
            )
            aviary.reset(seeds=0)
            for _ in range(20):
                aviary.step(np.full((1, 2, 4), -0.3))
                if look:
                    aviary.render()
            runs.append(b"".join(array.tobytes() for array in aviary.swarm))
            aviary.close()
        assert runs[0] == runs[1]


def test_the_global_random_state_is_left_alone():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    aviary = bulletuav.Aviary("crossing", dynamics="rigid_body")
    aviary.reset()
    aviary.step(np.zeros((1, 8, 3)))
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    aviary.close()


def test_unseeded_resets_go_on_and_differ():
    aviary = bulletuav.Aviary("hover", 2, seed=0)
    first, second = aviary.reset(), aviary.reset()
    assert (first != second).any()
    assert (first[0] != first[1]).any()
    again = bulletuav.Aviary("hover", 2, seed=0)
    np.testing.assert_array_equal(again.reset(), first)
    np.testing.assert_array_equal(again.reset(), second)
    entropy = [bulletuav.Aviary("hover").reset() for _ in range(2)]
    assert (entropy[0] != entropy[1]).any()


def test_seed_lists_and_masks():
    aviary = bulletuav.Aviary("hover", 3)
    first = aviary.reset(seeds=[7, 8, 9])
    np.testing.assert_array_equal(aviary.reset(seeds=7), first)
    second = aviary.reset(np.array([False, True, False]), seeds=[0, 0, 0])
    np.testing.assert_array_equal(second[[0, 2]], first[[0, 2]])
    np.testing.assert_array_equal(second[1], bulletuav.Aviary("hover").reset(seeds=0)[0])
    for mask in (np.ones(2, bool), np.ones(3)):
        with pytest.raises(ValueError, match="mask has shape"):
            aviary.reset(mask)
    with pytest.raises(ValueError, match="a list of 3, one for each world"):
        aviary.reset(seeds=[1, 2])
    with pytest.raises(ValueError, match="seed is -1"):
        aviary.reset(seeds=[1, -1, 2])
    with pytest.raises(ValueError, match=r"seed is 0\.5"):
        aviary.reset(seeds=[1, 0.5, 2])


@pytest.mark.parametrize(
    ("action", "said"),
    [
        (np.full((1, 2, 4), np.nan), r"action of drone 0 in world 0 is \[nan nan nan nan\]"),
        (np.full((1, 2, 4), np.inf), "finite numbers are needed"),
        (np.zeros((2, 4)), r"actions have shape \(2, 4\).*= \(1, 2, 4\) is needed"),
        (np.zeros((1, 2, 3)), "shape"),
    ],
)
def test_a_bad_action_is_refused_and_changes_nothing(action, said):
    aviary = bulletuav.Aviary("hover", num_drones=2)
    reference = fly(aviary, 0, steps=5)
    aviary.reset(seeds=0)
    with pytest.raises(ValueError, match=said):
        aviary.step(action)
    assert aviary.steps[0] == 0
    assert fly(aviary, 0, steps=5) == reference
    aviary.reset(seeds=0)
    one = aviary.step(np.zeros((1, 2, 4)))
    with pytest.raises(ValueError, match=said):
        aviary.step(action)
    two = aviary.step(np.zeros((1, 2, 4)))
    aviary.reset(seeds=0)
    np.testing.assert_array_equal(aviary.step(np.zeros((1, 2, 4))).observations, one.observations)
    np.testing.assert_array_equal(aviary.step(np.zeros((1, 2, 4))).observations, two.observations)
    aviary.close()


def test_a_failed_reset_changes_nothing(monkeypatch):
    aviary = bulletuav.Aviary("hover", 2)
    aviary.reset(seeds=0)
    before = aviary.swarm.copy()
    spawn = aviary.task.spawn

    def failing(rng):
        if aviary.count == 1:
            raise ValueError("no room")
        aviary.count += 1
        return spawn(rng)

    aviary.count = 0
    monkeypatch.setattr(aviary.task, "spawn", failing)
    with pytest.raises(ValueError, match="no room"):
        aviary.reset(seeds=1)
    for array, old in zip(aviary.swarm, before, strict=True):
        np.testing.assert_array_equal(array, old)
    aviary.close()


def test_actions_beyond_the_bounds_are_clipped_to_them():
    ends = []
    for size in (1.0, 1e9):
        aviary = bulletuav.Aviary("crossing", dynamics="rigid_body")
        aviary.reset(seeds=0)
        ends.append(aviary.step(np.full((1, 8, 3), size)).observations)
        aviary.close()
    np.testing.assert_array_equal(*ends)


def test_the_dead_keep_their_place_in_the_arrays_and_earn_nothing():
    aviary = bulletuav.Aviary("hover", num_drones=2, spacing=3.0, action="velocity")
    aviary.reset(seeds=0)
    down = np.array([[(0, 0, -1.0), (0, 0, 0)]])
    while aviary.alive[0, 0]:
        aviary.step(down)
    last = aviary.swarm.world(0).copy()
    down[0, 0] = np.nan  # nobody reads the action of the dead
    step = aviary.step(down)
    assert step.rewards[0, 0] == 0
    assert not step.terminated[0, 0]
    assert not step.truncated[0, 0]
    assert step.rewards[0, 1] > 0
    for now, then in zip(aviary.swarm.world(0), last, strict=True):
        np.testing.assert_array_equal(now[0], then[0])
    assert aviary.state()[0, 16] == 0
    assert aviary.state()[0, 33] == 1
    aviary.close()


def test_reward_is_the_sum_of_its_terms():
    aviary = bulletuav.Aviary("crossing", 2)
    aviary.reset(seeds=0)
    for k in range(60):
        step = aviary.step(np.random.default_rng(k).uniform(-1, 1, (2, 8, 3)))
        terms = [value for name, value in step.info.items() if name.startswith("reward/")]
        np.testing.assert_allclose(np.sum(terms, axis=0), step.rewards, rtol=1e-12)
    aviary.close()


def test_steps_out_of_order_are_refused():
    aviary = bulletuav.Aviary("hover")
    for call in (lambda: aviary.step(np.zeros((1, 1, 4))), aviary.state, aviary.first_info):
        with pytest.raises(RuntimeError, match="reset"):
            call()
    aviary.reset(seeds=0)
    aviary.close()
    aviary.close()
    for call in (lambda: aviary.step(np.zeros((1, 1, 4))), aviary.reset, aviary.render):
        with pytest.raises(RuntimeError, match="closed"):
            call()


def test_many_drones_fly_in_one_world():
    aviary = bulletuav.Aviary("crossing", difficulty="extreme")
    aviary.reset(seeds=0)
    step = aviary.step(np.zeros((1, 100, 3)))
    assert step.observations.shape == (1, 100, 55)
    assert aviary.alive.all()
    aviary.close()
