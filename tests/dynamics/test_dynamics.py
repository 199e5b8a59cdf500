import inspect

import numpy as np
import pytest
from bench import MULTIROTORS
from reference import Reference
from scipy.spatial.transform import Rotation

import bulletuav
from bulletuav import load_airframe
from bulletuav.compiled.program import Program
from bulletuav.control.setpoint import Setpoints
from bulletuav.dynamics import bullet, kinematic, rigid_body
from bulletuav.vehicle.swarm import Swarm

G = 9.80665
AIRFRAMES = MULTIROTORS
BOTH = ("bullet", "rigid_body")
TUMBLE = (3.0, 2.0, 5.0)


@pytest.fixture
def iris_inertia(urdf):
    """A body with two equal moments, whose torque-free motion has a closed form."""
    old = 'ixx="0.007" iyy="0.007" izz="0.012"'
    return urdf("hummingbird", (old, 'ixx="0.029125" iyy="0.029125" izz="0.055225"'))


def attitude_error(one, two):
    """Degrees between two quaternions."""
    return np.degrees((Rotation.from_quat(one).inv() * Rotation.from_quat(two)).magnitude())


def energy(rates, inertia=(0.029125, 0.029125, 0.055225)):
    return 0.5 * np.dot(inertia, np.square(rates))


def fall(make_bench, dynamics, hz, seconds=1.0):
    bench = make_bench(dynamics, hz=hz, substeps=int(hz * seconds), effects=())
    bench.swarm.rotor_speed[:] = 0
    bench.swarm.position[..., 2] = 1000
    return bench.place()


# Falling and flying without thrust


@pytest.mark.parametrize("dynamics", BOTH)
def test_free_fall_and_ballistic_flight_are_exact(make_bench, dynamics):
    bench = fall(make_bench, dynamics, 240)
    bench.swarm.velocity[:] = 3, -2, 8
    bench.place().spin(0.0)
    np.testing.assert_allclose(bench.swarm.position[0, 0], (3, -2, 1008 - G / 2), atol=1e-9)
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], (3, -2, 8 - G), atol=1e-9)


def test_bullet_has_the_mean_velocity_of_a_substep(make_bench):
    bench = fall(make_bench, "bullet", 240, seconds=1 / 240)
    bench.swarm.velocity[:] = 3, -2, 8
    bench.swarm.rates[:] = 0, 0, 5
    bench.place().spin(0.0)
    np.testing.assert_allclose(bench.engine.velocity[0, 0], (3, -2, 8 - G / 480), atol=1e-9)
    np.testing.assert_allclose(bench.engine.omega[0, 0], (0, 0, 5), atol=1e-9)


@pytest.mark.parametrize("dynamics", BOTH)
def test_without_gravity_and_forces_nothing_slows_down(make_bench, dynamics):
    bench = make_bench(dynamics, gravity=0.0, effects=(), substeps=240)
    bench.swarm.rotor_speed[:] = 0
    bench.swarm.velocity[:] = 150, 0, 20  # beyond the engine's default clamp
    bench.place().spin(0.0)
    np.testing.assert_allclose(bench.swarm.velocity[0, 0], (150, 0, 20), rtol=1e-12)
    np.testing.assert_allclose(bench.swarm.position[0, 0], (150, 0, 30), rtol=1e-9)


# Tumbling


def tumble(make_bench, dynamics, airframe, hz=240):
    bench = make_bench(dynamics, airframe, gravity=0.0, effects=(), hz=hz, substeps=hz)
    bench.swarm.rotor_speed[:] = 0
    bench.swarm.rates[:] = TUMBLE
    bench.place().spin(0.0)
    return bench


def exact_tumble(airframe):
    airframe = load_airframe(airframe)
    nothing = Reference(airframe, np.zeros(4), gravity=0.0, drag=False, ground_effect=False)
    return nothing.solve(np.zeros(3), (0, 0, 0, 1), np.zeros(3), TUMBLE, np.zeros(4), 1.0)


def test_the_reference_has_the_closed_form(iris_inertia):
    np.testing.assert_allclose(exact_tumble(iris_inertia)[3], (1.25765, -3.37910, 5), atol=5e-6)


