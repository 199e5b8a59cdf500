"""Edge computing from the air: users offload tasks to servers on drones."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.errors import finite
from bulletuav.network.access import ACCESS
from bulletuav.network.arrivals import Arrivals
from bulletuav.network.assignment import STRATEGIES
from bulletuav.network.exchange import (
    Band,
    Queue,
    Strategy,
    TaskNumbers,
    associate_users,
    process_tasks,
)
from bulletuav.network.link import capacity
from bulletuav.network.queueing import core_power, service_rate
from bulletuav.network.service_stats import ServiceStats
from bulletuav.network.uplink import Uplink
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame, Scene
from bulletuav.tasks.observations.base import Block, make_drone_block
from bulletuav.tasks.observations.users import MAX_QUEUE
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.users import Service, Users

MAX_TASKS = 1e6
"""Maximum mean number of tasks per world and decision"""
MIN_TASKS = 1e-9
"""Lower bound of the expected tasks per decision by which rewards are divided"""
MIN_RATE = 1e-9
"""Lower bound of data rates by which uploads are divided, bit/s"""


@dataclass(frozen=True)
class EdgeOptions:
    """Options of edge computing: tasks, servers, and the assignment of users.

    Attributes:
        num_users: Number of users on the ground, outdoors.
        wanted: Fraction of completed tasks of the episode from which the task is successful.
        arrival_rate: Arrival rate of each user's tasks, a Poisson process, 1/s.
        task_bits: Minimum and maximum size of a task, bit; sizes are uniformly distributed.
        cycles_per_bit: Processor cycles per bit of a task.
        deadline: Maximum time from the arrival of a task to its result, s. Tasks that would be
            later are dropped.
        num_cores: Number of cores of each drone.
        core_frequency: Frequency of a core, cycles/s.
        capacitance: Effective switched capacitance of a core, whose power is capacitance *
            core_frequency^3, W.
        queue: "simulated", task by task; or "erlang", the mean response time of an M/M/c queue in
            steady state at the current load.
        assignment: Assignment of users to drones: "max_rate", "nearest" or "dtlcm", see
            `bulletuav.network.assignment`.
        distance_weight: Weight of distance in "dtlcm", from 0 to 1; the rest weighs computing
            capacity.
        power_scale: Power by which the reward term `energy` is divided, W: about that of full
            thrust and busy cores.
    """

    num_users: int = field(default=50, metadata={"most": 10_000})
    wanted: float = 0.7
    arrival_rate: float = 0.15
    task_bits: tuple[float, float] = field(default=(0.5e6, 2e6), metadata={"most": 1e12})
    cycles_per_bit: float = 1000.0
    deadline: float = field(default=1.0, metadata={"most": 1e4})
    num_cores: int = field(default=4, metadata={"most": 1024})
    core_frequency: float = field(default=5e9, metadata={"most": 1e12})
    capacitance: float = field(default=1e-28, metadata={"most": 1e-20})
    queue: Literal["simulated", "erlang"] = "simulated"
    assignment: Literal["max_rate", "nearest", "dtlcm"] = "max_rate"
    distance_weight: float = 0.7
    power_scale: float = 400.0


class _ServicePrograms(NamedTuple):
    """Programs that process a decision's tasks, and the arrays of the frame that they use.

    Attributes:
        frame: The frame.
        sight: Its reading "sight".
        first: (W + 1,) offsets of the worlds' tasks.
        uniform: Random numbers from which tasks are generated.
        receiving: Computes the power that drones receive from users.
        working: Assigns users to drones, and processes the tasks.
    """

    frame: Frame
    sight: np.ndarray
    first: np.ndarray
    uniform: np.ndarray
    receiving: Program
    working: Program

    def sees(self, frame: Frame) -> bool:
        """Return True if the frame's reading "sight" is still the same array."""
        return frame.readings["sight"] is self.sight


