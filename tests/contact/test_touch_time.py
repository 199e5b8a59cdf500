"""Times of touch of drones that turn, against heights of a cylinder in closed form, and gaps."""

import numpy as np
import pytest
from contact.rig import Rig, measure_gaps, random_attitudes, random_directions
from contact.shots import TARGETS
from scipy.spatial.transform import Rotation

from bulletuav.compiled.kernel import allocating
from bulletuav.contact.separating_planes import is_separated_by_plane
from bulletuav.contact.time_of_impact import (
    CONTACT_DISTANCE,
    LOOSE_TOI_TOLERANCE,
    MAX_CONTACT_DISTANCE,
    NO_IMPACT,
    find_time_of_impact,
)

DT = 1 / 240
SAMPLES = np.linspace(0, 1, 2001)


@allocating
def _times(scenery, motions, room):  # type: ignore[no-untyped-def]
    """Return when shapes 0 and 1 touch: drones of `motions` (M,) and another, or pairs (M, 2)."""
    found = np.zeros(len(motions))
    drones = motions.reshape(len(motions), -1)
    for m in range(len(motions)):
        found[m] = find_time_of_impact(
            scenery, drones[m], 0, 0, 1, 0.0, CONTACT_DISTANCE, False, DT, (0.0, 0.0, 0.0), room
        )[0]
    return found


@allocating
def _kept_apart(scenery, motions, normals):  # type: ignore[no-untyped-def]
    """Return whether a plane separates each drone of `motions` (M,) from the other."""
    found = np.zeros(len(motions), dtype=np.bool_)
    for m in range(len(motions)):
        normal = (normals[m, 0], normals[m, 1], normals[m, 2])
        alone = motions[m : m + 1]
        found[m] = is_separated_by_plane(
            scenery, alone, 0, 0, 1, 0.0, MAX_CONTACT_DISTANCE, CONTACT_DISTANCE, DT, normal
        )
    return found


def _heights(motions: np.ndarray, share: np.ndarray, radius: float, half: float) -> np.ndarray:
    """Return the height of the lowest points of upright cylinders after shares of a substep, m."""
    turn = Rotation.from_rotvec(share[..., None] * motions["rotation"])
    up = (turn * Rotation.from_quat(motions["quaternion"])).as_matrix()[..., 2, 2]
    deep = radius * np.sqrt(np.maximum(0.0, 1 - up**2)) + half * np.abs(up)
    return motions["position"][..., 2] + share * motions["displacement"][..., 2] - deep


def test_turning_drones_touch_when_their_lowest_point_does() -> None:
    """The first touch is found to 1e-12 m, also of drones that roll and hardly approach."""
    rng = np.random.default_rng(3)
    with Rig() as rig:
        motions = np.repeat(rig.dynamics.contact.space.motions, 500)
        radius, _, half = rig.airframes[0].shape.half
        motions["time"], motions["end_time"] = 0.0, 1.0
        motions["quaternion"] = random_attitudes(rng, len(motions))
        angle = 10 ** rng.uniform(-4, -0.3, (len(motions), 1))
        motions["rotation"] = angle * random_directions(rng, len(motions))
        motions["displacement"] = 10 ** rng.uniform(-7, -2, (len(motions), 1)) * rng.normal(
            size=(len(motions), 3)
        )
        motions["position"] = 0.0
        gap = CONTACT_DISTANCE + 10 ** rng.uniform(-7, -3, len(motions))
        start = np.zeros(len(motions))
        motions["position"][:, 2] = gap - _heights(motions, start, radius, half)
        times = _times(rig.engine.scenery, motions, rig.dynamics.contact.space.scratch)
    hits = times < NO_IMPACT
    assert 100 < hits.sum() < 400
    at_touch = _heights(motions[hits], times[hits], radius, half)
    assert np.abs(at_touch - CONTACT_DISTANCE).max() < 1e-12
    for motion, time in zip(motions, times, strict=True):
        before = SAMPLES[time > SAMPLES]
        heights = _heights(np.repeat(motion, len(before)), before, radius, half)
        assert heights.min() > CONTACT_DISTANCE - 1e-12


