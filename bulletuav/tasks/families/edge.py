"""Edge computing from the air: users send tasks to the drones, which compute them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from bulletuav.network.assignment import STRATEGIES, assign
from bulletuav.network.link import capacity
from bulletuav.network.queueing import core_power, service_rate
from bulletuav.network.server import Arrivals, Served, Tasks, serve, serve_on_average
from bulletuav.network.service_stats import ServiceStats, count
from bulletuav.network.uplink import RadioConfig, Uplink
from bulletuav.tasks.base import Rngs
from bulletuav.tasks.families.users import UsersConfig, UsersTask
from bulletuav.tasks.frame import Frame, Scene, TaskContext

MOST_TASKS = 1e6  # of a world in a decision, in the mean


@dataclass(frozen=True)
class EdgeConfig(RadioConfig, UsersConfig):
    """Options of edge computing beside those of radio, users and cities.

    arrival_rate    tasks of each user, 1/s, a Poisson process
    task_bits       size of a task, bit, uniform from low to high
    cycles_per_bit  that it takes to compute
    deadline        of a task, s, from its arrival to its result; what would be later is given up
    num_cores, core_frequency  of each drone, cycles/s
    capacitance     effective, of a core: it takes capacitance * core_frequency^3, W
    queue           "simulated", task by task; or "erlang", the mean response of M/M/c, as if the load had always been as now
    assignment      who serves whom: "max_rate", "nearest" or "dtlcm", see `bulletuav.network.assignment`
    power_scale     W, that the reward term `energy` divides by: about what full thrust and busy cores take
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
    power_scale: float = 400.0


EdgeConfigT = TypeVar("EdgeConfigT", bound=EdgeConfig)


