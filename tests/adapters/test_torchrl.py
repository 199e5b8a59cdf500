import importlib
import logging
import pickle
import sys

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import ActionDiscretizer, EnvBase, TransformedEnv
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.envs.utils import check_env_specs

import bulletuav
from bulletuav.adapters.torchrl import DroneTensorEnv

CALM = {"dynamics": "single_integrator", "difficulty": "easy", "num_drones": 3}
SHORT = CALM | {"horizon": 5}
BREAK = {**CALM, "horizon": 60, "radius": 20.0, "margin": 10.0}
"""Drones that fly at random leave this small arena one after the other"""
MIXED = {
    "num_drones": 3,
    "airframe": ("firefly", "cf2x", "cf2x"),
    "action": "rotor",
    "dynamics": "rigid_body",
    "horizon": 4,
}


@pytest.fixture(autouse=True)
def quiet():
    torch.set_num_threads(1)
    torch.manual_seed(0)
    logging.getLogger("torchrl").setLevel(logging.WARNING)


def flown(env, steps, seed=0):
    """A rollout with random actions that goes on over the ends of episodes."""
    torch.manual_seed(1)
    env.set_seed(seed)
    return env.rollout(steps, break_when_any_done=False)


def same(one, other):
    """Whether two tensordicts hold the same keys with the same bits."""
    keys = set(one.keys(True, True))
    return keys == set(other.keys(True, True)) and all(torch.equal(one[k], other[k]) for k in keys)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"return_state": True, "infos": ("success", "reward/goal")},
        {"action": "discrete"},
        {"action": "discrete_27", "categorical_actions": False},
        {"observation_format": "dict"},
        {"observation": ("velocity", "depth"), "camera_size": (8, 8)},
        {"device": "cpu"},
    ],
    ids=str,
)
def test_torchrl_finds_what_the_specs_tell(options):
    env = DroneTensorEnv("crossing", 2, **SHORT | options)
    check_env_specs(env)
    assert env.batch_size == (2,)
    assert env.group_map == {"north": ["drone_0", "drone_1"], "east": ["drone_2"]}
    assert env.device == (torch.device("cpu") if "device" in options else None)
    env.close()


def test_a_task_of_one_drone_has_a_group_of_one():
    env = DroneTensorEnv("hover", 2, action="velocity", dynamics="single_integrator", horizon=4)
    check_env_specs(env)
    flight = env.rollout(4)
    assert flight["drones", "action"].shape == (2, 4, 1, 3)
    assert flight["next", "drones", "reward"].shape == (2, 4, 1, 1)
    assert flight["next", "truncated"][:, -1].all()
    assert not flight["next", "terminated"].any()
    env.close()


def test_tensors_are_the_arrays_of_the_batched_environment():
    env = DroneTensorEnv("converge", 3, return_state=True, infos=("conflicts",), **BREAK)
    batch = bulletuav.batch_env("converge", 3, autoreset_mode="Disabled", **BREAK)
    flight = flown(env, 90)
    seen, _ = batch.reset(seed=0)
    for t in range(90):
        now = flight[:, t]
        np.testing.assert_array_equal(now["drones", "mask"], batch.alive)
        seen[~batch.alive] = 0  # or as it was last, see the next test
        living = batch.alive[..., None]
        np.testing.assert_array_equal(now["drones", "observation"].numpy() * living, seen * living)
        np.testing.assert_array_equal(now["state"], batch.state())
        alive = batch.alive
        seen, rewards, terminated, truncated, info = batch.step(now["drones", "action"].numpy())
        told = now["next", "drones"]
        np.testing.assert_array_equal(told["observation"][alive], seen[alive])
        np.testing.assert_array_equal(told["reward"][..., 0], rewards.astype(np.float32))
        np.testing.assert_array_equal(told["terminated"][..., 0].numpy() & alive, terminated)
        np.testing.assert_array_equal(told["truncated"][..., 0].numpy() & alive, truncated)
        np.testing.assert_array_equal(told["done"][..., 0], ~batch.alive)
        np.testing.assert_array_equal(told["info", "conflicts"][..., 0], info["conflicts"] * alive)
        np.testing.assert_array_equal(now["next", "done"][:, 0], batch.ended | ~batch.alive.any(1))
        if batch.ended.any():
            seen, _ = batch.reset(options={"reset_mask": batch.ended})
    assert flight["next", "done"].sum() >= 3
    env.close()
    batch.close()


