from typing import ClassVar

import numpy as np
import pytest

import bulletuav
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.tasks.crossing import Crossing
from bulletuav.tasks.parts.city_layouts import open_ground

BAD = [
    ("hover", {"num_drones": 0}, "num_drones is 0"),
    ("hover", {"num_drones": 2.5}, "num_drones is 2.5"),
    ("hover", {"num_drones": None}, "num_drones is None"),
    ("hover", {"horizon": 0}, "horizon is 0"),
    ("hover", {"physics_hz": -240}, "physics_hz is -240"),
    (
        "hover",
        {"decision_hz": 50},
        r"decision_hz 50 does not divide physics_hz 240: try \[40, 48, 60\]",
    ),
    ("hover", {"decision_hz": 480}, "does not divide"),
    ("hover", {"seed": -1}, "seed is -1"),
    ("hover", {"airframe": "cf3x"}, "did you mean 'cf2x'"),
    ("hover", {"airframe": 7}, "airframe is 7"),
    ("hover", {"dynamics": "bulet"}, "did you mean 'bullet'"),
    ("hover", {"action": "rotors"}, "did you mean 'rotor'"),
    ("hover", {"rays": "compild"}, "did you mean 'compiled'"),
    ("hover", {"rays": None}, "unknown rays None"),
    ("hover", {"contacts": "impuls"}, "did you mean 'impulse'"),
    ("hover", {"contacts": "bullet", "dynamics": "rigid_body"}, "contacts.*from impulse, stop"),
    (
        "hover",
        {"contacts": "impulse", "dynamics": "point_mass", "action": "velocity"},
        "contacts 'impulse': choose from stop",
    ),
    ("hover", {"friction": -0.1}, "friction is -0.1"),
    ("hover", {"friction": 10.1}, "friction is 10.1"),
    ("hover", {"restitution": 1.1}, "restitution is 1.1"),
    ("hover", {"restitution": float("nan")}, "restitution is nan"),
    ("hover", {"controller": "lqr"}, "unknown controller 'lqr'"),
    ("hover", {"difficulty": "esy"}, "did you mean 'easy'"),
    ("hover", {"observation": ("attitude", "rate")}, "did you mean 'rates'"),
    ("hover", {"effects": ("drag", "lags")}, "did you mean 'lag'"),
    ("hover", {"render_mode": "rgb"}, "did you mean 'rgb_array'"),
    ("hover", {"render_size": (640,)}, "render_size is .*of 2 values"),
    ("hover", {"render_size": (640, 0)}, "render_size is 0"),
    ("hover", {"max_speed": 50.0}, "max_speed is 50 m/s.*10 m/s of airframe 'cf2x'"),
    ("hover", {"max_speed": float("nan")}, "max_speed is nan"),
    ("hover", {"max_speed": 0}, "max_speed is 0"),
    ("hover", {"max_speed": "fast"}, "max_speed is 'fast'"),
    ("hover", {"wind": (1.0, 2.0)}, "wind is"),
    ("hover", {"wind": (1.0, 2.0, float("inf"))}, "wind is inf"),
    ("hover", {"gravity": -9.8}, "gravity is -9.8"),
    ("hover", {"gravity": 0.0, "action": "velocity"}, "needs gravity"),
    (
        "hover",
        {"controller": "pid", "airframe": "hummingbird", "action": "velocity", "effects": ()},
        "no <pwm> tag",
    ),
    ("hover", {"num_drone": 3}, "did you mean 'num_drones'"),
    ("hover", {"spacing": 0.5, "num_drones": 4}, "may overlap"),
    ("hover", {"spacing": float("nan")}, "spacing is nan"),
    ("hover", {"spacing": -1.0}, "spacing is -1"),
    ("hover", {"height": 0.2}, "touch the ground"),
    ("hover", {"d_safe": 0.0}, "d_safe is 0"),
    ("hover", {"start": ((0, 0, 1),), "num_drones": 2}, "2 finite positions"),
    ("hover", {"start": ((0, 0, 1), (0, 0.05, 1)), "num_drones": 2}, "drones 0 and 1 overlap"),
    ("hover", {"start": ((0, 0, 0.01),)}, "touch the ground"),
    ("hover", {"weights": {"sped": 1.0}}, "did you mean 'speed'"),
    ("crossing", {"lane_spacing": 1.0}, "may be in conflict"),
    ("crossing", {"lane_spacing": 6.0}, "may be in conflict"),
    ("crossing", {"half_length": 20.0}, "too short for formations"),
    ("crossing", {"margin": 0.5}, "must exceed jitter"),
    ("crossing", {"half_length": 3000.0}, "the arena reaches 3030 m"),
    ("crossing", {"start_speed": 5.0}, "start_speed is 5.0: a list or tuple"),
    ("crossing", {"start_speed": ("a", 1.0)}, "start_speed is 'a'"),
    ("crossing", {"lanes": 2.5}, "lanes is 2.5"),
    ("crossing", {"weights": 5}, "weights is 5"),
    ("crossing", {"weights": {"goal": "x"}}, "weight of reward term 'goal' is 'x'"),
    ("hover", {"weights": {"speed": float("nan")}}, "weight of reward term 'speed' is nan"),
    ("hover", {"effects": None}, "effects is None"),
    ("hover", {"wind": 5.0}, "wind is 5.0"),
    ("hover", {"action": [["rotor"]]}, "unknown action"),
    ("hover", {"difficulty": ["easy"]}, "unknown difficulty"),
    ("hover", {"observation": 5}, "observation is 5"),
    ("hover", {"start": (("a", "b", "c"),)}, "1 finite positions"),
    ("hover", {"start": ((300.0, 0.0, 5.0),)}, "inside the arena"),
    ("hover", {"max_distance": 0.5}, "starts may be"),
    ("hover", {"gravity": 30.0}, "lifts at most 22 m/s"),
    ("crossing", {"gravity": 9.7, "airframe": "trainer"}, "which flies on wings, are those at 9.8"),
    ("hover", {"gravity": 3.71, "airframe": "quadplane"}, "gravity is 3.71 m/s.*'quadplane', whic"),
    ("hover", {"gravity": 0.0, "action": "rotor", "airframe": "quadplane"}, "leave gravity out"),
    ("hover", {"height": 1990.0}, "the arena reaches"),
    ("hover", {"num_drones": True}, "num_drones is True"),
    ("hover", {"turbulence": "strong"}, "unknown turbulence"),
    ("hover", {"turbulence": -1.0}, "turbulence is -1"),
    ("hover", {"camera_hz": 7}, "camera_hz 7 does not divide decision_hz 30"),
    ("hover", {"camera_range": (5.0, 5.0)}, r"camera_range is \(5, 5\) m: the nearest depth must"),
    ("hover", {"camera_range": 5.0}, "camera_range is 5.0: a list or tuple"),
    ("hover", {"camera_range": (0, 3000)}, "camera_range is 3000"),
    ("hover", {"camera_depth": "invers"}, "did you mean 'inverse'"),
    ("hover", {"camera_depth": "inverse"}, "needs a nearest depth above 0: set camera_range"),
    ("hover", {"camera_range": (0, 9), "observation": "rgb"}, "no effect without 'depth' or"),
    ("hover", {"camera_depth": "linear"}, "camera_depth has no effect without"),
    ("hover", {"camera_mounts": 5}, "camera_mounts is 5: a list or tuple"),
    ("hover", {"camera_mounts": ()}, "camera_mounts is empty: leave it out"),
    ("hover", {"camera_mounts": ({}, 5)}, "camera_mounts has 5: a dict such as"),
    ("hover", {"camera_mounts": {"pich": 5}}, "did you mean 'pitch'"),
    ("hover", {"camera_mounts": {"pitch": 100}}, "camera_mounts: pitch is 100"),
    ("hover", {"camera_mounts": {"offset": (0, 0)}}, "a list or tuple of 3 values"),
    ("hover", {"camera_mounts": {"stabilized": 1}}, "stabilized is 1: True or False"),
    ("hover", {"camera_mounts": {"pitch": -90}}, "camera_mounts has no effect without 'rgb'"),
    ("hover", {"preset": "hover"}, "did you mean 'hover_aviary'"),
    ("hover", {"airframe": ("cf2x", "iris"), "num_drones": 3}, "2 airframes for 3 drones"),
    (
        "hover",
        {"dynamics": "point_mass", "action": "rotor"},
        "action 'rotor' gives rotor setpoints, but dynamics 'point_mass' is driven by velocity",
    ),
    ("hover", {"dynamics": "double_integrator", "action": "attitude"}, "driven by acceleration"),
    (
        "hover",
        {"dynamics": "point_mass", "action": "velocity", "controller": "pid", "effects": ()},
        "has none: use controller 'lee'",
    ),
    (
        "hover",
        {"action": "rates", "controller": "pid", "effects": ()},
        "supports no rates setpoints",
    ),
    ("follow", {"target": "bird"}, "unknown target"),
    ("follow", {"target_speed": 15.0}, "below max_speed"),
    ("follow", {"distance": 1.0, "target": "drone"}, "too close to the target"),
    ("follow", {"distance": 1.0, "num_drones": 3}, "raise distance, or lower start_offset"),
    ("follow", {"distance": 30.0, "start_offset": 12.0}, "drones could start"),
    ("follow", {"max_distance": 0.5}, "starts may be"),
    ("follow", {"preset": "hover_aviary"}, "task 'follow' has none"),
    ("hover", {"airframe": []}, "empty list"),
    ("hover", {"gravity": 0.0, "action": "hover_rpm"}, "needs gravity"),
    ("crossing", {"altitude": 2.0}, "altitude 2 m is too low"),
    ("crossing", {"lanes": 0}, "lanes is 0"),
    ("crossing", {"start_speed": (10.0, 30.0)}, "start_speed"),
    ("crossing", {"start_speed": (float("nan"), 1.0)}, "start_speed"),
    ("crossing", {"reward": "trainin"}, "unknown reward 'trainin': did you mean 'training'"),
    ("crossing", {"reward": np.zeros(3)}, "reward is .*'benchmark', 'training', or a dict"),
    ("flocking", {"leader": False, "leader_turn": 0.2}, "no effect, as leader is False: leave it"),
    ("pad_landing", {"pad_circle": 2.0}, "pad_circle is 2.0, .* as pad_speed is 0"),
    ("pad_landing", {"pad_period": 2.0, "pad_speed": 0.5}, "no effect, as pad_tilt is 0"),
    ("patrol", {"charging_pads": 0, "pad_power": 100.0}, "no effect, as charging_pads is 0"),
    ("coverage", {"pad_radius": 1.0}, "no effect, as charging_pads is 0"),
    ("coverage", {"city": "hills", "irregularity": 0.5}, "city 'hills' has no generated streets"),
    ("coverage", {"city": {"kind": "forest"}, "irregularity": 0.5}, "no generated streets"),
    ("patrol", {"city": open_ground((99.0, 99.0)), "num_layouts": 2}, "'open' is already complete"),
    ("coverage", {"city": open_ground((99.0, 99.0)), "area": 90.0}, "area .* is already complete"),
    ("search", {"num_drones": 1, "radio_range": 20.0}, "no effect, as num_drones is 1"),
    ("crosing", {}, "unknown task 'crosing': did you mean 'crossing'"),
]


