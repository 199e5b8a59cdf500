"""Cities in worlds: what rays meet, what drones touch, and layouts that come and go."""

import gc
import os
import tracemalloc
import warnings

import numpy as np
import pytest
from bench import FLIGHTS

import bulletuav
import bulletuav.engine.engine as engine_module
from bulletuav.city.generator import generate
from bulletuav.city.statistics import Statistics
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.engine.bodies import COMPOUND
from bulletuav.engine.c_extension import SWITCH, Extension
from bulletuav.engine.calls import bullet
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.solids import Solids, box_corners
from bulletuav.vehicle.swarm import CITY, GROUND

needs_extension = pytest.mark.skipif(
    os.environ.get(SWITCH) == "0", reason="the extension is turned off"
)
HALF = 0.055  # m, half the height of a hummingbird; its radius is 0.27 m
TURN = np.radians(np.arange(0, 360, 60))
RING = 4 * np.stack([np.cos(TURN), np.sin(TURN)], axis=1) + (30, 0)
PRISM = np.concatenate([np.column_stack([RING, np.full(6, height)]) for height in (0.0, 12.0)])
TOWN = Solids(np.array([[(-5.0, -5, 0), (5, 5, 8)]]), (PRISM,))
"""A box 8 m high about the origin, and a hexagonal prism 12 m high at x = 30.

The prism's corners are 4 m from its middle, one of them to the east.
"""
TOWER = Solids(np.array([[(-2.0, -2, 0), (2, 2, 20)]]))
UP, DOWN = (0.0, 0, 1), (0.0, 0, -1)


@pytest.fixture
def make_city_bench(make_bench):
    """Builds benches in whose worlds the first of some layouts stands."""

    def make(layouts, dynamics="bullet", airframe="hummingbird", *, layout=0, **options):
        one = make_bench(dynamics, airframe, layouts=layouts, **options)
        stand(one, layout)
        return one

    return make


def stand(one, layout, mask=None):
    """Have a layout, one or (W,), stand in the worlds of `mask`."""
    worlds = len(one.alive)
    one.engine.set_layouts(
        np.broadcast_to(layout, worlds),
        np.ones(worlds, dtype=bool) if mask is None else np.array(mask),
    )


def distance(one, start, way, world=0, most=100.0):
    """Along the unit vector `way` to what rays meet first, m."""
    start, way = np.array([start], dtype=float), np.array([way], dtype=float)
    return most * float(one.engine.cast_rays(start, start + most * way, np.array([world]))[0])


# What rays meet


def test_rays_meet_the_surfaces_exactly(make_city_bench):
    one = make_city_bench((TOWN,))
    for start, way, expected in (
        ((-25, 0, 4), (1, 0, 0), 20.0),
        ((-25, 4.999, 7.999), (1, 0, 0), 20.0),
        ((-25, 5.001, 4), (1, 0, 0), 100.0),  # past both
        ((0, 0, 50), DOWN, 42.0),
        ((30, 0, 50), DOWN, 38.0),
        ((50, 0, 6), (-1, 0, 0), 16.0),  # the prism's edge, at x = 34
        ((30, -20, 6), (0, 1, 0), 20 - 4 * np.cos(np.pi / 6)),  # its face
        ((15, 0, 9), (-1, 0, 0), 100.0),  # over the box
        ((15, 0, 50), DOWN, 50.0),
    ):
        assert distance(one, start, way) == pytest.approx(
            expected, abs=1e-6
        )  # hulls that drones touch are 1 mm thicker


def test_rays_from_inside_meet_the_wall(make_city_bench):
    one = make_city_bench((TOWN,))
    assert distance(one, (0, 0, 4), (1, 0, 0)) == pytest.approx(5.0, abs=1e-6)
    assert distance(one, (30, 0, 4), UP) == pytest.approx(8.0, abs=1e-6)