def test_a_drone_that_left_is_zeros_until_its_world_starts_anew():
    flight = flown(env := DroneTensorEnv("converge", 3, infos=("separation",), **BREAK), 90)
    drones, after = flight["drones"], flight["next", "drones"]
    gone = ~drones["mask"]
    assert gone.any()
    for key in ("observation", "reward", ("info", "separation")):
        assert not after[key][gone].any(), key
    assert after["done"][gone].all()
    assert not after["mask"][gone].any()
    # Its last decision is told in full, and how it ended is kept.
    last = drones["mask"] & ~after["mask"]
    assert after["observation"][last].any(-1).all()
    for name in ("terminated", "truncated"):
        before, then = drones[name], after[name]
        assert (then[gone] == before[gone]).all()
    # A world is over when nobody flies, and terminated when the task ended all.
    over = flight["next", "done"][..., 0]
    assert torch.equal(over, ~after["mask"].any(-1))
    assert torch.equal(flight["next", "terminated"][..., 0], after["terminated"][..., 0].all(-1))
    either = flight["next", "terminated"] | flight["next", "truncated"]
    assert torch.equal(either[..., 0], over)
    starts = over[:, :-1]
    assert flight["drones", "mask"][:, 1:][starts].all()
    assert not flight["drones", "done"][:, 1:][starts].any()
    env.close()


def test_a_reset_of_some_worlds_leaves_the_others_as_they_were():
    env = DroneTensorEnv("converge", 3, return_state=True, infos=("success", "power"), **BREAK)
    env.set_seed(0)
    now = env.rand_action(env.reset())
    for _ in range(3):
        _, now = env.step_and_maybe_reset(env.rand_action(now))
    before = now.clone()
    now["_reset"] = torch.tensor([[False], [True], [False]])
    after = env.reset(now)
    kept = [0, 2]
    assert same(after[kept].exclude("_reset"), before[kept])
    assert not torch.equal(after["state"][1], before["state"][1])
    assert after["drones", "mask"][1].all()
    nobody = after.clone()
    nobody["_reset"] = torch.zeros(3, 1, dtype=torch.bool)
    assert same(env.reset(nobody), after)
    env.close()


def test_equal_seeds_give_equal_bits_and_each_world_its_own():
    env, other = (DroneTensorEnv("converge", 2, **BREAK) for _ in range(2))
    first = flown(env, 70)
    assert first["next", "done"].any()
    assert same(first, flown(other, 70))
    assert same(first, flown(env, 70))
    assert not same(first, flown(env, 70, seed=5))
    # World 1 from seed 0 starts as world 0 from seed 1.
    starts = [flown(env, 1, seed)["drones", "observation"] for seed in (0, 1)]
    assert torch.equal(starts[0][1], starts[1][0])
    # A world that was left out of the first reset has its seed still.
    env.set_seed(0)
    masked = env.reset()
    env.set_seed(0)
    for mask in ([[True], [False]], [[False], [True]]):
        masked["_reset"] = torch.tensor(mask)
        masked = env.reset(masked)
    assert torch.equal(masked["drones", "observation"], starts[0][:, 0])
    env.set_seed(None)
    with pytest.raises(ValueError, match="seed is -1"):
        env.set_seed(-1)
    env.close()
    other.close()


def test_tensors_belong_to_the_caller():
    env, other = (DroneTensorEnv("converge", 2, **BREAK) for _ in range(2))
    expected = flown(env, 70)
    torch.manual_seed(1)
    other.set_seed(0)
    now, steps = other.reset(), []
    for _ in range(70):
        step, now = other.step_and_maybe_reset(other.rand_action(now))
        steps.append(step.clone())
        for key in step["next"].keys(True, True):
            step["next"][key].fill_(1)
        now = other.reset(now.set("_reset", torch.zeros(2, 1, dtype=torch.bool)))
    kept = ("terminated", "truncated", "done", "mask")
    told = torch.stack(steps, dim=1)["next", "drones"]
    assert all(torch.equal(told[name], expected["next", "drones", name]) for name in kept)
    env.close()
    other.close()


