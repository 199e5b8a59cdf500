"""The engine: states in and out, rays, contacts, and worlds that do not feel each other."""

import contextlib
import gc
import os
import weakref

import bench
import numpy as np
import psutil
import pytest

import bulletuav
from bulletuav.engine.calls import bullet
from bulletuav.engine.engine import Engine
from bulletuav.engine.parking import PARKING_HEIGHT
from bulletuav.engine.tiles import TILE_PITCH, tile_offset
from bulletuav.vehicle.swarm import GROUND, Contacts, Swarm


def test_tiles_depend_on_the_index_alone_and_never_coincide():
    offsets = np.array([tile_offset(k) for k in range(1024)])
    assert tuple(offsets[0]) == (0, 0, 0)
    assert len(np.unique(offsets, axis=0)) == 1024
    assert np.abs(offsets).max() == 31 * TILE_PITCH
    np.testing.assert_array_equal(offsets[:4, :2] / TILE_PITCH, [(0, 0), (1, 0), (0, 1), (1, 1)])


def test_obstacles_are_bodies_when_somebody_looks_and_lie_apart_before():
    """Many bodies at one place would slow Bullet's tree down for good."""
    aviary = bulletuav.Aviary("obstacles", 3, num_obstacles=40, area=400.0)
    aviary.reset(seeds=0)
    client = aviary.worlds.engine._bullet.client
    before = bullet.getNumBodies(physicsClientId=client)
    table = aviary.worlds.engine._bullet.bodies.obstacle
    assert bullet.getNumBodies(physicsClientId=client) == before + 3 * 40
    places = [bullet.getBasePositionAndOrientation(one, client)[0] for one in table.ravel()]
    assert len(set(places)) == 3 * 40
    assert max(place[2] for place in places) < -1000.0
    aviary.worlds.show(aviary.swarm, aviary.alive)
    shown = bullet.getBasePositionAndOrientation(int(table[0, 7]), client)[0]
    np.testing.assert_allclose(shown, aviary.scene.obstacle[0, 7])
    aviary.close()


def test_states_go_in_and_out_unchanged(make_bench):
    one = make_bench("bullet", worlds=3, drones=2)
    rng = np.random.default_rng(0)
    normalise = bulletuav.geometry.rotation.normalise_quaternion
    one.swarm.quaternion[:] = normalise((0.1, -0.2, 0.3, 0.9))
    one.swarm.velocity[:], one.swarm.rates[:] = rng.normal(size=(2, 3, 2, 3))
    one.place()
    back = Swarm.zeros(3, 2, 4)
    one.engine.read_states(back, one.alive)
    for mine, theirs in zip(one.swarm[:4], back[:4], strict=True):
        np.testing.assert_allclose(theirs, mine, atol=1e-11)


def test_wrenches_act_at_the_centre_in_their_frames(make_bench):
    one = make_bench("bullet")
    one.swarm.quaternion[:] = bulletuav.geometry.rotation.from_euler(0.0, 0.0, np.pi / 2)
    one.place()
    force, torque = np.full((1, 1, 3), 0.0), np.full((1, 1, 3), 0.0)
    force[..., 0], torque[..., 0] = 0.716, 0.007
    one.engine.apply_wrenches(force, torque, one.alive)
    one.engine.step()
    one.engine.read_states(one.swarm, one.alive)
    np.testing.assert_allclose(one.swarm.velocity[0, 0], (1 / 240, 0, 0), atol=1e-15)
    np.testing.assert_allclose(one.swarm.rates[0, 0], (1 / 240, 0, 0), atol=1e-15)


