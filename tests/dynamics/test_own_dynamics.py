"""Dynamics of a user's own: one substep of flight in numpy, everything else from the base class."""

import numpy as np
import pytest
from bench import Bench

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import DYNAMICS, find_dynamics
from bulletuav.dynamics.base import Dynamics
from bulletuav.registry import names
from bulletuav.vehicle.swarm import GROUND

DRAG = 0.5  # 1/s


class Gliding(Dynamics):
    """A double integrator with linear drag, solved exactly for a constant acceleration."""

    consumes = SetpointLevel.ACCELERATION

    def advance_substep(self, swarm, alive, setpoint, air):
        dt = self.flight.dt
        decay = np.exp(-DRAG * dt)
        final = air.wind + setpoint[..., :3] / DRAG
        away = swarm.velocity - final
        swarm.position[:] += final * dt + away * (1 - decay) / DRAG
        swarm.velocity[:] = final + decay * away


class Spinning(Dynamics):
    """Rotors that follow their commands at once, on a body that stays where it is."""

    name = "spinning_top"
    consumes = SetpointLevel.ROTOR
    feels_surface = True

    def advance_substep(self, swarm, alive, setpoint, air):
        self.surface = air.surface
        swarm.rotor_speed[:] = setpoint


class Broken(Gliding):
    """It gives a position that is none."""

    def advance_substep(self, swarm, alive, setpoint, air):
        swarm.position[1, 0] = np.nan


@pytest.fixture
def aviary():
    """Build two worlds of three drones with own dynamics, and close them."""
    made = []

    def make(dynamics, **options):
        made.append(bulletuav.Aviary("converge", 2, num_drones=3, dynamics=dynamics, **options))
        made[-1].reset(seeds=0)
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_the_flight_is_that_of_the_closed_form():
    bench = Bench(Gliding, worlds=2, drones=2, wind=(1.0, 0.0, 0.0))
    bench.swarm.velocity[1] = 2.0, -1.0, 0.0
    start = bench.swarm.copy()
    bench.place().fly(SetpointLevel.ACCELERATION, (0.5, 0.2, 0.1, 0.0), decisions=5)
    bench.engine.close()

    elapsed = 5 * 24 / 240
    decay = np.exp(-DRAG * elapsed)
    final = np.array([1.0 + 0.5 / DRAG, 0.2 / DRAG, 0.1 / DRAG])
    away = start.velocity - final
    moved = final * elapsed + away * (1 - decay) / DRAG
    np.testing.assert_allclose(bench.swarm.velocity, final + decay * away, atol=1e-12)
    np.testing.assert_allclose(bench.swarm.position, start.position + moved, atol=1e-12)


def test_a_batch_flies_a_task_and_setpoints_above_go_through_the_controller(aviary):
    one = aviary(Gliding)
    assert one.setpoint_level == SetpointLevel.ACCELERATION
    assert one.options.dynamics_name == "Gliding"
    before = one.swarm.position.copy()
    for _ in range(5):
        step = one.step(np.full((2, 3, 3), (1.0, 0.0, 0.0)))
    assert np.isfinite(step.rewards).all()
    assert ((one.swarm.position - before)[..., 0] > 0).all()
    assert (one.swarm.velocity[..., 0] > 1.0).all()


def test_contacts_stop_drones_and_the_dead_stay(make_bench):
    bench = make_bench(Gliding, worlds=2, drones=3)
    bench.swarm.position[:, :, 2] = 0.5
    bench.swarm.velocity[:, 0] = 0, 0, -8
    bench.swarm.velocity[:, 2] = 5, 0, 0
    bench.alive[0, 2] = False
    contacts = bench.place().fly(SetpointLevel.ACCELERATION, (0.0, 0.0, 0.0, 0.0))
    assert contacts.world.tolist() == [0, 1]
    assert contacts.drone.tolist() == [0, 0]
    assert contacts.other.tolist() == [GROUND, GROUND]
    np.testing.assert_allclose(bench.swarm.position[:, 0, 2], 0.05505, atol=5e-5)
    assert not bench.swarm.velocity[:, 0].any()
    assert bench.swarm.position[:, 2, 0].tolist() == [10.0, pytest.approx(10.5, abs=0.02)]


