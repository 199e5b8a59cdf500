"""bulletuav itself, in the cases of the others."""

from functools import partial
from typing import ClassVar

import numpy as np
import pybullet
from gymnasium.vector import AutoresetMode
from serve import grid, serve

import bulletuav
from bulletuav.analysis.benchmark import SUBSTEPS, make_engine_cases, make_hovering_aviary
from bulletuav.city.generator import generate
from bulletuav.city.statistics import KINDS
from bulletuav.compiled.deferred import compile_deferred
from bulletuav.engine.calls import VISIBLE
from bulletuav.engine.engine import Engine
from bulletuav.envs.gymnasium import CentralAviary
from bulletuav.geometry.raster import Cameras, Images
from bulletuav.sensors.lidar import make_beams, make_rays
from bulletuav.tasks.lidar_navigation import LidarNavigation
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.swarm import Swarm

CITY = {"num_drones": 3, "num_beams": 16, "max_range": 60.0}
# A decision in one piece.
PIECE = {"dynamics": "single_integrator", "physics_hz": 10}
# Steps, ends and volume of urbanmarl.
URBANMARL_CITY = {
    "dynamics": "single_integrator",
    "physics_hz": 1,
    "decision_hz": 1,
    "horizon": 100,
    "contact_ends": "world",
    "boundary": "hard",
    "height": (20.0, 120.0),
    "ceiling": 200.0,
}
# Sizes and steps of urbanmarl.
EDGE = {
    "num_drones": 3,
    "num_users": 50,
    "decision_hz": 1,
    "autoreset_mode": AutoresetMode.SAME_STEP,
}
RAYS = 256 * 3 * 16  # of 256 worlds with 3 drones of 16 beams


def flight(worlds: int, drones: int, dynamics: str, **options):
    """Take whole steps: controllers, all forces, engine, contacts, observation, reward."""
    aviary = make_hovering_aviary(worlds, drones, dynamics, **options)
    return partial(aviary.step, np.zeros((worlds, drones, 3))), worlds * drones * SUBSTEPS


def pictures(drones: int):
    """Take the pictures of all drones' cameras, with 128 x 128 pixels."""
    engine = Engine([load_airframe("cf2x")] * drones, 1, 1 / 240)
    swarm = Swarm.zeros(1, drones, 4)
    swarm.position[0] = grid(drones)
    swarm.quaternion[..., 3] = 1.0
    cameras = Cameras(
        world=np.zeros(drones, dtype=np.int64),
        drone=np.arange(drones),
        eye=swarm.position[0] + [0.1, 0.0, 0.0],
        quaternion=swarm.quaternion[0],
        tangent=np.ones(drones),
        slot=np.arange(drones),
    )
    size = (drones, 128, 128)
    images = Images(
        depth=np.zeros(size, dtype=np.float32),
        labels=np.zeros(size, dtype=np.uint8),
        colours=np.zeros((*size, 3), dtype=np.uint8),
    )
    shown = np.ones((1, drones), dtype=bool)
    return partial(engine.pictures, cameras, images, (swarm, shown)), drones


def reset(drones: int):
    """Reset one world."""
    return partial(make_hovering_aviary(1, drones, "bullet").reset, seeds=0), 1


def crossing(drones: int):
    """Fly the PettingZoo environment, and reset it when an agent is done."""
    env = bulletuav.parallel_env("crossing", num_drones=drones, horizon=10**9, randomization={})
    env.reset(seed=0)
    actions = {agent: np.zeros(3, dtype=np.float32) for agent in env.agents}

    def step() -> None:
        if len(env.agents) < drones:
            env.reset()
        env.step(actions)

    return step, drones * SUBSTEPS


def decide(drones: int, hz: int, dynamics: str = "bullet"):
    """Fly `hover` in the PettingZoo form with the rotor speeds of hover, in short decisions.

    The rate is in decisions.
    """
    env = bulletuav.parallel_env("hover", num_drones=drones, dynamics=dynamics, **hovering_at(hz))
    env.reset(seed=0)
    actions = {agent: np.zeros(4, dtype=np.float32) for agent in env.agents}

    def step() -> None:
        if len(env.agents) < drones:
            env.reset()
        env.step(actions)

    return step, 1


def decide_alone(hz: int):
    """Do what `decide` does with one drone in the Gymnasium form."""
    env = CentralAviary("hover", **hovering_at(hz))
    env.reset(seed=0)
    action = np.zeros(4, dtype=np.float32)

    def step() -> None:
        if env.step(action)[2]:
            env.reset()

    return step, 1


