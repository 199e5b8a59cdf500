"""Tests of the helper threads, and of environments that use them."""

import gc
import multiprocessing
import os
import pickle
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
from numba import types

import bulletuav
from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.program import Program, by_world
from bulletuav.compiled.threads import TEAM
from bulletuav.conflict.separation import add_conflict, measure_conflict, no_conflict
from bulletuav.envs.aviary import Aviary

THREADS = (2, 3, 5)


@kernel
def double(first: int, last: int, given: np.ndarray, out: np.ndarray) -> None:
    """Write the doubles of some numbers."""
    for k in range(first, last):
        out[k] = 2.0 * given[k]


@kernel
def count_items(first: int, last: int, out: np.ndarray, counts: np.ndarray) -> None:
    """Count how often each item is computed, and the items of the thread."""
    for k in range(first, last):
        out[k] += 1
        counts[0] += 1


@kernel
def fail_at_seven(first: int, last: int, out: np.ndarray) -> None:
    """Raise an exception for item 7."""
    for k in range(first, last):
        out[k] = 1
        if k == 7:
            raise ValueError("seven")


@deferred(types.none)
@kernel
def add_one(out: np.ndarray, k: int) -> None:
    """Add 1 to a number; compiled at the first call."""
    out[k] += 1.0


@kernel
def add_ones(first: int, last: int, out: np.ndarray) -> None:
    """Add 1 to some numbers by a deferred function."""
    for k in range(first, last):
        add_one(out, k)


@pytest.mark.parametrize("size", [0, 1, 2, 7, 1000])
@pytest.mark.parametrize("threads", [1, 2, 3, 32])
def test_a_shared_call_computes_each_item_once(size, threads):
    out = np.zeros(size, dtype=np.int64)
    counts = np.zeros((threads, 8), dtype=np.int64)
    program = Program(threads)
    program.call(*program.shared(count_items, size, out, own=[(one,) for one in counts]))
    for _ in range(50):
        program.run()
    np.testing.assert_array_equal(out, 50)
    assert counts.sum() == 50 * size


def test_helpers_take_part_in_a_long_call():
    size = 3_000_000
    out, counts = np.zeros(size, dtype=np.int64), np.zeros((2, 8), dtype=np.int64)
    program = Program(2)
    program.call(*program.shared(count_items, size, out, own=[(one,) for one in counts]))
    end = time.monotonic() + 60
    while not counts[:, 0].all() and time.monotonic() < end:
        program.run()
    assert (counts[:, 0] > 0).all()


def test_a_shared_call_can_be_interpreted():
    given, out = np.arange(100.0), np.zeros(100)
    program = Program(2)
    program.call(*program.shared(double, 100, given, out))
    program.interpret()
    np.testing.assert_array_equal(out, 2 * given)


def test_an_exception_on_any_thread_is_raised_and_the_next_run_works():
    out = np.zeros(64, dtype=np.int64)
    program = Program(3)
    program.call(*program.shared(fail_at_seven, 64, out))
    with pytest.raises(RuntimeError, match="failed on one of several threads"):
        program.run()
    assert out[:8].all()
    assert out[32:].all()
    test_a_shared_call_computes_each_item_once(1000, 3)


def test_functions_are_compiled_when_helpers_call_them_first():
    out = np.zeros(64)
    program = Program(5)
    program.call(*program.shared(add_ones, 64, out))
    for _ in range(20):
        program.run()
    np.testing.assert_array_equal(out, 20)


def test_python_threads_share_the_helpers():
    outs = np.zeros((4, 500), dtype=np.int64)

    def work(out):
        own = [(one,) for one in np.zeros((3, 8), dtype=np.int64)]
        program = Program(3)
        program.call(*program.shared(count_items, 500, out, own=own))
        for _ in range(500):
            program.run()

    workers = [threading.Thread(target=work, args=(out,)) for out in outs]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    np.testing.assert_array_equal(outs, 500)


