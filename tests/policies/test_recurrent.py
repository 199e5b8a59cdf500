"""The policy for all quadrotors: its axes, its memory, its flights, and its exports."""

import dataclasses

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

import bulletuav
from bulletuav.adapters import c_source
from bulletuav.adapters.deployed import deployed
from bulletuav.policies.check import check_policy
from bulletuav.policies.find import find_policy
from bulletuav.policies.recurrent import (
    LABELS,
    AxesOfDrones,
    RecurrentNetwork,
    RecurrentPolicy,
    axes_layers,
)
from bulletuav.policies.rotor_axes import TURNS, RotorAxes, find_rotor_axes
from bulletuav.policies.run import FOUNDATION, SHIPPED
from bulletuav.training.foundation.airframes import draw_airframe
from bulletuav.vehicle.airframes import load_airframe

FOLDER = SHIPPED / FOUNDATION
QUADROTORS = ["cf21B", "cf2p", "cf2x", "cf2x_L250", "hummingbird", "iris", "racer"]


def with_rotors(*rotors):
    return dataclasses.replace(load_airframe("cf2x"), rotors=rotors)


@pytest.mark.parametrize(
    ("name", "yaw", "order"),
    [
        ("cf2x", 0.0, (0, 1, 2, 3)),
        # Rotors on the axes: front, left, back and right, the front one counterclockwise
        ("cf2p", 45.0, (0, 3, 2, 1)),
        # The same places, and the front one clockwise
        ("hummingbird", -45.0, (3, 2, 1, 0)),
        # Front right, back left, front left and back right
        ("iris", 0.0, (0, 3, 1, 2)),
    ],
)
def test_common_axes_have_the_same_rotors_at_the_same_places(name, yaw, order):
    found = find_rotor_axes(load_airframe(name))
    assert np.degrees(found.yaw) == pytest.approx(yaw)
    assert found.order == order


def test_rotors_of_the_other_directions_are_met_by_a_quarter_turn_to_the_left():
    opposite = [(x, y, -turn) for x, y, turn in load_airframe("cf2x").rotors]
    found = find_rotor_axes(with_rotors(*opposite))
    assert np.degrees(found.yaw) == pytest.approx(90.0)
    # The x axis points to the left: the front left rotor is at the front right of these axes
    assert found.order == (3, 0, 1, 2)
    assert tuple(opposite[k][2] for k in found.order) == TURNS


def test_other_airframes_are_refused():
    with pytest.raises(ValueError, match="'firefly' has 6 rotors, and this policy flies 4"):
        find_rotor_axes(load_airframe("firefly"))
    pairs = [(x, y, 1 if x > 0 else -1) for x, y, _ in load_airframe("cf2x").rotors]
    with pytest.raises(ValueError, match="neighbouring rotors of airframe 'cf2x' spin in the same"):
        find_rotor_axes(with_rotors(*pairs))


def test_observations_are_rotated_and_rotors_reordered():
    axes = RotorAxes(np.pi / 2, (3, 0, 1, 2))
    drones = AxesOfDrones.of([find_rotor_axes(load_airframe("cf2x")), axes])
    seen = np.tile(np.arange(1.0, 17.0), (1, 2, 1))
    common = drones.observe(seen)
    np.testing.assert_array_equal(common[0, 0], seen[0, 0])
    # The common x axis is the body's y axis, and the common y axis its negative x axis
    expected = [2, -1, 3, 5, -4, 6, 8, -7, 9, 11, -10, 12, 16, 13, 14, 15]
    np.testing.assert_allclose(common[0, 1], expected, atol=1e-12)
    # Rotor 3 of the airframe is the first of the common order
    actions = drones.command(np.array([[[0.1, 0.2, 0.3, 0.4]] * 2]))
    np.testing.assert_array_equal(actions[0], [[0.1, 0.2, 0.3, 0.4], [0.2, 0.3, 0.4, 0.1]])
    to_common, to_own = axes_layers(axes)
    np.testing.assert_allclose(to_common.weight @ seen[0, 1], expected, atol=1e-12)
    np.testing.assert_array_equal(to_own.weight @ [0.1, 0.2, 0.3, 0.4], [0.2, 0.3, 0.4, 0.1])


