"""Policies written for programs of others, compared with those that fly here."""

import numpy as np
import pytest
from safetensors.numpy import save_file

from bulletuav.adapters import c_source
from bulletuav.adapters.c_source import run_c, write_c
from bulletuav.adapters.deployed import AFFINE_ACTIONS, LIMITED_ACTIONS, Deployed, deployed
from bulletuav.cli import main
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.policies.layers import Argmax, Dense
from bulletuav.policies.neural_network import ACTORS, HIGH, LOW
from bulletuav.policies.run import RunConfig, shipped
from bulletuav.policies.swarm_features import find_layout
from bulletuav.sensors.base import Label

NAMES = {
    "ppo": ("mlp_extractor.policy_net.0", "action_net"),
    "dqn": ("q_net.q_net.0", "q_net.q_net.2"),
}
NAMES["sac"] = ("actor.latent_pi.0", "actor.mu")
SWARM = {
    "own and others": {"observation": ("velocity", "goal", "intruders", "neighbours")},
    "others alone": {"observation": "intruders"},
    "without motion": {"observation": ("goal", "obstacles"), "num_obstacles": 2},
}
CASES = {
    **{
        action: ("ppo", {"action": action})
        for action in (*AFFINE_ACTIONS, *LIMITED_ACTIONS, "rotor")
    },
    "squashed": ("sac", {}),
    "choices": ("dqn", {"action": "discrete_27"}),
    "normalised": ("ppo", {"normalise": True}),
    **{name: ("ppo", options) for name, options in SWARM.items()},
}


@pytest.fixture(params=CASES)
def policy(request, tmp_path):
    """A network of random weights, as a run keeps it."""
    algo, options = CASES[request.param]
    model = {"features": "swarm"} if request.param in SWARM else {}
    config = RunConfig("crossing", algo, options={"num_drones": 3, **options}, model=model)
    spec = EnvSpec("crossing", 1, config.evaluated)
    action, rng = spec.action, np.random.default_rng(1)
    features, inputs = {}, len(spec.observer.labels)
    if request.param in SWARM:
        layout = find_layout(spec.observer.labels)
        inputs = len(layout.own) + 2 * 5 * len(layout.kinds)
        for word in layout.kinds:
            for number, shape in ((0, (6, layout.inputs(word))), (2, (5, 6))):
                name = f"features_extractor.each.{word}.{number}"
                features[f"{name}.weight"] = rng.normal(0, 0.5, shape)
                features[f"{name}.bias"] = rng.normal(0, 1, shape[0])
    size = action.choices or action.size(0)
    hidden, last = NAMES[algo]
    arrays = {
        **features,
        f"{hidden}.weight": rng.normal(0, 0.3, (8, inputs)),
        f"{hidden}.bias": rng.normal(0, 1, 8),
        f"{last}.weight": rng.normal(0, 1, (size, 8)),
        f"{last}.bias": rng.normal(0, 1, size),
    }
    if action.choices is None:
        arrays |= {LOW: action.low[0], HIGH: action.high[0]}
    weights = {name: array.astype(np.float32) for name, array in arrays.items()}
    save_file(weights, tmp_path / "policy.safetensors")
    (tmp_path / "run.yaml").write_text(config.text())
    assert algo in ACTORS
    return deployed(tmp_path)


def agree(policy, run, precision):
    rows = policy.observations()
    rows[::3, len(rows[0]) // 2 :] = 0  # as of others who are not there
    own = policy.act(rows)
    given = run(rows, policy, precision)
    assert np.ptp(own, axis=0).max() > 0.1  # it does not do the same whatever it sees
    # Sums of some forty numbers, each of single precision, through a network of random weights.
    scale = max(1.0, np.abs(own).max())
    assert np.abs(given - own).max() <= (1e-6 if precision == "double" else 1e-5 * scale)
    low, high = ([getattr(one, name) for one in policy.outputs] for name in ("low", "high"))
    assert np.all(own >= np.array(low) - 1e-9)
    assert np.all(own <= np.array(high) + 1e-9)


@pytest.mark.parametrize("precision", ["float", "double"])
@pytest.mark.skipif(c_source.find_compiler() is None, reason="needs a C compiler")
def test_c_does_what_the_policy_does(policy, precision, tmp_path):
    source, header = write_c(policy, tmp_path / "pilot.c", precision)
    agree(policy, lambda *given: run_c(source, *given), precision)
    text = header.read_text()
    assert f"#define PILOT_INPUTS {len(policy.inputs)}" in text
    for k, one in enumerate(policy.outputs):
        assert f"[{k}] {one.name}, {one.unit}, {one.low:.9g} to {one.high:.9g}" in text


@pytest.mark.parametrize("precision", ["float", "double"])
def test_onnx_does_what_the_policy_does(policy, precision, tmp_path):
    pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    import onnx

    from bulletuav.adapters.onnx import run_onnx, write_onnx

    (path,) = write_onnx(policy, tmp_path / "pilot.onnx", precision)
    agree(policy, lambda *given: run_onnx(path, *given), precision)
    told = {one.key: one.value for one in onnx.load(path).metadata_props}
    first = policy.inputs[0]
    assert told["observation"].startswith(f"{first.name}, {first.unit}, {first.low:.9g} to ")
    assert told["setpoint"].count("\n") == len(policy.outputs) - 1


def test_what_has_no_form_is_refused(tmp_path):
    with pytest.raises(ValueError, match="features 'user_sum' cannot be exported"):
        deployed(shipped("mec"))
    config = RunConfig("crossing", options={"action": "velocity_increment"})
    (tmp_path / "run.yaml").write_text(config.text())
    weights = (shipped("crossing") / "policy.safetensors").read_bytes()
    (tmp_path / "policy.safetensors").write_bytes(weights)
    with pytest.raises(ValueError, match="action 'velocity_increment' cannot be exported"):
        deployed(tmp_path)
    (tmp_path / "run.yaml").write_text(
        RunConfig("crossing", options={"observation": "goal"}).text()
    )
    with pytest.raises(ValueError, match=r"was trained for \d+ numbers, and 4 are observed"):
        deployed(tmp_path)

    class Unknown(tuple):
        _asdict = dict

    one = Deployed("x", (), (), (Unknown(),), lambda rows: rows)
    with pytest.raises(ValueError, match="a layer Unknown cannot be written in C"):
        write_c(one, tmp_path / "policy.c")
    with pytest.raises(ValueError, match="a name of letters"):
        write_c(one, tmp_path / "my-policy.c")


def test_labels_cannot_end_the_comment_of_a_header(tmp_path):
    label = Label("evil */ int x;", "1", -1.0, np.inf)
    layers = (Dense(np.ones((2, 1)), np.zeros(2)), Argmax())
    one = Deployed("x", (label,), (label,), layers, lambda rows: 0 * rows)
    source, header = write_c(one, tmp_path / "policy.c", "double")
    assert header.read_text().count("*/") == 1
    if c_source.find_compiler() is not None:
        np.testing.assert_array_equal(run_c(source, np.ones((1, 1)), one, "double"), [[0.0]])


def test_the_command_tells_how_well_they_agree(tmp_path, capsys):
    main(["export", str(shipped("hover")), "--to", "c", "--out", str(tmp_path / "fly.c")])
    told = capsys.readouterr().out
    assert "fly.h" in told
    assert "(float)" in told
    with pytest.raises(SystemExit):
        main(["export", str(shipped("hover")), "--to", "c", "--precision", "half"])
    assert "precision" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["export", str(tmp_path), "--to", "mcap", "--precision", "float"])
    assert "--precision is for policies" in capsys.readouterr().err