def test_programs_by_world_compute_the_items_of_their_world_only():
    places, alive = np.random.default_rng(0).normal(size=(2, 3, 4, 3)), np.ones((3, 4), bool)
    conflict = no_conflict((3, 4))
    program = Program()
    add_conflict(program, *places, alive, 0.5, 1.0, conflict)
    by_world(program, [*places, alive, *conflict]).run(np.array([False, True, False]))
    expected = measure_conflict(*places, alive, 0.5, 1.0)
    np.testing.assert_array_equal(conflict.separation[1], expected.separation[1])
    assert np.isinf(conflict.separation[[0, 2]]).all()


def fly(task, num_worlds, steps, **options):
    """Fly random actions; return all results, and the hash of the state."""
    aviary = Aviary(task, num_worlds, seed=1, **options)
    aviary.reset()
    rng = np.random.default_rng(2)
    results = []
    for k in range(steps):
        # Random actions crash drones, and constant ones let them rest
        random = rng.uniform(aviary.action.low, aviary.action.high, aviary.given.shape)
        step = aviary.step(random if k // 5 % 2 == 0 else 0.3 * random.mean() + 0 * random)
        results.append([step.observations.copy(), step.rewards, step.terminated])
        over = ~aviary.alive.any(axis=1)
        if over.any():
            aviary.reset(over)
    return [one for step in results for one in step], aviary.state_hash()


CASES = [
    ("hover", 1, 25, {"num_drones": 210, "dynamics": "rigid_body"}),
    ("hover", 1, 25, {"num_drones": 70, "dynamics": "rigid_body", "controller": "pid"}),
    ("crossing", 1, 10, {"num_drones": 201, "dynamics": "point_mass"}),
    ("crossing", 1, 8, {"num_drones": 64, "dynamics": "single_integrator"}),
    ("crossing", 1, 8, {"num_drones": 100, "dynamics": "rigid_body", "contacts": "stop"}),
    ("obstacles", 9, 15, {"dynamics": "rigid_body"}),
    ("crossing", 7, 15, {"dynamics": "double_integrator"}),
    ("transport", 5, 10, {"dynamics": "rigid_body"}),
    ("navigation", 2, 10, {"num_drones": 3, "dynamics": "rigid_body", "turbulence": "moderate"}),
]


@pytest.mark.parametrize(("task", "worlds", "steps", "options"), CASES)
def test_results_do_not_depend_on_the_number_of_threads(task, worlds, steps, options):
    if options.get("controller") == "pid":
        options = {**options, "effects": ("drag", "downwash", "ground_effect")}
    expected, state = fly(task, worlds, steps, **options)
    for threads in THREADS:
        found, other = fly(task, worlds, steps, threads=threads, **options)
        for one, same in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, same)
        assert other == state


def test_drones_sleep_and_wake_with_any_number_of_threads():
    # Drones stand in pairs, one on the other; one falls on each tenth pair
    grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0)), -1).reshape(-1, 2)
    height = bulletuav.Airspace([(0, 0, 1.0)], dynamics="rigid_body").airframes[0].standing_height
    ground = np.column_stack([grid, np.full(48, height)])
    falling = ground[::3] + (0.01, 0.0, 0.8)
    states = []
    for threads in (1, *THREADS):
        space = bulletuav.Airspace(
            np.vstack([ground, falling]), dynamics="rigid_body", decision_hz=24, threads=threads
        )
        slept = 0
        space.command(None, "rotor", np.zeros((64, 4)))
        for _ in range(48):
            space.step()
            slept = max(slept, int(space.world.dynamics.contact.asleep.sum()))
        states.append([slept, *map(np.array, space.swarm)])
    assert states[0][0] > 40
    for other in states[1:]:
        for one, same in zip(other, states[0], strict=True):
            np.testing.assert_array_equal(one, same)


