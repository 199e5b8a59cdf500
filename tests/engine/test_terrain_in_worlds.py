"""Terrain in worlds: what rays meet, and that drones rest on hills and slide over seams."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from bulletuav.city.heightfield import Heightfield
from bulletuav.city.render import render
from bulletuav.city.terrain import CROWN_COLOUR, GROUND_COLOUR, Terrain, generate_terrain
from bulletuav.geometry.solids import Solids
from bulletuav.vehicle.swarm import CITY

DYNAMICS = ["bullet", "rigid_body"]
HALF = 0.055  # m, half the height of a hummingbird


def terrain(kind, side=100.0, seed=0):
    return generate_terrain(kind, side, np.random.default_rng(seed))


@pytest.fixture
def make_terrain_bench(make_bench):
    def make(solids, dynamics="rigid_body", **options):
        one = make_bench(dynamics, "hummingbird", layouts=(solids,), **options)
        one.engine.set_layouts(np.zeros(1, dtype=np.int64), np.ones(1, dtype=bool))
        return one

    return make


def first_hits(solids, start, change):
    """Fractions at which rays meet hulls or the ground, 1 for none; plane by plane."""
    found = np.ones(len(start))
    with np.errstate(divide="ignore"):
        ground = -start[:, 2] / change[:, 2]
    found = np.where((ground >= 0) & (ground <= 1), ground, found)
    for hull in solids.hulls:
        planes = ConvexHull(hull).equations
        above, along = start @ planes[:, :3].T + planes[:, 3], change @ planes[:, :3].T
        share = -above / np.where(along == 0, np.nan, along)
        enters = np.nanmax(np.where(along < 0, share, -np.inf), axis=1)
        leaves = np.nanmin(np.where(along > 0, share, np.inf), axis=1)
        meets = (enters <= leaves) & (enters >= 0) & (enters <= 1)
        meets &= ~((along == 0) & (above > 0)).any(axis=1)
        found = np.where(meets, np.minimum(found, enters), found)
    return found


@pytest.mark.parametrize("kind", ["hills", "forest", "wooded_hills"])
def test_rays_meet_what_all_planes_of_all_pieces_give(make_terrain_bench, kind):
    city = terrain(kind)
    one = make_terrain_bench(city.solids)
    rng = np.random.default_rng(1)
    start = rng.uniform((-49, -49, 0), (49, 49, 12), (600, 3))
    start[:, 2] += city.surface(start) + 0.1
    is_free = city.outdoors(start) | (start[:, 2] > city.roof(start))
    start = start[is_free]
    change = rng.normal(size=start.shape) * 30
    found = one.engine.cast_rays(start, start + change, np.zeros(len(start), dtype=int))
    expected = first_hits(city.solids, start, change)
    assert 0.3 < (expected < 1).mean() < 0.9
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_no_ray_passes_between_columns(make_terrain_bench):
    """Vertical rays through the corners and along the edges of cells."""
    city = terrain("hills")
    one = make_terrain_bench(city.solids)
    count = np.array(city.ground.corners.shape)
    x, y = (np.linspace(-50, 50, 4 * (one - 1) + 1)[1:-1] for one in count)
    plan = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    start = np.column_stack([plan, np.full(len(plan), 60.0)])
    end = start - (0, 0, 60)
    found = one.engine.cast_rays(start, end, np.zeros(len(plan), dtype=int))
    np.testing.assert_allclose(60 * (1 - found), city.surface(plan), atol=3e-6)
    one.swarm.position[0, 0] = start[0]
    assert one.engine.surface_below(one.swarm.position, one.alive)[0, 0] == pytest.approx(
        city.surface(plan[0]), abs=3e-6
    )


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_no_drone_falls_through_hills(make_terrain_bench, dynamics):
    """200 drones, of which 60 fall on edges of cells and 20 on corners."""
    city = terrain(Terrain(relief=33.0), 200.0)
    one = make_terrain_bench(city.solids, dynamics, drones=200)
    plan = np.random.default_rng(1).uniform(-90, 90, (200, 2))
    for axis, chosen in ((0, slice(40)), (1, slice(20, 60))):
        cell = city.ground.cell[axis]
        plan[chosen, axis] = np.round((plan[chosen, axis] + 100) / cell) * cell - 100
    plan = np.clip(plan, -90, 90)
    one.swarm.position[0] = np.column_stack([plan, city.surface(plan) + 1])
    one.swarm.rotor_speed[:] = 0
    one.place()
    for _ in range(12):
        one.spin(0.0)
        gap = one.swarm.position[0, :, 2] - city.surface(one.swarm.position[0])
        assert gap.min() > HALF - 1e-3
    assert gap.max() < 0.5
    assert np.linalg.norm(one.swarm.velocity[0], axis=1).max() < 4


def ramp(slope, cells):
    """Hills that fall along x, of several cells or one."""
    height = 5 + slope * np.linspace(60, 0, cells + 1)[:, None] * np.ones(cells + 1)
    return Heightfield(height, np.array([60.0, 60.0]))


@pytest.mark.parametrize("dynamics", DYNAMICS)
@pytest.mark.parametrize(("slope", "friction"), [(0.0, 0.0), (0.3, 0.0), (0.3, 0.5)])
def test_drones_slide_over_seams_as_over_a_plane(make_terrain_bench, dynamics, slope, friction):
    """Acceleration g (sin a - friction cos a), over up to six seams in 2 s."""
    ground = ramp(slope, 24)
    solids = Solids(np.zeros((0, 2, 3)), tuple(ground.columns()))
    one = make_terrain_bench(solids, dynamics, friction=friction, effects=())
    sine, cosine = slope / np.hypot(1, slope), 1 / np.hypot(1, slope)
    start = np.array([-20.0, 3.3])
    normal = np.array([sine, 0, cosine])
    one.swarm.position[0, 0] = [*start, ground.height(start)] + (HALF + 1e-3) * normal
    half = np.arctan(slope) / 2
    one.swarm.quaternion[0, 0] = 0, np.sin(half), 0, np.cos(half)
    one.swarm.velocity[0, 0] = 6 * np.array([cosine, 0, -sine])
    one.swarm.rotor_speed[:] = 0
    one.place()
    change = one.gravity * (sine - friction * cosine)
    for second in (1, 2):
        one.spin(0.0, 10)
        expected = max(6 + second * change, 0.0)
        speed = np.linalg.norm(one.swarm.velocity[0, 0])
        assert speed == pytest.approx(expected, abs=0.15)
    assert abs(one.swarm.position[0, 0, 1] - 3.3) < 0.05
    assert np.abs(one.swarm.rates).max() < 0.5


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_trunks_stop_drones(make_terrain_bench, dynamics):
    city = terrain(Terrain(tree_density=1.0, trunk_radius=0.4))
    one = make_terrain_bench(city.solids, dynamics, effects=(), gravity=0.0)
    low, high = city.raised.bounds[0]
    middle = (low + high) / 2
    one.swarm.position[0, 0] = middle - (3, 0, middle[2] - 2)
    one.swarm.velocity[0, 0] = 5, 0, 0
    one.swarm.rotor_speed[:] = 0
    contacts = [one.place().spin(0.0)] + [one.spin(0.0) for _ in range(9)]
    assert {int(other) for each in contacts for other in each.other} == {CITY}
    assert one.swarm.position[0, 0, 0] < middle[0] - 0.4 * np.sqrt(0.75)


def test_ground_effect_is_that_of_the_slope_below(make_terrain_bench):
    """It depends on the height above the ground below the drone, as above roofs."""
    city = terrain("hills")
    plan = np.array([10.0, 5.0])
    for dynamics in DYNAMICS:
        one = make_terrain_bench(
            city.solids, dynamics, drones=2, effects=("ground_effect",), substeps=1
        )
        flat = make_terrain_bench(
            Solids(np.zeros((0, 2, 3))), dynamics, drones=2, effects=("ground_effect",), substeps=1
        )
        for flight, height in ((one, float(city.surface(plan))), (flat, 0.0)):
            flight.swarm.position[0] = (*plan, height + 0.3), (*(plan + 5), 60)
            flight.place().spin(flight.airframe.hover_speed())
        assert one.swarm.velocity[0, 0, 2] == pytest.approx(flat.swarm.velocity[0, 0, 2], rel=1e-3)
        assert one.swarm.velocity[0, 0, 2] > 100 * abs(one.swarm.velocity[0, 1, 2])


def test_pictures_show_ground_and_crowns_in_their_colours():
    """Hues, as brightness depends on the sun and the piece."""
    city = terrain("wooded_hills")
    pixels = render(city.solids, city.side, (240, 160))
    hues = pixels.reshape(-1, 3).astype(float)
    hues /= hues.sum(axis=1, keepdims=True)
    for colour in (GROUND_COLOUR, CROWN_COLOUR):
        own = np.array(colour) / sum(colour)
        assert (np.abs(hues - own).max(axis=1) < 0.03).mean() > 0.02
