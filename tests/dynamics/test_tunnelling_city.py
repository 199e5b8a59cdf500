"""No drone passes through a city: random shots of every airframe at walls, edges and roofs in every dynamics."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import DYNAMICS
from bulletuav.geometry.solids import Solids
from bulletuav.vehicle.swarm import CITY

PITCH = 40.0  # m, between pieces
REACH = 2.0  # m, from where a shot is fired to where it hits
LOWEST = 1.0  # m: nothing is fired or hits below, where the ground would be in the way


def block(size, turn=0.0, lift=0.0):
    """Corners (8, 3) of a box about the z axis, its lower face at `lift` m, turned by `turn` degrees."""
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
    """(M,) whether straight ways from start to end (M, 3) get `slack` m deep into a convex piece with these planes."""
    begin, stop = (points @ planes[:, :3].T + planes[:, 3] + slack for points in (start, end))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = begin / (begin - stop)  # where the way meets each plane
    enter = np.where(begin > 0, np.where(stop > 0, np.inf, share), 0.0).max(axis=1)
    leave = np.where(begin > 0, 1.0, np.where(stop > 0, share, 1.0)).min(axis=1)
    return enter < leave


def events(piece, rng, count):
    """Where shots hit and whence they come, (count, 3) each: half of them at faces, half at edges, from anywhere outside."""
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


def range_of_shots(make_bench, dynamics, airframe, shots):
    """A bench whose world k is one shot at piece k mod 7 of the same city, at 5 to 40 m/s, at a random attitude."""
    options = {"worlds": shots, "effects": (), "substeps": 1, "max_speed": 100.0, "gravity": 0.0}
    one = make_bench(dynamics, airframe, layouts=(SOLIDS,), **options)
    one.engine.set_layouts(np.zeros(shots, dtype=int), np.ones(shots, dtype=bool))
    rng = np.random.default_rng(0)
    one.chosen = np.arange(shots) % len(PIECES)
    one.speed = rng.uniform(5, 40, shots)
    for k, piece in enumerate(PIECES):
        mine = one.chosen == k
        target, aim = events(piece, rng, mine.sum())
        one.swarm.position[mine, 0] = target - REACH * aim
        one.swarm.velocity[mine, 0] = one.speed[mine, None] * aim
    one.swarm.quaternion[:, 0] = Rotation.random(shots, rng=rng).as_quat()
    one.swarm.rotor_speed[:] = 0
    return one.place()


@pytest.mark.parametrize("shots", [35, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("dynamics", DYNAMICS)
@pytest.mark.parametrize("airframe", bulletuav.available_airframes())
def test_no_shot_passes(make_bench, airframe, dynamics, shots):
    """No drone's centre gets into a piece, neither at the end of a substep nor on the way there.

    In `bullet` it may by half the drone's thickness: a disc that tumbles over an edge overlaps it for some milliseconds
    before the engine has pushed it out.
    """
    one = range_of_shots(make_bench, dynamics, airframe, shots)
    setpoint = {
        SetpointLevel.ROTOR: np.zeros((shots, 1, 6)),
        SetpointLevel.VELOCITY: np.concatenate(
            [one.swarm.velocity, np.zeros((shots, 1, 1))], axis=-1
        ),
        SetpointLevel.ACCELERATION: np.zeros((shots, 1, 4)),
    }[one.dynamics.consumes]
    planes = [ConvexHull(piece).equations for piece in PIECES]
    slack = one.airframe.thinnest / 2 if dynamics == "bullet" else 0.0
    met, passed = np.zeros((shots, 1), dtype=bool), np.zeros(shots, dtype=bool)
    for _ in range(int(np.ceil(2 * REACH / 5 * 240))):
        one.alive &= ~met if dynamics != "bullet" else True
        before = one.swarm.position[:, 0].copy()
        contacts = one.dynamics.fly(
            one.swarm, one.alive, one.dynamics.consumes, setpoint, one.wind, one.motion
        )
        assert set(contacts.other[~met[contacts.world, 0]]) <= {CITY}
        met |= contacts.mask(met.shape)
        for k, sides in enumerate(planes):
            mine = one.chosen == k
            passed[mine] |= crosses(sides, before[mine], one.swarm.position[mine, 0], slack)
    assert met.all()
    assert not passed.any()
    if dynamics != "bullet":
        assert not one.swarm.velocity.any()


def test_a_pass_is_known_when_it_is_seen():
    """Through the thin wall at x = 40 in one leap, into it, along it, over it, away from it, and not as deep as that."""
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
