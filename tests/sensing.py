"""Sensors by hand: made, started and driven without an environment."""

import numpy as np

import bulletuav
from bulletuav.engine.calls import HAS_BULLET
from bulletuav.engine.engine import Engine
from bulletuav.sensors.base import Moment, SensorSetup
from bulletuav.vehicle.swarm import Swarm

LEVEL = (0.0, 0, 0, 1)


def open_world(
    layouts=(),
    worlds=1,
    drones=1,
    airframe="hummingbird",
    obstacles=(),
    stands=0,
    rays="compiled",
):
    """An engine in whose worlds those of some layouts stand that `stands` says."""
    airframes = [bulletuav.load_airframe(airframe)] * drones
    engine = Engine(airframes, worlds, 1 / 240, obstacles, layouts, rays=rays)
    if layouts:
        engine.set_layouts(np.broadcast_to(stands, worlds), np.ones(worlds, dtype=bool))
    return engine


def swarm_of(worlds, drones, position=0.0, velocity=0.0, quaternion=LEVEL, rates=0.0):
    """Drones in a state, each part (3,) or more."""
    swarm = Swarm.zeros(worlds, drones, 4)
    swarm.position[:], swarm.quaternion[:] = position, quaternion
    swarm.velocity[:], swarm.rates[:] = velocity, rates
    return swarm


def swarm_at(engine, position, quaternion=LEVEL):
    """The engine's drones at rest at a position, (3,) or more, its bodies in Bullet with them."""
    swarm = swarm_of(*engine.shape, position, quaternion=quaternion)
    if HAS_BULLET:
        engine.set_states(swarm, np.ones(engine.shape, dtype=bool))
    return swarm


def sensor_of(sensor, shape=(1, 1), engine=None, **setup):
    """A sensor, of a class or like an object, that works in W worlds of N drones."""
    one = sensor() if isinstance(sensor, type) else sensor
    return one.attached(SensorSetup(shape=shape, **setup), engine)


def start(sensor, world, swarm, rng=None):
    """Begin an episode of one world, whose drones know their true state."""
    sensor.reset(world, swarm, swarm, rng)


def moment_of(
    swarm,
    before=None,
    mask=None,
    steps=1,
    rngs=None,
    targets=None,
    readings=None,
    action=None,
):
    """The moment after a decision of the drones of `mask`, by default all; a reset with steps=0."""
    worlds, drones, _ = swarm.position.shape
    return Moment(
        before=swarm if before is None else before,
        after=swarm,
        targets=np.zeros((worlds, 0, 3)) if targets is None else targets,
        mask=np.ones((worlds, drones), dtype=bool) if mask is None else np.array(mask),
        steps=np.broadcast_to(steps, worlds).copy(),
        rngs=[None] * worlds if rngs is None else rngs,
        readings={} if readings is None else readings,
        action=np.zeros((worlds, drones, 0)) if action is None else action,
    )


def measure(sensor, swarm, **moment):
    """What a sensor reads at a moment."""
    return sensor.measure(moment_of(swarm, **moment))