@pytest.mark.parametrize("thickness", [0.5, 0.01])
def test_a_thin_wall_is_seen(make_city_bench, thickness):
    one = make_city_bench((Solids(np.array([[(20.0, -5, 0), (20 + thickness, 5, 60)]])),))
    assert distance(one, (0, 0, 30), (1, 0, 0)) == pytest.approx(20.0, abs=1e-6)


def test_surface_below_streets_roofs_and_hulls(make_city_bench):
    one = make_city_bench((TOWN,), drones=6)
    one.swarm.position[0] = (
        (0, 0, 30),
        (4.9, -4.9, 9),
        (5.1, 0, 30),
        (30, 0, 30),
        (33.9, 0, 30),
        (33.9, 1, 30),
    )
    assert one.engine.surface_below(one.swarm.position, one.alive)[0] == pytest.approx(
        (8, 8, 0, 12, 12, 0), abs=1e-6
    )


@pytest.mark.parametrize("irregularity", [0.0, 1.0])
def test_surface_below_a_generated_city(make_city_bench, irregularity):
    city = generate("dense", 400, np.random.default_rng(0), irregularity)
    one = make_city_bench((city.solids,), drones=500)
    rng = np.random.default_rng(1)
    one.swarm.position[0] = np.column_stack([rng.uniform(-210, 210, (500, 2)), np.full(500, 150.0)])
    roofs = city.roof(one.swarm.position[0])
    assert 150 < (roofs > 0).sum() < 350
    np.testing.assert_allclose(
        one.engine.surface_below(one.swarm.position, one.alive)[0], roofs, atol=1e-6
    )


# What drones touch


ROTORS = [flight for flight in FLIGHTS if flight[0] in ("rigid_body", "bullet")]
GAP = 1e-4 + 1e-9  # m; what counts as a touch, and rounding


@pytest.mark.parametrize(("dynamics", "contacts"), ROTORS)
def test_a_drone_falls_on_a_roof_and_rests_there(make_city_bench, dynamics, contacts):
    one = make_city_bench((TOWN,), dynamics, drones=3, contacts=contacts)
    one.swarm.position[0] = (0, 0, 8.4), (30, 0, 12.4), (15, 0, 0.4)
    one.swarm.rotor_speed[:] = 0
    one.place()
    told = [one.spin(0.0) for _ in range(10)]
    gap = one.swarm.position[0, :, 2] - (8 + HALF, 12 + HALF, HALF)
    assert ((gap > 0) & (gap <= GAP)).all()
    touched = {
        (drone, other) for hits in told for drone, other in zip(hits.drone, hits.other, strict=True)
    }
    assert touched == {(0, CITY), (1, CITY), (2, GROUND)}
    if contacts == "impulse":
        np.testing.assert_allclose(told[-1].impulse, 0.716 * 9.80665 * 0.1, rtol=0.05)


@pytest.mark.parametrize(("dynamics", "contacts"), ROTORS)
def test_a_wall_stops_a_drone(make_city_bench, dynamics, contacts):
    """A box, and a prism whose face to the south-west is 2 sqrt(3) m from its middle."""
    one = make_city_bench((TOWN,), dynamics, drones=2, effects=(), gravity=0.0, contacts=contacts)
    way = np.array((np.cos(np.pi / 6), 0.5, 0))
    one.swarm.position[0] = (-7, 0, 4), (30, 0, 6) - 6 * way
    one.swarm.velocity[0] = (5, 0, 0), 5 * way
    one.swarm.rotor_speed[:] = 0
    one.place()
    told = [one.spin(0.0) for _ in range(5)]
    assert {(d, o) for hits in told for d, o in zip(hits.drone, hits.other, strict=True)} == {
        (0, CITY),
        (1, CITY),
    }
    gap = (
        -5 - one.swarm.position[0, 0, 0],
        (30, 0, 6) @ way - one.swarm.position[0, 1] @ way - 2 * np.sqrt(3),
    )
    np.testing.assert_allclose(gap, 0.27 + GAP / 2, atol=GAP / 2)
    np.testing.assert_allclose(one.swarm.velocity, 0, atol=1e-3)


