"""The C extension and the calls through Python give the same bits."""

import _ctypes
import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import bench
import numpy as np
import pytest
from waiting import LONG

import bulletuav.engine.engine as engine_module
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.engine.c_extension import SWITCH, CExtension, Extension, load_extension
from bulletuav.engine.calls import MAX_RAYS, SURFACE_GROUP, bullet
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.vehicle.swarm import ObstacleMotion

pytestmark = pytest.mark.bullet
needs_extension = pytest.mark.skipif(
    os.environ.get(SWITCH) == "0", reason="the extension is turned off"
)


@pytest.fixture
def pair(make_bench, monkeypatch):
    """Makes the same bench twice: with the extension and without."""

    def make(*arguments, **options):
        fast = make_bench(*arguments, **options)
        assert fast.engine.ports, engine_module.EXTENSION.missing
        with monkeypatch.context() as patch:
            patch.setattr(engine_module, "EXTENSION", Extension(None, "", "for comparison"))
            plain = make_bench(*arguments, **options)
        assert not plain.engine.ports
        return fast, plain

    return make


def same(fast, plain):
    for mine, theirs in zip(fast.swarm, plain.swarm, strict=True):
        assert mine.tobytes() == theirs.tobytes()


def scatter(benches, seed, spread):
    for one in benches:
        rng = np.random.default_rng(seed)
        shape = one.alive.shape
        one.swarm.position[:] = rng.uniform(-spread, spread, (*shape, 3)) + (0, 0, spread + 0.3)
        turn = rng.normal(size=(*shape, 4))
        one.swarm.quaternion[:] = turn / np.linalg.norm(turn, axis=-1, keepdims=True)
        one.swarm.velocity[:] = rng.normal(size=(*shape, 3)) * 3
        one.swarm.rates[:] = rng.normal(size=(*shape, 3)) * 5
        one.place()


@needs_extension
@pytest.mark.parametrize("airframe", ["cf2x", "hummingbird", "firefly"])
def test_flights_are_the_same_to_the_bit(pair, airframe):
    benches = pair("bullet", airframe, worlds=3, drones=5, wind=(1.0, 0.5, 0))
    scatter(benches, 1, 30.0)
    for target in ((1.0, 2.0, 5.0, 0.3), (0.0, 0.0, 30.0, 0.0)):
        for one in benches:
            one.fly(SetpointLevel.POSITION, target, 5)
        same(*benches)


@needs_extension
def test_heaps_with_contacts_are_the_same_to_the_bit(pair):
    benches = pair("bullet", worlds=2, drones=6)
    # The second after a reset in place, with the first one's contacts behind it
    for seed in (1, 2):
        scatter(benches, seed, 0.3)
        touched = 0
        for _ in range(4):
            fast, plain = (one.spin(200.0) for one in benches)
            for mine, theirs in zip(fast, plain, strict=True):
                np.testing.assert_array_equal(mine, theirs)
            same(*benches)
            touched += len(fast.world)
        assert touched > 20