def test_workers_and_copies_fly_the_same():
    env = DroneTensorEnv("converge", 2, **SHORT)
    expected = flown(env, 8)
    copy = pickle.loads(pickle.dumps(env))
    assert same(flown(copy, 8), expected)
    copy.close()
    spread = DroneTensorEnv("converge", 2, workers=2, start_method="fork", **SHORT)
    assert same(flown(spread, 8), expected)
    spread.close()
    env.close()


def test_torchrls_wrapper_of_the_pettingzoo_environment_tells_the_same():
    env = DroneTensorEnv("converge", 1, return_state=True, **BREAK)
    with pytest.warns(UserWarning, match="PettingZoo in TorchRL is tested"):
        wrapper = PettingZooWrapper(
            bulletuav.parallel_env("converge", **BREAK),
            group_map=env.group_map,
            use_mask=True,
            done_on_any=False,
            return_state=True,
            seed=3,
        )
    check_env_specs(wrapper)
    wrapper.set_seed(3)  # resets at once
    env.set_seed(3)
    env.reset()
    native = env.rollout(60)[0]
    actions = iter(native["drones", "action"])

    def repeat(tensordict):
        return tensordict.set(("drones", "action"), next(actions))

    wrapped = wrapper.rollout(60, repeat)
    assert len(wrapped) == len(native)
    flew = native["drones", "mask"]
    assert not flew.all()
    assert torch.equal(flew, wrapped["drones", "mask"])
    for key in ("observation", "reward", "done", "terminated", "truncated"):
        one, other = native["next", "drones", key], wrapped["next", "drones", key]
        assert torch.equal(one[flew], other[flew]), key
    assert torch.equal(native["next", "state"], wrapped["next", "state"])
    assert torch.equal(native["next", "done"], wrapped["next", "done"])
    wrapper.close()
    env.close()


def test_in_a_mixed_swarm_a_group_has_the_numbers_of_its_widest_drone():
    together = DroneTensorEnv("free_flight", 2, **MIXED)
    check_env_specs(together)
    space = together.full_action_spec_unbatched["drones", "action"].space
    assert space.low.shape == (3, 6)
    assert (space.low < space.high).all()  # policies divide by the difference
    groups = {"big": ["drone_0"], "small": ["drone_2", "drone_1"]}
    apart = DroneTensorEnv("free_flight", 2, group_map=groups, **MIXED)
    check_env_specs(apart)
    assert apart.full_action_spec["small", "action"].shape == (2, 2, 4)
    flight = flown(together, 4)
    apart.set_seed(0)
    now = apart.reset()
    for t in range(4):
        given = flight["drones", "action"][:, t]
        now["big", "action"], now["small", "action"] = given[:, :1], given[:, [2, 1], :4]
        step, now = apart.step_and_maybe_reset(now)
        told = flight["next", "drones"][:, t]
        for key in ("observation", "reward"):
            assert torch.equal(step["next", "big", key], told[key][:, :1])
            assert torch.equal(step["next", "small", key], told[key][:, [2, 1]])
    together.close()
    apart.close()


