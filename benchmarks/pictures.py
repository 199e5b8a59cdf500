"""Measure pictures of the drones' cameras per second of processor time.

    python benchmarks/pictures.py

Cities of 25, 400 and 2,500 buildings, which are boxes, or prisms with 5 to 8 corners; cameras of
eight drones in streets, 64 in all. Depths alone, segmentation alone, colours alone, all three, the
slowest batch of eight, and PyBullet's TinyRenderer, where it is installed. Then `env.step` of
`lidar_navigation`, with the observation `depth` and without it.

All cases take turns; printed are medians over the rounds. As only processor time counts, other
work on the machine matters little.
"""

import argparse
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import bulletuav
from bulletuav.city.generator import generate
from bulletuav.city.statistics import Statistics
from bulletuav.engine.calls import HAS_BULLET
from bulletuav.engine.engine import Engine
from bulletuav.geometry.raster import Cameras, Images
from bulletuav.geometry.rotation import axes, from_euler
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import CameraMatrices, projection_matrix, view_matrix
from bulletuav.vehicle.swarm import Swarm

URBAN = Statistics(0.3, 500.0, 15.0)
"""Statistics of the cities: fraction of built area, buildings per km^2, scale of heights in m"""
NUM_DRONES = 8
NUM_BATCHES = 8
FIELD_OF_VIEW = 90.0
COLUMNS = ("depth", "segmentation", "rgb", "all", "slowest depth", "TinyRenderer")