def test_contacts_push_drones_where_that_is_asked_for(make_bench):
    """It comes down at 8 m/s, goes on along the ground, and friction takes 0.5 * 8 m/s from it."""
    bench = make_bench(Gliding, contacts="impulse", friction=0.5)
    bench.swarm.position[:, :, 2] = 0.5
    bench.swarm.velocity[:, 0] = 5, 0, -8
    contacts = bench.place().fly(SetpointLevel.ACCELERATION, (0.0, 0.0, 0.0, 0.0))
    assert contacts.other.tolist() == [GROUND]
    decay = np.exp(-DRAG * 0.1)
    velocity = bench.swarm.velocity[0, 0]
    np.testing.assert_allclose(velocity, ((5 - 0.5 * 8) * decay, 0, 0), atol=1e-2)
    assert 0.055 < bench.swarm.position[0, 0, 2] <= 0.0551
    np.testing.assert_allclose(contacts.normal, [(0, 0, 1)], atol=1e-9)
    np.testing.assert_allclose(contacts.impulse, 8 * decay**0.5 * 0.716, rtol=0.03)


def test_rotor_speeds_and_the_surface_below_are_told(make_bench):
    bench = make_bench(Spinning, worlds=2)
    bench.swarm.position[1, 0, 2] = 3
    bench.place().fly(SetpointLevel.ROTOR, (100.0, 200.0, -5.0, 1e9))
    most = bench.airframe.max_rotor_speed
    np.testing.assert_array_equal(bench.swarm.rotor_speed, np.full((2, 1, 4), (100, 200, 0, most)))
    np.testing.assert_allclose(bench.dynamics.surface, 0, atol=1e-6)
    bench.fly(SetpointLevel.POSITION, (0.0, 0.0, 10.0, 0.0))
    lower, higher = bench.swarm.rotor_speed[::-1].sum(axis=-1)
    assert lower > higher > 0


def test_what_is_wrong_is_named(make_bench, aviary):
    with pytest.raises(RuntimeError, match="'Broken' gave drone 0 in world 1 a position"):
        make_bench(Broken, worlds=2).fly(SetpointLevel.ACCELERATION, (0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="dynamics 'Gliding' is driven by acceleration"):
        aviary(Gliding, action="rates")
    with pytest.raises(ValueError, match=r"unknown dynamics .*int.*: choose from bullet"):
        aviary(int)
    with pytest.raises(ValueError, match="cannot be imported: No module named 'nowhere'"):
        aviary("nowhere:Gliding")


def test_a_dynamics_without_flight_names_what_it_lacks(make_bench):
    class Lazy(Dynamics):
        consumes = SetpointLevel.VELOCITY

    with pytest.raises(NotImplementedError, match="'Lazy' lacks advance_substep"):
        make_bench(Lazy).fly(SetpointLevel.VELOCITY, (0.0, 0.0, 0.0, 0.0))


def test_setpoints_that_no_controller_gives_are_refused(make_bench):
    class Turning(Gliding):
        consumes = SetpointLevel.RATES

    with pytest.raises(ValueError, match="velocity setpoints cannot be converted to rates"):
        make_bench(Turning).fly(SetpointLevel.VELOCITY, (0.0, 0.0, 0.0, 0.0))


def test_names_module_paths_and_classes_are_found():
    assert set(DYNAMICS) <= set(names("dynamics"))
    assert [find_dynamics(name).name for name in DYNAMICS] == list(DYNAMICS)
    by_path = find_dynamics("bulletuav.dynamics.rigid_body:RigidBody")
    assert by_path is find_dynamics("rigid_body") is find_dynamics(by_path)
    assert Spinning.name == "spinning_top"
    with pytest.raises(ValueError, match="unknown dynamics 'bulet': did you mean 'bullet'"):
        find_dynamics("bulet")