class EdgeComputing(Service):
    """Edge servers on drones: users offload tasks to the drone that serves them.

    A task of D bits takes D / rate to upload; a user uploads one task at a time. The task then
    waits for a core of the drone, first come first served, and takes D * cycles_per_bit /
    core_frequency to compute. Its outcome is determined when it is generated, at the data rates at
    the end of that decision. In addition to flight, drones consume the power of their cores in the
    previous decision.

    Reward terms depend on the tasks. With the default weights a completed task has a positive
    value: its contribution to `tasks` exceeds that to `latency`. A drone that serves no user only
    pays for its flight.

    Infos, (W, N): "completed", the fraction of completed tasks, and "latency", their mean latency,
    s. The expected number of future tasks counts as not completed, so ending early does not raise
    the fraction. "dropped" is the number of tasks lost in the episode. These are the same for all
    drones. "queue" is the number of tasks of mean size that wait or are computed at each drone, and
    "utilisation" the mean fraction of the last decision for which its cores were busy.

    Attributes:
        uplink: Radio link from users to drones.
    """

    def __init__(self, task: Task[Any], users: Users) -> None:
        """Set up the radio link and the arrivals of tasks.

        Args:
            task: The task, with options of users, radio and edge computing.
            users: Users that generate tasks.

        Raises:
            ValueError: If an option is invalid.
        """
        super().__init__(task, users)
        config, context = task.config, task.context
        self._config, self._context = config, context
        # Bounds on tasks also bound the memory that they need
        smallest, largest = config.task_bits
        if not 0 < smallest <= largest:
            raise ValueError(
                f"task_bits is {config.task_bits}: from low to high, above 0, is needed"
            )
        tasks = config.arrival_rate * config.num_users * context.period
        if tasks > MAX_TASKS:
            raise ValueError(
                f"arrival_rate is {config.arrival_rate:g}: "
                f"{tasks:g} tasks of num_users {config.num_users} in a decision, "
                f"at most {MAX_TASKS:g} are possible"
            )
        rates = np.full(config.num_users, config.arrival_rate)
        self._arrivals = Arrivals(rates, context.period, config.task_bits)
        for name in ("cycles_per_bit", "deadline", "core_frequency", "power_scale"):
            if getattr(config, name) <= 0:
                raise ValueError(f"{name} is {getattr(config, name):g}: it must be above 0")
        finite("distance_weight", config.distance_weight, 0, 1)
        self.uplink = Uplink(config)
        self._expected_tasks = max(tasks, MIN_TASKS)
        # Uploads end at the deadline, so a user transmits at most all the time
        load = min(config.arrival_rate * config.deadline, 1.0)
        self._activity = load if isinstance(config.activity, str) else float(config.activity)
        # Servers: cycles per task, cycles/s, tasks/s and W
        mean_bits = (smallest + largest) / 2
        self._demand = float(mean_bits * config.cycles_per_bit)
        self._capacity = float(config.num_cores * config.core_frequency)
        rate = service_rate(config.core_frequency, mean_bits, config.cycles_per_bit)
        self._service_rate = float(rate)
        power = core_power(config.capacitance, config.core_frequency)
        self._compute_power = config.num_cores * float(power)
        self._service: _ServicePrograms | None = None

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of servers and tasks.

        Returns:
            The fields of `bulletuav.network.service_stats.ServiceStats`; "received" (N, U), power
            from each user, W; "serves" (N, U), 1 if the drone serves the user; "link_free" (U,) and
            "core_free" (N, C), time until uplinks and cores are free, s.
        """
        drones = self._context.num_drones
        users = self._config.num_users
        totals = ("generated", "finished", "delay")
        stats: dict[str, tuple[int, ...]] = {
            name: () if name in totals else (drones,) for name in ServiceStats._fields
        }
        return {
            **stats,
            "received": (drones, users),
            "serves": (drones, users),
            "link_free": (users,),
            "core_free": (drones, self._config.num_cores),
        }

    def quantities(self) -> Mapping[str, Any]:
        """Return the expected number of tasks per decision."""
        return {"expected_tasks": self._expected_tasks}

    def payload_power(self, scene: Scene) -> np.ndarray:
        """Return the power of the cores in the last decision, (W, N) W."""
        power: np.ndarray = scene.memory["utilisation"] * self._compute_power
        return power

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Assign users to drones, compute data rates, and process the decision's tasks."""
        service = self._service
        if service is None or service.frame is not frame or not service.sees(frame):
            first = np.zeros(len(frame.alive) + 1, dtype=np.int64)
            service = self._service = self._make_service(frame, first, np.empty(0))
        # Worlds draw fading first, then tasks
        flying = np.logical_or.reduce(frame.alive, axis=1)
        service.receiving.run()
        received = frame.scene.memory["received"]
        self.uplink.fade(received, service.sight, rngs, flying)
        buffer = self._arrivals.draw(rngs, flying, service.first, service.uniform)
        if buffer is not service.uniform:
            service = self._service = self._make_service(frame, service.first, buffer)
        service.working.run()

    def _make_service(
        self, frame: Frame, first: np.ndarray, uniform: np.ndarray
    ) -> _ServicePrograms:
        """Create the programs for the arrays of a frame."""
        config, memory, swarm = self._config, frame.scene.memory, frame.after
        users, received, sight = memory["users"], memory["received"], frame.readings["sight"]
        receiving = Program()
        poses = (swarm.position, swarm.quaternion)
        self.uplink.add_received(receiving, *poses, users, sight, received)
        working = Program()
        servers, rates = np.zeros(users.shape[:2], dtype=np.int64), np.zeros(users.shape[:2])
        weight = float(config.distance_weight)
        strategy = Strategy(STRATEGIES[config.assignment], self._capacity, self._demand, weight)
        scheme, noise = ACCESS[config.access], self.uplink.noise
        band = Band(float(config.bandwidth), noise, scheme, self._activity)
        geometry = (swarm.position, frame.alive, users, received, memory["utilisation"])
        working.call(associate_users, strategy, band, *geometry, servers, memory["serves"], rates)
        dt, *bits = self._arrivals.decision
        drawn = TaskNumbers(first, uniform, self._arrivals.cumulative, *bits)
        queue = Queue(
            on_average=config.queue == "erlang",
            cycles_per_bit=float(config.cycles_per_bit),
            core_frequency=float(config.core_frequency),
            cores=config.num_cores,
            arrival_rate=float(config.arrival_rate),
            service_rate=self._service_rate,
            deadline=float(config.deadline),
            dt=dt,
            duration=float(self._context.duration),
        )
        stats = ServiceStats(*(memory[name] for name in ServiceStats._fields))
        free = (memory["link_free"], memory["core_free"])
        working.call(process_tasks, drawn, queue, servers, rates, *free, frame.time, stats)
        return _ServicePrograms(frame, sight, first, uniform, receiving, working)

    def quality(self, place: np.ndarray, targets: np.ndarray, sight: np.ndarray) -> np.ndarray:
        """Return the fraction of a user's tasks that would meet the deadline.

        Assumes equally many users per drone, no interference and no queue.

        Args:
            place: (C, 3) positions of drones, m.
            targets: (U, 3) positions of users, m.
            sight: (C, U) bool, whether they are in line of sight.

        Returns:
            (C, U) from 0 to 1.
        """
        config = self._config
        # Power received by a level drone at each position; no world flies, so no fading is drawn
        level = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(place), 1))
        power = self.uplink.received(
            position=place[None],
            quaternion=level,
            users=targets[None],
            sight=sight[None],
            rng=[None],
            flying=np.zeros(1, dtype=bool),
        )[0]
        # Rate of each user, and the largest task that meets the deadline at this rate
        users = max(len(targets) / self._context.num_drones, 1.0)
        rate = capacity(config.bandwidth / users, users * power / self.uplink.noise)
        seconds_per_bit = (
            1 / np.maximum(rate, MIN_RATE) + config.cycles_per_bit / config.core_frequency
        )
        in_time = config.deadline / seconds_per_bit
        # Fraction of the uniformly distributed sizes up to that task
        smallest, largest = config.task_bits
        share = np.minimum((in_time - smallest) / max(largest - smallest, 1e-9), 1.0)
        return np.where(in_time < smallest, 0.0, share)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the service statistics of the episode; see the class docstring."""
        memory = frame.scene.memory
        kept = {"completed": "share", "latency": "mean_latency"}
        kept |= {name: name for name in ("queue", "utilisation")}
        service = {name: memory[its].copy() for name, its in kept.items()}
        lost = (memory["generated"] - memory["finished"])[:, None]
        dropped = lost + np.zeros(frame.alive.shape)
        return {**service, "dropped": dropped}

    def world_state(self) -> Mapping[str, Block]:
        """Return utilisation and queue of every drone."""
        bounds = {"utilisation": ("1", 1.0), "queue": ("tasks", MAX_QUEUE)}
        drones = self._context.num_drones
        return {name: make_drone_block(name, *bound, drones) for name, bound in bounds.items()}

    def links(self, frame: Frame) -> np.ndarray:
        """Return which drones serve which users, (W, N, U) bool; none before the first decision."""
        serving: np.ndarray = frame.scene.memory["serves"] > 0
        return serving

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return whether the required fraction of tasks is completed, (W, N) bool."""
        completed: np.ndarray = frame.scene.memory["share"] >= self._config.wanted
        return completed


EDGE_SHOWS = {
    "completed": "completed by all",
    "latency": "latency of all (s)",
    "served": "in sight of any",
    "queue": "queue (tasks)",
    "collision": "collisions",
}
"""Infos that pictures of edge computing show, with captions"""
