import sys

import numpy as np
import pytest

import bulletuav
from bulletuav import registry
from bulletuav.cli import main
from bulletuav.policies import Policy, find_policy, policy_names
from bulletuav.policies.orca import Orca

CALM = {"dynamics": "point_mass", "randomization": {}, "num_drones": 3}


def fly(aviary, policy, seeds=0):
    observations = aviary.reset(seeds=seeds)
    policy.reset(np.ones(aviary.num_worlds, dtype=bool))
    actions = []
    while aviary.alive.any():
        actions.append(policy.act(observations, aviary.swarm))
        observations = aviary.step(actions[-1]).observations
    return np.array(actions)


def test_random_actions_follow_from_the_seed_and_fill_the_bounds():
    for action in ("velocity", "rpm", "discrete_27"):
        dynamics = "rigid_body" if action == "rpm" else "point_mass"
        aviary = bulletuav.Aviary(
            "converge", 2, action=action, horizon=60, **CALM | {"dynamics": dynamics}
        )
        policy = find_policy("random")(aviary)
        first = fly(aviary, policy, [3, 4])
        np.testing.assert_array_equal(fly(aviary, policy, [3, 4])[:5], first[:5])
        other = fly(aviary, policy, [4, 4])[:5]
        np.testing.assert_array_equal(other[:, 0], other[:, 1])
        np.testing.assert_array_equal(other[:, 1], first[:5, 1])
        low, high = aviary.action.low, aviary.action.high
        assert ((first >= low) & (first <= high)).all()
        assert first[..., 0].min() < low.min() + 0.1 * np.ptp([low.min(), high.max()])
        assert first[..., 0].max() > high.max() - 0.1 * np.ptp([low.min(), high.max()])
        aviary.close()


@pytest.mark.parametrize("name", ["straight", "potential", "orca", "mvp", "voronoi"])
def test_increments_lead_where_velocities_do(name):
    for action in ("velocity", "velocity_increment"):
        aviary = bulletuav.Aviary("crossing", action=action, **CALM)
        policy = find_policy(name)(aviary)
        fly(aviary, policy)
        # Straight flights conflict with each other, which is no success
        assert (aviary.first_info()["goal_distance"] <= aviary.task.config.goal_radius).any()
        aviary.close()


def test_every_policy_says_what_it_reads():
    specs = [find_policy(name) for name in registry.names("policy")]
    observed = {f"{name}_observed" for name in ("straight", "orca", "mvp", "voronoi")}
    flocks = {"reynolds", "olfati_saber", "vasarhelyi"}
    shirkers = {"hover", "clump", "scatter", "unseeing", "half"}
    searches = {"at_clue", "from_above", "map", "together", "touch"}
    assert {spec.name for spec in specs if not spec.reads_swarm} == {
        "random",
        "over_roofs",
        "lidar_hop",
        "street_pilot",
        "pad_seeker",
        "pad_blind",
        "carrier",
        *(f"transport_{name}" for name in ("lift", "above", "drag", "drop", "beside", "ram")),
        *flocks,
        *(f"flock_{name}" for name in shirkers),
        "sweep",
        *(f"search_{name}" for name in searches),
        "interceptor",
        "intercept_blind",
        *observed,
    }
    assert find_policy("straight").reads_swarm


def test_policies_are_found_by_their_names():
    known = registry.names("policy")
    assert {"straight", "orca", "planner", "random", "oracle"} <= set(known)
    assert policy_names() == [*known, "trained", "untrained", "foundation"]
    assert find_policy("orca").make is find_policy("bulletuav.policies.orca:Orca").make is Orca
    with pytest.raises(ValueError, match=r"unknown policy 'kmean': did you mean 'kmeans'\?"):
        find_policy("kmean")
    with pytest.raises(ValueError, match="unknown policy 'trainned': did you mean 'trained'"):
        find_policy("trainned")


HIGHER = """
import numpy as np

from bulletuav.policies import Policy


class Higher(Policy):
    name = "higher"
    actions = ("velocity",)
    reads_swarm = True

    def reset(self, mask): ...

    def act(self, observations, swarm):
        return self.encoded(np.full(swarm.position.shape, (0.0, 0.0, 3.0)))


class Unfinished(Policy):
    name = "unfinished"


number = 5
"""


@pytest.fixture
def higher(tmp_path, monkeypatch):
    """The name of a module in the current folder, which is not where Python looks for modules."""
    (tmp_path / "higher_policy.py").write_text(HIGHER)
    monkeypatch.chdir(tmp_path)
    elsewhere = [folder for folder in sys.path if folder not in ("", ".", str(tmp_path))]
    monkeypatch.setattr(sys, "path", elsewhere)
    yield "higher_policy"
    sys.modules.pop("higher_policy", None)


def test_the_command_line_flies_a_policy_of_the_current_folder(higher, tmp_path):
    with pytest.raises(ValueError, match="higher_policy:Higher cannot be imported"):
        find_policy(f"{higher}:Higher")
    short = ["--dynamics", "single_integrator", "--drones", "2", "--horizon", "4"]
    files = ["--animation", "none", "--out", "out"]
    main(["fly", "crossing", "--policy", f"{higher}:Higher", *short, *files])
    assert (tmp_path / "out").is_dir()