def own_loop(drones: int, hz: int):
    """Command the rotor speeds of hover from a loop of one's own, without a task.

    The rate is in steps.
    """
    start = np.array(grid(drones))
    airspace = bulletuav.Airspace(start, decision_hz=hz, seed=0)
    speeds = airspace.hover_speed
    airspace.place(None, start, rotor_speed=speeds)

    def step() -> None:
        airspace.command(None, bulletuav.SetpointLevel.ROTOR, speeds)
        airspace.step()

    return step, 1


def random_rotors(percent: int):
    """Fly swarms by random rotor speeds up to a share of their range, resets among them."""
    options = {"dynamics": "rigid_body", "action": "hover_rpm", "decision_hz": 240}
    step, worlds = random_flight("hover", 64, 0, percent / 100, num_drones=8, **options)
    return step, 8 * worlds


def hovering_at(hz: int) -> dict:
    """Options of `hover` for rotor speeds about those of hover, at so many decisions a second."""
    return {"action": "hover_rpm", "decision_hz": hz, "horizon": 10**9}


def batched_crossing(worlds: int, drones: int):
    """Fly the batched environment with the cheapest dynamics, to compare with point masses.

    The rate is in agent-decisions.
    """
    env = bulletuav.batch_env(
        "crossing", worlds, num_drones=drones, dynamics="single_integrator", randomization={}
    )
    env.reset(seed=0)
    return partial(env.step, np.zeros((worlds, drones, 3))), worlds * drones


def floor(worlds: int, drones: int):
    """Take steps of the engine alone, in C, with a wrench and a state of every drone."""
    engine, cases = make_engine_cases(worlds, drones)
    if not engine.ports:
        raise RuntimeError("needs the C extension: see `bulletuav doctor`")
    return cases["engine calls"], worlds * drones * SUBSTEPS


def random_flight(task: str, worlds: int, settle: int, share: float = 1.0, **options):
    """Fly a task with random actions up to a share of their range.

    First come `settle` steps, after which worlds begin anew at different times.
    """
    env = bulletuav.batch_env(task, worlds, **options)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    shape = (worlds, env.num_drones, *env.action_space.shape)

    def step() -> None:
        env.step(rng.uniform(-share, share, shape))

    for _ in range(settle):
        step()
    return step, worlds


class Blind(LidarNavigation):
    """`lidar_navigation` without a range finder, and without the reward term that needs it."""

    name = "blind_navigation"
    observation = tuple(block for block in LidarNavigation.observation if block != "lidar")
    required_sensors = ()
    reward: ClassVar = {
        term: weight for term, weight in LidarNavigation.reward.items() if term != "proximity"
    }


def city_hover(task: str | type, worlds: int):
    """Hover at the start, so that all drones fly on. The rate is in environment steps."""
    env = bulletuav.batch_env(task, worlds, horizon=10**9, battery_capacity=None, **CITY, **PIECE)
    env.reset(seed=0)
    return partial(env.step, np.zeros((worlds, env.num_drones, *env.action_space.shape))), worlds


def beams_alone(worlds: int):
    """Cast the rays of `city_hover` in one call of C, and nothing else.

    The rate is in environment steps.
    """
    aviary = bulletuav.batch_env("lidar_navigation", worlds, **CITY, **PIECE).aviary
    aviary.reset(seeds=0)
    engine = Engine(
        aviary.options.airframe, worlds, 1 / 10, layouts=aviary.task.layouts(), rays="bullet"
    )
    everyone = np.ones(engine.shape, dtype=bool)
    engine.set_layouts(aviary.scene.layout, everyone[:, 0])
    azimuth = np.radians([beam.azimuth for beam in make_beams(CITY["num_beams"], (0.0,))])
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
    swarm = aviary.swarm
    rays = make_rays(
        swarm.position, swarm.quaternion, everyone, directions, CITY["max_range"], True
    )
    return in_c(engine, *rays), worlds


def in_c(engine: Engine, start: np.ndarray, end: np.ndarray, tile: np.ndarray):
    """Cast rays by a call of the C extension alone."""
    port = engine.surface_port
    if port is None:
        raise RuntimeError("needs the C extension: see `bulletuav doctor`")
    start = start + port.offset[tile, 0]
    end = end + port.offset[tile, 0]
    fraction = np.empty(len(start))
    first, last, result = (array.ctypes.data for array in (start, end, fraction))

    # C has pointers into the arrays, so these must live as long as the call.
    def call(_kept=(engine, start, end, fraction)) -> None:
        port.rays(port.session, len(start), first, last, VISIBLE, result)

    return call


