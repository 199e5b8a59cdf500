"""No drone passes through anything: random shots of every airframe at boxes and spheres."""

import numpy as np
import pytest
from bench import FLIGHTS, ranges, rims
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.vehicle.swarm import FIRST_OBSTACLE, ObstacleMotion

BODIES = (
    Obstacle("box", (0.5, 0.5, 0.5)),
    Obstacle("box", (0.5, 4.0, 6.0)),
    Obstacle("box", (2.0, 3.0, 1.0)),
    Obstacle("sphere", (0.3,)),
    Obstacle("sphere", (1.5,)),
)
SLACK = 0.05  # m; a drone that tumbles over an edge goes round what a straight line cuts off
FAR_AWAY = (0.0, 0.0, 500.0)


def deepest(body, airframe, position, quaternion, turns):
    """Tell how deep the rim of any drone is in its body, m; below 0 if none is.

    Args:
        body: The body.
        airframe: That of the drones.
        position: (M, 3) of the drones, seen from the body, m.
        quaternion: (M, 4) of the drones.
        turns: (M, 4) of the body.
    """
    points = rims(airframe)
    around = Rotation.from_quat(np.repeat(quaternion, len(points), axis=0)).apply(
        np.tile(points, (len(position), 1))
    )
    places = around + np.repeat(position, len(points), axis=0)
    local = Rotation.from_quat(np.repeat(turns, len(points), axis=0)).inv().apply(places)
    if body.kind == "sphere":
        return (body.size[0] - np.linalg.norm(local, axis=1)).max()
    return (np.array(body.size) / 2 - np.abs(local)).min(axis=1).max()


def crosses(body, start, end, target, turns):
    """Tell (M,) which straight lines from start to end (M, 3) go through their body.

    That is more than SLACK below the surface. The bodies are convex: who never passed is still on
    the outer side of the face that it met, however it slid along it.
    """
    turn = Rotation.from_quat(turns).inv()
    begin = turn.apply(start - target)
    way = turn.apply(end - target) - begin
    if body.kind == "sphere":
        nearest = np.clip(
            -(begin * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-12), 0, 1
        )
        return np.linalg.norm(begin + nearest[:, None] * way, axis=1) < body.size[0] - SLACK
    half = np.array(body.size) / 2 - SLACK
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([(-half - begin) / way, (half - begin) / way])
    enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
    return (enter < leave) & (enter < 1) & (leave > 0)


def range_of_shots(make_bench, dynamics, airframe, shots, contacts):
    """Make a bench whose world k is one shot at body k mod 5.

    The body is turned at random; shots come from a random direction at 5 to 40 m/s.
    """
    bench = make_bench(
        dynamics,
        airframe,
        worlds=shots,
        effects=(),
        obstacles=BODIES,
        substeps=1,
        max_speed=100.0,
        contacts=contacts,
        gravity=0.0,
    )
    rng = np.random.default_rng(0)
    aim = rng.normal(size=(shots, 3))
    aim /= np.linalg.norm(aim, axis=1, keepdims=True)
    target = np.array((0.0, 0.0, 60.0))
    places = np.tile(FAR_AWAY, (shots, len(BODIES), 1)) + np.arange(len(BODIES))[None, :, None] * 20
    chosen = np.arange(shots) % len(BODIES)
    places[np.arange(shots), chosen] = target
    turns = Rotation.random(shots * len(BODIES), rng=rng).as_quat().reshape(shots, len(BODIES), 4)
    bench.engine.set_obstacles(places, turns, np.ones(shots, dtype=bool))
    bench.motion = ObstacleMotion(places, places, turns)
    distance = np.array([body.radius for body in BODIES])[chosen] + 1.0
    speed = rng.uniform(5, 40, shots)
    bench.swarm.position[:, 0] = target - distance[:, None] * aim
    bench.swarm.velocity[:, 0] = speed[:, None] * aim
    bench.swarm.quaternion[:, 0] = Rotation.random(shots, rng=rng).as_quat()
    bench.swarm.rotor_speed[:] = 0
    bench.place()
    bench.aim, bench.speed, bench.chosen, bench.target, bench.turns = (
        aim,
        speed,
        chosen,
        target,
        turns,
    )
    bench.distance = distance
    return bench