class EdgeTask(UsersTask[EdgeConfigT], Generic[EdgeConfigT]):
    """Users produce tasks, send them to the drone that serves them, and it computes them on its cores.

    A task of D bits takes D / rate to upload, one of a user after the other, then waits for a core of the drone, first come
    first served, and computes for D * cycles_per_bit / core_frequency. What becomes of it is settled when it is generated,
    at the rates of the end of that decision. Beside flight drones pay for what their cores did in the decision before.

    Reward terms are told by the tasks. What a task brings, its share of `tasks` less that of `latency`, is worth more than
    nothing for the weights that tasks have: who serves nobody only pays for its flight.
    """

    def __init__(self, config: EdgeConfigT, context: TaskContext) -> None:
        """Raises ValueError for sizes that cannot be, or where the city leaves no room to fly or to walk."""
        super().__init__(config, context)
        low, high = config.task_bits
        if not 0 < low <= high:
            raise ValueError(
                f"task_bits is {config.task_bits}: from low to high, above 0, is needed"
            )
        mean = config.arrival_rate * config.num_users * context.period
        if mean > MOST_TASKS:
            raise ValueError(
                f"arrival_rate is {config.arrival_rate:g}: {mean:g} tasks of num_users {config.num_users} in a decision, at "
                f"most {MOST_TASKS:g} are possible"
            )
        rates = np.full(config.num_users, config.arrival_rate)
        self._arrivals = Arrivals(rates, context.period, config.task_bits)
        for name in ("cycles_per_bit", "deadline", "core_frequency", "power_scale"):
            if getattr(config, name) <= 0:
                raise ValueError(f"{name} is {getattr(config, name):g}: it must be above 0")
        self.uplink = Uplink(config)
        self._demand = (low + high) / 2 * config.cycles_per_bit
        self._activity = min(
            config.arrival_rate * config.deadline, 1.0
        )  # uploads end at the deadline: a user sends no more
        self._expected = max(
            config.arrival_rate * config.num_users * context.period, 1e-9
        )  # tasks in a decision
        self._compute_power = config.num_cores * float(
            core_power(config.capacitance, config.core_frequency)
        )
        self._capacity = config.num_cores * config.core_frequency
        self._service_rate = float(
            service_rate(config.core_frequency, (low + high) / 2, config.cycles_per_bit)
        )

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Beside that of users what drones did in the last decision, and the world in this episode.

        `utilisation` of the cores; `queue`, tasks (of mean size) that wait or are computed; `latency`, s, mean of the tasks
        of the drone's users; `completed` tasks, the sum of their latencies, `delay_completed`, s, and `completed_share`;
        power `received` from each user, W; `link_free` and `core_free`, s from now. Tasks `generated` and `finished`, the
        `delay` of all, s, and, the same for all drones, the `share` of tasks completed and the `mean_latency`, see `info`.
        """
        drones, users = self.context.num_drones, self.config.num_users
        totals = ("generated", "finished", "delay")
        return {
            **super().memory(),
            **{name: () if name in totals else (drones,) for name in ServiceStats._fields},
            "received": (drones, users),
            "link_free": (users,),
            "core_free": (drones, self.config.num_cores),
        }

    def quantities(self) -> Mapping[str, Any]:
        """Tell how many tasks all users are expected to have in a decision."""
        return {**super().quantities(), "expected_tasks": self._expected}

    def payload_power(self, scene: Scene) -> np.ndarray:
        """Tell what the cores take that were busy in the last decision, (W, N) W."""
        return scene.memory["utilisation"] * self._compute_power

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Work out rates, tasks of the decision, and what became of them."""
        super().update_memory(frame, rngs)
        memory, config = frame.scene.memory, self.config
        flying, after, users = np.any(frame.alive, axis=1), frame.after, memory["users"]
        # Who serves whom, at which rate.
        sight = frame.readings["sight"]
        pose = (after.position, after.quaternion)
        power = self.uplink.received(*pose, users, sight, rngs, flying)
        load, strategy = memory["utilisation"] * self._capacity, STRATEGIES[config.assignment]
        who = (strategy, after.position, frame.alive, users, power)
        servers = assign(*who, self._capacity, self._demand, load)
        rates = self.uplink.rates(power, servers, self._activity)
        memory["received"][:] = power
        # What becomes of the tasks that users have in this decision.
        served = self._serve(self._arrivals.draw(rngs, flying), servers, rates, memory)
        remaining = np.maximum(self.context.duration - frame.time, 0.0)
        left = config.arrival_rate * config.num_users * remaining
        stats = ServiceStats(*(memory[name] for name in ServiceStats._fields))
        core_time = config.num_cores * self.context.period
        most = config.num_cores * self._service_rate
        count(served, stats, left, config.deadline, core_time, most)

    def _serve(
        self,
        tasks: Tasks,
        servers: np.ndarray,
        rates: np.ndarray,
        memory: Mapping[str, np.ndarray],
    ) -> Served:
        """Compute the tasks of a decision, one by one or in the mean."""
        config, period = self.config, self.context.period
        if config.queue == "simulated":
            work = (config.cycles_per_bit, config.core_frequency, config.deadline, period)
            return serve(tasks, servers, rates, *work, memory["link_free"], memory["core_free"])
        drones = self.context.num_drones
        cores = (config.num_cores, config.arrival_rate, self._service_rate)
        limits = (config.deadline, period)
        return serve_on_average(
            tasks, servers, rates, drones, config.cycles_per_bit, *cores, *limits
        )

    def service_quality(
        self, place: np.ndarray, targets: np.ndarray, sight: np.ndarray
    ) -> np.ndarray:
        """Tell the share of a user's tasks that would be in time.

        If each drone had as many users, with nobody else and no queue; see `TargetTask`.
        """
        config = self.config
        upright = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(place), 1))
        nobody = np.zeros(1, dtype=bool)
        pose = (place[None], upright)
        power = self.uplink.received(*pose, targets[None], sight[None], [None], nobody)[0]
        # The rate that is left to each user, and the largest task that is in time at that rate.
        users = max(len(targets) / self.context.num_drones, 1.0)
        rate = capacity(config.bandwidth / users, users * power / self.uplink.noise)
        low, high = config.task_bits
        computing = config.cycles_per_bit / config.core_frequency
        largest = config.deadline / (1 / np.maximum(rate, 1e-9) + computing)
        share = np.minimum((largest - low) / max(high - low, 1e-9), 1.0)
        return np.where(largest < low, 0.0, share)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Tell beside `served` the episode's `completed` share of tasks and `latency`, s, so far.

        The same for all drones. Tasks that are yet to come, as many as in the mean, are not
        completed: so ending early does not raise the share.
        """
        memory = frame.scene.memory
        told = {"completed": memory["share"].copy(), "latency": memory["mean_latency"].copy()}
        return {**super().info(frame), **told}

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell whether the wanted share of tasks is completed."""
        return frame.scene.memory["share"] >= self.config.wanted
