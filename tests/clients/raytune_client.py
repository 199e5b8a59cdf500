"""Sweep the learning rate of `fast_ppo` by Ray Tune; a killed sweep is restored."""

import inspect
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

# Ray reads them when it is imported
os.environ.update(RAY_AUTH_MODE="disabled", RAY_USAGE_STATS_ENABLED="0")

import ray
from library import OPTIONS, TASK
from ray import tune

from bulletuav.policies.run import RunConfig
from bulletuav.training.trainer import train

RATES = (1e-4, 3e-4, 1e-3)
STEPS = 50_000
"""Decisions of drones in a trial, at least"""
NAME = "sweep"


def trial(config):
    """Train with the settings of a trial; a restored trial goes on from its last checkpoint."""
    settings = {"learning_rate": config["learning_rate"]}
    run = RunConfig(
        TASK, "fast_ppo", steps=STEPS, options=OPTIONS, model=settings, evaluations=4, episodes=4
    )
    folder = Path(config["folder"]) / tune.get_context().get_trial_id()
    rows = train(run, folder)
    tune.report({"return": rows[-1]["return"], "cpu": time.process_time()})


def sweep(folder):
    """Start the sweep, or restore it."""
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    path = Path(folder) / NAME
    if tune.Tuner.can_restore(path):
        tuner = tune.Tuner.restore(str(path), trial)
    else:
        tuner = tune.Tuner(
            trial,
            param_space={"learning_rate": tune.grid_search(list(RATES)), "folder": folder},
            run_config=tune.RunConfig(name=NAME, storage_path=folder, verbose=0),
        )
    results = tuner.fit()
    assert not results.errors
    return {one.config["learning_rate"]: one.metrics for one in results}


def steps_of(state):
    """Return the steps in the progress of a run, 0 before its first checkpoint."""
    rows = json.loads(state.read_text())["rows"] if state.exists() else []
    return int(rows[-1]["steps"]) if rows else 0


def kill_after_first_trial(folder):
    """Start the sweep in a process of its own, and kill it in the middle of the second trial."""
    command = [sys.executable, __file__, folder]
    sweeping = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL)
    while True:
        time.sleep(0.2)
        assert sweeping.poll() is None, "the sweep has ended before it was killed"
        done = sorted(steps_of(path) for path in Path(folder).glob("*/state.json"))
        if len(done) == 2 and 0 < done[0] < STEPS <= done[1]:
            break
    os.killpg(sweeping.pid, signal.SIGKILL)
    sweeping.wait()
    return {path: path.stat().st_mtime_ns for path in Path(folder).glob("*/run.yaml")}


def main():
    """Sweep with an interruption, and print a line of JSON; see `library.report`."""
    with tempfile.TemporaryDirectory(prefix="tune", ignore_cleanup_errors=True) as folder:
        started = kill_after_first_trial(folder)
        found = sweep(folder)
        assert sorted(found) == sorted(RATES)
        states = list(Path(folder).glob("*/state.json"))
        assert len(states) == len(RATES)
        assert all(steps_of(path) >= STEPS for path in states)
        # Trials went on in their folders
        assert all(path.stat().st_mtime_ns == when for path, when in started.items())
        line = {
            "versions": {name: version(name) for name in ("ray", "torch")},
            "python": ".".join(map(str, sys.version_info[:2])),
            "how": f"`fast_ppo`, {len(RATES)} trials; killed, then restored",
            "glue": len(inspect.getsource(trial).splitlines()),
            "worlds": 32,
            "share": None,
            "training": STEPS / found[RATES[-1]]["cpu"],
        }
        ray.shutdown()
    print(json.dumps(line))


if __name__ == "__main__":
    sweep(*sys.argv[1:]) if sys.argv[1:] else main()