def _poses(motions: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places and attitudes of drones (M, ...) after shares (M,) of a substep."""
    share = share.reshape(-1, *[1] * motions.ndim)
    quaternion = motions["quaternion"]
    turn = Rotation.from_rotvec((share * motions["rotation"]).reshape(-1, 3))
    attitude = (turn * Rotation.from_quat(quaternion.reshape(-1, 4))).as_quat()
    return motions["position"] + share * motions["displacement"], attitude.reshape(quaternion.shape)


def _gaps(rig: Rig, motions: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return distances (M,), m, of drones (M,) from an obstacle at the origin, or in pairs (M, 2).

    They are those after shares (M,) of the substep.
    """
    place, attitude = _poses(motions, share)
    if motions.ndim == 1:
        # The obstacle
        place = np.stack([place, np.zeros(place.shape)], axis=1)
        attitude = np.stack([attitude, np.tile([0.0, 0, 0, 1], (len(motions), 1))], axis=1)
    table = rig.engine.scenery.table
    return measure_gaps(table, 0, 1, place[:, 0], attitude[:, 0], place[:, 1], attitude[:, 1])


def _unit(quaternion: tuple[float, ...]) -> np.ndarray:
    """Return a quaternion of as many digits as a float has."""
    return np.array(quaternion) / np.linalg.norm(quaternion)


def test_rims_that_graze_an_edge_touch_where_they_reach_it() -> None:
    """Newton's method alone goes back and forth here, between too far away and too close."""
    with Rig(["iris"], obstacles=[TARGETS["wall of 2 mm"]]) as rig:
        rig.obstacle[:] = 0.0
        rig.place()
        motions = np.repeat(rig.dynamics.contact.space.motions, 40)
        motions["time"], motions["end_time"] = 0.0, 1.0
        motions["position"] = (0.3851, -2.0031, -0.6644)
        motions["position"][:, 0] += np.linspace(3e-5, 6e-5, len(motions))
        motions["quaternion"] = _unit((0.15571, 0.20242, -0.77796, 0.57407))
        motions["displacement"] = (0.0015, 0.0552, -0.0376)
        motions["rotation"] = (-0.0004, -0.0281, 0.0216)
        assert _gaps(rig, motions, np.zeros(len(motions))).min() > 1.1 * CONTACT_DISTANCE
        times = _times(rig.engine.scenery, motions, rig.dynamics.contact.space.scratch)
        assert times.max() < 0.5
        assert np.abs(_gaps(rig, motions, times) - CONTACT_DISTANCE).max() < 1e-11


def _on_a_way(rig: Rig, way: tuple[tuple[float, ...], ...]) -> np.ndarray:
    """Return the motion (1,) of a rig's only drone: place, attitude, move and turn."""
    motions = rig.dynamics.contact.space.motions
    motions["time"], motions["end_time"] = 0.0, 1.0
    for column, values in zip(
        ("position", "quaternion", "displacement", "rotation"), way, strict=True
    ):
        motions[column] = _unit(values) if column == "quaternion" else values
    return motions


GRAZES = {
    "hull": (
        (-0.2696170430, -0.4391763274, 0.4271825507),
        (0.8128688797, 0.3417271410, 0.3367741287, 0.3302270912),
        (-0.0009525733, 0.0001216883, 0.0000983275),
        (0.0809235306, -0.2251732119, 0.3834387695),
    ),
    "wire of 2 cm": (
        (-0.02920906, -0.03232178, 2.06237194),
        (-0.07168078, 0.44991470, 0.46764095, 0.75746325),
        (-0.00014351, -0.00019156, -0.00016930),
        (-0.40653350, 0.17028877, 0.08880891),
    ),
}
"""Place, attitude, move and turn of Crazyflies that come 3 and 10 um closer than a touch"""


@pytest.mark.parametrize("name", GRAZES)
def test_no_search_leaps_over_a_graze(name: str) -> None:
    """By Newton's method alone, where others than the nearest points come closer."""
    with Rig(obstacles=[TARGETS[name]]) as rig:
        rig.obstacle[:] = 0.0
        rig.place()
        motions = _on_a_way(rig, GRAZES[name])
        gaps = _gaps(rig, np.repeat(motions, len(SAMPLES)), SAMPLES)
        assert gaps[0] > CONTACT_DISTANCE > gaps.min()
        times = _times(rig.engine.scenery, motions, rig.dynamics.contact.space.scratch)
        assert times[0] < SAMPLES[gaps.argmin()]
        assert abs(_gaps(rig, motions, times)[0] - CONTACT_DISTANCE) < 1e-11


PASSES_BY = (
    (-0.28275330768, -0.37440983008, 0.41394313282),
    (-0.89400972663, -0.42929478511, -0.10543394635, 0.07304984008),
    (-0.00852844051, -0.01826717994, -0.00082291301),
    (0.10639913048, -0.30584888929, 0.15517814362),
)
"""Place, attitude, move and turn of a racer that passes by 0.9 um farther away than a touch"""


def test_slow_searches_that_pass_by_find_no_impact() -> None:
    """After 200 steps the search ended here, 0.2 mm before the least gap, as if that touched."""
    with Rig(["racer"], obstacles=[TARGETS["hull"]]) as rig:
        rig.obstacle[:] = 0.0
        rig.place()
        motions = _on_a_way(rig, PASSES_BY)
        gaps = _gaps(rig, np.repeat(motions, len(SAMPLES)), SAMPLES)
        assert 0 < gaps.min() - CONTACT_DISTANCE < 1e-6
        times = _times(rig.engine.scenery, motions, rig.dynamics.contact.space.scratch)
    assert times[0] == NO_IMPACT


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize("frames", [("cf2x", "cf2x"), ("cf2x", "racer")])
def test_turning_pairs_touch_when_their_distance_says(
    frames: tuple[str, str], together: bool
) -> None:
    """Also pairs that rotate about each other as one, or roll, and hardly approach."""
    rng = np.random.default_rng(7)
    count = 150
    with Rig(list(frames)) as rig:
        motions = np.repeat(rig.dynamics.contact.space.motions[None], count, axis=0)
        motions["time"], motions["end_time"] = 0.0, 1.0
        motions["quaternion"] = random_attitudes(rng, count, 2)
        away = random_directions(rng, count)
        angle = 10 ** rng.uniform(-3, -0.3, (count, 1))
        turn = angle * random_directions(rng, count)
        other = 10 ** rng.uniform(-3, -0.3, (count, 1)) * random_directions(rng, count)
        motions["rotation"] = np.stack([turn, turn if together else other], axis=1)
        # As near as they get
        gap = CONTACT_DISTANCE + 10 ** rng.uniform(-6, -3, count)
        motions["position"] = motions["displacement"] = 0.0
        near, far = np.zeros(count), np.ones(count)
        for _ in range(50):
            middle = 0.5 * (near + far)
            motions["position"][:, 0] = middle[:, None] * away
            close = _gaps(rig, motions, np.zeros(count)) < gap
            near, far = np.where(close, middle, near), np.where(close, far, middle)
        motions["position"][:, 0] = far[:, None] * away
        drift = 10 ** rng.uniform(-7, -3, (count, 1)) * random_directions(rng, count)
        # About b, so that centres go round each other
        motions["displacement"][:, 0] = np.cross(turn, far[:, None] * away) + drift
        times = _times(rig.engine.scenery, motions, rig.dynamics.contact.space.scratch)
        hits = times < NO_IMPACT
        assert count / 10 < hits.sum() < count
        at_touch = _gaps(rig, motions, np.where(hits, times, 0.0))
        assert np.abs(at_touch - CONTACT_DISTANCE)[hits].max() < 1e-12
        for share in np.linspace(0, 1, 101):
            before = np.minimum(share, np.where(hits, times, 1.0))
            assert (_gaps(rig, motions, before) > CONTACT_DISTANCE - 1e-12).all()


def _grazing(
    rig: Rig, rng: np.random.Generator, count: int, steps: int, least_turn: float = -3.0
) -> np.ndarray:
    """Return ways whose least gap is that of a touch, with turns from 10**least_turn rad on."""
    motions = np.repeat(rig.dynamics.contact.space.motions, count)
    motions["time"], motions["end_time"] = 0.0, 1.0
    motions["quaternion"] = random_attitudes(rng, count)
    angle = 10 ** rng.uniform(least_turn, -0.3, (count, 1))
    motions["rotation"] = angle * random_directions(rng, count)
    motions["displacement"] = 10 ** rng.uniform(-3, -1, (count, 1)) * random_directions(rng, count)
    away = random_directions(rng, count)
    near, far = np.zeros(count), np.full(count, 6.0)
    for _ in range(steps):
        middle = 0.5 * (near + far)
        motions["position"] = middle[:, None] * away
        apart = _least(rig, motions) > CONTACT_DISTANCE
        near, far = np.where(apart, near, middle), np.where(apart, middle, far)
    motions["position"] = far[:, None] * away
    return motions


def _least(rig: Rig, motions: np.ndarray) -> np.ndarray:
    """Return the least gaps on ways: of samples, and by the golden section about the least one."""
    shares = np.linspace(0, 1, 65)
    gaps = np.array([_gaps(rig, motions, np.full(len(motions), share)) for share in shares])
    lowest = gaps.argmin(axis=0)
    begin = shares[np.maximum(lowest - 1, 0)]
    end = shares[np.minimum(lowest + 1, len(shares) - 1)]
    golden = 0.5 * (np.sqrt(5) - 1)
    for _ in range(40):
        one, two = end - golden * (end - begin), begin + golden * (end - begin)
        first = _gaps(rig, motions, one) < _gaps(rig, motions, two)
        begin, end = np.where(first, begin, one), np.where(first, two, end)
    return np.minimum(gaps.min(axis=0), _gaps(rig, motions, 0.5 * (begin + end)))


def test_drones_separated_by_a_plane_do_not_touch_on_their_path() -> None:
    """Also where the pair is apart at both ends, and comes together in between."""
    rng = np.random.default_rng(5)
    with Rig(["iris"], obstacles=[TARGETS["wall of 20 cm"]]) as rig:
        rig.obstacle[:] = 0.0
        rig.place()
        scenery = rig.engine.scenery
        motions = _grazing(rig, rng, 200, 20, least_turn=-0.5)
        side = np.sign(motions["position"][:, :1])
        across = side * (1.0, 0.0, 0.0)
        # A little nearer than a touch
        motions["position"] -= 1e-5 * across
        touches = _least(rig, motions) < CONTACT_DISTANCE
        ends = np.minimum(*(_gaps(rig, motions, np.full(200, share)) for share in (0.0, 1.0)))
        assert ((ends > 2 * MAX_CONTACT_DISTANCE) & touches).sum() > 10
        assert not (_kept_apart(scenery, motions, across) & touches).any()
        # Well away from one
        motions["position"] += 0.02 * across
        apart = _kept_apart(scenery, motions, across)
        assert not (apart & (_least(rig, motions) < CONTACT_DISTANCE)).any()
        assert apart.mean() > 0.5
        assert not _kept_apart(scenery, motions, 0.0 * across).any()


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("airframe", ["cf2x", "racer", "iris"])
def test_grazes_by_nanometres_are_found_correctly(airframe: str, name: str) -> None:
    """Ways are moved until the least gap on them is that of a touch, and then by 1 nm to 0.1 mm."""
    rng = np.random.default_rng(1)
    count = 1000
    with Rig([airframe], obstacles=[TARGETS[name]]) as rig:
        rig.obstacle[:] = 0.0
        rig.place()
        motions = _grazing(rig, rng, count, 40)
        away = motions["position"] / np.linalg.norm(motions["position"], axis=1, keepdims=True)
        shift = 10 ** rng.uniform(-9, -4, (count, 1)) * rng.choice([-1, 1], (count, 1))
        motions["position"] += shift * away
        least = _least(rig, motions)
        outside = _gaps(rig, motions, np.zeros(count)) > CONTACT_DISTANCE
        touched = (
            _times(rig.engine.scenery, motions, rig.dynamics.contact.space.scratch) < NO_IMPACT
        )
    assert 100 < touched.sum() < count - 100
    assert not (touched & (least > CONTACT_DISTANCE + LOOSE_TOI_TOLERANCE)).any()
    assert not (~touched & outside & (least < CONTACT_DISTANCE - 1e-12)).any()