def as_prism(box: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the corners of a prism with 5 to 8 corners in plan, inside a box (2, 3)."""
    count = int(rng.integers(5, 9))
    angle = 2 * np.pi * np.arange(count) / count + rng.uniform(-0.2, 0.2, count)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    plan = box.mean(axis=0)[:2] + circle * (box[1] - box[0])[:2] / 2
    return np.concatenate([np.column_stack([plan, np.full(count, z)]) for z in box[:, 2]])


@dataclass
class Scene:
    """A city with drones in its streets.

    Attributes:
        engine: The engine, with one world.
        drones: State and mask of the drones.
        batches: Cameras of the drones at different times.
    """

    engine: Engine
    drones: tuple[Swarm, np.ndarray]
    batches: list[Cameras]


def make_scene(buildings: int, has_prisms: bool) -> Scene:
    """Make a city, and place drones in its streets, looking anywhere with little tilt."""
    rng = np.random.default_rng(buildings)
    side = 1000 * math.sqrt(buildings / URBAN.beta)
    boxes = generate(URBAN, side, rng, 0.0).solids.boxes
    solids = Solids(boxes)
    if has_prisms:
        solids = Solids(boxes[:0], tuple(as_prism(box, rng) for box in boxes))
    airframe = bulletuav.load_airframe("hummingbird")
    engine = Engine([airframe] * NUM_DRONES, 1, 1 / 240, (), (solids,))
    engine.set_layouts(np.zeros(1, dtype=int), np.ones(1, dtype=bool))
    swarm = Swarm.zeros(1, NUM_DRONES, 4)
    batches = []
    for _ in range(NUM_BATCHES):
        eye = np.array([free_place(boxes, side, rng) for _ in range(NUM_DRONES)])
        # Some drones see each other
        eye[1] = eye[0] + [3.0, 0.5, 0.2]
        angles = [(*(0.3 * rng.normal(size=2)), rng.uniform(-np.pi, np.pi)) for _ in eye]
        turn = np.array([from_euler(*map(float, one)) for one in angles])
        swarm.position[0], swarm.quaternion[0] = eye, turn
        index = np.arange(NUM_DRONES)
        world, tangent = np.zeros(NUM_DRONES, dtype=int), np.ones(NUM_DRONES)
        batches.append(Cameras(world, index, eye, turn, tangent, index))
    return Scene(engine, (swarm, np.ones((1, NUM_DRONES), dtype=bool)), batches)


def free_place(boxes: np.ndarray, side: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a place in a street, 5 to 15 m above the ground and 1 m from buildings."""
    while True:
        place = np.append(rng.uniform(-side / 2, side / 2, 2), rng.uniform(5.0, 15.0))
        if not ((place > boxes[:, 0] - 1) & (place < boxes[:, 1] + 1)).all(axis=1).any():
            return place


def blank(size: int, chosen: tuple[str, ...]) -> Images:
    """Allocate the chosen images of a batch."""
    rows = [NUM_DRONES if name in chosen else 0 for name in ("depth", "segmentation", "rgb")]
    return Images(
        np.zeros((rows[0], size, size), dtype=np.float32),
        np.zeros((rows[1], size, size), dtype=np.uint8),
        np.zeros((rows[2], size, size, 3), dtype=np.uint8),
    )


def draw_all(scene: Scene, size: int, chosen: tuple[str, ...]) -> list[float]:
    """Draw all batches, and return the pictures per second of each."""
    images = blank(size, chosen)
    rates = []
    for cameras in scene.batches:
        start = time.process_time()
        scene.engine.pictures(cameras, images, scene.drones)
        rates.append(NUM_DRONES / (time.process_time() - start))
    return rates


def render_some(scene: Scene, size: int) -> float:
    """Return the pictures per second of TinyRenderer, for one batch."""
    projection = projection_matrix(1.0, FIELD_OF_VIEW)
    cameras = scene.batches[0]
    start = time.process_time()
    for eye, turn in zip(cameras.eye, cameras.quaternion, strict=True):
        forward, _, up = (np.array(axis) for axis in axes(turn))
        view = view_matrix(eye, eye + forward, up.tolist())
        scene.engine.picture_by_bullet(0, CameraMatrices(view, projection, (size, size)))
    return NUM_DRONES / (time.process_time() - start)


def median_rate(rates: list[float]) -> float:
    """Return the rate of the median time."""
    return 1 / statistics.median(1 / rate for rate in rates)


def measure_scenes(size: int, rounds: int) -> None:
    """Print a row for each city."""
    whole = ("depth", "segmentation", "rgb")
    kinds = [(count, prisms) for prisms in (False, True) for count in (25, 400, 2500)]
    scenes = {kind: make_scene(*kind) for kind in kinds}
    found: dict[tuple[int, bool], dict[str, list[float]]] = {
        kind: {name: [] for name in COLUMNS} for kind in kinds
    }
    for number in range(rounds + 1):
        for kind, scene in scenes.items():
            row = found[kind]
            for name in COLUMNS[:4]:
                rates = draw_all(scene, size, whole if name == "all" else (name,))
                row[name] += rates
                if name == "depth":
                    row["slowest depth"].append(min(rates))
            if HAS_BULLET and number < 3:
                row["TinyRenderer"].append(render_some(scene, size))
        # The first round compiles, and creates Bullet's bodies
        if number == 0:
            found = {kind: {name: [] for name in COLUMNS} for kind in kinds}
    print(f"\nPictures per second of processor time, {size} x {size}, {NUM_DRONES} drones:\n")
    print(f"| buildings | {' | '.join(COLUMNS)} |")
    print(f"|---|{'---:|' * len(COLUMNS)}")
    for (count, prisms), row in found.items():
        cells = [f"{median_rate(row[name]):,.0f}" if row[name] else "" for name in COLUMNS]
        print(f"| {count:,} {'prisms' if prisms else 'boxes'} | {' | '.join(cells)} |")


def step_time(observation: tuple[str, ...], worlds: int, drones: int) -> Callable[[], float]:
    """Make a function that measures the processor time of a decision, s."""
    env = bulletuav.batch_env(
        "lidar_navigation",
        worlds,
        num_drones=drones,
        num_layouts=1,
        dynamics="point_mass",
        observation=observation,
        camera_size=(128, 128),
    )
    env.reset(seed=0)
    action = np.zeros((worlds, drones, 3), dtype=np.float32)

    def step() -> float:
        start = time.process_time()
        for _ in range(4):
            env.step(action)
        return (time.process_time() - start) / 4

    return step


def measure_steps(rounds: int) -> None:
    """Print the pictures per second of decisions with pictures."""
    print("\nPictures per second of processor time in `env.step`, 128 x 128, `point_mass`:\n")
    print("| worlds | drones | pictures/s | of the step, pictures take |")
    print("|---:|---:|---:|---:|")
    for worlds, drones in ((1, 1), (1, 8), (64, 1)):
        seeing, blind = (
            step_time(observation, worlds, drones)
            for observation in (("velocity", "depth"), ("velocity",))
        )
        pairs = [(seeing(), blind()) for _ in range(rounds + 1)][1:]
        with_pictures, without = (statistics.median(times) for times in zip(*pairs, strict=True))
        rate = worlds * drones / with_pictures
        print(f"| {worlds} | {drones} | {rate:,.0f} | {1 - without / with_pictures:.0%} |")


def main() -> None:
    """Measure, and print tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15, help="rounds of all cases")
    parser.add_argument("--sizes", type=int, nargs="+", default=[128], help="pixels of a side")
    arguments = parser.parse_args()
    for size in arguments.sizes:
        measure_scenes(size, arguments.rounds)
    measure_steps(arguments.rounds)


if __name__ == "__main__":
    main()
