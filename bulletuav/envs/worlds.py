"""What W worlds of N drones are made of, and what can be asked of them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.engine.body_source import BodySource
from bulletuav.envs.energy import Energy
from bulletuav.envs.env_spec import MOST_WORLDS, EnvSpec
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.marks import marks_of
from bulletuav.envs.parts import hover_speeds, make_dynamics, make_engine
from bulletuav.envs.randomization import Uncertainty
from bulletuav.envs.renderer import Renderer
from bulletuav.envs.snapshot import (
    MAX_STEPS,
    UNSTARTED,
    Bounds,
    contact_bounds,
    state_bounds,
)
from bulletuav.envs.viewer import VIEWERS, Viewer, make_viewer
from bulletuav.errors import as_int, points_of
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Label
from bulletuav.sensors.sight import line_of_sight
from bulletuav.sensors.suite import SensorSuite
from bulletuav.tasks import TaskSource
from bulletuav.tasks.frame import Frame, Scene
from bulletuav.tasks.targets import links
from bulletuav.vehicle.swarm import Contacts, Swarm
from bulletuav.vehicle.wind import Wind

NOTHING_STANDS = Solids(np.zeros((0, 2, 3)))


class Worlds(Environment):
    """Parts of the batched core: engine, dynamics, sensors, scene; `Aviary` moves them.

    Attributes: see `Aviary`.
    """

    def __init__(
        self,
        task: TaskSource,
        num_worlds: int = 1,
        *,
        first_world: int = 0,
        **options: Any,
    ) -> None:
        """Build the worlds.

        Args:
            task: Name of a task, `module:Name`, or its class.
            num_worlds: W.
            first_world: Number of the first of these worlds among those of several processes.
                World k is then the one that it would be in a single process.
            **options: See `EnvOptions` and the task's config.

        Raises:
            ValueError: An option cannot be.
        """
        self._spec = spec = EnvSpec(task, num_worlds, options)
        self.options, self.task, self.action = spec.options, spec.task, spec.action
        self.observer, self.global_state = spec.observer, spec.state
        self.num_worlds, self.num_drones = spec.num_worlds, self.options.num_drones
        self._first_world = as_int("first_world", first_world, 0, MOST_WORLDS)
        obstacles = self.task.obstacles()
        bodies = (obstacles, self.task.layouts())
        self._engine = make_engine(self.options, self.num_worlds, *bodies, first_world)
        self._dynamics = make_dynamics(self.options, self._engine)
        self.parameters, self._cascade = (
            self._dynamics.flight.parameters,
            self._dynamics.flight.cascade,
        )
        self.options.check_setpoint_levels(self.action.level, self._dynamics.consumes)
        self._renderer = Renderer(self._engine, self.options.render_size)
        shape = (self.num_worlds, self.num_drones)
        self._hover_speed = hover_speeds(self.options)
        self.swarm = Swarm.zeros(*shape, self._hover_speed.shape[1])
        self.scene = Scene.empty(*shape, len(obstacles), self.task.memory())
        self.commanded = np.zeros((*shape, 3))
        self.alive = np.zeros(shape, dtype=bool)
        self.steps = np.zeros(self.num_worlds, dtype=np.int64)
        blowing = (self.options.wind, self.options.wind20)
        self._wind = Wind(*blowing, self.num_worlds, self.options.wind_profile)
        randomization = self.options.randomization
        self._uncertainty = Uncertainty(randomization, self._engine, self.parameters, self._wind)
        drawn = self._uncertainty.drawn
        self._sensors = SensorSuite(spec.sensors, spec.setup, self._engine, drawn)
        self._energy = Energy(self.options, self.parameters, self._dynamics.supply)
        self._nothing_seen = np.zeros((*shape, self.task.num_targets), dtype=bool)
        self.rng: list[np.random.Generator] = [UNSTARTED] * self.num_worlds
        self._frame: Frame | None = None
        self._checked = False
        self._given = spec.given
        # Last, as it opens a port.
        is_served = self.options.render_mode in VIEWERS
        self.viewer: Viewer | None = make_viewer(self) if is_served else None

    def _show(self, swarm: Swarm, mask: np.ndarray) -> None:
        """Have the engine's bodies stand where drones of `mask` (W, N) and obstacles are."""
        self._dynamics.show(swarm, mask)
        self._engine.show_obstacles()

    def _state_arrays(self) -> dict[str, np.ndarray]:
        """Tell the arrays (W, ...) by name that are a world's state, whatever flew before."""
        scene = self.scene._asdict()
        memory = {f"memory {name}": array for name, array in scene.pop("memory").items()}
        drawn = {f"drawn {name}": array for name, array in self._uncertainty.drawn.items()}
        return {
            **self.swarm._asdict(),
            **scene,
            **memory,
            **drawn,
            "commanded": self.commanded,
            "alive": self.alive,
            "steps": self.steps,
            "parameters": self.parameters,
            "controller": self._cascade.memory,
            "charge": self._energy.readings()["charge"],
        }

    def _more_arrays(self) -> dict[str, np.ndarray]:
        """Tell what else its future follows from; something in them may be left from before."""
        parts = (self._wind, self._energy, self._sensors, self._dynamics)
        return {name: array for part in parts for name, array in part.kept().items()}

    def _bounds(self) -> Bounds:
        """Return the bounds of arrays that a snapshot may write, by name."""
        return {
            **state_bounds(self.swarm),
            "steps": (0, MAX_STEPS),
            "layout": (NO_LAYOUT, len(self.task.layouts()) - 1),
            **self._sensors.kept_bounds(),
            **contact_bounds(self._dynamics.contact),
        }

    def _current(self) -> Frame:
        if self._frame is None:
            raise RuntimeError("the worlds have not been started: call reset() first")
        return self._frame

    @exclusive
    def state(self) -> np.ndarray:
        """Tell the global state.

        Returns:
            (W, K) float32: the true position, attitude, velocity, rates, goal position and alive of
            every drone, 17 numbers each; then what there is of charges, the city's parameters,
            users, utilisations and queues. `global_state.labels` name them all.
        """
        self._require_open()
        return self.global_state.tell(self._current(), self.alive)

    @exclusive
    def render(
        self,
        world: int = 0,
        *,
        collision: bool = False,
        marks: bool = True,
    ) -> np.ndarray | None:
        """(height, width, 3) uint8 picture of a world with render_mode "rgb_array"; None otherwise.

        Shows the drones that flew the last decision, so also those that it ended. Marks are rings
        around drones, and arrows as far as they fly in a second; crosses on goals, and lines to
        them; dots on targets, green where some drone sees them, else red, and blue lines to those
        that a drone serves; orange lines along the range finder's beams, pale where they hit
        nothing. A key tells them in pictures of 240 pixels' height or more.

        Args:
            world: Index of the world.
            collision: Whether drones are drawn by the shapes that touch, not by their looks.
            marks: Whether marks are drawn.
        """
        self._require_open()
        if self.options.render_mode != "rgb_array":
            return None
        self._spec.require_world(world)
        flown = self._current().alive
        self._show(self.swarm, self.alive)
        self._engine.set_poses(
            self.swarm, flown & ~self.alive
        )  # those that just ended are still to be seen
        seen = marks_of(self.task, self._current(), world, self._sensors.sensors.values())
        picture = self._renderer.picture(world, self.swarm, seen, flown, collision, marks)
        self._engine.park(flown & ~self.alive)
        return picture

    @exclusive
    def add_body(
        self,
        source: BodySource,
        position: Sequence[float],
        quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        world: int | None = None,
        friction: float | None = None,
        restitution: float | None = None,
    ) -> int:
        """Put up a body that stands still: drones hit it, sensors measure it, pictures show it.

        It stays through resets. Tasks know nothing of it: their starts may lie within it.

        Args:
            source: Path of a URDF with one link, all of whose collision shapes count (box, sphere,
                cylinder, or a mesh by its convex hull); path of a Wavefront OBJ, each object of
                which is a convex hull; corners (V, 3) of a hull, m; or an `Obstacle`.
            position: (3,) of its origin in the world's own frame, m.
            quaternion: (4,) body to world, (x, y, z, w).
            world: Index of the world in which it stands; all when left out.
            friction: Coefficient of friction; that of the obstacle, or 0.5, when left out.
            restitution: Share of the speed that an impact gives back; that of the obstacle, or 0,
                when left out.

        Returns:
            What `Contacts.other` calls it.

        Raises:
            ValueError: The source or a number cannot be, or there is no such world.
            FileNotFoundError: There is no such file.
        """
        self._require_open()
        if world is not None:
            self._spec.require_world(world)
        return self._engine.add_body(source, position, quaternion, world, friction, restitution)

    @exclusive
    def line_of_sight(
        self,
        start: np.ndarray,
        end: np.ndarray,
        world: np.ndarray | int = 0,
    ) -> np.ndarray:
        """Tell for pairs of points whether nothing but drones is in between.

        Args:
            start: (M, 3) m, or one point.
            end: (M, 3) m, or one point.
            world: Of each pair, (M,), or one for all.

        Returns:
            (M,) bool.

        Raises:
            ValueError: Points are not finite, or there is no such world.
        """
        self.require_started()
        start, end = np.broadcast_arrays(points_of("start", start), points_of("end", end))
        return line_of_sight(
            self._engine, start, end, np.broadcast_to(self._spec.worlds(world), len(start))
        )

    @property
    def sight(self) -> np.ndarray:
        """(W, N, U) bool: which targets the drones saw that flew the last decision."""
        return self._current().seen

    @property
    def links(self) -> np.ndarray:
        """(W, N, U) bool: which targets the drones serve that flew the last decision."""
        frame = self._current()
        served: np.ndarray = links(self.task, frame) & frame.alive[..., None]
        return served

    @property
    def readings(self) -> Mapping[str, np.ndarray]:
        """What sensors measured last, (W, N, ...) by name; see `Frame.readings`."""
        return self._current().readings

    @property
    def reading_labels(self) -> dict[str, tuple[Label, ...]]:
        """Labels of the numbers that sensors measure, by name of the reading."""
        return self._sensors.numbers()

    @property
    def contacts(self) -> Contacts:
        """What touched what in the last decision; of worlds that were just reset nothing."""
        return self._current().contacts.of_worlds(np.ones(self.num_worlds, dtype=bool))

    def solids(self, world: int = 0) -> Solids:
        """Tell what stands in a world, beside obstacles."""
        layout = self.scene.layout[self._spec.worlds(world)]
        return NOTHING_STANDS if layout == NO_LAYOUT else self.task.layouts()[layout]

    @property
    def setpoint_level(self) -> SetpointLevel:
        """Setpoint level that the dynamics consumes."""
        return self._dynamics.consumes

    @property
    def communicates(self) -> bool:
        """Whether messages between drones are simulated, with infos that count them."""
        return "radio" in self._sensors.sensors

    def require_started(self) -> None:
        """Raise RuntimeError before the first reset and after `close`."""
        if self._engine.closed or self._frame is None:
            self._require_open()
            self._current()

    def _require_open(self) -> None:
        if self._engine.closed:
            raise RuntimeError("this environment is closed: make a new one")

    @exclusive
    def close(self) -> None:
        """Free the engine, and end the live view; a second call does nothing."""
        if self.viewer is not None:
            self.viewer.close()
        self._engine.close()