@needs_extension
def test_fast_flight_among_moving_obstacles_is_the_same_to_the_bit(pair):
    obstacles = (Obstacle("box", (2.0, 3.0, 4.0)), Obstacle("sphere", (1.5,)))
    benches = pair("bullet", worlds=2, drones=6, obstacles=obstacles)
    scatter(benches, 3, 6.0)
    turns = np.tile((0.0, 0, 0, 1), (2, 2, 1))
    touched = 0
    for step in range(12):
        before = np.tile(((-1.0 + 0.4 * step, 0, 3.0), (1.0, 0.3 * step, 5.0)), (2, 1, 1))
        motion = ObstacleMotion(before, before + (0.4, 0.3, 0), turns)
        setpoint = np.broadcast_to((0.0, 0, 4, 0), (2, 6, 4)).copy()
        contacts = [
            one.dynamics.fly(
                one.swarm, one.alive, SetpointLevel.POSITION, setpoint, one.wind, motion
            )
            for one in benches
        ]
        same(*benches)
        for mine, theirs in zip(*contacts, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        touched += len(contacts[0].world)
    assert touched


@needs_extension
def test_every_call_alone_is_the_same_to_the_bit(pair):
    fast, plain = benches = pair(
        "bullet",
        worlds=2,
        drones=100,
        obstacles=(Obstacle("box", (4.0, 4.0, 1.0)),),
        contacts="bullet",
    )
    scatter(benches, 5, 1.0)
    mask = np.random.default_rng(0).random((2, 100)) < 0.7
    force = np.random.default_rng(1).normal(size=(2, 2, 100, 3))
    for one in benches:
        assert isinstance(one.engine._bullet.calls, CExtension) == (one is fast)
        one.engine.set_obstacles(
            np.full((2, 1, 3), 0.5), np.tile((0.0, 0, 0, 1), (2, 1, 1)), np.array([True, False])
        )
        one.engine.apply_wrenches(*force, mask)
        one.engine.step()
        one.engine.step()
        one.engine.read_states(one.swarm, mask)
    same(fast, plain)
    contacts = [one.engine.contacts(one.swarm, one.dt) for one in benches]
    assert len(contacts[0].world) > 64
    for mine, theirs in zip(*contacts, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    start = np.random.default_rng(2).uniform(-3, 3, (MAX_RAYS + 100, 3)) + (0, 0, 3)
    fractions = [
        one.engine._bullet.calls.rays(start, start - (0.5, 0.2, 4), SURFACE_GROUP)
        for one in benches
    ]
    assert fractions[0].tobytes() == fractions[1].tobytes()
    assert 100 < (fractions[0] < 1).sum() < len(start)


@needs_extension
def test_surface_below_an_edge_inside_the_compiled_loop(pair):
    """Ground effect over a box and beside it: rays from the compiled loop and from Python agree."""
    benches = pair(
        "bullet",
        drones=3,
        obstacles=(Obstacle("box", (2.0, 2.0, 1.0)),),
        effects=("ground_effect",),
    )
    at = np.array([[[0.0, 0, 0.5]]])
    lifts = []
    for one in benches:
        one.engine.set_obstacles(at, np.tile((0.0, 0, 0, 1), (1, 1, 1)), np.array([True]))
        one.swarm.position[0] = (
            (0, 0, 1.3),
            (1.2, 0, 1.3),
            (9, 0, 1.3),
        )  # above, in the bounding sphere only, far away
        one.place().spin(one.airframe.hover_speed())
        lifts.append(one.swarm.velocity[0, :, 2].copy())
    same(*benches)
    assert lifts[0][0] > 1e-3
    assert abs(lifts[0][1]) < 1e-12  # 1.3 m above the ground no effect is left
    assert lifts[0][1] == pytest.approx(lifts[0][2], rel=1e-6)


def test_after_close_calls_are_the_engines_errors(make_bench):
    one = make_bench("bullet").place()
    one.engine.close()
    with pytest.raises(bullet.error):
        one.engine.step()
    assert not one.engine.ports


def test_the_switch_turns_it_off(monkeypatch):
    monkeypatch.setenv(SWITCH, "0")
    assert load_extension(bullet.__file__) == Extension(None, "", f"turned off by {SWITCH}=0")


@needs_extension
def test_a_module_that_lacks_a_function_is_named(make_bench):
    assert load_extension(_ctypes.__file__).missing.endswith(
        "does not offer b3InitStepSimulationCommand"
    )
    assert (
        load_extension("/nowhere/pybullet.so").missing
        == "pybullet.so does not offer a loaded pybullet module"
    )
    make_bench("bullet").place().spin(0.0)  # what was found before still works


def test_an_installation_without_it_says_what_is_needed(monkeypatch):
    monkeypatch.delenv(SWITCH, raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "a C compiler" in load_extension(bullet.__file__).missing


@pytest.mark.parametrize("path", [_ctypes.__file__, "/nowhere/_batch.so"])
def test_a_stale_build_says_to_install_again(monkeypatch, path):
    monkeypatch.delenv(SWITCH, raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: SimpleNamespace(origin=path))
    assert "install bulletuav again" in load_extension(bullet.__file__).missing


@needs_extension
@pytest.mark.parametrize("path", [_ctypes.__file__, "/nowhere/plugin.so"])
def test_a_refused_plugin_warns_and_flies_on(monkeypatch, path):
    monkeypatch.setattr(engine_module, "EXTENSION", engine_module.EXTENSION._replace(path=path))
    with pytest.warns(UserWarning, match="could not load the plugin.*bulletuav doctor"):
        one = bench.Bench("bullet")
    assert not one.engine.ports
    one.place().spin(0.0)
    one.engine.close()


@needs_extension
def test_an_engine_that_answers_differently_is_not_trusted(monkeypatch):
    one = bench.Bench("bullet")
    with pytest.raises(RuntimeError, match="differently"):
        CExtension(engine_module.EXTENSION.library, np.array([10**6]))
    one.engine.close()


def test_a_smoke_set_without_the_extension():
    root = Path(__file__).parents[2]
    files = [
        "tests/dynamics/test_sweep.py",
        "tests/test_golden.py",
        "tests/engine/test_c_extension.py",
    ]
    command = [sys.executable, "-m", "pytest", "-n0", "-p", "no:cacheprovider", *files]
    # Some go no other way through the code: with users on the ground, with dynamics of our own.
    users = " and ".join(
        f"not always_did[{task}]" for task in ("coverage", "default", "los", "mec", "mec_advanced")
    )
    skip = [
        "-k",
        f"not smoke and not thousand and not trace and {users} and not mobile_users and not follow"
        " and not rigid_body",
    ]
    done = subprocess.run(
        command + skip,
        cwd=root,
        env={**os.environ, SWITCH: "0"},
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]


def test_an_engine_is_made_without_warnings(make_bench):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make_bench("bullet")
