"""Training of one policy for all quadrotors: its teachers, its network, and its runs."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy.linalg import expm, solve_discrete_are

from bulletuav.adapters.slots import DroneSlots
from bulletuav.policies.neural_network import read_weights
from bulletuav.policies.recurrent import RecurrentNetwork
from bulletuav.policies.rotor_axes import TURNS, find_rotor_axes
from bulletuav.policies.run import FOUNDATION, RunConfig
from bulletuav.training.foundation.airframes import draw_airframe
from bulletuav.training.foundation.gru import (
    GruSizes,
    add_gru_gradient,
    count_gru,
    gru_arrays,
    make_changes,
    make_steps,
    run_gru,
)
from bulletuav.training.foundation.learner import AirframeSlots, Student
from bulletuav.training.foundation.teacher import (
    REACH,
    STATE_COSTS,
    command_teachers,
    linear_model,
    teacher_gains,
)
from bulletuav.training.schedules import default_run
from bulletuav.training.segments import make_slots
from bulletuav.training.store import Store
from bulletuav.training.trainer import check_algorithm, train
from bulletuav.vehicle.airframes import load_airframe

MODEL = {"airframes": 5, "hidden_size": 6, "buffer_size": 20, "gradient_steps": 2}


def config(**changes):
    run = default_run("hover", FOUNDATION)
    usual = {
        "steps": 600,
        "worlds": 2,
        "options": {**run.options, "horizon": 30},
        "model": MODEL,
        "evaluations": 2,
        "episodes": 1,
        "evaluation": {"difficulty": "easy", "horizon": 5, "airframe": ["cf2p", "racer"]},
    }
    return dataclasses.replace(run, **{**usual, **changes})


def drawn(count, seed=3):
    rng = np.random.default_rng(seed)
    return [draw_airframe(rng) for _ in range(count)]


# --- Airframes


def test_drawn_airframes_are_quadrotors_of_all_sizes_in_the_common_order():
    airframes = drawn(300)
    for one in airframes:
        one.require_physical()
        assert find_rotor_axes(one) == (0.0, (0, 1, 2, 3))
        assert tuple(turn for *_, turn in one.rotors) == TURNS
        # A flat body has at most the sum of the others
        assert one.inertia[2] <= one.inertia[0] + one.inertia[1]
    masses = [one.mass for one in airframes]
    assert min(masses) < 0.03
    assert max(masses) > 2.0
    assert drawn(2) == airframes[:2]
    assert drawn(2, seed=4) != airframes[:2]


# --- Teachers


def test_the_model_is_the_motion_of_the_airframe():
    airframe = load_airframe("racer")
    moving, acting = linear_model(airframe)
    # All rotors at most thrust lift by thrust to weight times gravity
    rotors = moving[5, 11:] @ np.ones(4)
    assert rotors == pytest.approx(airframe.max_thrust / airframe.mass)
    # The right rotors alone roll to the left, by thrust times arm over inertia
    thrust, (inertia, _, _) = airframe.max_thrust / 4, airframe.inertia
    assert moving[8, 11:] @ [1, 1, 0, 0] == pytest.approx(-2 * 0.0675 * thrust / inertia)
    assert moving[10, 11] == pytest.approx(-0.01 * thrust / 0.005)
    # Steady thrusts are half of the change of the action
    steady = -np.linalg.solve(moving[11:, 11:], acting[11:])
    np.testing.assert_allclose(steady, 0.5 * np.eye(4), atol=1e-12)


@pytest.mark.parametrize("airframe", [*drawn(5), load_airframe("cf2x"), load_airframe("racer")])
def test_gains_are_those_of_another_solver(airframe):
    moving, acting = linear_model(airframe)
    both = expm(np.block([[moving, acting], [np.zeros((4, 19))]]) / 30)
    a, b = both[:15, :15], both[:15, 15:]
    cost = solve_discrete_are(a, b, np.diag(STATE_COSTS) + 1e-10 * np.eye(15), np.eye(4))
    expected = np.linalg.solve(np.eye(4) + b.T @ cost @ b, b.T @ cost @ a)
    np.testing.assert_allclose(teacher_gains(airframe, 30), expected, atol=1e-6)
    assert np.abs(np.linalg.eigvals(a - b @ expected)).max() < 1.0


def test_teachers_command_their_gains_within_bounds_and_reach():
    gains = np.random.default_rng(0).normal(0, 0.05, (2, 4, 15))
    seen = np.random.default_rng(1).normal(0, 0.5, (6, 16)).astype(np.float32)
    seen[0, 0], seen[1, 3] = 50.0, -400.0
    speeds = np.random.default_rng(2).uniform(100, 200, (3, 2, 4))
    most, hover = np.array([300.0, 250.0]), np.array([0.3, 0.5])
    actions = np.zeros((6, 4), np.float32)
    command_teachers(seen, speeds, most, hover, gains, actions)
    for row in range(6):
        i = row % 2
        state = np.concatenate(
            [
                -np.clip(seen[row, :3], -REACH, REACH),
                seen[row, 3:6],
                -seen[row, 6:8],
                seen[row, 9:12],
                (speeds[row // 2, i] / most[i]) ** 2 - hover[i],
            ]
        )
        expected = np.clip(2 * hover[i] - 1 - gains[i] @ state, -1, 1)
        np.testing.assert_allclose(actions[row], expected, atol=1e-6)
    assert np.abs(actions).max() == 1.0


def test_teachers_succeed_on_drawn_airframes():
    airframes = drawn(20)
    gains = np.array([teacher_gains(one, 30) for one in airframes])
    most = np.array([one.max_rotor_speed for one in airframes])
    hover = np.array([(one.hover_speed() / one.max_rotor_speed) ** 2 for one in airframes])
    options = default_run("hover", FOUNDATION).options
    env = DroneSlots("hover", 1, **options, airframe=airframes)
    env.seed(7)
    seen, actions, found = env.reset(), np.zeros((20, 4), np.float32), []
    for _ in range(240):
        command_teachers(seen, env.aviary.swarm.rotor_speed, most, hover, gains, actions)
        env.step_async(actions)
        seen, _, _, infos = env.step_wait()
        found += [info["is_success"] for info in infos if "is_success" in info]
    assert np.mean(found) >= 0.95
    env.close()


# --- The network


def network(seed=0):
    sizes = GruSizes(16, 6, 4)
    rng = np.random.default_rng(seed)
    parameters = rng.normal(0, 0.4, count_gru(sizes)).astype(np.float32)
    return sizes, parameters


def as_torch(parameters, sizes):
    """Return the parameters as tensors in double precision, and a function of the outputs."""
    tensors = {
        name: torch.tensor(array.astype(float), requires_grad=True)
        for name, array in gru_arrays(parameters, sizes).items()
    }

    def outputs(rows):
        encoded = torch.tanh(rows @ tensors["encoder.weight"].T + tensors["encoder.bias"])
        own = [
            tensors[f"gru.{name}_l0"] for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        ]
        start = torch.zeros(1, len(rows), sizes.hidden, dtype=torch.float64)
        states, _ = torch._VF.gru(encoded, start, own, True, 1, 0.0, False, False, True)
        return states @ tensors["decoder.weight"].T + tensors["decoder.bias"]

    return tensors, outputs


def test_gradients_of_sequences_are_those_of_pytorch():
    sizes, parameters = network()
    rng = np.random.default_rng(1)
    rows = rng.normal(0, 1, (70, 9, 16)).astype(np.float32)
    labels = rng.normal(0, 1, (70, 9, 4)).astype(np.float32)
    lengths, chosen = rng.integers(1, 10, 70), rng.integers(70, size=128)
    gradient = np.zeros_like(parameters)
    steps, changes = make_steps(sizes, 9), make_changes(sizes)
    loss = add_gru_gradient(
        parameters, gradient, sizes, steps, changes, rows, labels, lengths, chosen
    )
    tensors, outputs = as_torch(parameters, sizes)
    error = outputs(torch.tensor(rows[chosen]).double()) - torch.tensor(labels[chosen])
    flown = torch.tensor(np.arange(9) < lengths[chosen][:, None])
    exact = (error**2)[flown].mean()
    exact.backward()
    assert loss == pytest.approx(exact.item(), rel=1e-5)
    for name, array in gru_arrays(gradient, sizes).items():
        expected = tensors[name].grad.numpy()
        np.testing.assert_allclose(array, expected, atol=2e-6, rtol=2e-4)


def test_single_steps_are_those_of_the_policy():
    sizes, parameters = network()
    weights = {name: one.copy() for name, one in gru_arrays(parameters, sizes).items()}
    one = np.ones(4, np.float32)
    bounds = {"action.low": -one, "action.high": one}
    inputs = {"input.limit": np.full(16, 9.0), "input.scale": np.ones(16)}
    policy = RecurrentNetwork({**weights, **bounds, **inputs})
    rng, steps = np.random.default_rng(2), make_steps(sizes, 1)
    hidden, outputs = np.zeros((70, 6), np.float32), np.zeros((70, 4), np.float32)
    kept = np.zeros((70, 6))
    for _ in range(5):
        rows = rng.normal(0, 1, (70, 16)).astype(np.float32)
        run_gru(parameters, sizes, steps, rows, hidden, outputs)
        actions, kept = policy.step(rows, kept)
        np.testing.assert_allclose(np.clip(outputs, -1, 1), actions, atol=1e-5)
        np.testing.assert_allclose(hidden, kept, atol=1e-5)


# --- Runs


def test_a_rollout_has_whole_episodes_of_new_airframes_with_labels():
    run = config(steps=10**6)
    student = Student(run, make_slots(run, AirframeSlots))
    student.begin_segment(1)
    names = []
    for _ in range(3):
        student.collect()
        names.append(student._env.aviary.options.airframe[0].mass)
    assert len(set(names)) == 3
    assert student.num_steps == 3 * 30 * 10
    # 20 episodes are kept: those of the second rollout, and of the third in place of the first
    assert student._filled == 20
    assert student._next == 10
    assert (student._lengths > 5).all()
    assert np.abs(student._labels[:, 0]).max() <= 1.0
    # In the first decisions, teachers fly all drones, whose last actions are observed
    np.testing.assert_allclose(student._rows[:, 1, 12:], student._labels[:, 0], atol=1e-6)


def test_rotors_of_spinning_drones_stop():
    run = config(steps=1000, options={**config().options, "horizon": 60})
    student = Student(run, make_slots(run, AirframeSlots))
    student.begin_segment(1)
    # No teacher flies, and two opposite rotors turn each drone about its z axis
    student.num_steps = 1000
    student.parameters[:] = 0.0
    gru_arrays(student.parameters, student.sizes)["decoder.bias"][:] = (1, -1, 1, -1)
    student.collect()
    last = student._rows[:10, 2:, 12:]
    spins = np.isclose(last, (1, -1, 1, -1)).all(axis=-1)
    stops = (last == -1.0).all(axis=-1)
    assert spins[:, 0].all()
    assert stops.any()
    flown = np.arange(2, 60) < student._lengths[:10, None]
    assert (spins | stops)[flown].all()


def weights(folder):
    found = read_weights(folder / "policy.safetensors")
    return np.concatenate([found[name].ravel() for name in sorted(found)])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    return folder, train(config(), folder)


def test_a_run_has_the_files_and_columns_of_the_others(run):
    folder, rows = run
    assert [row["steps"] for row in rows] == [0, 300, 600]
    assert "train/loss" in (folder / "updates.csv").read_text()
    assert "torch" not in (folder / "run.yaml").read_text()
    assert len(list(folder.glob("checkpoints/*/training.safetensors"))) == 1
    assert RunConfig.read(folder / "run.yaml").plain() == config().plain()


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(run, tmp_path):
    train(config(), tmp_path / "again")
    np.testing.assert_array_equal(weights(tmp_path / "again"), weights(run[0]))
    train(config(seed=1), tmp_path / "other")
    assert not np.array_equal(weights(tmp_path / "other"), weights(run[0]))


def test_an_interrupted_run_goes_on_to_the_weights_of_one_that_was_not(run, tmp_path):
    def progress(done):
        if done > 400:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config(), tmp_path, progress)
    assert len(Store(tmp_path, config()).rows) == 2
    train(config(), tmp_path)
    np.testing.assert_array_equal(weights(tmp_path), weights(run[0]))


def test_a_damaged_checkpoint_is_refused(run, tmp_path):
    student = Student(config(), make_slots(config(), AirframeSlots))
    with pytest.raises(ValueError, match="holds no checkpoint of this run"):
        student.restore(tmp_path)
    other = config(model={**MODEL, "hidden_size": 7})
    with pytest.raises(ValueError, match="parameters have another size"):
        Student(other, make_slots(other, AirframeSlots)).restore(max(run[0].glob("checkpoints/*")))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"model": {"airframe": 3}}, "foundation has no setting 'airframe': did you mean"),
        ({"model": {"batch_size": 65}}, "batch_size is 65: a multiple of 64 is needed"),
        ({"model": {"hidden_size": 0}}, "hidden_size is 0"),
        ({"model": {"learning_rate": -1.0}}, "learning_rate is -1"),
        ({"shared_reward": True}, "shared_reward is True, and foundation has no use for it"),
        ({"staggered": True}, "staggered is True"),
        (
            {"stages": [{"num_drones": 3}], "evaluation": {"num_drones": 1}},
            "num_drones is 3, and foundation draws airframes",
        ),
        ({"stages": [{}, {"horizon": 40}]}, "horizon is 40 in a stage, and all episodes of"),
        ({"stages": [{"decision_hz": 60}]}, "decision_hz is 60 in a stage"),
    ],
)
def test_settings_that_cannot_be_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        check_algorithm(config(**changes))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"airframe": "racer"}, "airframe is 'racer', and foundation draws airframes"),
        ({"action": "rates"}, "action is 'rates', and foundation commands rotors"),
        ({"observation": ["goal"]}, "observation is .*, and foundation needs"),
        ({"normalise": True}, "normalise is True, and foundation observes"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, said):
    usual = config().options
    with pytest.raises(ValueError, match=said):
        check_algorithm(config(options={**usual, **options}))


def test_other_tasks_are_refused():
    with pytest.raises(ValueError, match="foundation learns task 'hover', not 'crossing'"):
        default_run("crossing", FOUNDATION)