@pytest.mark.parametrize("workers", [1, 2])
def test_groups_have_the_numbers_that_their_team_observes(workers):
    options = {"num_drones": 4, "dynamics": "point_mass", "horizon": 5, "workers": workers}
    mixed = {"chasers": ["velocity", "room"], "evaders": ["velocity"]}
    env = DroneTensorEnv("pursuit_evasion", 2, observation=mixed, **options)
    check_env_specs(env)
    flight = flown(env, 4)
    assert flight["chasers", "observation"].shape == (2, 4, 3, 9)
    assert flight["evaders", "observation"].shape == (2, 4, 1, 3)
    # One group has the numbers of its widest drone
    joined = DroneTensorEnv(
        "pursuit_evasion", 2, observation=mixed, group_map="ALL_IN_ONE_GROUP", **options
    )
    check_env_specs(joined)
    joined.set_seed(0)
    seen = joined.reset()["agents", "observation"]
    assert seen.shape == (2, 4, 9)
    assert torch.equal(seen[:, :3], flight["chasers", "observation"][:, 0])
    assert torch.equal(seen[:, 3:, :3], flight["evaders", "observation"][:, 0])
    assert not seen[:, 3, 3:].any()
    env.close()
    joined.close()


def test_groups_are_teams_or_what_one_asks_for():
    env = DroneTensorEnv("crossing", 1, group_map="ALL_IN_ONE_GROUP", **SHORT)
    assert env.group_map == {"agents": ["drone_0", "drone_1", "drone_2"]}
    assert env.n_agents == 3
    check_env_specs(env)
    env.close()
    with pytest.raises(ValueError, match="did you mean 'ALL_IN_ONE_GROUP'"):
        DroneTensorEnv("crossing", 1, group_map="ALL_IN_ONE", **SHORT)
    with pytest.raises(ValueError, match="drone_1"):
        DroneTensorEnv("crossing", 1, group_map={"a": ["drone_0"]}, **SHORT)


def test_discrete_actions_are_numbers_or_one_hot():
    options = {**SHORT, "action": "discrete"}
    numbers = DroneTensorEnv("converge", 2, **options)
    hot = DroneTensorEnv("converge", 2, categorical_actions=False, **options)
    flight = flown(numbers, 5)
    chosen = flight["drones", "action"]
    assert chosen.shape == (2, 5, 3)
    hot.set_seed(0)
    encoded = torch.nn.functional.one_hot(chosen, 7).bool().unbind(1)
    actions = iter(encoded)
    other = hot.rollout(5, lambda tensordict: tensordict.set(("drones", "action"), next(actions)))
    assert torch.equal(
        other["next", "drones", "observation"], flight["next", "drones", "observation"]
    )
    numbers.close()
    hot.close()


@pytest.mark.parametrize("options", [{}, MIXED | {"task": "free_flight"}], ids=["equal", "mixed"])
def test_random_actions_are_those_of_the_spec(options):
    options = {"task": "crossing", **SHORT, **options}
    env = DroneTensorEnv(options.pop("task"), 2, **options)
    for data in (None, env.reset()):
        torch.manual_seed(3)
        drawn = env.rand_action(data)
        torch.manual_seed(3)
        expected = EnvBase.rand_action(env, None if data is None else env.reset())
        assert drawn.batch_size == expected.batch_size
        assert all(torch.equal(drawn[key], expected[key]) for key in env.action_keys)
    # Transforms may change the actions
    turned = TransformedEnv(env, ActionDiscretizer(3, action_key=env.action_keys[0]))
    turned.rand_action(turned.reset())
    env.close()


def set_spec(env, key):
    env.full_action_spec = halve(env.full_action_spec.clone(), key)


def set_leaf(env, key):
    env.set_spec_lock_(False)
    env.full_action_spec[key] = halve(env.full_action_spec.clone(), key)[key]


def set_bounds(env, key):
    halve(env.full_action_spec, key)


def halve(spec, key):
    """Raise the lower bounds of actions from -1 to 0."""
    space = spec[key].space
    space.low = torch.zeros_like(space.low)
    return spec


@pytest.mark.parametrize("change", [set_spec, set_leaf, set_bounds])
def test_random_actions_follow_changes_of_the_spec(change):
    env = DroneTensorEnv("crossing", 2, **SHORT)
    key = env.action_keys[0]
    assert (env.rand_action()[key] < 0).any()
    change(env, key)
    assert all((env.rand_action()[key] >= 0).all() for _ in range(5))
    env.close()


