"""One decision of all worlds as a program: what happens from actions to observations."""

from typing import Any

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.control.actions.base import Compiled, limit_each
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.envs.infos import Told, stays
from bulletuav.envs.parts import add_obstacles
from bulletuav.envs.stages import (
    admit,
    begin,
    conclude,
    copy_vectors,
    keep_before,
    settle,
    tell,
    tick,
)
from bulletuav.envs.worlds import Worlds
from bulletuav.sensors.base import Moment
from bulletuav.tasks import TaskSource
from bulletuav.tasks.account import Account, add_account, make_account, mark_contacts, mark_landings
from bulletuav.tasks.base import Task
from bulletuav.tasks.check import require_finite
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import PRESENT
from bulletuav.tasks.stages import Judgement, add_judgement, add_outcome, clear
from bulletuav.vehicle.swarm import Contacts, Swarm, confine

INFOS = {
    "success": bool,
    "collision": bool,
    "resting": bool,
    "impulse": float,
    "conflicts": np.int64,
    "separation": float,
    "goal_distance": float,
    "power": float,
    "charge": float,
}
"""Names and types of what infos tell beside reward terms, in the order of `stages.tell`.

Of tasks without goals they do not tell "goal_distance".
"""


class Decisions(Worlds):
    """What a decision reads and writes, and the program that flies it.

    Arrays stay where they are for the environment's life: compiled stages find them there.
    """

    def __init__(
        self,
        task: TaskSource,
        num_worlds: int = 1,
        **options: Any,
    ) -> None:
        """Build the worlds; see `Worlds`."""
        super().__init__(task, num_worlds, **options)
        self._make_arrays()

    def _make_arrays(self) -> None:
        """Make the arrays of decisions, and the frame that shows them."""
        shape, task = self.alive.shape, self.task
        size = self.action.low.shape[-1]
        # What is told: actions, and setpoints made of them
        self.given = np.zeros((*shape, size))
        self._setpoint = self.action.decode(np.zeros((*shape, size)), self.commanded).copy()
        self._levels = np.full(shape, int(self.action.level))
        # Wind, and mass that is carried
        self._air = np.zeros((*shape, 3))
        self._payload = np.zeros(shape)
        # Who flies, who ended how
        self._flying = np.zeros(self.num_worlds, dtype=bool)
        self._ended, self._success = np.zeros((2, *shape), dtype=bool)
        self.terminated, self.truncated, self._present, self._left = np.zeros((4, *shape), bool)
        self._moved = np.zeros(shape, dtype=bool)
        self.rewards = np.zeros(shape)
        # What was touched, worked out when somebody asks
        self._contacts: Contacts | None = Contacts.none()
        self._contacts_before: Contacts | None = None
        # What tasks are shown; `after` is the state itself, so it is not copied
        self._readings = {"sight": self._nothing_seen, **self._energy.readings()}
        self._live = Frame(
            before=self.swarm.copy(),
            after=self.swarm,
            action=np.zeros((*shape, size)),
            scene=self.scene,
            tell=self._tell_contacts,
            alive=np.zeros(shape, dtype=bool),
            time=np.zeros(self.num_worlds),
            last=np.zeros(self.num_worlds, dtype=bool),
            d_safe=float(task.config.d_safe),
            zone=float(task.zone),
            goal_before=self.scene.goal.copy(),
            readings=self._readings,
        )
        # Room of observations, and the program, made once all is known
        self._vector = self.observer.make_room(shape)
        self._account: Account | None = None
        self.program: Program | None = None

    def _more_arrays(self) -> dict[str, np.ndarray]:
        """Tell also what the last decision told; see `Worlds._more_arrays`."""
        frame = self._live
        told = {f"before {name}": array for name, array in frame.before._asdict().items()}
        told |= {f"reading {name}": array for name, array in self._readings.items()}
        names = ("action", "alive", "time", "last", "goal_before")
        told |= {f"frame {name}": getattr(frame, name) for name in names}
        ends = {
            "terminated": self.terminated,
            "truncated": self.truncated,
            "present": self._present,
        }
        return {**super()._more_arrays(), **told, **ends, "rewards": self.rewards}

    def _tell_contacts(self) -> Contacts:
        """Tell what touched what in the last decision, told once."""
        if self._contacts is None:
            self._contacts = self._dynamics.touched()
        return self._contacts

    @property
    def _collects_contacts(self) -> bool:
        """Whether there are contacts that compiled code knows nothing of."""
        return self.task.rebound is not None or self.options.contacts == "bullet"

    def _look(self) -> None:
        """Take over what stands now; programs know only what stood when they were made."""
        if self._dynamics.look_around():
            self._account = None
        if self._account is None:
            account, reckoning = make_account(self._live), Program()
            self._add_account(reckoning, account)
            # Last, so that an interrupt before it leaves nothing that is half made
            self._reckoning, self.program, self._account = reckoning, None, account

    def _add_account(self, program: Program, account: Account) -> None:
        """Add what follows from a flight for every drone."""
        add_account(program, account, self._live, self._dynamics.contact)
        if self._collects_contacts:
            program.turn(self._mark_contacts)
        if self.task.lands:
            known = (account, self._live, np.array(self.task.context.standing_height))
            program.turn(lambda: mark_landings(*known))

    def _mark_contacts(self) -> None:
        """Take over contacts that were collected in Python; compiled code has marked all others."""
        assert self._account is not None
        if self._contacts is not None or self.options.contacts == "bullet":
            mark_contacts(self._account, self._live)

    def _name_infos(self, terms: list[str]) -> None:
        """Make room for infos; `terms` are the names of the reward terms that the task gives."""
        shape = self.alive.shape
        untold = None if self.task.has_goals else "goal_distance"
        self._terms = terms
        self._unweighted = np.zeros((len(terms), *shape))
        self._table = np.zeros((len(terms) + len(INFOS), *shape))
        self._weighted = self._table[: len(terms)]
        standard = [(None if name == untold else name, kind) for name, kind in INFOS.items()]
        self._rows = [*((f"reward/{name}", float) for name in terms), *standard]
        own = type(self.task).info is not Task.info
        self._tells_more = own or bool(
            self.task.lands or self._uncertainty.drawn or self._sensors.sensors
        )

    def _forget(self) -> None:
        """Forget what was worked out of the frame as it was before."""
        self._live.derived.clear()
        self._live.derived[PRESENT] = self._present

    def _make_program(self) -> Program:
        """Make the program of a decision, in the order in which things happen."""
        program, frame, task = Program(), self._live, self.task
        self._forget()
        task.evaluate_step(frame)  # tells the program what the task derives
        self._add_action(program)
        self._add_flight(program)
        if self._sensors.sensors:
            program.turn(lambda: self._keep(self._measure(frame.before, frame.after, frame.alive)))
        assert self._account is not None
        self._add_account(program, self._account)
        if type(task).update_memory is not Task.update_memory:
            program.turn(lambda: task.update_memory(frame, self.rng))
        self._add_judgement(program)
        self._add_result(program)
        program.compile()  # now, so that the first decision takes no longer than others
        self._observing, self._telling = self._make_first()
        self.program = program  # last: an interrupt before it leaves nothing that is half made
        return program

    def _make_first(self) -> tuple[Program, Program]:
        """Make the programs of what is observed, and of what is told, right after a reset."""
        observing, telling = Program(), Program()
        self.observer.add_to(observing, self._live, self._vector)
        # Terms are zero then, whatever they would be
        add_outcome(telling, self.task, self._live, self._judgement)
        telling.call(clear, self._weighted)
        self._add_infos(telling)
        return observing, telling

    def _add_action(self, program: Program) -> None:
        """Add what comes before the flight: actions, wind, goals and obstacles, setpoints."""
        frame, action, scene = self._live, self.action, self.scene
        bounds = (action.low, action.high, action.choices is not None)
        # Actions that cannot be end the decision before anything has changed
        program.call(admit, self.given, self.alive, *bounds, frame.action, otherwise=self._refuse)
        clock = (self.steps, float(self.options.decision_hz))
        program.call(begin, self.alive, *clock, frame.alive, self._flying, frame.time)
        # Wind at the places before the flight
        self._wind.add_to(program, self.swarm.position, frame.time, self._air)
        # Tasks compare before and after
        before = (scene.goal, frame.goal_before, scene.obstacle, self._dynamics.contact.before)
        program.call(keep_before, self.swarm, frame.before, *before)
        # Only tasks that move goals or obstacles take Python's time
        if type(self.task).move_scene is not Task.move_scene:
            program.turn(self._move_scene)
        # Setpoints: compiled where the action allows it
        if isinstance(action.decode, Compiled):
            numbers = (self._setpoint, *action.decode.numbers)
            program.call(action.decode.kernel, frame.action, self.commanded, *numbers)
        else:
            program.turn(self._decode)
        if self.task.speed_limit is not None:
            program.call(limit_each, self._setpoint, np.array(self.task.speed_limit, dtype=float))
        # The last velocity asked for, which increments start from
        if action.level == SetpointLevel.VELOCITY:
            program.call(copy_vectors, self._setpoint, self.commanded)
        if self._uncertainty.drains:
            program.turn(lambda: self._uncertainty.drain(frame.time))

    def require_action(self, drone: int, numbers: np.ndarray) -> None:
        """Raise ValueError for numbers (A,) of a drone that cannot be; nobody flies."""
        given, chosen = np.zeros(self.given.shape), np.zeros(self.alive.shape, dtype=bool)
        given[:, drone], chosen[:, drone] = numbers, True
        self._spec.actions(given, chosen)

    def _refuse(self) -> None:
        """Raise ValueError for an action that cannot be; everything is as before."""
        self._contacts = self._contacts_before
        self._spec.actions(self.given, self.alive)

    def _move_scene(self) -> None:
        """Let the task move goals and obstacles."""
        self.task.move_scene(self.scene, self._live.time, self._flying, self.rng)

    def _decode(self) -> None:
        """Make setpoints by an action that is not compiled."""
        self._setpoint[:] = self.action.decode(self._live.action, self.commanded)

    def _add_flight(self, program: Program) -> None:
        """Add the flight, and the energy that it takes."""
        frame, scene, task = self._live, self.scene, self.task
        program.call(copy_vectors, scene.obstacle, self._dynamics.contact.after)
        flight = (self._levels, self._setpoint, self._air)
        self._dynamics.add_to(program, self.swarm, frame.alive, *flight)
        add_obstacles(program, self._engine, scene.obstacle)
        if task.rebound is not None:
            flown, box = frame.alive, (task.arena_low, task.arena_high, float(task.rebound))
            bounds = (self.swarm, self.commanded, flown, *box, self._moved)
            program.call(confine, *bounds, otherwise=self._put_back)
        clock = (self.steps, float(self.options.decision_hz), self.options.horizon)
        program.call(tick, self._flying, *clock, frame.time, frame.last)
        if type(task).payload_power is not Task.payload_power:
            program.turn(self._take_payload)
        given = (self._air, self._payload, frame.alive)
        self._energy.add_to(program, frame.before, self.swarm, *given)

    def _take_payload(self) -> None:
        """Ask the task what equipment takes beside flight."""
        self._payload[:] = self.task.payload_power(self.scene)

    def _put_back(self) -> None:
        """Place drones that had left the arena; contacts tell what they meet there, too."""
        moved, flown = self._moved, self._live.alive
        self._dynamics.place(self.swarm, moved)
        told = self._tell_contacts()
        self._contacts = told.joined(self._dynamics.overlaps(self.swarm, moved, flown))

    @property
    def _judgement(self) -> Judgement:
        """Arrays for what the task makes of the decision."""
        terms = dict(zip(self._terms, self._unweighted, strict=True))
        return Judgement(self._ended, self._success, terms)

    def _add_judgement(self, program: Program) -> None:
        """Add what the task makes of the decision."""
        add_judgement(program, self.task, self._live, self._judgement)

    def _add_result(self, program: Program) -> None:
        """Add who leaves, observations, rewards and infos."""
        frame = self._live
        charge = self._energy.readings()["charge"]
        ends = (self.terminated, self.truncated, self._present, self.alive, self._left)
        told = (self._ended, charge, frame.alive, frame.last)
        program.call(conclude, *told, *ends, otherwise=lambda: self._engine.park(self._left))
        self.observer.add_to(program, frame, self._vector)
        if self.options.render_mode == "human":
            program.turn(self._show_live)
        weights = np.array([float(self.task.weights[name]) for name in self._terms])
        sums = (self._unweighted, weights, frame.alive, self._weighted, self.rewards)
        program.call(settle, *sums, otherwise=self._refuse_reward)
        self._add_infos(program)

    def _add_infos(self, program: Program) -> None:
        """Add what infos tell beside reward terms."""
        frame, account = self._live, self._account
        assert account is not None
        energy = self._energy.readings()
        program.call(
            tell,
            self._success,
            frame.alive,
            (account.collision, account.resting, account.impulse),
            (account.conflict.onsets, account.conflict.separation, account.distance),
            (energy["power"], energy["charge"]),
            self._table[-len(INFOS) :],
        )

    def _show_live(self) -> None:
        """Bring the live window up to date."""
        self._show(self.swarm, self.alive)
        self._renderer.show(self.swarm, self.alive, 1 / self.options.decision_hz)

    def _refuse_reward(self) -> None:
        """Raise ValueError for a reward that is not finite."""
        weighted = dict(zip(self._terms, self._weighted, strict=True))
        require_finite(self.task, weighted, self.rewards)

    def _measure(
        self,
        before: Swarm,
        after: Swarm,
        mask: np.ndarray,
    ) -> dict[str, np.ndarray]:
        """Measure with all sensors, from the drones of `mask` (W, N)."""
        if not self._sensors.sensors:
            return {}
        targets = self.task.targets(self.scene)
        moment = Moment(before, after, targets, mask, self.steps, self.rng, {})
        return self._sensors.measure(moment, self._show)

    def _keep(self, readings: dict[str, np.ndarray]) -> None:
        """Write readings to the arrays of the frame."""
        for name, value in readings.items():
            held = self._readings.get(name)
            if held is None or held is self._nothing_seen:
                self._readings[name] = np.array(value)
            else:
                held[...] = value

    def telling(self, world: Any = ...) -> Told:
        """Keep what the last decision tells; calling the result makes infos of it.

        Args:
            world: Index of the world of which they tell, in arrays (N,); of all, (W, N), when left
                out.
        """
        more: dict[str, np.ndarray] = {}
        if self._tells_more:
            landed = {"landed": self._live.landed} if self.task.lands else {}
            told = {
                **landed,
                **self.task.info(self._live),
                **self._uncertainty.info(),
                **self._sensors.info(),
            }
            # What stays as it is can wait to be copied until somebody asks
            more = {name: one if stays(one) else np.array(one) for name, one in told.items()}
        return Told(self._table.copy(), self._rows, more, world)
