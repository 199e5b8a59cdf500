"""No drone passes through a city: random shots of every airframe at walls, edges and roofs."""

import numpy as np
import pytest
from bench import ranges, rims
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.geometry.solids import Solids
from bulletuav.vehicle.swarm import CITY

PITCH = 40.0  # m, between pieces
REACH = 2.0  # m, from where a shot is fired to where it hits
LOWEST = 1.0  # m: nothing is fired or hits below, where the ground would be in the way


def block(size, turn=0.0, lift=0.0):
    """Corners (8, 3) of a box about the z axis, from `lift` m up, turned by `turn` degrees."""
    half = np.array(size) / 2
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half + (
        0,
        0,
        half[2] + lift,
    )
    return Rotation.from_euler("z", turn, degrees=True).apply(corners)


def house():
    """Walls 4 m high under a gabled roof, whose ridge is 7 m high; the whole turned."""
    gables = np.array([(x, 0.0, 7.0) for x in (-5, 5)])
    return Rotation.from_euler("z", 25, degrees=True).apply(
        np.concatenate([block((10, 6, 4)), gables])
    )


BOXES = (
    block((10, 8, 12)),
    block((0.2, 8, 10)),
    block((8, 8, 0.2), lift=5),
)  # a building, a thin wall, a thin roof
HULLS = (house(), block((0.2, 8, 10), 30), block((3, 3, 9), 45), block((8, 5, 0.2), 15, lift=5))
PIECES = [piece + (PITCH * k, 0, 0) for k, piece in enumerate(BOXES + HULLS)]
SOLIDS = Solids(
    np.array([(piece.min(axis=0), piece.max(axis=0)) for piece in PIECES[: len(BOXES)]]),
    tuple(PIECES[len(BOXES) :]),
)


def crosses(planes, start, end, slack):
    """Tell (M,) which ways from start to end (M, 3) get `slack` m deep into a convex piece."""
    begin, stop = (points @ planes[:, :3].T + planes[:, 3] + slack for points in (start, end))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = begin / (begin - stop)  # where the way meets each plane
    enter = np.where(begin > 0, np.where(stop > 0, np.inf, share), 0.0).max(axis=1)
    leave = np.where(begin > 0, 1.0, np.where(stop > 0, share, 1.0)).min(axis=1)
    return enter < leave


def deepest(planes, airframe, position, quaternion):
    """Tell how deep the rim of any of M drones is in a piece, m; below 0 if none is."""
    points = rims(airframe)
    around = Rotation.from_quat(np.repeat(quaternion, len(points), axis=0)).apply(
        np.tile(points, (len(position), 1))
    )
    places = around + np.repeat(position, len(points), axis=0)
    return -(places @ planes[:, :3].T + planes[:, 3]).max(axis=1).min()


def events(piece, rng, count):
    """Draw where shots hit and whence they come, (count, 3) each.

    Half of them hit faces, half edges, from anywhere outside.
    """
    hull = ConvexHull(piece)
    target, aim = np.empty((2, count, 3))
    for k in range(count):
        while True:
            face = rng.integers(len(hull.simplices))
            share = rng.dirichlet((1, 1, 1)) * (
                1,
                1,
                k % 2,
            )  # of its corners; two of them make an edge
            target[k] = share @ piece[hull.simplices[face]] / share.sum()
            near = hull.equations[
                np.abs(hull.equations[:, :3] @ target[k] + hull.equations[:, 3]) < 1e-9
            ]
            away = rng.normal(size=3)
            away /= np.linalg.norm(away)
            begin = target[k] + REACH * away
            outside = (
                hull.equations[:, :3] @ begin + hull.equations[:, 3]
            ).max() > 0.6  # no drone's radius is greater
            if (
                min(target[k, 2], begin[2]) > LOWEST
                and outside
                and (near[:, :3] @ away > 0.2).all()
            ):
                break
        aim[k] = -away
    return target, aim