def street_rays(buildings: int, how: str):
    """Cast level rays of 60 m from random places outdoors in a city of so many buildings.

    Args:
        buildings: Their number, about.
        how: What casts them: "bulletuav", "C" (its extension alone) or "pybullet".
    """
    rng = np.random.default_rng(0)
    side = round(buildings**0.5) * KINDS["urban"].pitch
    city = generate("urban", side, rng)
    places = rng.uniform((-side / 2, -side / 2, 5), (side / 2, side / 2, 25), (4 * RAYS, 3))
    start = places[city.outdoors(places, 1.0)][:RAYS]
    azimuth = rng.uniform(-np.pi, np.pi, RAYS)
    end = start + CITY["max_range"] * np.stack(
        [np.cos(azimuth), np.sin(azimuth), np.zeros(RAYS)], axis=1
    )
    if how == "pybullet":
        client = _mesh_client(city.solids)
        return partial(
            pybullet.rayTestBatch, start, end, numThreads=1, physicsClientId=client
        ), RAYS
    rays = "bullet" if how == "C" else "compiled"
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240, layouts=[city.solids], rays=rays)
    tile = np.zeros(RAYS, dtype=np.int64)
    engine.set_layouts(tile[:1], np.ones(1, dtype=bool))
    if how == "C":
        return in_c(engine, start, end, tile), RAYS
    return partial(engine.cast_rays, start, end, tile), RAYS


def _mesh_client(solids) -> int:
    """Make a client of pybullet with nothing in it but the mesh of a city."""
    client = pybullet.connect(pybullet.DIRECT)
    vertices, triangles = solids.mesh
    mesh = pybullet.createCollisionShape(
        pybullet.GEOM_MESH,
        vertices=vertices.tolist(),
        indices=triangles.ravel().tolist(),
        flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        physicsClientId=client,
    )
    pybullet.createMultiBody(0, mesh, physicsClientId=client)
    return client


def in_cities():
    """Make the cases of cities.py."""
    cases = {
        "blind, 256": partial(city_hover, Blind, 256),
        "48 rays in C, 256": partial(beams_alone, 256),
    }
    cases["beams, 256"] = partial(city_hover, "lidar_navigation", 256)
    for buildings in (100, 400, 2500):
        for how in ("bulletuav", "C", "pybullet"):
            cases[f"rays, {how}, {buildings}"] = partial(street_rays, buildings, how)
    city = partial(random_flight, "lidar_navigation", **CITY)
    for worlds in (1, 64, 256):
        cases[f"city, {worlds}"] = partial(city, worlds, 600, **PIECE)
        cases[f"city at 240 Hz, {worlds}"] = partial(
            city, worlds, 600, dynamics="single_integrator"
        )
        cases[f"city by the second, {worlds}"] = partial(city, worlds, 100, **URBANMARL_CITY)
    cases["city in the engine, 256"] = partial(city, 256, 10, dynamics="bullet")
    return cases


def at_the_edge():
    """Make the cases of edge.py."""
    mec = partial(random_flight, "mec", **EDGE)
    cases = {"mec in the engine, 256": partial(mec, 256, 10, dynamics="bullet")}
    for worlds in (1, 64, 256):
        cases[f"mec, {worlds}"] = partial(mec, worlds, 300)
        cases[f"mec as urbanmarl, {worlds}"] = partial(mec, worlds, 300, preset="urbanmarl")
    return cases


if __name__ == "__main__":
    serve(
        {
            "bullet, 10": partial(flight, 1, 10, "bullet"),
            "bullet, 100": partial(flight, 1, 100, "bullet"),
            "bullet, 1000": partial(flight, 1, 1000, "bullet"),
            "bullet, 64 x 8": partial(flight, 64, 8, "bullet"),
            "rigid_body with PID, 64 x 8": partial(flight, 64, 8, "rigid_body", controller="pid"),
            "crossing, 8": partial(crossing, 8),
            "random rotors, 10 %": partial(random_rotors, 10),
            "random rotors, 100 %": partial(random_rotors, 100),
            "crossing of points, 64 x 8": partial(batched_crossing, 64, 8),
            **{
                f"PettingZoo, {drones}, {hz} Hz": partial(decide, drones, hz)
                for drones in (1, 10, 100)
                for hz in (240, 48, 30, 10)
            },
            "Gymnasium, 240 Hz": partial(decide_alone, 240),
            **{
                f"Airspace, {drones}, {hz} Hz": partial(own_loop, drones, hz)
                for drones in (1, 10, 50)
                for hz in (240, 48)
            },
            "reset, 10": partial(reset, 10),
            "pictures, 8": partial(pictures, 8),
            "floor, 64 x 8": partial(floor, 64, 8),
            **in_cities(),
            **at_the_edge(),
        },
        compile_deferred,
    )
