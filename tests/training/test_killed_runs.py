"""Runs of the command line that a signal ends go on to the weights of runs that nothing ended."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from waiting import until

from bulletuav.policies.neural_network import read_weights
from bulletuav.policies.run import FAST, FOUNDATION, POLICY, RunConfig
from bulletuav.training.schedules import default_run
from bulletuav.training.trainer import train

FLIGHT = {"dynamics": "single_integrator", "num_drones": 3, "difficulty": "easy", "horizon": 12}
RUNS = {
    FAST: RunConfig(
        "converge",
        FAST,
        steps=120_000,
        worlds=16,
        evaluations=4,
        episodes=1,
        options={**FLIGHT, "observation": ["velocity", "goal_offset", "intruders"]},
        evaluation={"dynamics": "single_integrator", "horizon": 5},
        model={"n_steps": 16, "batch_size": 96, "features": "swarm"},
    ),
    FOUNDATION: RunConfig(
        "hover",
        FOUNDATION,
        steps=60_000,
        worlds=4,
        evaluations=4,
        episodes=1,
        options={**default_run("hover", FOUNDATION).options, "horizon": 30},
        evaluation={"difficulty": "easy", "horizon": 5, "airframe": ["cf2p", "racer"]},
        model={"airframes": 8, "hidden_size": 8, "buffer_size": 64, "gradient_steps": 4},
    ),
}


@pytest.fixture(scope="module", params=RUNS)
def whole(request, tmp_path_factory):
    """A run that nothing ended: its settings and its folder."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    train(RUNS[request.param], folder)
    return RUNS[request.param], folder


def test_a_run_that_signals_end_goes_on_to_the_same_weights(whole, tmp_path):
    config, folder = whole
    (tmp_path / "given.yaml").write_text(config.text())
    command = [sys.executable, "-m", "bulletuav", "train", "--config", "given.yaml", "--out", "out"]
    out, curve = tmp_path / "out", tmp_path / "out/curve.csv"
    ends = (
        # In the second segment
        (signal.SIGTERM, lambda: curve.exists() and curve.read_text().count("\n") == 3),
        # While the third checkpoint is evaluated, before its row is stored
        (signal.SIGKILL, (out / "checkpoints/002" / POLICY).exists),
        # In the fourth segment
        (signal.SIGINT, lambda: curve.read_text().count("\n") == 5),
    )
    for number, moment in ends:
        with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL) as running:
            until(moment)
            running.send_signal(number)
        assert running.returncode == (130 if number == signal.SIGINT else -number)
    subprocess.run(command, cwd=tmp_path, check=True, stderr=subprocess.DEVNULL)
    assert curve.read_text().count("\n") == 1 + 5
    names = [path.relative_to(folder) for path in folder.glob(f"checkpoints/*/{POLICY}")]
    assert len(names) == 5
    for name in (POLICY, *names):
        expected, found = read_weights(folder / name), read_weights(out / name)
        assert expected.keys() == found.keys()
        for key in expected:
            np.testing.assert_array_equal(found[key], expected[key], err_msg=f"{name} {key}")