def test_rays_see_the_ground_and_no_drones(make_bench):
    one = make_bench("bullet", worlds=2, drones=2).place()
    np.testing.assert_allclose(
        one.engine.surface_below(one.swarm.position, one.alive), 0, atol=1e-9
    )
    start = np.array([(0.0, 0, 10), (0.0, 0, 10), (0.0, 0, 10)])
    end = np.array([(0.0, 0, -10), (0.0, 0, 5), (1.0, 0, 20)])
    np.testing.assert_allclose(
        one.engine.cast_rays(start, end, np.array([1, 0, 1])), (0.5, 1, 1), atol=1e-12
    )
    half = one.alive.copy()
    half[0] = False
    assert np.isneginf(one.engine.surface_below(one.swarm.position, half)[0]).all()


def test_more_rays_than_one_call_takes(make_bench):
    one = make_bench("bullet").place()
    start = np.zeros((40000, 3))
    start[:, 2] = np.linspace(1, 9, 40000)
    fraction = one.engine.cast_rays(start, start - [0, 0, 10], np.zeros(40000, dtype=int))
    np.testing.assert_allclose(fraction, start[:, 2] / 10, atol=1e-12)


def test_a_falling_drone_lands_on_the_ground(make_bench):
    one = make_bench("bullet")
    one.swarm.position[..., 2] = 0.5
    one.swarm.rotor_speed[:] = 0
    one.place()
    contacts = [one.spin(0.0) for _ in range(10)]
    assert 0.055 < one.swarm.position[0, 0, 2] <= 0.055 + 1e-4
    hit = next(c for c in contacts if len(c.drone))
    assert (hit.world[0], hit.drone[0], hit.other[0]) == (0, 0, GROUND)
    resting = contacts[-1].impulse.sum()
    assert resting == pytest.approx(0.716 * 9.80665 * 0.1, rel=0.05)


def test_colliding_drones_are_both_told_and_push_equally(make_bench):
    one = make_bench("bullet", drones=2, effects=(), gravity=0.0)
    one.swarm.position[0] = (0, 0, 10), (0.6, 0, 10)
    one.swarm.velocity[0] = (2, 0, 0), (-2, 0, 0)
    one.swarm.rotor_speed[:] = 0
    contacts = one.place().spin(0.0)
    assert list(zip(contacts.drone, contacts.other, strict=True)) == [(0, 1), (1, 0)]
    change = np.abs(one.swarm.velocity[0, :, 0] - (2, -2))
    np.testing.assert_allclose(contacts.impulse, 0.716 * change, rtol=1e-3)
    assert contacts.impulse[0] == pytest.approx(2 * 0.716)  # without restitution they stick
    np.testing.assert_allclose(contacts.point[:, 0], 0.3, atol=2e-4)
    np.testing.assert_allclose(contacts.normal, [(-1, 0, 0), (1, 0, 0)], atol=1e-6)
    np.testing.assert_allclose(contacts.velocity, [(4, 0, 0), (-4, 0, 0)], atol=1e-6)
    np.testing.assert_allclose(one.swarm.velocity[0].sum(axis=0), 0, atol=1e-6)
    np.testing.assert_array_equal(contacts.mask((1, 2)), [[True, True]])


def test_contacts_merge_in_order():
    """Impulses of a drone and other are added; the first of their points tells the rest."""
    rows = {
        "world": np.array([1, 0, 1]),
        "drone": np.array([0, 1, 0]),
        "other": np.array([GROUND, 0, GROUND]),
        "impulse": np.array([2.0, 1.0, 0.5]),
        "point": np.array([(1.0, 0, 0), (2.0, 0, 0), (3.0, 0, 0)]),
        "normal": np.array([(0.0, 0, 1), (0.0, 1, 0), (1.0, 0, 0)]),
        "velocity": np.array([(0.0, 0, -4), (0.0, -5, 0), (-6.0, 0, 0)]),
        "depth": np.array([0.1, 0.2, 0.3]),
    }
    contacts = Contacts.merged(**rows)
    assert contacts.world.tolist() == [0, 1]
    assert contacts.drone.tolist() == [1, 0]
    assert contacts.other.tolist() == [0, GROUND]
    assert contacts.impulse.tolist() == [1.0, 2.5]
    assert contacts.point.tolist() == [[2, 0, 0], [1, 0, 0]]
    assert contacts.normal.tolist() == [[0, 1, 0], [0, 0, 1]]
    assert contacts.velocity.tolist() == [[0, -5, 0], [0, 0, -4]]
    assert contacts.depth.tolist() == [0.2, 0.1]
    assert not len(Contacts.none().world)
    assert [len(column) for column in Contacts.merged(**Contacts.none()._asdict())] == [0] * 8