def test_random_actions_are_on_the_present_device():
    env = DroneTensorEnv("crossing", 2, **SHORT)
    assert env.rand_action().device is None
    env.to("cpu")
    assert env.rand_action().device == torch.device("cpu")
    data, _ = env.step_and_maybe_reset(env.rand_action(env.reset()))
    assert data.device == torch.device("cpu")
    env.close()


@pytest.mark.parametrize("options", [{}, {"observation_format": "dict", "infos": ("success",)}])
def test_steps_of_rollouts_are_those_of_torchrl(options):
    """Entries of a policy stay until it replaces them, as in TorchRL's own function."""
    flown = []
    for step in (DroneTensorEnv.step_and_maybe_reset, EnvBase.step_and_maybe_reset):
        env = DroneTensorEnv("converge", 2, **BREAK | options)
        torch.manual_seed(1)
        env.set_seed(0)
        data, steps = env.reset(), []
        data["drones", "memory"], data["count"] = torch.zeros(2, 3, 4), torch.zeros(2)
        data["own"] = TensorDict({"number": torch.ones(2)}, [2])
        for _ in range(70):
            done, after = step(env, env.rand_action(data))
            steps.append(done.clone())
            after["own"]["number"] += 1  # in place, and in the step before, too
            after["own"]["further"] = torch.zeros(2)
            assert set(done["own"].keys()) == {"number"}
            data = after.exclude(("own", "further"))
        flown.append(torch.stack(steps, 1))
        env.close()
    assert flown[0]["next", "done"].any()
    assert same(*flown)
    # And their values are those of the batched environment
    options = {name: value for name, value in options.items() if name != "infos"}
    batch = bulletuav.batch_env("converge", 2, autoreset_mode="Disabled", **BREAK | options)
    seen, _ = batch.reset(seed=0)
    for now in flown[0].unbind(1):
        alive = batch.alive
        np.testing.assert_array_equal(now["drones", "mask"], alive)
        assert_observed(now["drones", "observation"], seen, alive)
        seen, rewards, _, _, info = batch.step(now["drones", "action"].numpy())
        assert_observed(now["next", "drones", "observation"], seen, alive)
        reward = now["next", "drones", "reward"][..., 0]
        np.testing.assert_array_equal(reward, rewards.astype(np.float32))
        np.testing.assert_array_equal(now["next", "drones", "done"][..., 0], ~batch.alive)
        if ("next", "drones", "info", "success") in now.keys(True):
            success = now["next", "drones", "info", "success"][..., 0]
            np.testing.assert_array_equal(success, info["success"] * alive)
        if batch.ended.any():
            seen, _ = batch.reset(options={"reset_mask": batch.ended})
    batch.close()


def assert_observed(tensors, arrays, alive):
    """Check that active drones' tensors are the arrays of the batched environment."""
    pairs = [(tensors[key], arrays[key]) for key in arrays] if isinstance(arrays, dict) else None
    for tensor, array in pairs or [(tensors, arrays)]:
        np.testing.assert_array_equal(tensor[alive], array[alive])


def test_a_batch_of_another_size_raises_before_the_step():
    env = DroneTensorEnv("converge", 4, **BREAK)
    env.set_seed(0)
    data = env.rand_action(env.reset())
    before = env.batch.state()
    with pytest.raises(RuntimeError, match=r"got torch.Size\(\[1\]\) and torch.Size\(\[4\]\)"):
        env.step_and_maybe_reset(data[:1].clone())
    np.testing.assert_array_equal(env.batch.state(), before)
    env.close()


def test_hooks_of_subclasses_change_the_next_decision():
    class Hooked(DroneTensorEnv):
        def _post_step_mdp_hooks(self, done, after):
            return done, after.set("hooked", torch.ones(self.batch_size))

    env = Hooked("converge", 2, **BREAK)
    _, after = env.step_and_maybe_reset(env.rand_action(env.reset()))
    assert after["hooked"].all()
    env.close()


