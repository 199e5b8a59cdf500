"""Drones of `rigid_body` that are moved together, against each of them alone: to the bit."""

import numpy as np
import pytest

from bulletuav.compiled.lanes import WIDTH
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