def test_steps_are_those_of_pytorch():
    torch = pytest.importorskip("torch")
    weights = load_file(FOLDER / "policy.safetensors")
    network = RecurrentNetwork(weights)
    exact = torch.nn.GRU(network.hidden_size, network.hidden_size).double()
    exact.load_state_dict(
        {
            name.removeprefix("gru."): torch.tensor(array)
            for name, array in weights.items()
            if name.startswith("gru.")
        }
    )
    rows = np.random.default_rng(0).normal(0, 2, (30, 5, 16))
    hidden, own = np.zeros((5, network.hidden_size)), []
    for one in rows:
        actions, hidden = network.step(one, hidden)
        own.append(actions)
    with torch.no_grad():
        limit, scale = weights["input.limit"], weights["input.scale"]
        values = torch.tensor(np.clip(rows, -limit, limit) * scale)
        tensors = {name: torch.tensor(array).double() for name, array in weights.items()}
        encoded = torch.tanh(values @ tensors["encoder.weight"].T + tensors["encoder.bias"])
        states, _ = exact(encoded)
        given = states @ tensors["decoder.weight"].T + tensors["decoder.bias"]
    np.testing.assert_allclose(own, given.clamp(-1, 1).numpy(), atol=1e-10)


def test_steps_depend_on_no_other_row_of_the_batch():
    network = RecurrentNetwork(load_file(FOLDER / "policy.safetensors"))
    rng = np.random.default_rng(0)
    rows, hidden = rng.normal(size=(9, len(LABELS))), rng.normal(size=(9, network.hidden_size))
    all_rows = network.step(rows, hidden)
    each = [network.step(rows[k : k + 1], hidden[k : k + 1]) for k in range(9)]
    for together, alone in zip(all_rows, zip(*each, strict=True), strict=True):
        np.testing.assert_array_equal(together, np.concatenate(alone))


def fly(airframes, worlds, **options):
    spec = find_policy("foundation", "hover")
    options = {"airframe": airframes, "difficulty": "medium", **options}
    aviary = bulletuav.Aviary("hover", worlds, **spec.complete("hover", options))
    policy, observations = spec(aviary), aviary.reset(seeds=7_000_000)
    policy.reset(np.ones(worlds, dtype=bool))
    while aviary.alive.any():
        observations = aviary.step(policy.act(observations, aviary.swarm)).observations
    success = aviary.info_table()()["success"]
    aviary.close()
    return success


@pytest.mark.parametrize("dynamics", ["rigid_body", "bullet"])
def test_one_policy_flies_all_quadrotors_of_the_package(dynamics):
    airframes = [load_airframe(name) for name in QUADROTORS]
    success = fly(airframes, 3, dynamics=dynamics)
    assert success.shape == (3, 7)
    assert success.mean() >= 0.95


def test_it_flies_drawn_airframes_that_it_has_never_seen():
    rng = np.random.default_rng(7_000_000)
    drawn = [draw_airframe(rng) for _ in range(100)]
    assert fly(drawn, 1, dynamics="rigid_body").mean() >= 0.95


def test_it_flies_to_far_goals_and_holds_them():
    far = {"start_offset": 10.0, "height": 15.0, "spacing": 30.0, "max_distance": 40.0}
    options = {**far, "horizon": 900, "min_in_place": 0.5, "dynamics": "rigid_body"}
    airframes = [load_airframe(name) for name in ("hummingbird", "iris", "racer")]
    assert fly(airframes, 2, **options).all()


def test_it_is_reproducible_and_snapshots_hold_its_memory():
    check_policy("foundation", "hover", **find_policy("foundation", "hover").options)