def test_types_are_checked_if_asked_for():
    env = DroneTensorEnv("converge", 2, **BREAK)
    spec = env.full_reward_spec.clone()
    spec["drones", "reward"] = spec["drones", "reward"].to(torch.float64)
    env.full_reward_spec = spec
    env.step_and_maybe_reset(env.rand_action(env.reset()))
    env.run_type_checks = True
    for step in (env.step, env.step_and_maybe_reset):
        with pytest.raises(TypeError, match=r"expected reward\.dtype"):
            step(env.rand_action(env.reset()))
    env.close()


def test_names_of_dimensions_are_those_of_torchrl():
    kept = []
    for step in (DroneTensorEnv.step_and_maybe_reset, EnvBase.step_and_maybe_reset):
        env = DroneTensorEnv("converge", 2, **BREAK)
        data = env.rand_action(env.reset())
        data.names = ["world"]
        done, after = step(env, data)
        kept.append([one.names for one in (done, done["next"], after, after["drones"])])
        env.close()
    assert kept[0] == kept[1]
    assert kept[0][2] == ["world"]


def test_rollouts_break_at_the_first_or_the_last_end():
    env = DroneTensorEnv("converge", 2, **BREAK)
    env.set_seed(0)
    first = env.rollout(100)
    assert first["next", "done"][:, -1].any()
    assert not first["next", "done"][:, :-1].any()
    env.set_seed(0)
    last = env.rollout(100, break_when_all_done=True, break_when_any_done=False)
    assert last["next", "done"][:, -1].all()
    held = env.rand_action(env.reset())
    held["_step"] = torch.tensor([[True], [False]])
    with pytest.raises(NotImplementedError, match="all of the 2 worlds are stepped together"):
        env.step(held)
    env.close()


def test_places_can_be_given_to_a_reset():
    env = DroneTensorEnv("converge", 1, **SHORT)
    start = np.array([[0.0, 0.0, 20.0], [30.0, 0.0, 20.0], [0.0, 30.0, 20.0]])
    env.reset(start=start)
    np.testing.assert_array_equal(env.batch.aviary.swarm.position[0], start)
    env.close()


def test_pictures_and_close():
    env = DroneTensorEnv("converge", 2, render_mode="rgb_array", render_size=(16, 12), **SHORT)
    env.reset()
    assert env.render(1).shape == (12, 16, 3)
    assert repr(env) == "DroneTensorEnv('converge', 2 worlds)"
    env.close()
    env.close()
    assert env.is_closed
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="unknown task 'crosing'"):
        DroneTensorEnv("crosing", 1)
    with pytest.raises(ValueError, match="num_worlds is 0"):
        DroneTensorEnv("hover", 0)
    with pytest.raises(ValueError, match="did you mean 'dynamics'"):
        DroneTensorEnv("hover", 1, dynamic="bullet")
    env = DroneTensorEnv("converge", 1, infos=("sucess",), **SHORT)
    with pytest.raises(ValueError, match="unknown info 'sucess': did you mean 'success'"):
        env.reset()
    env.close()


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.delitem(sys.modules, "bulletuav.adapters.torchrl")
    monkeypatch.setitem(sys.modules, "torchrl.data", None)
    with pytest.raises(ImportError, match=r"constraints/torchrl\.txt .*\[torchrl\]'"):
        importlib.import_module("bulletuav.adapters.torchrl")


def test_random_actions_respect_the_masks():
    """Without masks, random flight leaves this small arena."""
    small = {"num_drones": 3, "difficulty": "easy", "radius": 20.0, "margin": 10.0, "horizon": 300}
    options = {"action": "discrete", "action_masks": True, "dynamics": "single_integrator"}
    env = DroneTensorEnv("converge", 2, **small, **options)
    env.set_seed(0)
    torch.manual_seed(0)
    flight = env.rollout(200, break_when_any_done=False, auto_reset=True)
    masks, actions = flight["drones", "action_mask"], flight["drones", "action"]
    assert masks.dtype == torch.bool
    assert masks.shape == (2, 200, 3, 7)
    assert not masks.all()
    assert masks.gather(-1, actions[..., None]).all()
    alive = flight["next", "drones", "mask"]
    assert not (masks[~flight["drones", "mask"]][:, 1:]).any()
    assert alive[:, 150].any()
    env.close()