def test_parked_drones_stay_out_of_the_way(make_bench):
    """Nothing touches them, the engine's own contacts included."""
    one = make_bench("bullet", drones=3, contacts="bullet").place()
    one.engine.park(one.alive)
    for _ in range(100):
        one.engine.step()
    assert not len(one.engine.contacts(one.swarm, one.dt).world)
    one.engine.read_states(one.swarm, one.alive)
    assert (one.swarm.position[..., 2] == PARKING_HEIGHT).all()
    assert np.ptp(one.swarm.position[0, :, 0]) == 20


# Reproducibility with contacts: drones dropped in a heap


def heap(one, mask=None):
    mask = one.alive if mask is None else mask
    drones = one.alive.shape[1]
    one.swarm.position[mask] = np.tile(
        [(0.2 * (i % 2), 0, 0.1 + 0.12 * i) for i in range(drones)], (mask.sum() // drones, 1)
    )
    one.swarm.quaternion[mask] = 0, 0, 0, 1
    one.swarm.velocity[mask] = one.swarm.rates[mask] = 0
    one.swarm.rotor_speed[mask] = 0
    one.dynamics.place(one.swarm, mask)


def shake(one, decisions, seed, world=0):
    """Random rotor speeds from one stream a world; returns the bytes of everything in `world`."""
    streams = [
        np.random.default_rng(seed if w == world else 1000 + w + seed)
        for w in range(one.alive.shape[0])
    ]
    seen, touched = [], 0
    for _ in range(decisions):
        speeds = np.array([rng.uniform(0, 500, (one.alive.shape[1], 4)) for rng in streams])
        contacts = one.dynamics.fly(
            one.swarm, one.alive, bench.SetpointLevel.ROTOR, speeds, one.wind, one.motion
        )
        seen.append(b"".join(array[world].tobytes() for array in one.swarm))
        touched += int((contacts.world == world).sum())
    assert touched > decisions  # otherwise nothing was tested
    return b"".join(seen)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_a_reset_leaves_no_trace_of_the_past(make_bench, dynamics):
    one = make_bench(dynamics, drones=5)
    heap(one)
    fresh = shake(one, 20, seed=1)
    for past in (0, 1, 7):
        heap(one)
        for _ in range(past):
            one.spin(300.0)
        heap(one)
        assert shake(one, 20, seed=1) == fresh
    other = make_bench(dynamics, drones=5)
    heap(other)
    assert shake(other, 20, seed=1) == fresh
    heap(other)
    assert shake(other, 20, seed=2) != fresh


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_a_world_does_not_feel_the_others(make_bench, dynamics):
    runs = []
    for others in (1, 2):
        one = make_bench(dynamics, worlds=4, drones=4)
        heap(one)
        if others == 2:  # another past, and another reset in the middle
            shake(one, 5, seed=9, world=2)
            heap(one)
        first = shake(one, 8, seed=3, world=2)
        if others == 2:
            heap(one, np.repeat([[True], [False], [False], [True]], 4, axis=1))
        runs.append(first + shake(one, 8, seed=4, world=2))
        one.engine.close()
    assert runs[0] == runs[1]


# Life and death of the engine


def test_closing_twice_and_using_afterwards(make_bench):
    one = make_bench("bullet")
    one.engine.close()
    one.engine.close()
    assert one.engine.closed


def test_an_open_environment_can_be_left_to_the_garbage_collector():
    env = bulletuav.parallel_env("hover")
    env.reset(seed=0)
    engine = weakref.ref(env.aviary.worlds.engine)
    finalizer = env.aviary.worlds.engine._finalizer
    del env
    gc.collect()
    assert engine() is None
    assert not finalizer.alive


@pytest.mark.slow
def test_a_thousand_worlds_one_after_the_other_leak_nothing():
    airframes = [bulletuav.load_airframe("cf2x")] * 2
    process, sizes = psutil.Process(os.getpid()), []
    for k in range(1000):
        Engine(airframes, 1, 1 / 240).close()
        if k in (99, 999):
            gc.collect()
            sizes.append(process.memory_info().rss)
    assert sizes[1] - sizes[0] < 5e6


@pytest.mark.slow
def test_a_thousand_environments_one_after_the_other_leak_nothing():
    process, sizes = psutil.Process(os.getpid()), []
    for k in range(1000):
        with contextlib.closing(bulletuav.parallel_env("hover")) as env:
            env.reset(seed=k)
        if k in (99, 999):
            gc.collect()
            sizes.append(process.memory_info().rss)
    assert sizes[1] - sizes[0] < 10e6


def test_nothing_is_printed(capfd, urdf):
    env = bulletuav.parallel_env("hover", airframe=urdf("cf2x"))
    env.reset(seed=0)
    env.close()
    assert capfd.readouterr() == ("", "")


@pytest.mark.bullet
def test_a_urdf_that_the_engine_cannot_load_is_refused(urdf):
    """Checks before leave little for which it is so: here the file goes after they have passed."""
    path = urdf("cf2x")
    airframe = bulletuav.load_airframe(path)
    path.write_text("<robot")
    with pytest.raises(ValueError, match=r"own.urdf: the engine cannot load it"):
        bulletuav.parallel_env("hover", airframe=airframe)


def is_connected(env):
    """Whether Bullet has anything of an environment."""
    return bool(env.aviary.worlds.engine._open)


@pytest.mark.parametrize("options", [{}, {"dynamics": "bullet"}, {"rays": "bullet"}])
def test_bullet_is_connected_to_when_something_needs_it(options):
    """Compiled dynamics, rays, contacts and pictures do not need it."""
    options = {"dynamics": "rigid_body", **options}
    env = bulletuav.parallel_env("obstacles", num_drones=2, render_mode="rgb_array", **options)
    needs_it = options["dynamics"] == "bullet" or "rays" in options
    assert is_connected(env) == needs_it
    env.reset(seed=0)
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert is_connected(env) == needs_it
    env.render()
    assert is_connected(env) == needs_it
    env.close()
    assert not is_connected(env)


def test_bodies_made_late_are_where_and_as_heavy_as_those_made_at_once():
    """Also after drones were parked, and masses changed."""
    late, soon = (Engine([bulletuav.load_airframe("cf2x")] * 3, 2, 1 / 240) for _ in range(2))
    soon.make_bodies()
    swarm = Swarm.zeros(2, 3, 4)
    swarm.position[:] = np.random.default_rng(0).uniform(1, 5, (2, 3, 3))
    mask = np.array([[True, False, True], [False, True, True]])
    states = []
    for engine in (late, soon):
        engine.set_masses(1, np.full(3, 0.04), np.full((3, 3), 3e-5))
        engine.park(np.ones((2, 3), dtype=bool))
        engine.set_states(swarm, mask)
        made = engine._bullet
        bodies = made.bodies.drone.ravel().tolist()
        poses = [bullet.getBasePositionAndOrientation(one, made.client) for one in bodies]
        masses = [bullet.getDynamicsInfo(one, -1, made.client)[:3] for one in bodies]
        states.append((poses, masses))
        engine.close()
    assert states[0] == states[1]
    assert states[0][1][3][0] == 0.04


def test_a_closed_engine_does_not_connect():
    engine = Engine([bulletuav.load_airframe("cf2x")], 1, 1 / 240)
    engine.close()
    engine.close()
    with pytest.raises(RuntimeError, match="the engine is closed"):
        engine.step()
    assert not engine._open