@pytest.mark.parametrize(("airframe", "dynamics", "contacts", "shots"), list(ranges(20)))
def test_no_shot_passes(make_bench, airframe, dynamics, contacts, shots):
    """Every touch is told, no drone passes, and none overlaps its body at any time."""
    bench = range_of_shots(make_bench, dynamics, airframe, shots, contacts)
    level = bench.dynamics.consumes
    setpoint = {
        SetpointLevel.ROTOR: np.zeros((shots, 1, 6)),
        SetpointLevel.VELOCITY: np.concatenate(
            [bench.swarm.velocity, np.zeros((shots, 1, 1))], axis=-1
        ),
        SetpointLevel.ACCELERATION: np.zeros((shots, 1, 4)),
    }[level]
    met = np.zeros((shots, 1), dtype=bool)
    places, attitudes = [bench.swarm.position[:, 0].copy()], []
    steps = int(np.ceil((2 * bench.distance / bench.speed).max() * 240))
    for _ in range(steps):
        bench.alive &= ~met if contacts == "stop" else True
        touched = bench.dynamics.fly(
            bench.swarm, bench.alive, level, setpoint, bench.wind, bench.motion
        )
        assert (touched.other == FIRST_OBSTACLE - bench.chosen[touched.world]).all()
        met |= touched.mask(met.shape)
        places.append(bench.swarm.position[:, 0].copy())
        attitudes.append(bench.swarm.quaternion[:, 0].copy())
    assert met.all()
    # All substeps of a body's shots at once
    for k, body in enumerate(BODIES):
        mine = bench.chosen == k
        start, *later = (place[mine] for place in places)
        turns = np.tile(bench.turns[mine, k], (steps, 1))
        now, start = np.concatenate(later), np.tile(start, (steps, 1))
        attitude = np.concatenate([one[mine] for one in attitudes])
        assert not crosses(body, start, now, bench.target, turns).any()
        assert deepest(body, bench.airframe, now - bench.target, attitude, turns) < 0
    if contacts == "stop":  # outside, at the first touch
        assert not bench.swarm.velocity.any()


def test_an_overlap_is_known_when_it_is_seen():
    """A flat drone 1 mm above a ball, and 1 mm within; and beside a box that is turned."""
    airframe = bulletuav.load_airframe("cf2x")
    half = airframe.shape.half[2]
    level = np.array([(0.0, 0, 0, 1)] * 2)
    above = np.array([(0, 0, 0.3 + half + 0.001), (0, 0, 0.3 + half - 0.001)])
    assert deepest(BODIES[3], airframe, above[:1], level[:1], level[:1]) == pytest.approx(-0.001)
    assert deepest(BODIES[3], airframe, above, level, level) == pytest.approx(0.001)
    turned = Rotation.from_euler("z", [[45], [45]], degrees=True).as_quat()
    corner = 0.5 * np.sqrt(2) / 2
    over = np.array([(corner / 2, corner / 2, 0.25 + half - 0.002)] * 2)
    assert deepest(BODIES[0], airframe, over, level, turned) == pytest.approx(0.002)
    assert deepest(BODIES[0], airframe, np.array([(0.37, 0.37, 0)] * 2), level, turned) < 0


@pytest.mark.parametrize(("dynamics", "contacts"), FLIGHTS)
def test_a_moving_body_hits_a_drone_that_hovers(make_bench, dynamics, contacts):
    bench = make_bench(
        dynamics,
        "cf2x",
        obstacles=(Obstacle("box", (1.0, 1.0, 1.0)),),
        effects=(),
        contacts=contacts,
    )
    turn = np.array([[(0.0, 0.0, 0.0, 1.0)]])
    bench.place()
    level = (
        SetpointLevel.ROTOR
        if bench.dynamics.consumes == SetpointLevel.ROTOR
        else SetpointLevel.POSITION
    )
    hover = bench.airframe.hover_speed()
    seen = []
    for k in range(20):
        places = [np.array([[(-3.0 + 0.2 * step, 0.0, 10.0)]]) for step in (k, k + 1)]
        bench.motion = ObstacleMotion(*places, turn)
        contacts = bench.fly(
            level, (hover,) * 4 if level == SetpointLevel.ROTOR else (0.0, 0.0, 10.0, 0.0)
        )
        seen += contacts.other.tolist()
        if seen:
            break
    assert seen[0] == FIRST_OBSTACLE
    assert 11 <= k <= 13  # the face is 0.063 m from the drone's centre after 2.44 m


def test_rays_see_obstacles(make_bench):
    bench = make_bench(
        "bullet", obstacles=(Obstacle("box", (4.0, 4.0, 2.0)), Obstacle("sphere", (1.0,))), worlds=2
    )
    places = np.array([[(0.0, 0, 5), (3.0, 0, 20)], [(50.0, 0, 5), (0.0, 0, 4)]])
    bench.engine.set_obstacles(places, np.tile((0.0, 0, 0, 1), (2, 2, 1)), np.ones(2, dtype=bool))
    np.testing.assert_allclose(
        bench.engine.surface_below(bench.swarm.position, bench.alive)[:, 0], (6.0, 5.0), atol=1e-6
    )