@pytest.mark.parametrize("dynamics", BOTH)
def test_drones_tumble_exactly_and_conserve_energy_and_momentum(make_bench, iris_inertia, dynamics):
    bench = tumble(make_bench, dynamics, iris_inertia)
    _, quaternion, _, rates = exact_tumble(iris_inertia)
    np.testing.assert_allclose(bench.swarm.rates[0, 0], rates, atol=1e-6)
    # Either sign is the same attitude
    assert abs(bench.swarm.quaternion[0, 0] @ quaternion) == pytest.approx(1, abs=1e-12)
    assert energy(bench.swarm.rates[0, 0]) == pytest.approx(energy(TUMBLE), rel=1e-8)
    J = np.array((0.029125, 0.029125, 0.055225))
    momentum = Rotation.from_quat(bench.swarm.quaternion[0, 0]).apply(J * bench.swarm.rates[0, 0])
    np.testing.assert_allclose(momentum, J * TUMBLE, atol=1e-7)


def test_the_engine_alone_would_gain_energy(make_bench, iris_inertia):
    bench = make_bench("bullet", iris_inertia, gravity=0.0, effects=())
    bench.swarm.rates[:] = TUMBLE
    bench.place()
    for _ in range(240):
        bench.engine.step()
    bench.engine.read_states(bench.swarm, bench.alive)
    assert energy(bench.swarm.rates[0, 0]) / energy(TUMBLE) - 1 == pytest.approx(0.0188, abs=0.001)


# Powered flight


def same_state(swarm, expected, i=0):
    """Position, attitude (either sign), velocity and rates of drone i, to 1e-6."""
    position, quaternion, velocity, rates = expected
    np.testing.assert_allclose(swarm.position[0, i], position, atol=1e-6)
    assert abs(swarm.quaternion[0, i] @ quaternion) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(swarm.velocity[0, i], velocity, atol=1e-6)
    np.testing.assert_allclose(swarm.rates[0, i], rates, atol=1e-6)


def powered(make_bench, dynamics, airframe, **options):
    bench = make_bench(dynamics, airframe, substeps=72, **options)
    bench.swarm.position[..., 2] = 0.15
    bench.swarm.quaternion[:] = Rotation.from_euler("xyz", (0.1, -0.2, 0.5)).as_quat()
    bench.swarm.velocity[:] = 1, 2, 0.5
    bench.swarm.rates[:] = 0.2, -0.1, 0.3
    bench.start = Swarm(*(array[0, 0].copy() for array in bench.swarm.copy()))
    bench.command = bench.airframe.hover_speed() * np.resize(
        [1.08, 1.08, 1.09, 1.08], len(bench.airframe.rotors)
    )
    return bench.place()


@pytest.mark.parametrize("dynamics", BOTH)
@pytest.mark.parametrize("airframe", AIRFRAMES)
def test_flight_agrees_with_an_independent_integration_of_all_forces(
    make_bench, airframe, dynamics
):
    bench = powered(make_bench, dynamics, airframe, wind=(2.0, -1.0, 0.3))
    bench.spin(bench.command)
    exact = Reference(bench.airframe, bench.command, wind=(2.0, -1.0, 0.3)).solve(
        *bench.start[:5], 0.3
    )
    same_state(bench.swarm, exact)


@pytest.mark.parametrize("dynamics", BOTH)
@pytest.mark.parametrize("airframe", AIRFRAMES)
def test_flight_agrees_with_an_independent_integration_in_a_wake(make_bench, airframe, dynamics):
    """In wind, with a wake that is held within a substep, as `rigid_body` says."""
    wind = (2.0, -1.0, 0.3)
    bench = powered(make_bench, dynamics, airframe, drones=2, wind=wind)
    arm = bench.airframe.arm
    bench.swarm.position[..., 2] = 2.0
    bench.swarm.position[0, 0, :2] = 0.0
    bench.swarm.position[0, 1] = bench.swarm.position[0, 0] + (0.2 * arm, -0.1 * arm, 4 * arm)
    begin = bench.swarm.copy()
    bench.place().spin(bench.command)
    pair = [Reference(bench.airframe, bench.command, wind=wind) for _ in range(2)]
    states = [[array[0, i] for array in begin[:4]] for i in range(2)]
    for step in range(72):
        speeds = pair[1].speeds(begin.rotor_speed[0, 1], step / 240)
        pair[1].blow_on(pair[0], states[0][0] - states[1][0], speeds, states[0][1])
        assert pair[0].push[2] < -0.01 * bench.airframe.mass * G
        states = [
            one.solve(*state, one.speeds(begin.rotor_speed[0, i], step / 240), 1 / 240)
            for i, (one, state) in enumerate(zip(pair, states, strict=True))
        ]
    for i, state in enumerate(states):
        same_state(bench.swarm, state, i)