def test_policies_of_other_modules_are_found_as_module_and_name(higher, monkeypatch):
    monkeypatch.syspath_prepend(".")
    spec = find_policy(f"{higher}:Higher")
    assert spec.name == "higher"
    assert spec.actions == ("velocity",)
    aviary = bulletuav.Aviary("crossing", **CALM)
    aviary.reset(seeds=0)
    actions = spec(aviary).act(aviary.reset(seeds=0), aviary.swarm)
    assert (actions[..., 2] > 0).all()
    aviary.close()
    for source, said in (
        (f"{higher}:Hihger", "is not there: did you mean 'Higher'"),
        (f"{higher}:Unfinished", "policy Unfinished has no act"),
        (f"{higher}:number", "that is no policy"),
        (f"{higher}:", "unknown algorithm 'higher_policy'"),
        ("nowhere_at_all:Higher", "cannot be imported"),
        ("pppo:model.zip", "did you mean 'ppo'"),
    ):
        with pytest.raises(ValueError, match=said):
            find_policy(source)


def test_registered_policies_are_found_by_their_names(monkeypatch):
    registry.names("policy")
    monkeypatch.setitem(registry._registered, "policy", dict(registry._registered["policy"]))

    @registry.register("policy")
    class Sideways(Policy):
        name = "sideways"
        actions = ()
        reads_swarm = False

        def reset(self, mask): ...
        def act(self, observations, swarm): ...

    registry.register("policy", "no_class")(5)
    assert find_policy("sideways").make is Sideways
    with pytest.raises(ValueError, match="registered as 5: that is no policy"):
        find_policy("no_class")


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Untrained models for one drone's observation, saved."""
    import gymnasium
    import stable_baselines3

    folder = tmp_path_factory.mktemp("models")

    class Alone(gymnasium.Env):
        def __init__(self, action):
            aviary = bulletuav.Aviary("converge", action=action, **CALM)
            self.observation_space = aviary.observer.space()
            self.action_space = bulletuav.batch_env(
                "converge", 1, action=action, **CALM
            ).action_space
            aviary.close()

    for algorithm, action in (("PPO", "velocity"), ("DQN", "discrete")):
        model = getattr(stable_baselines3, algorithm)(
            "MlpPolicy", Alone(action), seed=0, device="cpu"
        )
        model.save(folder / algorithm.lower())
    return folder


@pytest.mark.parametrize(("algorithm", "action"), [("ppo", "velocity"), ("dqn", "discrete")])
def test_a_trained_model_flies_each_drone_by_its_own_observation(models, algorithm, action):
    import stable_baselines3

    path = models / f"{algorithm}.zip"
    aviary = bulletuav.Aviary("converge", 2, action=action, horizon=10, **CALM)
    policy = find_policy(f"{algorithm}:{path}", trust=True)(aviary)
    observations = aviary.reset(seeds=0)
    actions = policy.act(observations, aviary.swarm)
    model = getattr(stable_baselines3, algorithm.upper()).load(path, device="cpu")
    for w in range(2):
        for i in range(3):
            alone, _ = model.predict(observations[w, i], deterministic=True)
            np.testing.assert_allclose(actions[w, i], np.atleast_1d(alone), atol=1e-5)
    fly(aviary, policy)
    aviary.close()


def test_a_trained_model_is_evaluated_like_any_policy(models):
    result = bulletuav.evaluate(
        "converge", f"ppo:{models / 'ppo.zip'}", 3, horizon=10, trust=True, **CALM
    )
    without_ending = bulletuav.evaluate(
        "converge", f"ppo:{models / 'ppo'}", 3, horizon=10, trust=True, **CALM
    )
    for row, same in zip(without_ending.rows, result.rows, strict=True):
        np.testing.assert_array_equal(list(row.values()), list(same.values()))
    assert not result.about["reads_swarm"]
    assert len(result.rows) == 3


def test_a_model_for_other_spaces_is_refused(models):
    for options, said in (
        ({"observation": "goal"}, "was trained for observations"),
        ({"action": "discrete"}, "for actions"),
    ):
        aviary = bulletuav.Aviary("converge", **CALM, **options)
        with pytest.raises(ValueError, match=said):
            find_policy(f"ppo:{models / 'ppo.zip'}", trust=True)(aviary)
        aviary.close()
    with pytest.raises(ValueError, match="is not a model of sac"):
        find_policy(f"sac:{models / 'ppo'}", trust=True)(bulletuav.Aviary("converge", **CALM))
    with pytest.raises(FileNotFoundError, match="no model nowhere.zip"):
        find_policy("ppo:nowhere.zip")


def test_a_missing_extra_is_named(monkeypatch, models):
    for name in ("sb3", "sb3_model"):
        monkeypatch.delitem(sys.modules, f"bulletuav.adapters.{name}", raising=False)
        monkeypatch.delattr(f"bulletuav.adapters.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    aviary = bulletuav.Aviary("converge", **CALM)
    with pytest.raises(ImportError, match=r"\[sb3\]'"):
        find_policy(f"ppo:{models / 'ppo.zip'}", trust=True)(aviary)
    aviary.close()


def test_a_model_that_sees_pictures(tmp_path):
    """Observations that are a dict go to the model as they are."""
    import gymnasium
    import stable_baselines3

    options = CALM | {
        "num_drones": 1,
        "observation": ("goal", "rgb"),
        "camera_size": (36, 36),
        "horizon": 3,
    }
    aviary = bulletuav.Aviary("converge", **options)

    class Alone(gymnasium.Env):
        observation_space, action_space = (
            aviary.observer.space(),
            bulletuav.batch_env("converge", 1, **options).action_space,
        )

    stable_baselines3.PPO("MultiInputPolicy", Alone(), seed=0, device="cpu").save(tmp_path / "eyes")
    policy = find_policy(f"ppo:{tmp_path / 'eyes.zip'}", trust=True)(aviary)
    assert fly(aviary, policy).shape == (3, 1, 1, 3)
    aviary.close()