def tower(corners):
    """Make a round tower 12 m high about the origin, whose radius is 4 m at its corners."""
    turn = 2 * np.pi * np.arange(corners) / corners
    ring = 4 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    levels = [np.column_stack([ring, np.full(corners, height)]) for height in (0.0, 12.0)]
    return Solids(np.zeros((0, 2, 3)), (np.concatenate(levels),))


@pytest.mark.parametrize("corners", [200, 256])
def test_a_round_tower_of_many_corners_stands(make_city_bench, corners):
    """A drone falls on its roof, one over the edge, and one flies at the middle of a side."""
    one = make_city_bench((tower(corners),), drones=3)
    side = np.array((np.cos(np.pi / corners), np.sin(np.pi / corners)))
    one.swarm.position[0] = (0, 0, 12.4), (-3.9, 0, 12.4), (*(6 * side), 6)
    one.swarm.velocity[0, 2, :2] = -5 * side
    one.swarm.rotor_speed[:] = 0
    one.place()
    told = [one.spin(0.0) for _ in range(4)]
    hits = {pair for row in told for pair in zip(row.drone, row.other, strict=True)}
    assert hits == {(0, CITY), (1, CITY), (2, CITY)}
    gap = one.swarm.position[0, :2, 2] - 12 - HALF
    assert 0 < gap[0] <= GAP
    first = next(row for row in told if 2 in row.drone)
    point = first.point[first.drone == 2][0]
    assert point[:2] @ side == pytest.approx(4 * np.cos(np.pi / corners), abs=GAP)
    np.testing.assert_allclose(first.normal[first.drone == 2][0], (*side, 0), atol=1e-6)


def test_a_tower_of_too_many_corners_is_refused(make_city_bench):
    with pytest.raises(ValueError, match="a face of a hull has more than 256 corners: simplify"):
        make_city_bench((tower(257),))


def test_many_pieces_are_all_seen_and_all_collide(make_city_bench):
    """2,500 buildings, drones dropped on each; more than one compound of each colour holds."""
    city = generate(Statistics(0.1, 750, 8), 1825.74, np.random.default_rng(0), 0.3)
    boxes = city.solids.boxes
    assert len(boxes) > 2450 > 9 * COMPOUND
    one = make_city_bench((city.solids,), drones=125)
    one.swarm.rotor_speed[:] = 0
    top = np.concatenate([boxes[:, :, :2].mean(axis=1), boxes[:, 1, 2:]], axis=1)
    start = top + (0, 0, 100)
    fraction = one.engine.cast_rays(start, start - (0, 0, 200), np.zeros(len(top), dtype=int))
    np.testing.assert_allclose(fraction, 0.5, atol=1e-9)
    for first in range(0, len(top), 125):
        places = top[(first + np.arange(125)) % len(top)]
        one.swarm.position[0] = places + (0, 0, HALF + 0.05)
        one.swarm.quaternion[:] = 0, 0, 0, 1
        one.swarm.velocity[:] = one.swarm.rates[:] = 0
        contacts = one.place().spin(0.0, 2)
        gap = one.swarm.position[0, :, 2] - places[:, 2] - HALF
        assert ((gap > 0) & (gap <= GAP)).all()
        assert (contacts.other == CITY).sum() == 125


def test_ground_effect_is_that_of_the_roof_below(make_city_bench):
    """As strong at 0.2 m over a roof as over the street; nothing at the roof's height beside it."""
    for dynamics in ("bullet", "rigid_body"):
        one = make_city_bench((TOWN,), dynamics, drones=4, effects=("ground_effect",), substeps=1)
        one.swarm.position[0] = (0, 0, 8.2), (30, 0, 12.2), (15, 0, 0.2), (15, 5, 8.2)
        one.place().spin(one.airframe.hover_speed())
        roof, hull, street, air = one.swarm.velocity[0, :, 2]
        assert roof == pytest.approx(street, rel=1e-6)
        assert hull == pytest.approx(street, rel=1e-6)
        assert street > 100 * abs(air)
        assert street > 5e-4


