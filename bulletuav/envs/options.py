"""Options of an environment: keyword arguments as validated, frozen values."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bulletuav.compiled.threads import MAX_THREADS
from bulletuav.control.actions import ACTIONS, ActionNames, action_names
from bulletuav.control.cascade import CONTROLLERS, PID_LEVELS
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import DEFAULT_DYNAMICS, find_dynamics
from bulletuav.engine.engine import RAY_METHODS
from bulletuav.envs.bodies import BodiesOption, as_bodies
from bulletuav.envs.events import Event, as_events
from bulletuav.envs.randomization import CERTAIN, Randomization
from bulletuav.envs.rates import MAX_HZ, decision_rate, picture_rate
from bulletuav.envs.viewer import DEFAULT_ADDRESS, VIEWERS, parse_address
from bulletuav.errors import as_bool, as_int, as_sequence, find_choice, finite, shown, unknown
from bulletuav.geometry.obstacle import MAX_FRICTION
from bulletuav.geometry.view import FAR
from bulletuav.sensors.camera import DEPTHS, RENDERERS
from bulletuav.sensors.lidar import FRAMES
from bulletuav.sensors.messages import Channel, as_channel
from bulletuav.sensors.mounts import as_mounts
from bulletuav.tasks.observations.images import ARRAY, CAMERA_FORMATS, MAX_FRAMES
from bulletuav.vehicle.airframe import STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.cruise import limiting_airframe, top_speed
from bulletuav.vehicle.parameters import DEFAULT_EFFECTS, EFFECTS
from bulletuav.vehicle.thermals import Thermals, as_thermals
from bulletuav.vehicle.wind import (
    MAX_WIND,
    TURBULENCE,
    Profile,
    WindField,
    as_profile,
    check_field,
)

ENERGIES = ("zeng", "actuator")
FORMATS = ("vector", "dict")
LIST_OPTIONS = (
    *("observation", "sensors", "effects", "wind"),
    *("render_size", "camera_size", "camera_range", "lidar_elevations"),
)
RENDER_MODES = ("rgb_array", "human", *VIEWERS)
ROTOR_ACTIONS = ("rotor", "rpm")
MAX_DRONES = 10_000
MAX_PIXELS = 4096  # per side
MAX_BEAMS = 8192  # of a drone's range finder, in total
MAX_LIDAR_RANGE = 10_000.0  # m
MAX_CAPACITY = 1e6  # W h
MIN_SHARED = 64  # drones of a single world that several threads share
GRAVITY_TOLERANCE = 0.01  # relative difference from standard gravity that aircraft with wings allow
MAX_NAMES = 100  # in a list of names
MAX_SIZE, MAX_COUNT = 1e9, 10**9  # of task config numbers without a bound of their own
MAX_WEIGHT = 1e6
MAX_COUNTS = {
    "num_drones": MAX_DRONES,
    "num_neighbours": 1000,
    "horizon": 10**9,
    "physics_hz": MAX_HZ,
    "num_beams": MAX_BEAMS,
    "frame_stack": MAX_FRAMES,
    "threads": MAX_THREADS,
}
"""Maximum of each option that is a whole number above 0"""
NAME_LISTS = ("observation", "sensors", "effects")


@dataclass(frozen=True)
class EnvOptions:
    """Options common to all tasks. Every ValueError names the value and the remedy.

    Attributes:
        num_drones: Number of drones in a world; or (min, max), from which each episode draws its
            number. Arrays have the maximum, and drones that are not drawn are absent in the
            episode, as drones are whose episode ended.
        min_drones: Minimum number of drones in a world; set by num_drones=(min, max).
        airframe: Name of an airframe, path of a URDF, or an `Airframe`; or one for each drone.
        action: Meaning of actions: a name in `bulletuav.control.actions.ACTIONS`; a list with a
            name for each drone; or a dict from the names of the task's teams to names. The default
            is that of the task; if the dynamics does not support it, the action of the highest
            setpoint level that the dynamics supports, such as "velocity" in "point_mass".
        decision_hz: Decisions per second: a whole number that divides physics_hz; or from 0.1 to 1
            (decisions of up to 10 s), if a decision has a whole number of substeps.
        decision_every: A dict from the names of the task's teams to whole numbers: drones of a team
            with k decide in every k-th decision of the world, from the first one on, and fly their
            last action in between. Infos have "decides". None for 1 for all.
        horizon: Number of decisions after which an episode is truncated.
        max_speed: Scale of velocity actions, m/s; at most the airframe's maximum speed.
        max_climb: Limit of the vertical velocity of velocity actions, up and down, m/s; None for
            max_speed.
        dynamics: "bullet" (as "rigid_body", by bodies in Bullet), "rigid_body" (RK4), "point_mass",
            "double_integrator" or "single_integrator"; `module:Name`, or a
            class derived from `bulletuav.dynamics.base.Dynamics`. The default is "bullet", or
            "rigid_body", with a warning, where PyBullet is not installed.
        observation: Names of observation blocks and of sensor readings, or block objects, which are
            concatenated; or a dict from the names of the task's teams to such lists, then without
            pictures; None for the task's default.
        observation_format: "vector", or "dict" with an entry for each block.
        sensors: Additional sensors, or replacements of built-in ones: objects or names.
        reward: "benchmark" for the weights by which the task is evaluated (the default), or
            "training" for the task's weights for learning, its `training_weights`; or a dict of
            additional reward terms: (term, weight) by name. `weights` overrides single weights.
        num_neighbours: Number of nearest drones, and of nearest obstacles, that are observed.
        normalise: Whether observations are scaled from their bounds to [-1, 1].
        difficulty: "easy", "medium", "hard" or "extreme": sets other options, which can still be
            overridden.
        preset: Named set of values of other options, defined by the task; overrides the difficulty.
        physics_hz: Physics substeps per second.
        seed: Seed of the first reset, if `reset` has none.
        render_mode: None, "rgb_array" (pictures, without a display), "human" (a live window), "web"
            (a live page for browsers) or "foxglove" (a live server for Foxglove).
        render_size: Width and height of pictures, pixels.
        render_address: Address of the "web" or "foxglove" server, host:port.
        controller: "lee" (geometric) or "pid" (the Crazyflie's own).
        integral: Whether "lee" compensates steady unmodelled forces, such as wakes and wind; see
            `bulletuav.control.observers`.
        effects: Effects of `EFFECTS` that are simulated: "lag" of the rotors, "drag" of the rotors,
            "body_drag", "damping" of rates, "rotor_inertia", "ground_effect", "downwash", and
            "voltage" of the battery. The default is all except "voltage".
        wind: Steady wind (east, north, up), m/s, or a function of positions (W, N, 3) m and times
            (W,) s that returns (W, N, 3) m/s.
        wind_profile: Growth of the steady wind with height, with `wind` at 20 feet: None (uniform),
            "power", "log", or a pair: ("power", exponent) or ("log", roughness length in m). See
            `bulletuav.vehicle.wind.PROFILES`.
        turbulence: Dryden gusts, one field in each world: None, "light", "moderate", "severe", or
            the wind speed at 20 feet that scales them, m/s.
        thermals: Columns of rising air, with sinking air between them: None, or a dict of
            attributes of `bulletuav.vehicle.thermals.Thermals`, such as {"strength": 2.5}; {} for
            its defaults.
        randomization: Randomized parameters, such as {"gps_noise": 1.0}; see
            `bulletuav.envs.randomization.Randomization`.
        events: Changes during each episode, at fixed or random times, such as the failure of a
            rotor: events, or dicts of the attributes of `bulletuav.envs.events.Event`.
        camera: Renderer of the drones' cameras (observations "rgb", "depth", "segmentation"):
            "compiled" (exact depths, collision shapes, flat colours), or "bullet" (PyBullet's
            TinyRenderer, a hundredth of the speed, with the visual shapes of drones and facades).
        camera_size: Width and height of the drones' cameras, pixels.
        camera_hz: Camera pictures per second; must divide decision_hz; None for one per decision.
        camera_range: Nearest and farthest depth of pictures, m; other depths are clipped, that of
            the sky too.
        camera_depth: Form of depths: "metres", "linear" (0 at the nearest and 1 at the farthest
            depth), or "inverse" (linear in 1/depth: 1 at the nearest and 0 at the farthest depth).
        camera_mounts: Direction of the camera on the drone, a dict of attributes of
            `bulletuav.sensors.mounts.Mount`, such as {"pitch": -90}; or several dicts for several
            cameras, whose pictures are stacked: (cameras, height, width). None for a camera that
            looks forward.
        camera_format: "array" for pictures of their own types and shapes, or "image" for (height,
            width, channels) uint8, as convolutional networks take them: bounds of pixels, such as
            0 and the largest depth, become 0 and 255. A picture that is observed alone is then an
            array instead of a dict.
        frame_stack: Number of frames of an observed picture: those of the last decisions, the
            oldest first; at a reset all are the first one. In the format "array" they are a new
            first axis, in the format "image" channels. 1 for no stack.
        gravity: Gravitational acceleration, m/s^2; 0 for none. Within 1 % of standard gravity if
            an aircraft flies on wings.
        num_beams: Beams of the range finder (observation "lidar") at each elevation, evenly spaced
            in azimuth.
        max_range: Maximum range of the range finder and of the clearance, m.
        lidar_elevations: Elevations of the beams above the horizon, degrees.
        lidar_frame: "yaw" (the first beam along the drone's heading) or "world" (to the east).
        battery_capacity: Energy of a full battery, W h, or "airframe" for the airframe's own
            battery; a drone's episode ends with an empty battery. None for unlimited energy.
        energy: Power model: "zeng" (rotary-wing formula) or "actuator" (the simulated rotors; also
            without gravity).
        rays: Ray casting of sensors: "compiled" (exact and fast), or "bullet" (Bullet's
            `rayTestBatch`, for comparison: slower, and shapes are larger by up to 1e-4 of their
            size, and 1 mm). Rays against drones and loads are always compiled.
        contacts: Contact model: "impulse" (drones are pushed, slide and rest), "stop" (a drone
            stays at the contact until the decision ends), or "bullet" (Bullet's own contacts, for
            comparison). None for the first one that the dynamics supports.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Coefficient of restitution of the ground and of buildings. For two surfaces the
            geometric mean of their coefficients applies.
        bodies: Bodies in each world beside those of the task: a list of
            `bulletuav.envs.bodies.Body`, or of dicts of its attributes; or a function from the
            random generator of a world to such a list, called at each reset, or a
            `bulletuav.envs.bodies.DrawnBodies`.
        debug: Whether compiled functions run as plain Python, with the same results, some hundred
            times slower: for breakpoints, prints and coverage.
        action_masks: Whether infos have "action_mask", the valid moves of a discrete action, int8,
            1 for valid ones; see `bulletuav.envs.action_masks.ActionMasks`. Moves that lead out of
            the arena are invalid. An invalid move is flown all the same.
        communication: Channel for messages that are part of actions and observations, such as
            {"size": 8, "range": 300.0}; a `bulletuav.sensors.messages.Channel`, or a dict of its
            attributes. None for no messages.
        threads: Number of threads that compute a decision, with the same results. They share the
            worlds of a batch, or the drones of a single world, which pays from some hundred drones
            on. It needs dynamics "rigid_body" or a kinematic one. Sensors, wind functions and
            Python code of tasks run on one thread.
    """

    num_drones: int
    airframe: tuple[Airframe, ...]
    action: ActionNames
    decision_hz: float
    horizon: int
    max_speed: float
    dynamics: str = DEFAULT_DYNAMICS
    observation: tuple[Any, ...] | Mapping[str, tuple[Any, ...]] | None = None
    observation_format: str = "vector"
    sensors: tuple[Any, ...] = ()
    reward: Mapping[str, tuple[Any, float]] = field(default_factory=dict)
    num_neighbours: int = 3
    normalise: bool = False
    difficulty: str = "easy"
    preset: str | None = None
    max_climb: float | None = None
    physics_hz: int = 240
    seed: int | None = None
    render_mode: str | None = None
    render_size: tuple[int, int] = (640, 480)
    render_address: str = DEFAULT_ADDRESS
    controller: str = "lee"
    integral: bool = False
    effects: tuple[str, ...] = DEFAULT_EFFECTS
    wind: tuple[float, float, float] | WindField = (0.0, 0.0, 0.0)
    wind_profile: Profile | None = None
    turbulence: str | float | None = None
    thermals: Thermals | None = None
    randomization: Randomization = CERTAIN
    events: tuple[Event, ...] = ()
    camera: str = "compiled"
    camera_size: tuple[int, int] = (64, 48)
    camera_hz: int | None = None
    camera_range: tuple[float, float] = (0.0, FAR)
    camera_depth: str = "metres"
    camera_mounts: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None
    camera_format: str = ARRAY
    frame_stack: int = 1
    gravity: float = STANDARD_GRAVITY
    num_beams: int = 16
    max_range: float = 60.0
    lidar_elevations: tuple[float, ...] = (0.0,)
    lidar_frame: str = "yaw"
    battery_capacity: float | str | None = None
    energy: str = "zeng"
    rays: str = "compiled"
    contacts: str | None = None
    friction: float = 0.5
    restitution: float = 0.0
    bodies: BodiesOption = ()
    debug: bool = False
    action_masks: bool = False
    min_drones: int | None = None
    communication: Channel | None = None
    decision_every: Mapping[str, int] | None = None
    threads: int = 1

    def __post_init__(self) -> None:
        for name, most in MAX_COUNTS.items():
            self._keep(name, as_int(name, getattr(self, name), 1, most))
        if self.min_drones is not None:
            self._keep("min_drones", as_int("min_drones", self.min_drones, 1, self.num_drones))
        self._keep("decision_hz", decision_rate(self.decision_hz, self.physics_hz))
        if self.camera_hz is not None:
            self._keep("camera_hz", picture_rate(self.camera_hz, self.decision_hz))
        if self.seed is not None:
            self._keep("seed", as_int("seed", self.seed, 0))
        if self.render_mode is not None:
            find_choice("render_mode", self.render_mode, dict.fromkeys(RENDER_MODES))
        parse_address(self.render_address)
        for name in ("render_size", "camera_size"):
            self._keep(
                name,
                tuple(
                    as_int(name, side, 8, MAX_PIXELS)
                    for side in as_sequence(name, getattr(self, name), 2)
                ),
            )
        dynamics = find_dynamics(self.dynamics)
        if self.contacts is None:
            self._keep("contacts", dynamics.contacts[0])
        find_choice("contacts", self.contacts, dict.fromkeys(dynamics.contacts))
        self._check_threads(dynamics.has_threads)
        self._keep("action", _as_action(self.action, self.num_drones))
        self._keep("decision_every", _as_decision_every(self.decision_every))
        choices = {"controller": tuple(CONTROLLERS)}
        choices |= {"lidar_frame": FRAMES, "energy": ENERGIES, "observation_format": FORMATS}
        choices |= {"camera_format": CAMERA_FORMATS, "camera_depth": DEPTHS}
        choices |= {"rays": tuple(RAY_METHODS), "camera": RENDERERS}
        for name, known in choices.items():
            find_choice(name, getattr(self, name), dict.fromkeys(known))
        check_names("effects", "effect", self.effects, EFFECTS)
        for name in ("normalise", "integral", "debug", "action_masks"):
            as_bool(name, getattr(self, name))
        self._keep("bodies", as_bodies(self.bodies))
        self._keep("events", as_events(self.events))
        self._keep("communication", as_channel(self.communication))
        if self.communication is not None and self.num_drones == 1:
            raise ValueError("communication needs two drones or more: leave it out for one drone")
        self._check_reward()
        self._check_sensors()
        self._check_cameras()
        self._check_flight()

    def check_worlds(self, num_worlds: int) -> None:
        """Raise ValueError if there is too little to share between several threads."""
        if self.threads > 1 and num_worlds == 1 and self.num_drones < MIN_SHARED:
            raise ValueError(
                f"threads is {self.threads}: {self.num_drones} drones of one world fly on one "
                f"thread; threads share the worlds of a batch, or {MIN_SHARED} drones or more"
            )

    def _check_threads(self, has_threads: bool) -> None:
        if self.threads > 1 and not has_threads:
            raise ValueError(
                f"threads is {self.threads}: dynamics {self.dynamics_name!r} flies on one thread; "
                f"use 'rigid_body' or a kinematic one, or a batch with workers"
            )
        if self.threads > 1 and self.debug:
            raise ValueError("debug is True: debuggers see one thread, so it needs threads=1")

    def _check_reward(self) -> None:
        if not isinstance(self.reward, Mapping):
            raise ValueError(
                f"reward is {shown(self.reward)}: 'benchmark', 'training', or a dict from names to "
                f"(term, weight) is needed; weights of the task's own terms are changed by "
                f"`weights`"
            )
        for name, value in self.reward.items():
            if not isinstance(name, str) or not isinstance(value, list | tuple) or len(value) != 2:
                raise ValueError(
                    f"reward has {shown(name)}: {shown(value)}; (term, weight) is needed, such as "
                    f"(my_term, -0.1)"
                )
            finite(f"reward: weight of {name!r}", value[1], -MAX_WEIGHT, MAX_WEIGHT)

    def _keep(self, name: str, value: Any) -> None:
        """Store a validated value, so that kernels are compiled for one type."""
        object.__setattr__(self, name, value)

    def _check_sensors(self) -> None:
        self._keep("max_range", finite("max_range", self.max_range, most=MAX_LIDAR_RANGE))
        if self.max_range <= 0:
            raise ValueError(f"max_range is {self.max_range:g} m: it must be above 0")
        elevations = as_sequence("lidar_elevations", self.lidar_elevations, most=MAX_BEAMS)
        self._keep(
            "lidar_elevations",
            tuple(finite("lidar_elevations", elevation) for elevation in elevations),
        )
        for elevation in self.lidar_elevations:
            if not -90 <= elevation <= 90:
                raise ValueError(
                    f"lidar_elevations has {elevation:g} degrees: from -90 (down) to 90 (up) is "
                    f"needed"
                )
        if not self.lidar_elevations:
            raise ValueError("lidar_elevations is empty: give at least one angle")
        if self.num_beams * len(self.lidar_elevations) > MAX_BEAMS:
            raise ValueError(
                f"num_beams is {self.num_beams} at each of {len(self.lidar_elevations)} "
                f"lidar_elevations: at most "
                f"{MAX_BEAMS} beams in total are possible"
            )
        if isinstance(self.battery_capacity, str):
            if self.battery_capacity != "airframe":
                raise unknown("battery_capacity", self.battery_capacity, ("airframe",))
            for airframe in self.airframe:
                if airframe.pack is None:
                    raise ValueError(
                        f"battery_capacity is 'airframe', and airframe {airframe.name!r} has no "
                        f"<battery> tag: give watt-hours"
                    )
        elif self.battery_capacity is not None:
            capacity = finite("battery_capacity", self.battery_capacity, most=MAX_CAPACITY)
            self._keep("battery_capacity", capacity)
            if capacity <= 0:
                raise ValueError(
                    f"battery_capacity is {capacity:g} W h: it must be above 0; None for no limit"
                )

    def _check_cameras(self) -> None:
        # Files of runs store the plain values
        as_mounts(self.camera_mounts)
        if isinstance(self.camera_mounts, Sequence):
            self._keep("camera_mounts", tuple(self.camera_mounts))
        given = as_sequence("camera_range", self.camera_range, 2)
        near, far = (finite("camera_range", depth, 0.0, FAR) for depth in given)
        self._keep("camera_range", (near, far))
        if not near < far:
            raise ValueError(
                f"camera_range is ({near:g}, {far:g}) m: the nearest depth must be below the "
                f"farthest one"
            )
        if self.camera == "bullet" and "camera_colours" in self.randomization.active:
            raise ValueError("camera 'bullet' has its own colours: leave out camera_colours")
        if self.camera_depth == "inverse" and near == 0:
            raise ValueError(
                "camera_depth 'inverse' needs a nearest depth above 0: set camera_range, such as "
                "(0.5, 100)"
            )

    def _check_flight(self) -> None:
        if len(self.airframe) != self.num_drones:
            raise ValueError(
                f"{len(self.airframe)} airframes for {self.num_drones} drones: give one, or one "
                f"for each drone"
            )
        self._keep("max_speed", finite("max_speed", self.max_speed))
        limiting = limiting_airframe(self.airframe)
        if not 0 < self.max_speed <= top_speed(limiting):
            raise ValueError(
                f"max_speed is {self.max_speed:g} m/s: it must be above 0 and at most the "
                f"{top_speed(limiting):g} m/s of "
                f"airframe {limiting.name!r}"
            )
        if self.max_climb is not None:
            self._keep("max_climb", finite("max_climb", self.max_climb))
            if self.max_climb <= 0:
                raise ValueError(f"max_climb is {self.max_climb:g} m/s: it must be above 0")
        self._check_air()
        balancing = [name for name in action_names(self.action) if name not in ROTOR_ACTIONS]
        if self.gravity == 0 and balancing:
            raise ValueError(
                f"action {balancing[0]!r} needs gravity: use 'rotor' or 'rpm', all others balance "
                f"thrust against weight"
            )
        if self.integral and self.controller == "pid":
            raise ValueError("integral is for controller 'lee': leave it out, 'pid' has its own")
        if self.controller == "pid" and "lag" in self.effects:
            warnings.warn(
                "controller 'pid' is made for motors without lag and may flip a drone: leave "
                "'lag' out of effects",
                stacklevel=2,
            )
        for airframe in self.airframe:
            if airframe.is_load:
                continue
            lifts = airframe.max_thrust > airframe.mass * self.gravity
            if not lifts and (airframe.can_hover or not airframe.wings):
                raise ValueError(
                    f"gravity is {self.gravity:g} m/s^2: airframe {airframe.name!r} lifts at most "
                    f"{airframe.max_thrust / airframe.mass:.3g} m/s^2 and cannot hover"
                )
            differs = abs(self.gravity / STANDARD_GRAVITY - 1.0) > GRAVITY_TOLERANCE
            if airframe.forward_rotors and differs:
                raise ValueError(
                    f"gravity is {self.gravity:g} m/s^2: limits and controllers of airframe "
                    f"{airframe.name!r}, which flies on wings, are those at {STANDARD_GRAVITY:g} "
                    f"m/s^2; leave gravity out, or choose a multirotor"
                )
            if self.controller == "pid" and airframe.pwm is None:
                raise ValueError(
                    f"controller 'pid' drives motors by PWM, and airframe {airframe.name!r} has no "
                    f"<pwm> tag: use 'lee'"
                )

    def _check_air(self) -> None:
        self._keep("friction", finite("friction", self.friction, 0, MAX_FRICTION))
        self._keep("restitution", finite("restitution", self.restitution, 0, 1))
        if callable(self.wind):
            check_field(self.wind)
        else:
            given = as_sequence("wind", self.wind, 3)
            self._keep(
                "wind",
                tuple(finite("wind", component, -MAX_WIND, MAX_WIND) for component in given),
            )
        self._keep("wind_profile", as_profile(self.wind_profile))
        if callable(self.wind) and self.wind_profile is not None:
            raise ValueError(
                "wind_profile changes a steady wind with height: leave it out where wind is a "
                "function, which returns the wind at each height"
            )
        if isinstance(self.turbulence, str):
            find_choice("turbulence", self.turbulence, TURBULENCE)
        elif self.turbulence is not None:
            self._keep("turbulence", finite("turbulence", self.turbulence, most=MAX_WIND))
            if self.turbulence < 0:
                raise ValueError(f"turbulence is {self.turbulence:g} m/s: it must not be negative")
        self._keep("thermals", as_thermals(self.thermals))
        self._keep("gravity", finite("gravity", self.gravity))
        if self.gravity < 0:
            raise ValueError(f"gravity is {self.gravity:g} m/s^2: it must not be negative")

    @property
    def has_absent(self) -> bool:
        """Whether episodes may have fewer drones than num_drones."""
        return self.min_drones is not None and self.min_drones < self.num_drones

    @property
    def substeps(self) -> int:
        """Number of physics substeps of a decision."""
        return round(self.physics_hz / self.decision_hz)

    @property
    def wind20(self) -> float:
        """Wind speed at 20 feet that scales the turbulence, m/s; 0 for none."""
        return (
            TURBULENCE[self.turbulence]
            if isinstance(self.turbulence, str)
            else self.turbulence or 0.0
        )

    @property
    def dynamics_name(self) -> str:
        """Name of the dynamics, given by name or class."""
        return self.dynamics if isinstance(self.dynamics, str) else self.dynamics.name

    def check_setpoint_levels(
        self, actions: Mapping[str, SetpointLevel], dynamics: SetpointLevel
    ) -> None:
        """Check that the setpoint levels of actions can drive the dynamics.

        Args:
            actions: Level of each kind of action, by its name.
            dynamics: Level that drives the dynamics.

        Raises:
            ValueError: If one can neither directly nor through the controller.
        """
        for name, level in actions.items():
            if level > dynamics:
                raise ValueError(
                    f"action {name!r} gives {level.name.lower()} setpoints, but dynamics "
                    f"{self.dynamics_name!r} is driven by "
                    f"{dynamics.name.lower()}: use an action of that level or above, or dynamics "
                    f"'rigid_body' or 'bullet'"
                )
        if self.energy == "actuator" and dynamics < SetpointLevel.ROTOR:
            raise ValueError(
                f"energy is 'actuator', and dynamics {self.dynamics_name!r} has no rotors: use "
                f"'zeng', 'rigid_body' or 'bullet'"
            )
        if self.controller == "pid" and dynamics < SetpointLevel.ROTOR:
            raise ValueError(
                f"controller 'pid' drives motors, and dynamics {self.dynamics_name!r} has none: "
                f"use controller 'lee'"
            )
        for level in actions.values():
            self.check_controller(level)

    def check_controller(self, level: SetpointLevel) -> None:
        """Raise ValueError for a setpoint level that the controller does not support."""
        if self.controller == "pid" and level not in PID_LEVELS:
            raise ValueError(
                f"controller 'pid' supports no {level.name.lower()} setpoints: use controller 'lee'"
            )


def _as_action(action: Any, num_drones: int) -> ActionNames:
    """Return the option `action` as one name, a name for each drone, or names by team.

    Raises:
        ValueError: If a name is unknown, or there is another number of names than of drones.
    """
    if isinstance(action, Mapping):
        for team, name in action.items():
            find_choice(f"action of team {shown(team)}", name, ACTIONS)
        return dict(action)
    if not isinstance(action, list | tuple):
        find_choice("action", action, ACTIONS)
        return str(action)
    if len(action) != num_drones:
        raise ValueError(
            f"action has {len(action)} names for {num_drones} drones: give one name, or one for "
            f"each drone"
        )
    for name in action:
        find_choice("action", name, ACTIONS)
    return action[0] if len(set(action)) == 1 else tuple(action)


def _as_decision_every(given: Any) -> dict[str, int] | None:
    """Return the option `decision_every` with its numbers checked."""
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise ValueError(
            f"decision_every is {shown(given)}: a dict from teams to whole numbers is needed; "
            f"decision_hz changes the rate of all drones"
        )
    most = MAX_COUNTS["horizon"]
    return {
        team: as_int(f"decision_every of team {shown(team)}", number, 1, most)
        for team, number in given.items()
    }


def check_names(name: str, what: str, given: Any, known: Sequence[str]) -> None:
    """Raise ValueError for a name that is unknown or repeated."""
    for one in given or ():
        if not isinstance(one, str) or one not in known:
            raise ValueError(f"{name}: {unknown(what, one, known)}")
        if given.count(one) > 1:
            raise ValueError(f"{name} has {one!r} {given.count(one)} times: name it once")
