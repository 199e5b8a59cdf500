"""Drones of `rigid_body` that are moved together, against each of them alone: to the bit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bulletuav import load_airframe
from bulletuav.compiled.lanes import WIDTH
from bulletuav.control.autopilot import AUTOPILOT_MEMORY, WING_BORNE
from bulletuav.control.setpoint import SetpointLevel

KINDS = ("high", "near the ground", "tumbling", "resting", "absent", "falling")
DECISIONS = 4


def begin(bench, states, rows, alive):
    """Give a bench the states (W, N, ...) and constants of its drones."""
    for array, new in zip(bench.swarm, states, strict=True):
        array[:] = new
    bench.dynamics.flight.parameters[:] = rows
    bench.alive[:] = alive
    bench.place()


def draw(bench, rng):
    """Put drones of all kinds at random; returns what `begin` takes."""
    swarm, shape = bench.swarm, bench.alive.shape
    kind = np.arange(bench.alive.size).reshape(shape) % len(KINDS)
    rows = bench.dynamics.flight.parameters.copy()
    for name in ("mass", "inertia", "lag_up", "drag_xy", "ground_effect_reach"):
        rows[name] *= rng.uniform(0.8, 1.2, rows[name].shape)
    rows["ground_effect_fade"] = 1.0 / rows["ground_effect_reach"]
    swarm.velocity[:] = rng.normal(size=swarm.velocity.shape)
    swarm.rates[:] = rng.normal(size=swarm.rates.shape)
    swarm.quaternion[:] += 0.2 * rng.normal(size=swarm.quaternion.shape)
    low, height = bench.airframe.shape.half[2], bench.dynamics.flight.parameters["arm"]
    near = kind == KINDS.index("near the ground")
    swarm.position[near, 2] = 1.2 * height[near]
    swarm.rates[kind == KINDS.index("tumbling")] *= 100
    swarm.position[kind == KINDS.index("falling"), 2] = 0.3
    resting = kind == KINDS.index("resting")
    swarm.position[resting, 2] = low + 2e-4
    for array in (swarm.velocity, swarm.rates, swarm.rotor_speed):
        array[resting] = 0
    swarm.quaternion[resting] = 0, 0, 0, 1
    swarm.quaternion[:] /= np.linalg.norm(swarm.quaternion, axis=-1, keepdims=True)
    alive = kind != KINDS.index("absent")
    return [array.copy() for array in swarm], rows, alive


@pytest.mark.parametrize("level", [SetpointLevel.ROTOR, SetpointLevel.VELOCITY])
@pytest.mark.parametrize(
    "shape",
    [
        (1, 2),
        (1, WIDTH - 1),
        (1, WIDTH),
        (1, WIDTH + 1),
        (3, 5),
        (3, 12),
        (2 * WIDTH, 1),
        (2, 4 * WIDTH + 3),
    ],
)
def test_drones_that_are_moved_together_fly_as_each_alone(make_bench, shape, level):
    worlds, drones = shape
    rng = np.random.default_rng(worlds * 100 + drones)
    options = {"effects": ("lag", "drag", "body_drag", "damping", "rotor_inertia", "ground_effect")}
    many = make_bench("rigid_body", worlds=worlds, drones=drones, **options)
    alone = make_bench("rigid_body", **options)
    states, rows, alive = draw(many, rng)
    full = many.airframe.hover_speed()
    scale = full if level == SetpointLevel.ROTOR else 2.0
    setpoints = scale * rng.uniform(0.0, 2.0, (DECISIONS, *shape, 4))
    setpoints[:, np.arange(worlds * drones).reshape(shape) % len(KINDS) == 3] = 0.0

    begin(many, states, rows, alive)
    for setpoint in setpoints:
        many.fly(level, setpoint)
    assert np.isfinite(many.swarm.position).all()
    for w, i in np.ndindex(shape):
        begin(alone, [array[w, i] for array in states], rows[w, i], alive[w, i])
        for setpoint in setpoints:
            alone.fly(level, setpoint[w, i])
        for name, got, expected in zip(many.swarm._fields, many.swarm, alone.swarm, strict=True):
            assert got[w, i].tobytes() == expected[0, 0].tobytes(), (w, i, name)


def draw_resting(bench, rows, rng):
    """Draw two drones on the ground and one above, for each world; returns what `begin` takes."""
    swarm, shape = bench.swarm, bench.alive.shape
    rows = rows.copy()
    for name in ("mass", "inertia", "lag_up", "lag_down", "drag_height", "wake_share"):
        rows[name] *= rng.uniform(0.8, 1.2, rows[name].shape)
    for array in (swarm.velocity, swarm.rates, swarm.rotor_speed):
        array[:] = 0
    swarm.position[:] = 0
    swarm.position[..., 0] = 5 * np.arange(shape[1])
    swarm.position[..., 2] = bench.airframe.shape.half[2] + 5e-5
    swarm.position[:, 2] = swarm.position[:, 0] + rng.uniform(-0.2, 0.2, (shape[0], 3))
    swarm.position[:, 2, 2] += rng.uniform(0.5, 1.0, shape[0])
    yaw = rng.uniform(-np.pi, np.pi, shape)
    swarm.quaternion[:] = 0
    # Some lie upside down
    side = rng.random(shape) < 0.3
    swarm.quaternion[..., 0] = np.where(side, np.cos(yaw / 2), 0)
    swarm.quaternion[..., 1] = np.where(side, np.sin(yaw / 2), 0)
    swarm.quaternion[..., 2] = np.where(side, 0, np.sin(yaw / 2))
    swarm.quaternion[..., 3] = np.where(side, 0, np.cos(yaw / 2))
    swarm.rotor_speed[:, 2] = bench.airframe.hover_speed()
    return [array.copy() for array in swarm], rows, np.ones(shape, dtype=bool)


def test_forces_on_sleeping_drones_are_those_of_each_alone(make_bench):
    """Blocks of several worlds compute them together, a world of two sleeping drones does not."""
    worlds = 2 * WIDTH
    options = {"drones": 3, "substeps": 6}
    many = make_bench("rigid_body", "cf2x", worlds=worlds, **options)
    one = make_bench("rigid_body", "cf2x", **options)
    mean = many.dynamics.flight.parameters.copy()
    counts = {"stayed": 0, "woke": 0}

    def fly(bench, drawn, world, setpoints):
        begin(bench, *drawn(world))
        seen = []
        for setpoint in setpoints:
            bench.fly(SetpointLevel.ROTOR, setpoint[world])
            contact = bench.dynamics.contact
            impulse = np.where(contact.touches.number > 0, contact.touches.impulse[..., 0], 0.0)
            # Written in the first substep of sleep
            known = contact.asleep & ~np.isnan(contact.load[..., 0])
            load = np.where(known[..., None], contact.load, 0.0)
            arrays = (*bench.swarm, contact.asleep, impulse, load)
            seen.append([array.copy() for array in arrays])
        return seen

    @settings(max_examples=8)
    @given(st.integers(0, 2**32 - 1), st.floats(0.5, 2.5))
    @example(0, 2.4)  # in which many wake
    def check(seed, throttle):
        rng = np.random.default_rng(seed)
        states, rows, alive = draw_resting(many, mean, rng)
        full = many.airframe.hover_speed()
        setpoints = throttle * full * rng.uniform(0.0, 1.0, (8, worlds, 3, 4))
        setpoints[:, :, 2] = full
        setpoints[:3, :, :2] = 0.0

        def drawn(world):
            return [array[world] for array in states], rows[world], alive[world]

        together = fly(many, drawn, slice(None), setpoints)
        slept = together[2][6]
        assert slept[:, :2].all()
        for now, before in zip(together[3:], together[2:], strict=False):
            counts["stayed"] += (now[6] & before[6]).sum()
            counts["woke"] += (~now[6] & before[6]).sum()
        for world in range(worlds):
            alone = fly(one, drawn, slice(world, world + 1), setpoints)
            for k, (all_worlds, single) in enumerate(zip(together, alone, strict=True)):
                for number, (got, expected) in enumerate(zip(all_worlds, single, strict=True)):
                    assert got[world].tobytes() == expected[0].tobytes(), (k, world, number)

    check()
    assert counts["stayed"] > 100
    assert counts["woke"] > 10


@pytest.mark.parametrize("airframe", ["trainer", "quadplane"])
def test_wings_that_stall_in_some_lanes_fly_as_each_alone(make_bench, airframe):
    shape = 3, WIDTH + 1
    many = make_bench("rigid_body", airframe, worlds=shape[0], drones=shape[1])
    alone = make_bench("rigid_body", airframe)
    rng = np.random.default_rng(5)
    swarm = many.swarm
    swarm.position[..., 0] *= 10.0
    swarm.velocity[..., 0] = 13.0
    # Down to an angle of attack of 50 degrees, and some fly backward
    swarm.velocity[..., 2] = rng.choice([0.0, 0.0, -4.0, -15.0], shape)
    swarm.velocity[..., 0] *= rng.choice([1.0, 1.0, 1.0, -1.0], shape)
    swarm.rates[:] = rng.normal(scale=0.3, size=swarm.rates.shape)
    states = [array.copy() for array in swarm]
    rows, alive = many.dynamics.flight.parameters.copy(), many.alive.copy()
    full = [many.airframe.max_rotor_speed] * len(many.airframe.rotors)
    most = [full + [surface.high for surface in many.airframe.surfaces]]
    setpoints = np.array(most) * rng.uniform(0.0, 1.0, (DECISIONS, *shape, np.size(most)))

    begin(many, states, rows, alive)
    for setpoint in setpoints:
        many.fly(SetpointLevel.ROTOR, setpoint)
    for w, i in np.ndindex(shape):
        begin(alone, [array[w, i] for array in states], rows[w, i], alive[w, i])
        for setpoint in setpoints:
            alone.fly(SetpointLevel.ROTOR, setpoint[w, i])
        for name, got, expected in zip(swarm._fields, swarm, alone.swarm, strict=True):
            assert got[w, i].tobytes() == expected[0, 0].tobytes(), (w, i, name)


def draw_winged(bench, names, rng):
    """Put aircraft with wings in cruise, hover and a dive; some are absent."""
    swarm, shape = bench.swarm, bench.alive.shape
    swarm.position[:] = 0
    swarm.position[..., 0] = 200 * np.arange(shape[1])
    swarm.position[..., 2] = 500
    speeds = np.where(np.array(names) == "trainer", 13.0, 14.0) * np.ones(shape)
    hovers = (rng.random(shape) < 0.3) & (np.array(names) != "trainer")
    speeds[hovers] = rng.uniform(0.0, 3.0, hovers.sum())
    swarm.velocity[:] = rng.normal(scale=0.5, size=swarm.velocity.shape)
    swarm.velocity[..., 0] += speeds
    swarm.velocity[..., 2] -= rng.choice([0.0, 0.0, 0.0, 9.0], shape)
    swarm.rates[:] = rng.normal(scale=0.3, size=swarm.rates.shape)
    swarm.quaternion[:] = (0, 0, 0, 1)
    swarm.quaternion[:] += 0.1 * rng.normal(size=swarm.quaternion.shape)
    swarm.quaternion[:] /= np.linalg.norm(swarm.quaternion, axis=-1, keepdims=True)
    bench.wind[:] = rng.normal(scale=2.0, size=bench.wind.shape)
    alive = rng.random(shape) < 0.85
    alive[0, 0] = True
    return [array.copy() for array in swarm], bench.dynamics.flight.parameters.copy(), alive


def draw_setpoint(level, names, shape, rng):
    """Draw setpoints of a level (W, N, 4) that change the direction, and fly to and from hover."""
    value = rng.normal(size=(*shape, 4))
    if level == SetpointLevel.POSITION:
        return value * (200.0, 200.0, 10.0, 1.0) + (0.0, 0.0, 500.0, 0.0)
    if level == SetpointLevel.VELOCITY:
        return value * (3.0, 3.0, 1.0, 1.0) + rng.choice([0.0, 15.0], (*shape, 1)) * (1, 0, 0, 0)
    if level == SetpointLevel.ACCELERATION:
        return value * (2.0, 2.0, 0.5, 1.0)
    weight = np.where(np.array(names) == "trainer", 3.0, 25.0)
    thrust = weight * rng.uniform(0.5, 1.2, shape)
    return np.concatenate([0.3 * value[..., :3], thrust[..., None]], axis=-1)


WINGED_LEVELS = [level for level in SetpointLevel if level != SetpointLevel.ROTOR]


@pytest.mark.parametrize("level", WINGED_LEVELS)
@pytest.mark.parametrize("airframe", ["trainer", "quadplane"])
@pytest.mark.parametrize("shape", [(1, 2), (3, WIDTH + 1)])
def test_autopilots_that_run_together_fly_as_each_alone(make_bench, airframe, shape, level):
    """At all levels, with transitions, and with absent aircraft; their memories, too."""
    check_as_alone(make_bench, (airframe,) * shape[1], shape[0], level)


def test_autopilots_of_mixed_fleets_fly_as_each_alone(make_bench):
    """Blocks of one airframe, and blocks with several."""
    fleet = ("quadplane",) * (WIDTH + 2) + ("trainer",) * 3 + ("cf2x",) * WIDTH + ("quadplane",)
    check_as_alone(make_bench, fleet, 2, SetpointLevel.VELOCITY)


def test_surfaces_without_an_autopilot_stay_still(make_bench):
    """The autopilot of other blocks does not move surfaces of aircraft that it does not fly."""
    unguided = replace(load_airframe("quadplane"), name="unguided", forward_rotors=())
    bench = make_bench("rigid_body", ("quadplane",) * WIDTH + (unguided,) * WIDTH)
    bench.swarm.position[..., 0] *= 20
    bench.swarm.velocity[..., 0] = 14.0
    bench.place().fly(SetpointLevel.VELOCITY, (14.0, 1.0, 0.0, 0.0), 3)
    assert bench.swarm.deflection[0, :WIDTH].any()
    assert not bench.swarm.deflection[0, WIDTH:].any()


def check_as_alone(make_bench, names, worlds, level):
    shape = worlds, len(names)
    rng = np.random.default_rng(11)
    # 12 substeps are no multiple of the period of the outer loops
    many = make_bench("rigid_body", names, worlds=worlds, substeps=12)
    states, rows, alive = draw_winged(many, names, rng)
    begin(many, states, rows, alive)
    memory = many.dynamics.flight.cascade.memory
    setpoints, borne = [draw_setpoint(level, names, shape, rng) for _ in range(8)], []
    for setpoint in setpoints:
        many.fly(level, setpoint)
        borne.append(memory[..., memory.shape[2] - AUTOPILOT_MEMORY + WING_BORNE].copy())
    assert np.isfinite(many.swarm.position).all()
    if level <= SetpointLevel.VELOCITY and "quadplane" in names:
        # Some changed from one kind of flight to the other
        assert len(np.unique(borne)) == 2
        assert (np.diff(borne, axis=0) != 0).any()
    for airframe in sorted(set(names)):
        alone = make_bench("rigid_body", airframe, substeps=12)
        own = [array.shape[2] for array in alone.swarm]
        for w, i in np.ndindex(shape):
            if names[i] != airframe:
                continue
            cut = [array[w, i, :size] for array, size in zip(states, own, strict=True)]
            alone.wind[:] = many.wind[w, i]
            alone.dynamics.flight.cascade.memory[:] = 0
            begin(alone, cut, rows[w, i], alive[w, i])
            for setpoint in setpoints:
                alone.fly(level, setpoint[w, i])
            pairs = zip(many.swarm._fields, many.swarm, alone.swarm, strict=True)
            for name, got, expected in pairs:
                together = got[w, i, : expected.shape[2]]
                assert together.tobytes() == expected[0, 0].tobytes(), (w, i, name)
            if airframe != "cf2x":
                single = alone.dynamics.flight.cascade.memory[0, 0]
                assert memory[w, i].tobytes() == single.tobytes(), (w, i)