# Layouts come and go


def test_nothing_stands_before_it_is_set(make_bench, make_city_bench):
    one = make_city_bench((TOWN, TOWER), layout=NO_LAYOUT, effects=(), gravity=0.0)
    free = make_bench("bullet", effects=(), gravity=0.0)
    assert distance(one, (-25, 0, 4), (1, 0, 0)) == 100
    assert distance(one, (0, 0, 50), DOWN) == pytest.approx(50, abs=1e-9)
    assert one.engine.surface_below(one.swarm.position, one.alive) == pytest.approx(0)
    for flight in (one, free):
        flight.swarm.position[:], flight.swarm.velocity[:] = (-7, 0, 4), (20, 0, 0)
        assert not len(flight.place().spin(0.0, 10).world)
    np.testing.assert_array_equal(one.swarm.position, free.swarm.position)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_another_layout_takes_its_place(make_city_bench, dynamics):
    one = make_city_bench((TOWN, TOWER), dynamics, effects=(), gravity=0.0)

    def shot():
        one.swarm.position[:], one.swarm.velocity[:], one.swarm.rotor_speed[:] = (
            (-7, 0, 7),
            (20, 0, 0),
            0,
        )
        one.swarm.quaternion[:], one.swarm.rates[:] = (0, 0, 0, 1), 0
        contacts = one.place().spin(0.0, 2)
        seen = distance(one, (-25, 0, 4), (1, 0, 0)), distance(one, (0, 0, 50), DOWN)
        return seen, float(one.swarm.position[0, 0, 0]), list(contacts.other)

    for layout, wall, roof in (
        (0, 20, 42),
        (1, 23, 30),
        (0, 20, 42),
        (NO_LAYOUT, 100, 50),
        (1, 23, 30),
        (1, 23, 30),
    ):
        stand(one, layout)
        seen, x, _ = shot()
        assert seen == pytest.approx((wall, roof), abs=1e-6)
        assert one.engine.city_grid.layout[0] == layout
        if layout == NO_LAYOUT:
            assert x == pytest.approx(-3)
        else:
            assert -9 < x < wall - 25 - 0.26


def test_a_world_has_its_own_layout_and_only_those_asked_for_change(make_city_bench):
    one = make_city_bench((TOWN, TOWER), worlds=3, layout=[0, 1, NO_LAYOUT])

    def roofs():
        return [round(50 - distance(one, (0, 0, 50), DOWN, world), 6) for world in range(3)]

    assert roofs() == [8, 20, 0]
    assert [distance(one, (50, 0, 6), (-1, 0, 0), world) for world in range(3)] == pytest.approx(
        [16, 48, 100], abs=1e-6
    )
    one.swarm.position[:] = 0, 0, 40
    assert one.engine.surface_below(one.swarm.position, one.alive)[:, 0] == pytest.approx(
        [8, 20, 0], abs=1e-6
    )
    stand(one, [1, 0, 0], mask=[False, True, False])
    assert roofs() == [8, 8, 0]
    stand(one, [1, NO_LAYOUT, 1], mask=[True, True, True])
    assert roofs() == [20, 0, 20]


def test_drones_touch_what_stands_in_their_own_world(make_city_bench):
    one = make_city_bench((TOWN, TOWER), worlds=3, layout=[0, 1, NO_LAYOUT])
    one.swarm.position[:] = 0, 0, 8.3
    one.swarm.position[1] = 0, 0, 20.3
    one.swarm.rotor_speed[:] = 0
    contacts = one.place().spin(0.0, 5)
    assert list(zip(contacts.world, contacts.other, strict=True)) == [(0, CITY), (1, CITY)]
    np.testing.assert_allclose(one.swarm.position[:2, 0, 2], (8 + HALF, 20 + HALF), atol=3e-3)
    assert one.swarm.position[2, 0, 2] < 8.3 - 0.5 * 9 * 0.5**2