def crossing(threads, **options):
    """Return positions after some decisions of a batch."""
    env = bulletuav.batch_env("crossing", 4, dynamics="point_mass", threads=threads, **options)
    env.reset(seed=3)
    for _ in range(5):
        seen = env.step(np.ones(env.aviary.given.shape))[0]
    return seen


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_starts_its_own_helpers():
    expected = crossing(2)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()

    def child():
        queue.put((crossing(3), len(TEAM._helpers)))

    process = context.Process(target=child)
    process.start()
    found, helpers = queue.get(timeout=120)
    process.join(60)
    assert process.exitcode == 0
    assert helpers == 2
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(crossing(2), expected)


def test_worker_processes_start_after_threads():
    expected = crossing(2)
    env = bulletuav.batch_env("crossing", 4, dynamics="point_mass", workers=2)
    env.reset(seed=3)
    for _ in range(5):
        seen = env.step(np.ones((4, env.num_drones, 3)))[0]
    env.close()
    np.testing.assert_array_equal(seen, expected)


def test_environments_with_threads_are_collected_and_states_are_exchanged():
    one = Aviary("crossing", 4, dynamics="rigid_body", seed=1, threads=2)
    one.reset()
    one.step(np.zeros(one.given.shape))
    saved = pickle.loads(pickle.dumps(one.save_state()))
    other = Aviary("crossing", 4, dynamics="rigid_body", seed=5)
    other.reset()
    other.load_state(saved)
    for aviary in (one, other):
        aviary.step(np.full(aviary.given.shape, 0.5))
    np.testing.assert_array_equal(one.swarm.position, other.swarm.position)
    assert one.state_hash() == other.state_hash()
    del one
    gc.collect()
    other.step(np.zeros(other.given.shape))
    np.testing.assert_array_equal(crossing(2), crossing(1))


SCRIPT = """
    import numpy as np, bulletuav, os, signal, sys, threading
    env = bulletuav.batch_env("crossing", 8, dynamics="point_mass", threads=4)
    env.reset(seed=0)
    actions = np.zeros(env.aviary.given.shape)
    env.step(actions)
"""


@pytest.mark.parametrize("ending", ["", "sys.exit(0)", "env.close()", "del env"])
def test_the_process_ends_cleanly(ending):
    script = textwrap.dedent(SCRIPT) + ending
    ended = subprocess.run([sys.executable, "-c", script], timeout=120, capture_output=True)
    assert ended.returncode == 0
    assert b"Traceback" not in ended.stderr
    assert b"Fatal" not in ended.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_an_interrupt_ends_a_flight():
    script = textwrap.dedent(SCRIPT) + textwrap.dedent(
        """
        signal.signal(signal.SIGINT, signal.default_int_handler)
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        try:
            while True:
                env.step(actions)
                if env.ended.all():
                    env.reset()
        except KeyboardInterrupt:
            env.reset(seed=0)
            env.step(actions)
            print("interrupted")
        """
    )
    ended = subprocess.run([sys.executable, "-c", script], timeout=120, capture_output=True)
    assert ended.returncode == 0
    assert ended.stdout.strip() == b"interrupted"


def test_options_without_effect_raise_an_error():
    with pytest.raises(ValueError, match="dynamics 'bullet' flies on one thread"):
        Aviary("hover", 2, dynamics="bullet", threads=2)
    with pytest.raises(ValueError, match="10 drones of one world fly on one thread"):
        Aviary("hover", 1, num_drones=10, dynamics="rigid_body", threads=2)
    with pytest.raises(ValueError, match="it needs threads=1"):
        Aviary("hover", 2, dynamics="rigid_body", threads=2, debug=True)
    with pytest.raises(ValueError, match="workers is 2"):
        bulletuav.batch_env("hover", 4, dynamics="rigid_body", threads=2, workers=2)
    for number in (0, 33, 1.5):
        with pytest.raises(ValueError, match="threads"):
            Aviary("hover", 2, dynamics="rigid_body", threads=number)