@pytest.mark.parametrize("airframe", AIRFRAMES)
def test_both_agree_in_free_flight_under_a_controller(make_bench, airframe):
    ends = []
    for dynamics in BOTH:
        bench = make_bench(dynamics, airframe, substeps=240)
        bench.swarm.velocity[:] = 2, -1, 0
        bench.swarm.quaternion[:] = Rotation.from_euler("x", 0.3).as_quat()
        bench.place().fly(0, (1.0, 1.0, 11.0, 0.0))
        ends.append(bench.swarm)
    for one, other in zip(*ends, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("dynamics", BOTH)
def test_rpm_obeys_the_plain_quadrotor_equations(dynamics):
    """Thrust, torque and weight alone, through the public interface, for 1 s."""
    env = bulletuav.parallel_env("hover", action="rpm", effects=(), dynamics=dynamics, height=3.0)
    env.reset(seed=0)
    start = env.aviary.swarm.world(0).copy()
    rpm = np.array([16750.0, 16760.0, 16755.0, 16752.0])
    for _ in range(30):
        env.step({"drone_0": rpm})
    model = Reference(
        load_airframe("cf2x"), rpm * 2 * np.pi / 60, lag=False, drag=False, ground_effect=False
    )
    begin = [array[0] for array in start]
    same_state(env.aviary.swarm, model.solve(*begin[:5], 1.0))
    env.close()


@pytest.mark.parametrize("dynamics", BOTH)
def test_downwash_pushes_the_lower_drone_only(make_bench, dynamics):
    speeds = []
    for effects in ((), ("downwash",)):
        bench = make_bench(dynamics, "cf2x", drones=2, effects=effects)
        bench.swarm.position[0] = (0, 0, 10), (0, 0, 11)
        bench.place().spin(bench.airframe.hover_speed())
        speeds.append(bench.swarm.velocity[0, :, 2].copy())
    np.testing.assert_allclose(speeds[0], 0, atol=1e-9)
    # 0.32 m g 0.046 / sqrt(0.046^2 + 0.1^2) = 0.0354 N, for 0.1 s
    assert speeds[1][0] == pytest.approx(-0.0354 / 0.027 * 0.1, rel=0.02)
    assert speeds[1][1] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("dynamics", BOTH)
def test_steady_wind_carries_a_hovering_drone(make_bench, dynamics):
    bench = make_bench(dynamics, "cf2x", wind=(3.0, 0, 0), substeps=1)
    bench.place().spin(bench.airframe.hover_speed())
    drag = 1.6e-6 * 4 * bench.airframe.hover_speed() * 3 + 0.5 * 1.225 * 5e-4 * 9
    assert bench.swarm.velocity[0, 0, 0] == pytest.approx(drag / 0.027 / 240, rel=1e-3)


@pytest.mark.parametrize("dynamics", BOTH)
def test_drones_that_are_not_alive_neither_move_nor_act(make_bench, dynamics):
    bench = make_bench(dynamics, "cf2x", drones=2, effects=("downwash",))
    bench.swarm.position[0] = (0, 0, 10), (0, 0, 11)
    bench.place()
    bench.alive[0, 1] = False
    bench.engine.park(~bench.alive)
    before = bench.swarm.copy()
    bench.spin(bench.airframe.hover_speed())
    for array, old in zip(bench.swarm, before, strict=True):
        np.testing.assert_array_equal(array[0, 1], old[0, 1])
    assert bench.swarm.velocity[0, 0, 2] == pytest.approx(0, abs=1e-9)  # no wake from above


RANGES = ("begin", "end", "first", "last")
"""Arguments of kernels that threads share: the first item, and the end"""


@pytest.mark.parametrize(
    "advance", [bullet.advance_bullet, kinematic.advance_kinematic, rigid_body.advance_rigid_body]
)
def test_advance_takes_the_same_records_in_all_dynamics(advance):
    names = [one for one in inspect.signature(advance.py_func).parameters if one not in RANGES]
    assert names[:2] == ["decision", "contact"]
    assert len(names) <= 5


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body", "bullet"])
def test_a_decision_has_what_the_dynamics_is_built_from(make_bench, dynamics):
    bench = make_bench(dynamics)
    decisions = []
    bench.dynamics.add_flight = lambda program, decision: decisions.append(decision)
    setpoints = Setpoints(np.zeros(bench.alive.shape, int), np.zeros((*bench.alive.shape, 4)))
    wind = np.zeros((*bench.alive.shape, 3))
    bench.dynamics.add_to(Program(), bench.swarm, bench.alive, setpoints, wind)
    decision, flight = decisions[0], bench.dynamics.flight
    assert decision.drones == (bench.swarm, bench.alive, flight.parameters)
    assert decision.step == (flight.substeps, flight.dt)
    assert decision.setpoints is setpoints
    assert decision.cascade is flight.cascade
    assert decision.air.wind is wind