@pytest.mark.parametrize(
    ("task", "options", "said"), BAD, ids=[f"{task}-{options}" for task, options, _ in BAD]
)
def test_what_cannot_be_is_refused_at_construction_with_the_value_and_a_remedy(task, options, said):
    with pytest.raises(ValueError, match=said):
        bulletuav.parallel_env(task, **options)


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("flocking", {"leader": False, "difficulty": "medium"}),
        ("pad_landing", {"difficulty": "medium", "pad_circle": 2.0}),
        ("coverage", {"difficulty": "medium", "city": "hills"}),
        ("search", {"num_drones": 1, "difficulty": "medium"}),
        ("search", {"num_drones": 2, "radio_range": 20.0}),
    ],
)
def test_defaults_and_difficulties_may_set_options_without_effect(task, options):
    EnvSpec(task, 1, options)


def test_missing_and_broken_urdf(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.urdf"):
        bulletuav.parallel_env("hover", airframe=tmp_path / "nowhere.urdf")
    (tmp_path / "broken.urdf").write_text("not xml")
    with pytest.raises(ValueError, match=r"broken\.urdf is not valid XML"):
        bulletuav.parallel_env("hover", airframe=str(tmp_path / "broken.urdf"))


@pytest.mark.parametrize("worlds", [0, 1.5, True])
def test_num_worlds_is_checked(worlds):
    with pytest.raises(ValueError, match=f"num_worlds is {worlds}"):
        bulletuav.Aviary("hover", worlds)


def test_an_unknown_tag_of_an_airframe_is_refused(urdf):
    path = urdf("cf2x", ("<motor_lag", '<motor_lagg value="1"/><motor_lag'))
    with pytest.raises(ValueError, match="did you mean 'motor_lag'"):
        bulletuav.Aviary("hover", airframe=path)


def test_a_drone_must_fit_into_d_safe():
    with pytest.raises(ValueError, match=r"d_safe 0\.5 m must exceed the 0\.551 m"):
        bulletuav.Aviary("hover", airframe="hummingbird", d_safe=0.5)


def test_given_values_go_before_the_difficulty_and_that_before_defaults():
    hard = bulletuav.Aviary("hover", difficulty="hard", height=8.0)
    assert (hard.task.config.height, hard.task.config.start_tilt, hard.options.horizon) == (
        8.0,
        60.0,
        240,
    )
    easy = bulletuav.Aviary("crossing", difficulty="easy")
    assert (
        easy.num_drones,
        bulletuav.Aviary("crossing", difficulty="easy", num_drones=3).num_drones,
    ) == (4, 3)


def test_the_name_of_a_reward_selects_the_weights_of_the_task():
    def weights(**options):
        return EnvSpec("crossing", 1, options).task.weights

    usual, training = weights(), dict(Crossing.training_weights)
    del training["obstacle_warning"]  # `crossing` has no obstacles
    assert weights(reward="benchmark") == usual
    assert weights(reward="training") == {**usual, **training}
    # Weights for training override those of a preset, and given ones override both
    preset = weights(preset="uavconflict")
    mixed = weights(preset="uavconflict", reward="training", weights={"goal": 3.0})
    assert mixed == {**preset, **training, "goal": 3.0}


def test_a_task_without_weights_for_training_trains_with_those_of_the_benchmark():
    class Plain(Crossing):
        name = "plain"
        training_weights: ClassVar = {}

    trained = EnvSpec(Plain, 1, {"reward": "training"}).task.weights
    assert trained == EnvSpec(Plain, 1, {}).task.weights


def test_a_task_that_replaces_reward_terms_inherits_training_weights_of_the_others():
    class Short(Crossing):
        name = "short"
        reward: ClassVar = {"progress": 1.0, "goal": 5.0}

    task = EnvSpec(Short, 1, {"reward": "training"}).task
    assert task.weights["progress"] == Crossing.training_weights["progress"]
    assert set(task.weights) == {*Short.reward, "obstacle_warning"}


def test_a_slow_airframe_lowers_the_default_speed_only(urdf):
    slow = urdf("hummingbird", ('<max_speed value="20"/>', '<max_speed value="6"/>'))
    aviary = bulletuav.Aviary("crossing", airframe=slow, start_speed=(1.0, 5.0))
    assert aviary.options.max_speed == 6
    with pytest.raises(ValueError, match="at most the 6 m/s"):
        bulletuav.Aviary("crossing", airframe=slow, max_speed=7.0)


def test_own_airframe_from_a_path_flies(urdf):
    own = urdf(
        "cf2x",
        ('robot name="cf2x"', 'robot name="mine"'),
        ('<mass value="0.027"/>', '<mass value="0.030"/>'),
    )
    options = {"action": "target_position", "min_in_place": 0.05}
    aviary = bulletuav.Aviary("hover", airframe=own, **options)
    aviary.reset(seeds=0)
    for _ in range(90):
        step = aviary.step(aviary.action.encode(aviary.scene.goal))
    assert aviary.options.airframe[0].name == "mine"
    assert step.info["success"].all()
    aviary.close()


def test_observation_blocks_can_be_chosen():
    aviary = bulletuav.Aviary("crossing", observation=("goal", "attitude"))
    assert aviary.reset(seeds=0).shape == (1, 8, 8)
    assert [label.name for label in aviary.observer.labels][:5] == [
        "goal direction x",
        "goal direction y",
        "goal direction z",
        "goal distance",
        "quaternion x",
    ]
    single = bulletuav.Aviary("crossing", observation="goal")
    assert single.reset(seeds=0).shape == (1, 8, 4)


@pytest.mark.parametrize("effect", ["lag", "drag", "ground_effect", "downwash"])
def test_each_effect_can_be_switched_off_and_matters(effect):
    """Two Crazyflies above each other near the ground, in wind.

    Without any one of the effects the flight differs.
    """
    ends = []
    effects = ("lag", "drag", "ground_effect", "downwash")
    for chosen in (effects, tuple(one for one in effects if one != effect)):
        aviary = bulletuav.Aviary(
            "hover",
            num_drones=2,
            start=((0, 0, 0.1), (0, 0, 0.6)),
            wind=(2.0, 0, 0),
            effects=chosen,
            dynamics="rigid_body",
        )
        aviary.reset(seeds=0)
        aviary.step(np.full((1, 2, 4), -0.1))
        ends.append(aviary.swarm.position.copy())
        aviary.close()
    assert np.abs(ends[0] - ends[1]).max() > 1e-6


def test_gravity_and_wind_can_be_switched_off():
    aviary = bulletuav.Aviary("hover", gravity=0.0, wind=(0.0, 0, 0), effects=("lag", "drag"))
    start = aviary.reset(seeds=0)
    before = aviary.swarm.position.copy()
    aviary.step(np.full((1, 1, 4), -1.0))
    np.testing.assert_array_equal(aviary.swarm.position, before)
    assert start.shape == (1, 1, 13)
    aviary.close()


@pytest.mark.parametrize(
    ("dynamics", "contacts"),
    [(name, "stop") for name in ("single_integrator", "double_integrator", "point_mass")]
    + [("rigid_body", "impulse"), ("bullet", "impulse")],
)
def test_contacts_are_the_first_that_a_dynamics_can_do(dynamics, contacts):
    aviary = bulletuav.Aviary("crossing", dynamics=dynamics)
    assert aviary.options.contacts == contacts
    aviary.close()


@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_surfaces_of_the_ground_are_options(friction):
    """A drone that touches down at 2 m/s and slides at 4 m/s loses sqrt(f * 0.5) times 2 m/s."""
    aviary = bulletuav.Aviary(
        "hover",
        action="rotor",
        dynamics="rigid_body",
        effects=(),
        friction=friction,
        restitution=0.0,
        gravity=0.0,
    )
    aviary.reset(seeds=0)
    aviary.swarm.position[0, 0] = 0, 0, 0.05
    aviary.swarm.quaternion[0, 0] = 0, 0, 0, 1
    aviary.swarm.velocity[0, 0] = 4, 0, -2
    aviary.swarm.rates[:] = aviary.swarm.rotor_speed[:] = 0
    aviary.step(np.full((1, 1, 4), -1.0))
    left = 4 - 2 * np.sqrt(friction * 0.5)
    np.testing.assert_allclose(aviary.swarm.velocity[0, 0], (left, 0, 0), atol=0.01)
    aviary.close()


def test_an_observation_of_nothing_is_refused():
    with pytest.raises(ValueError, match="observation is empty: name at least one block"):
        EnvSpec("crossing", 1, {"observation": ()})


def test_gravity_of_other_places_is_for_multirotors(finned):
    # Within 1 % on Earth: 9.78 at the equator and 9.83 at the poles
    for airframe, gravity in (("trainer", 9.78), ("quadplane", 9.83), (finned, 3.71)):
        sizes = {} if airframe == "trainer" else {"d_safe": 4.0}
        env = bulletuav.parallel_env("crossing", airframe=airframe, gravity=gravity, **sizes)
        env.reset(seed=0)
        env.close()
