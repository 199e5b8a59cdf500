"""Aeroplanes fly through a target position, and then circle it."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav import load_airframe
from bulletuav.control.autopilot import AUTOPILOT_MEMORY, WAYPOINT_PHASE
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.control.waypoint import EXTENDING, HOMING, LOITERING, update_phase
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.envelope import find_envelope, find_trim

TRAINER = load_airframe("trainer")
LIMITS = find_envelope(TRAINER)
CRUISE = LIMITS.cruise_speed
LATERAL = STANDARD_GRAVITY * math.tan(LIMITS.max_bank)
RADIUS = CRUISE**2 / LATERAL
POSITION, VELOCITY, ACCELERATION, ATTITUDE, RATES, ROTOR = SetpointLevel
KINEMATIC = ("single_integrator", "point_mass", "double_integrator")
DYNAMICS = (*KINEMATIC, "rigid_body", "bullet")
WINDS = ((5.0, 0.0, 0.0), (0.0, 5.0, 0.0), (-5.0, 0.0, 0.0), (0.0, -5.0, 0.0))
DECISION = 10 / 240


def phase_of(target, phase=HOMING, dt=0.0, last=None, velocity=(10.0, 0.0, 0.0)):
    """Phase of an aeroplane at the origin at 10 m/s, whose tightest turn has a radius of 10 m."""
    memory = np.zeros(4)
    memory[1:] = phase, *(last or target)
    found = update_phase((0.0, 0.0, 0.0), velocity, (*target, 0.0), 10.0, 10.0, dt, memory, 1)
    assert memory.tolist() == [0.0, found, *target]
    return found


@pytest.mark.parametrize("side", [1, -1])
def test_a_target_inside_a_turn_circle_is_one_to_fly_on_from(side):
    # The centre of the circle is 10 m to the side, so that abeam it ends at 20 m
    assert phase_of((0.0, 19.9 * side)) == EXTENDING
    assert phase_of((0.0, 20.1 * side)) == HOMING
    # 8^2 + (16 - 10)^2 = 10^2
    assert phase_of((8.0, 15.9 * side)) == EXTENDING
    assert phase_of((8.0, 16.1 * side)) == HOMING
    assert phase_of((7.9, 16.0 * side)) == EXTENDING
    assert phase_of((-8.1, 16.0 * side)) == HOMING


@pytest.mark.parametrize("side", [1, -1])
def test_an_extension_ends_outside_a_wider_circle(side):
    # Behind the middle of a circle of 13 m: x^2 + (10 - 13)^2 = 13^2, so x = 12.649
    assert phase_of((-12.6, 10.0 * side), EXTENDING) == EXTENDING
    assert phase_of((-12.7, 10.0 * side), EXTENDING) == HOMING
    assert phase_of((-12.6, 10.0 * side), HOMING) == HOMING


@pytest.mark.parametrize("phase", [HOMING, EXTENDING])
def test_a_pass_is_abeam_and_within_a_tenth_of_the_radius(phase):
    assert phase_of((-0.01, 0.99), phase) == LOITERING
    assert phase_of((0.0, 0.0), phase) == LOITERING
    assert phase_of((-0.01, 1.01), phase) == EXTENDING
    # Before it is abeam
    assert phase_of((0.01, 0.99), phase) == EXTENDING
    assert phase_of((0.9, 0.0), phase) == HOMING
    # A pass of the last 0.1 s, in which it flew 1 m
    assert phase_of((-1.7, 0.99), phase, dt=0.1) == LOITERING
    assert phase_of((-1.8, 0.99), phase, dt=0.1) != LOITERING


def test_a_step_of_the_target_by_half_of_the_radius_is_a_new_target():
    assert phase_of((40.0, 0.0), LOITERING, last=(36.0, 2.9)) == LOITERING
    # 4^2 + 3.1^2 > 5^2
    assert phase_of((40.0, 0.0), LOITERING, last=(36.0, 3.1)) == HOMING
    # An extension for the last target is none for the new one
    assert phase_of((-12.6, 10.0), EXTENDING, last=(0.0, 10.0)) == HOMING


def test_an_aeroplane_at_rest_homes():
    assert phase_of((5.0, 0.0), velocity=(0.0, 0.0, 0.0)) == HOMING


class Approaches:
    """Aeroplanes in cruise, one in each world, each with a target of its own.

    Attributes:
        position: (T, W, 2) horizontal positions, m, after every substep or decision.
        phase: (T, W) their phases.
        away: (T, W) horizontal distances from the targets, m.
        passes: (W,) index of the first row after the pass.
        miss: (W,) closest distance to the target around the pass, on straight lines between the
            rows, m.
        extra: (W,) path over ground until the pass, less the distance at the start, m.
    """

    def __init__(self, bench, headings, offsets, winds, seconds):
        self.bench = bench
        worlds = len(bench.alive)
        bench.wind[:, 0] = winds
        bench.place_trimmed(find_trim(TRAINER, CRUISE))
        turned = Rotation.from_euler("z", np.reshape(headings, (-1, 1)))
        swarm = bench.swarm
        swarm.position[..., :2] = 0.0
        swarm.quaternion[:, 0] = (turned * Rotation.from_quat(swarm.quaternion[:, 0])).as_quat()
        swarm.velocity[:, 0] = turned.apply((CRUISE, 0.0, 0.0)) + bench.wind[:, 0]
        bench.place()
        self.target = np.zeros((worlds, 1, 4))
        self.target[:, 0, :2] = turned.apply(np.c_[offsets, np.zeros(worlds)])[:, :2]
        self.target[:, 0, 2] = 1000.0
        self.position, self.phase = self.fly(seconds)
        self._measure()

    def fly(self, seconds, level=POSITION, setpoint=None):
        """Fly on, and return positions and phases."""
        bench, positions, phases = self.bench, [], []
        memory = bench.dynamics.flight.cascade.memory
        setpoint = self.target if setpoint is None else setpoint
        for _ in range(round(seconds / (bench.dt * bench.substeps))):
            bench.dynamics.fly(bench.swarm, bench.alive, level, setpoint, bench.wind, bench.motion)
            positions.append(bench.swarm.position[:, 0, :2].copy())
            phases.append(memory[:, 0, WAYPOINT_PHASE - AUTOPILOT_MEMORY].copy())
        return np.array(positions), np.array(phases)

    def _measure(self):
        goal, worlds = self.target[:, 0, :2], np.arange(len(self.target))
        self.away = np.linalg.norm(self.position - goal, axis=-1)
        assert (self.phase[-1] == LOITERING).all()
        self.passes = (self.phase == LOITERING).argmax(axis=0)
        track = np.concatenate([np.zeros((1, *goal.shape)), self.position])
        step = np.diff(track, axis=0)
        part = ((goal - track[:-1]) * step).sum(-1) / (step**2).sum(-1)
        nearest = track[:-1] + np.clip(part, 0, 1)[..., None] * step
        near = np.linalg.norm(nearest - goal, axis=-1)
        around = np.clip(self.passes + np.arange(-3, 2)[:, None], 0, len(near) - 1)
        self.miss = near[around, worlds].min(axis=0)
        flown = np.linalg.norm(step, axis=-1).cumsum(axis=0)
        self.extra = flown[self.passes, worlds] - np.linalg.norm(goal, axis=-1)


BEARINGS = np.arange(12) * math.pi / 6 + 0.05


def spread(distances, *, headings=(0.0,), winds=((0.0, 0.0, 0.0),)):
    """Headings, offsets of targets (ahead and to the left, m) and winds of all combinations."""
    rows = [
        (heading, (distance * math.cos(bearing), distance * math.sin(bearing)), wind)
        for heading in headings
        for wind in winds
        for bearing in BEARINGS
        for distance in distances
    ]
    return tuple(map(list, zip(*rows, strict=True)))


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_targets_at_all_bearings_are_passed_and_then_circled_in_calm_air(make_bench, dynamics):
    """Targets at 3 to 22 m are inside the turn circles, of 15.5 m, at many bearings."""
    few = dynamics == "bullet"
    headings = (0.0,) if few else (0.0, 2.0, 4.0)
    given = spread((8.0, 45.0) if few else (3.0, 8.0, 15.0, 22.0, 45.0, 150.0), headings=headings)
    bench = make_bench(dynamics, TRAINER, worlds=len(given[0]), substeps=10)
    flown = Approaches(bench, *given, seconds=60)
    # The distance of a pass, 0.1 radii, and of a run of the loops: 1.78 m
    assert flown.miss.max() < 0.1 * RADIUS + 0.02 * CRUISE
    # At most a turn
    assert flown.extra.max() < 1.05 * 2 * math.pi * RADIUS
    loiter = 2 * RADIUS
    # The last 20 s: more than a circle
    np.testing.assert_allclose(flown.away[-round(20 / DECISION) :], loiter, rtol=0.1)
    for away, passed in zip(flown.away.T, flown.passes, strict=True):
        assert away[passed:].max() < 1.2 * loiter


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body", "bullet"])
def test_targets_at_all_bearings_are_passed_in_wind(make_bench, dynamics):
    given = spread((8.0,) if dynamics == "bullet" else (3.0, 8.0, 15.0, 30.0, 80.0), winds=WINDS)
    bench = make_bench(dynamics, TRAINER, worlds=len(given[0]), substeps=10)
    flown = Approaches(bench, *given, seconds=75)
    assert flown.miss.max() < 2.0
    # One and a half turns at the speed with the wind behind
    assert flown.extra.max() < 1.5 * 2 * math.pi * (CRUISE + 5.0) ** 2 / LATERAL
    # With the lag of `point_mass`, the circle is wider
    settled = flown.away[-round(20 / DECISION) :]
    np.testing.assert_allclose(settled, 2 * RADIUS, rtol=0.13 if dynamics == "point_mass" else 0.02)


@pytest.mark.parametrize("dynamics", KINEMATIC)
def test_long_substeps_do_not_hide_a_pass(make_bench, dynamics):
    given = spread((15.0, 80.0))
    bench = make_bench(dynamics, TRAINER, worlds=24, hz=10, substeps=1)
    flown = Approaches(bench, *given, seconds=60)
    # 0.1 radii, and the way of a substep
    assert flown.miss.max() < 0.1 * RADIUS + 0.1 * CRUISE
    assert flown.extra.max() < 1.1 * 2 * math.pi * RADIUS


@pytest.mark.parametrize("dynamics", [*KINEMATIC, "rigid_body"])
def test_mirrored_targets_have_mirrored_tracks_until_the_pass(make_bench, dynamics):
    """The loiter after the pass is to the left."""
    offsets = [
        (x, side * y) for x, y in ((60.0, 40.0), (-50.0, 20.0), (5.0, 14.0)) for side in (1, -1)
    ]
    bench = make_bench(dynamics, TRAINER, worlds=6, substeps=10)
    flown = Approaches(bench, [0.0] * 6, offsets, [(0.0, 0.0, 0.0)] * 6, seconds=30)
    assert {EXTENDING, HOMING} <= set(flown.phase[:, 4])
    # The propeller's torque is not symmetric, and shifts tracks by up to two decisions
    atol = 2 * DECISION * CRUISE if dynamics == "rigid_body" else 1e-9
    for k in (0, 2, 4):
        end = min(flown.passes[k : k + 2])
        left, right = flown.position[:end, k], flown.position[:end, k + 1]
        np.testing.assert_allclose(left, right * (1, -1), atol=atol)


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_a_new_target_is_passed_too(make_bench, dynamics):
    bench = make_bench(dynamics, TRAINER, worlds=1, substeps=10)
    flown = Approaches(bench, [0.0], [(60.0, 10.0)], [(0.0, 0.0, 0.0)], seconds=20)
    for step in ((0.0, 9.0), (-30.0, 20.0), (200.0, 0.0)):
        flown.target[0, 0, :2] += step
        position, phase = flown.fly(30)
        assert phase[0, 0] != LOITERING
        assert phase[-1, 0] == LOITERING
        away = np.linalg.norm(position[:, 0] - flown.target[0, 0, :2], axis=-1)
        assert away.min() < 1.8


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_a_target_that_moves_slowly_is_passed_once(make_bench, dynamics):
    """At 4 m/s and 24 decisions a second, as another vehicle that is followed."""
    bench = make_bench(dynamics, TRAINER, worlds=1, substeps=10)
    flown = Approaches(bench, [0.0], [(0.0, 0.0)], [(0.0, 0.0, 0.0)], seconds=DECISION)
    flown.target[0, 0, :2] = 80.0, 10.0
    phases, away = [], []
    for _ in range(1200):
        flown.target[0, 0, 0] += 4.0 * DECISION
        position, phase = flown.fly(DECISION)
        phases.append(phase[0, 0])
        away.append(np.linalg.norm(position[0, 0] - flown.target[0, 0, :2]))
    passed = np.flatnonzero(np.array(phases) == LOITERING)
    assert phases[0] == HOMING
    assert passed.tolist() == list(range(passed[0], 1200))
    assert min(away) < 1.8
    # Around a centre that moves
    assert max(away[passed[0] + 240 :]) < 2.5 * 2 * RADIUS


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
@pytest.mark.parametrize("angle", [0.0, 0.4, 1.5, -2.5])
def test_a_point_that_stays_ahead_is_flown_as_a_velocity(make_bench, dynamics, angle):
    ahead = np.array((math.cos(angle), math.sin(angle)))
    tracks = []
    for level in (POSITION, VELOCITY):
        bench = make_bench(dynamics, TRAINER, worlds=1, substeps=10)
        flown = Approaches(bench, [0.0], [(0.0, 0.0)], [(0.0, 0.0, 0.0)], seconds=DECISION)
        flown.target[0, 0, :2] = CRUISE * ahead
        flown.target[0, 0, 2] = 0.0
        track = []
        for _ in range(200):
            if level == POSITION:
                place = bench.swarm.position[0, 0]
                flown.target[0, 0, :3] = place + (*(60.0 * ahead), 0.0)
            position, phase = flown.fly(DECISION, level, flown.target)
            assert phase[0, 0] == HOMING
            track.append(position[0, 0])
        tracks.append(track)
    # The course to the point changes a little until the next decision
    np.testing.assert_allclose(*tracks, atol=0.3)


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_it_does_not_turn_to_a_near_point_that_stays_abeam(make_bench, dynamics):
    bench = make_bench(dynamics, TRAINER, worlds=1, substeps=10)
    flown = Approaches(bench, [0.0], [(0.0, 0.0)], [(0.0, 0.0, 0.0)], seconds=DECISION)
    before = bench.swarm.velocity[0, 0, :2].copy()
    for _ in range(100):
        flown.target[0, 0, :3] = bench.swarm.position[0, 0] + (0.0, 20.0, 0.0)
        _, phase = flown.fly(DECISION)
        assert phase[0, 0] == EXTENDING
    after = bench.swarm.velocity[0, 0, :2]
    course = [math.atan2(velocity[1], velocity[0]) for velocity in (before, after)]
    assert course[0] == pytest.approx(course[1], abs=0.05)


@pytest.mark.parametrize(
    ("dynamics", "level", "setpoint"),
    [
        ("point_mass", VELOCITY, (CRUISE, 0, 0, 0)),
        ("double_integrator", ACCELERATION, (0, 0, 0, 0)),
        ("rigid_body", VELOCITY, (CRUISE, 0, 0, 0)),
        ("rigid_body", ACCELERATION, (0, 0, 0, 0)),
        ("rigid_body", ATTITUDE, (0, 0, 0, 2.5)),
        ("rigid_body", RATES, (0, 0, 0, 2.5)),
        ("rigid_body", ROTOR, (600.0, 0, 0, 0, 0)),
    ],
)
def test_another_level_between_makes_it_pass_again(make_bench, dynamics, level, setpoint):
    bench = make_bench(dynamics, TRAINER, worlds=1, substeps=10)
    flown = Approaches(bench, [0.0], [(40.0, 0.0)], [(0.0, 0.0, 0.0)], seconds=20)
    flown.fly(DECISION, level, np.reshape(np.array(setpoint, float), (1, 1, -1)))
    position, phase = flown.fly(25)
    assert phase[0, 0] != LOITERING
    assert phase[-1, 0] == LOITERING
    assert np.linalg.norm(position[:, 0] - flown.target[0, 0, :2], axis=-1).min() < 1.8


def make_crossing(**options):
    """Four worlds of one aeroplane that is commanded target positions."""
    options |= {"airframe": "trainer", "num_drones": 1, "action": "target_position"}
    aviary = bulletuav.Aviary("crossing", 4, **options)
    aviary.reset()
    return aviary


@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_crossing_is_solved_by_targets_at_the_goal(dynamics):
    aviary = make_crossing(dynamics=dynamics, seed=2)
    succeeded = np.zeros(4, dtype=bool)
    for _ in range(aviary.options.horizon):
        step = aviary.step(aviary.action.encode(aviary.scene.goal))
        succeeded |= step.info["success"].reshape(4, -1).all(axis=1)
        if step.truncated.any() or succeeded.all():
            break
    aviary.close()
    assert succeeded.all()


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_threads_and_snapshots_give_the_same_bits(dynamics):
    """Property: the phase is part of the state, whichever thread flies the aeroplane."""
    ends = []
    for threads in (1, 2):
        aviary = make_crossing(dynamics=dynamics, turbulence="light", threads=threads, seed=4)
        # All of them are passed after about 60 m
        centre = aviary.action.encode(np.broadcast_to((0.0, 0.0, 50.0), (4, 1, 3)))
        for _ in range(100):
            aviary.step(centre)
        saved = aviary.save_state()
        for _ in range(2):
            for _ in range(40):
                aviary.step(centre)
            away = np.linalg.norm(aviary.swarm.position[..., :2], axis=-1)
            assert (away > RADIUS).all()
            ends.append(aviary.swarm.position.copy())
            aviary.load_state(saved)
        assert (aviary.worlds.cascade.memory[..., WAYPOINT_PHASE - AUTOPILOT_MEMORY] > 0).all()
        aviary.reset()
        assert not aviary.worlds.cascade.memory[..., WAYPOINT_PHASE - AUTOPILOT_MEMORY :].any()
        aviary.close()
    for other in ends[1:]:
        np.testing.assert_array_equal(ends[0], other)


def test_plain_python_gives_the_same_bits():
    ends = []
    for debug in (False, True):
        world = bulletuav.Airspace(
            np.array([(0.0, 0.0, 50.0)]), ["trainer"], dynamics="point_mass", debug=debug
        )
        phases = []
        for target in ((1.0, 5.0, 50.0, 0.0), (-0.1, 0.0, 50.0, 0.0)):
            world.command(0, POSITION, target)
            world.step()
            phases.append(int(world.world.cascade.memory[0, 0, WAYPOINT_PHASE - AUTOPILOT_MEMORY]))
        assert phases == [EXTENDING, LOITERING]
        ends.append(world.swarm.position.copy())
        world.close()
    np.testing.assert_array_equal(*ends)