def test_memory_is_cleared_in_the_worlds_that_start_again():
    spec = find_policy("foundation", "hover")
    aviary = bulletuav.Aviary("hover", 2, **spec.options)
    policy, observations = spec(aviary), aviary.reset(seeds=0)
    policy.act(observations, aviary.swarm)
    policy.reset(np.array([True, False]))
    memory = policy.memory()["_hidden"]
    assert not memory[0].any()
    assert memory[1].all()
    aviary.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"airframe": "firefly"}, "has 6 rotors"),
        ({"observation": ["goal", "velocity"]}, "set observation to these"),
        ({"normalise": True}, "leave normalise out"),
    ],
)
def test_other_environments_are_refused(options, said):
    spec = find_policy("foundation", "hover")
    aviary = bulletuav.Aviary("hover", **spec.complete("hover", options))
    with pytest.raises(ValueError, match=said):
        spec(aviary)
    aviary.close()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"gru.bias_hh_l0": None}, "the file lacks gru.bias_hh_l0"),
        ({"decoder.weight": np.zeros((3, 20))}, r"decoder.weight has the shape \(3, 20\)"),
        ({"input.limit": -np.ones(16)}, "input.limit must not be negative"),
    ],
)
def test_other_files_are_refused(change, said, tmp_path):
    arrays = {**load_file(FOLDER / "policy.safetensors"), **change}
    path = tmp_path / "policy.safetensors"
    save_file({name: one for name, one in arrays.items() if one is not None}, path)
    aviary = bulletuav.Aviary("hover", **find_policy("foundation", "hover").options)
    with pytest.raises(ValueError, match=f"is not a recurrent policy: {said}"):
        RecurrentPolicy(aviary, path)
    aviary.close()


def test_observed_numbers_are_those_of_the_blocks():
    aviary = bulletuav.Aviary("hover", **find_policy("foundation", "hover").options)
    assert tuple(label.name for label in aviary.observer.labels) == LABELS
    aviary.close()


@pytest.mark.parametrize("airframe", ["racer", "hummingbird"])
@pytest.mark.skipif(c_source.find_compiler() is None, reason="needs a C compiler")
def test_c_steps_the_hidden_state_as_the_policy_does(airframe, tmp_path):
    policy = deployed(FOLDER, airframe=airframe)
    source, header = c_source.write_c(policy, tmp_path / "pilot.c", "double")
    rows = policy.observations()
    own = policy.act(rows)
    assert np.ptp(own, axis=0).min() > 100.0  # rad/s
    np.testing.assert_allclose(c_source.run_c(source, rows, policy, "double"), own, atol=1e-6)
    assert f"#define PILOT_HIDDEN {policy.memory}" in header.read_text()
    assert f"double hidden[{policy.memory}], double setpoint[4]" in header.read_text()


def test_onnx_steps_the_hidden_state_as_the_policy_does(tmp_path):
    pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    from bulletuav.adapters.onnx import run_onnx, write_onnx

    policy = deployed(FOLDER, airframe="hummingbird")
    (path,) = write_onnx(policy, tmp_path / "pilot.onnx", "double")
    rows = policy.observations()
    given = run_onnx(path, rows, policy, "double")
    np.testing.assert_allclose(given, policy.act(rows), atol=1e-6)


def test_the_exported_policy_acts_as_the_one_that_flies():
    policy = deployed(FOLDER, airframe="cf2p")
    spec = find_policy("foundation", "hover")
    aviary = bulletuav.Aviary("hover", **spec.complete("hover", {"airframe": "cf2p"}))
    pilot, observations = spec(aviary), aviary.reset(seeds=3)
    pilot.reset(np.ones(1, dtype=bool))
    seen, commanded = [], []
    for _ in range(20):
        actions = pilot.act(observations, aviary.swarm)
        seen.append(observations[0, 0])
        commanded.append(aviary.action.decode(actions, aviary.commanded)[0, 0].copy())
        observations = aviary.step(actions).observations
    aviary.close()
    np.testing.assert_allclose(policy.act(np.array(seen)), commanded, atol=1e-6)


def test_an_export_needs_one_airframe():
    with pytest.raises(ValueError, match="flies several airframes, cf21B, .* by --airframe NAME"):
        deployed(FOLDER)