def test_cities_are_bodies_when_somebody_asks_for_them():
    """Compiled rays and contacts do without; who asks finds what stands, where it stands."""
    aviary = bulletuav.Aviary("navigation", 2, area=150.0, leg=50.0, seed=0)
    aviary.reset(seeds=0)
    engine, client = aviary.worlds.engine, aviary.worlds.engine._bullet.client
    before = bullet.getNumBodies(physicsClientId=client)
    layout = int(aviary.scene.layout[1])
    standing = engine._bullet.bodies.bodies_of(1, CITY)
    assert bullet.getNumBodies(physicsClientId=client) > before
    assert standing == engine._bullet.bodies.layouts.make()[layout][1][1]
    assert all(engine._bullet.bodies.other(body) == CITY for body in standing)
    for k, of_worlds in enumerate(engine._bullet.bodies.layouts.make()):
        for w in range(2):
            for body in [*of_worlds[w][0], *of_worlds[w][1]]:
                place = bullet.getBasePositionAndOrientation(body, client)[0]
                assert place[:2] == tuple(engine._offset[w, 0, :2])
                assert (place[2] == 0) == (aviary.scene.layout[w] == k)
    # They follow from now on, and are no strangers.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for seed in range(1, 9):
            aviary.reset(seeds=seed)
            body = engine._bullet.bodies.bodies_of(0, CITY)[0]
            assert bullet.getBasePositionAndOrientation(body, client)[0][2] == 0
    aviary.close()


@pytest.mark.parametrize("rays", ["compiled", "bullet"])
def test_resets_make_no_bodies_and_remove_none(rays):
    aviary = bulletuav.Aviary(
        "navigation", 2, area=150.0, leg=50.0, num_layouts=3, irregularity=0.5, seed=0, rays=rays
    )
    client = aviary.worlds.engine._bullet.client

    def bodies():
        return [bullet.getBodyUniqueId(k, client) for k in range(bullet.getNumBodies(client))]

    before, stood = bodies(), set()
    for k in range(40):
        aviary.reset(np.array([True, k % 3 == 0]))
        stood.add(tuple(aviary.scene.layout))
    assert bodies() == before
    assert len(stood) > 4
    aviary.close()


# The extension and the plain calls


@needs_extension
def test_rays_and_flights_are_the_same_to_the_bit_without_the_extension(
    make_city_bench, monkeypatch
):
    city = generate(Statistics(0.5, 900, 12), 130.0, np.random.default_rng(0), 0.9)
    layouts = (city.solids, TOWN, rubble(0))
    fast = make_city_bench(layouts, worlds=2, drones=8, layout=[0, 2])
    with monkeypatch.context() as patch:
        patch.setattr(engine_module, "EXTENSION", Extension(None, "", "for comparison"))
        plain = make_city_bench(layouts, worlds=2, drones=8, layout=[0, 2])
    assert (len(fast.engine.ports), len(plain.engine.ports)) == (1, 0)
    rng = np.random.default_rng(1)
    start, end = rng.uniform(-70, 70, (2, 5000, 3)) + (0, 0, 72)
    where = rng.integers(2, size=5000)
    fractions = [
        one.engine.cast_rays(start, end, where, (one.swarm, one.alive)) for one in (fast, plain)
    ]
    assert fractions[0].tobytes() == fractions[1].tobytes()
    assert 100 < (fractions[0] < 1).sum() < 4900
    touched = []
    for layout in ([0, 2], [2, 1]):
        for one in (fast, plain):
            stand(one, layout)
            scatter(one)
        for _ in range(10):
            contacts = [
                one.fly(SetpointLevel.VELOCITY, (3.0, 1.0, -6.0, 0.0)) for one in (fast, plain)
            ]
            for mine, theirs in zip(
                (*fast.swarm, *contacts[0]), (*plain.swarm, *contacts[1]), strict=True
            ):
                assert mine.tobytes() == theirs.tobytes()
            touched += contacts[0].other.tolist()
    assert touched.count(CITY) > 30


