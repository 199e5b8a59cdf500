"""What environments take, and that they take no more the longer they fly."""

import gc
import subprocess
import sys

import numpy as np
import psutil
import pytest

import bulletuav

MEGABYTE = 2**20


def resident():
    """Bytes of memory that this process takes."""
    gc.collect()
    return psutil.Process().memory_info().rss


def growth(env, steps, warm):
    """Bytes by which the process grew while a batch flew `steps`, after `warm` of them."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    shape = (env.num_envs, env.num_drones, *env.action_space.shape)
    for step in range(steps + warm):
        if step == warm:
            before = resident()
        env.step(rng.uniform(-1, 1, shape))
    env.close()
    return resident() - before


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_no_growth_over_some_thousand_steps_with_crashes_and_resets(dynamics):
    env = bulletuav.batch_env(
        "hover", 4, dynamics=dynamics, horizon=100, decision_hz=48, height=0.7, max_distance=50.0
    )
    assert growth(env, 4000, 1000) < 2 * MEGABYTE


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_no_growth_over_a_million_steps(dynamics):
    env = bulletuav.batch_env(
        "hover",
        1,
        dynamics=dynamics,
        physics_hz=240,
        decision_hz=240,
        horizon=500,
        height=0.7,
        max_distance=50.0,
    )
    assert growth(env, 1_000_000, 50_000) < 4 * MEGABYTE


@pytest.mark.parametrize(
    ("worlds", "drones", "most"), [(64, 8, 150), pytest.param(1, 1000, 250, marks=pytest.mark.slow)]
)
def test_memory_of_large_swarms(worlds, drones, most):
    """In a process of its own, for the engine keeps what it once took."""
    program = (
        "import bulletuav, numpy as np, psutil\n"
        "small = bulletuav.Aviary('hover'); small.reset(seeds=0); small.step(np.zeros((1, 1, 4)))\n"
        "before = psutil.Process().memory_info().rss\n"
        f"env = bulletuav.Aviary('hover', {worlds}, num_drones={drones}, action='velocity')\n"
        "env.reset(seeds=0)\n"
        f"env.step(np.zeros(({worlds}, {drones}, 3)))\n"
        "print(psutil.Process().memory_info().rss - before)\n"
    )
    out = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert int(out.stdout) < most * MEGABYTE


@pytest.mark.parametrize("resets", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_no_growth_over_resets_in_cities(resets):
    """Layouts are made once and moved by pose; four worlds, each reset by itself."""
    aviary = bulletuav.Aviary(
        "lidar_navigation", 4, area=150.0, leg=40.0, num_layouts=3, irregularity=0.5, seed=0
    )
    aviary.reset()
    action = np.zeros((4, 3, 3))
    stood = set()
    for k in range(resets + 100):
        if k == 100:
            before = resident()
        aviary.reset(np.arange(4) == k % 4)
        stood.add(tuple(aviary.scene.layout))
        if k % 10 == 0:
            aviary.step(action)
    assert len(stood) > 50
    assert resident() - before < 2 * MEGABYTE
    aviary.close()