def range_of_shots(make_bench, dynamics, airframe, shots, contacts):
    """Make a bench whose world k is one shot at piece k mod 7, at 5 to 40 m/s."""
    options = {"worlds": shots, "effects": (), "substeps": 1, "max_speed": 100.0, "gravity": 0.0}
    bench = make_bench(dynamics, airframe, layouts=(SOLIDS,), contacts=contacts, **options)
    bench.engine.set_layouts(np.zeros(shots, dtype=int), np.ones(shots, dtype=bool))
    rng = np.random.default_rng(0)
    bench.chosen = np.arange(shots) % len(PIECES)
    bench.speed = rng.uniform(5, 40, shots)
    for k, piece in enumerate(PIECES):
        mine = bench.chosen == k
        target, aim = events(piece, rng, mine.sum())
        bench.swarm.position[mine, 0] = target - REACH * aim
        bench.swarm.velocity[mine, 0] = bench.speed[mine, None] * aim
    bench.swarm.quaternion[:, 0] = Rotation.random(shots, rng=rng).as_quat()
    bench.swarm.rotor_speed[:] = 0
    return bench.place()


@pytest.mark.parametrize(("airframe", "dynamics", "contacts", "shots"), list(ranges(18)))
def test_no_shot_passes(make_bench, airframe, dynamics, contacts, shots):
    """No drone's centre gets into a piece on its way, and no part of it at the end of a substep.

    The way of one that tumbles over an edge is not straight: a line from end to end may cut off
    half the drone's thickness.
    """
    bench = range_of_shots(make_bench, dynamics, airframe, shots, contacts)
    setpoint = {
        SetpointLevel.ROTOR: np.zeros((shots, 1, 6)),
        SetpointLevel.VELOCITY: np.concatenate(
            [bench.swarm.velocity, np.zeros((shots, 1, 1))], axis=-1
        ),
        SetpointLevel.ACCELERATION: np.zeros((shots, 1, 4)),
    }[bench.dynamics.consumes]
    planes = [ConvexHull(piece).equations for piece in PIECES]
    slack = bench.airframe.thinnest / 2 if contacts == "impulse" else 0.0
    met = np.zeros((shots, 1), dtype=bool)
    places, attitudes = [bench.swarm.position[:, 0].copy()], []
    for _ in range(int(np.ceil(2 * REACH / 5 * 240))):
        bench.alive &= ~met if contacts == "stop" else True
        touched = bench.dynamics.fly(
            bench.swarm, bench.alive, bench.dynamics.consumes, setpoint, bench.wind, bench.motion
        )
        assert set(touched.other[~met[touched.world, 0]]) <= {CITY}
        met |= touched.mask(met.shape)
        places.append(bench.swarm.position[:, 0].copy())
        attitudes.append(bench.swarm.quaternion[:, 0].copy())
    assert met.all()
    # All substeps of a piece's shots at once
    for k, sides in enumerate(planes):
        mine = bench.chosen == k
        before, now = (
            np.concatenate([one[mine] for one in of]) for of in (places[:-1], places[1:])
        )
        assert not crosses(sides, before, now, slack).any()
        attitude = np.concatenate([one[mine] for one in attitudes])
        assert deepest(sides, bench.airframe, now, attitude) < 0
    if contacts == "stop":
        assert not bench.swarm.velocity.any()


def test_a_pass_is_known_when_it_is_seen():
    """Through a thin wall at x = 40, into it, along it, over it, away, and not as deep as that."""
    planes = ConvexHull(PIECES[1]).equations
    start = np.array(
        [(39.0, 0, 5), (39, 0, 5), (39.88, -9, 5), (39, 0, 10.1), (39, 0, 5), (39, 0, 5)]
    )
    end = np.array(
        [(41.0, 0, 5), (39.96, 0, 5), (39.88, 9, 5), (41, 0, 10.1), (38, 0, 5), (39.94, 0, 5)]
    )
    np.testing.assert_array_equal(
        crosses(planes, start, end, 0.05), (True, True, False, False, False, False)
    )