# Reproducibility with contacts. Rubble is the hardest: drones on it touch many pieces at once.


def rubble(seed):
    """80 boxes of 0.2 to 1 m over each other."""
    rng = np.random.default_rng(seed)
    low = np.column_stack([rng.uniform(-2, 2, (80, 2)), np.zeros(80)])
    return Solids(
        np.stack(
            [low, low + np.column_stack([rng.uniform(0.2, 0.6, (80, 2)), rng.uniform(0.2, 1, 80)])],
            axis=1,
        )
    )


def scatter(one, mask=None):
    """Drones at rest side by side, 0.6 m apart, 1.5 m up."""
    mask = one.alive if mask is None else mask
    drones = one.alive.shape[1]
    places = [
        (1.2 * (i // 2 % 3) - 1.2, 1.2 * (i % 2) - 0.6, 1.5 + 0.6 * (i // 6)) for i in range(drones)
    ]
    one.swarm.position[mask] = np.tile(places, (mask.sum() // drones, 1))
    one.swarm.quaternion[mask] = 0, 0, 0, 1
    one.swarm.velocity[mask] = one.swarm.rates[mask] = 0
    one.swarm.rotor_speed[mask] = one.airframe.hover_speed()
    one.dynamics.place(one.swarm, mask)


def stumble(one, decisions, seeds, k=0):
    """Fly at random velocities, mostly downward, a stream a world; returns the bytes of world k."""
    streams = [np.random.default_rng(seed) for seed in seeds]
    drones = one.alive.shape[1]
    seen, touches = [], 0
    for _ in range(decisions):
        velocity = [rng.uniform((-6, -6, -7), (6, 6, -1), (drones, 3)) for rng in streams]
        setpoint = np.concatenate([velocity, np.zeros((len(seeds), drones, 1))], axis=-1)
        contacts = one.dynamics.fly(
            one.swarm, one.alive, SetpointLevel.VELOCITY, setpoint, one.wind, one.motion
        )
        seen.append(b"".join(array[k].tobytes() for array in one.swarm))
        touches += int(((contacts.world == k) & (contacts.other == CITY)).sum())
    assert touches > 3 * decisions  # otherwise nothing was tested
    return b"".join(seen)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_a_world_does_not_feel_what_others_do_nor_what_stands_there(make_city_bench, dynamics):
    """480 substeps on rubble; the same alone in a client, as another process would have it."""
    layouts = (rubble(0), rubble(1), TOWN)

    def run(layout, seeds):
        one = make_city_bench(layouts, dynamics, worlds=3, drones=6, layout=layout)
        scatter(one)
        bits = stumble(one, 20, seeds, k=1)
        one.engine.close()
        return bits

    bits = run([0, 1, 1], (10, 1, 12))
    assert run([0, 1, 1], (20, 1, 22)) == bits
    assert run([2, 1, NO_LAYOUT], (20, 1, 22)) == bits
    assert run([0, 1, 1], (10, 2, 12)) != bits
    alone = make_city_bench(layouts, dynamics, drones=6, layout=1, first_world=1)
    scatter(alone)
    assert stumble(alone, 20, (1,)) == bits


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_a_reset_into_the_same_layout_gives_the_same_bits(make_city_bench, dynamics):
    one = make_city_bench((rubble(0), rubble(1)), dynamics, worlds=2, drones=6)
    scatter(one)
    fresh = stumble(one, 20, (1, 2))
    for between in ([], [1], [1, NO_LAYOUT, 1]):
        for layout in between:
            stand(one, layout)
            scatter(one)
            one.fly(SetpointLevel.VELOCITY, (2.0, 1.0, -4.0, 0.0), 3)
        stand(one, 0)
        scatter(one)
        assert stumble(one, 20, (1, 2)) == fresh


def test_a_world_of_an_environment_does_not_feel_the_others():
    """Collisions end episodes there, and worlds are reset into other layouts at different times."""

    def run(others, worlds=3, first_world=0):
        town = {"city": "dense", "area": 150.0, "leg": 50.0, "irregularity": 0.5}
        aviary = bulletuav.Aviary(
            "lidar_navigation", worlds, first_world=first_world, horizon=40, **town
        )
        k = 1 - first_world
        observations, seen, hits = aviary.reset(seeds=first_world), [], 0
        seen.append(observations[k].tobytes())
        streams = [np.random.default_rng(7 if w == k else others + w) for w in range(worlds)]
        mean = [rng.uniform(-1, 1, (3, 3)) * (1, 1, 0.2) for rng in streams]
        for _ in range(200):
            action = np.array(
                [m + rng.uniform(-0.1, 0.1, (3, 3)) for m, rng in zip(mean, streams, strict=True)]
            )
            step = aviary.step(action)
            hits += int(step.info["collision"][k].sum())
            seen.append(
                b"".join(
                    array[k].tobytes() for array in (*aviary.swarm, step.observations, step.rewards)
                )
            )
            over = ~aviary.alive.any(axis=1)
            if over.any():
                observations = aviary.reset(over)
            if over[k]:
                seen.append(observations[k].tobytes())
        aviary.close()
        assert hits >= 4
        return seen

    bits = run(100)
    assert run(200) == bits
    assert run(0, worlds=1, first_world=1) == bits


def test_a_city_of_thousands_of_boxes_is_built_and_seen(make_city_bench):
    """More than one mesh of the engine holds: 36 corners of triangles for each box."""
    place = (
        4.0
        * np.stack(np.meshgrid(np.arange(70), np.arange(60), indexing="ij"), axis=-1).reshape(-1, 2)
        - 140
    )
    low = np.concatenate([place, np.zeros((len(place), 1))], axis=1)
    hull = box_corners(
        np.array([(60.5, 60.5, 9), (61.5, 61.5, 10)])
    )  # with it, rays are the engine's
    one = make_city_bench((Solids(np.stack([low, low + (2.0, 2.0, 3.0)], axis=1), (hull,)),))
    start = np.concatenate([place + 1, np.full((len(place), 1), 20.0)], axis=1)
    fraction = one.engine.cast_rays(start, start - (0, 0, 20), np.zeros(len(start), dtype=int))
    assert (
        np.isclose(fraction, 17 / 20, atol=1e-6).sum() == len(place) - 1
    )  # the hull hangs above one of them
    assert np.isclose(fraction, 10 / 20, atol=1e-6).sum() == 1
    assert len(one.engine._bullet.bodies.layouts.facades(0)) == 2


def test_nothing_stands_in_a_city_without_buildings(make_city_bench):
    one = make_city_bench((Solids(np.zeros((0, 2, 3))),))
    assert (
        one.engine.cast_rays(
            np.array([(0, 0, 9.0)]), np.array([(9, 0, 9.0)]), np.zeros(1, dtype=int)
        )
        == 1
    )
    assert one.engine._bullet.bodies.layouts.facades(0) == []


def test_a_life_in_a_city_leaves_no_memory_behind():
    """PyBullet keeps the lists that it is handed; 60 kB of a small city stayed for good."""

    def live():
        aviary = bulletuav.Aviary("navigation", 1, num_layouts=1, area=250.0)
        aviary.reset(seeds=0)
        aviary.close()

    live()
    tracemalloc.start()
    kept = []
    try:
        for _ in range(6):
            live()
            gc.collect()
            kept.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # The median, as whatever else lives in this process may fill a cache of its own meanwhile
    assert np.median(np.diff(kept)) < 10_000
