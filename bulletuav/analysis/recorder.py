"""Recorder of world 0 during an episode: states, decisions, contacts and scene."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bulletuav.analysis.recorded import INFO_ARRAYS, Recording
from bulletuav.analysis.scene import Recorded, SceneLog
from bulletuav.geometry.rotation import to_world
from bulletuav.vehicle.swarm import Contacts, Swarm


class _State(NamedTuple):
    """State of world 0 at one time.

    Attributes:
        swarm: State of all drones.
        alive: Drones in the airspace, (N,) bool.
        goal: Goals, (N, 3), m; (0, 3) without goals.
        obstacle: Centres of the obstacles, (K, 3), m.
        target: Active targets, (U, 3), m.
        seen: Active targets in sight of any drone, (U,) bool.
    """

    swarm: Swarm
    alive: np.ndarray
    goal: np.ndarray
    obstacle: np.ndarray
    target: np.ndarray
    seen: np.ndarray


class _Decision(NamedTuple):
    """Data of one decision.

    Attributes:
        action: Actions, (W, N, A).
        reward: Rewards, (W, N).
        info: Infos, (W, N, ...) by name.
        contacts: Contacts of world 0.
    """

    action: np.ndarray
    reward: np.ndarray
    info: Mapping[str, Any]
    contacts: Contacts


class Recorder:
    """Records an episode of world 0 of an aviary, decision by decision."""

    def __init__(self, aviary: Recorded) -> None:
        """Start with the present state, such as right after a reset."""
        self._aviary = aviary
        self._first = int(aviary.steps[0])
        # States have one more row than decisions: the start.
        self._states = [_state(aviary)]
        self._decisions: list[_Decision] = []
        self._log = SceneLog(aviary)
        self._in_first = np.arange(aviary.num_worlds) == 0

    def record(self, action: np.ndarray, reward: np.ndarray, info: Mapping[str, Any]) -> None:
        """Record one decision, right after it was flown.

        Args:
            action: Actions, (W, N, A).
            reward: Rewards, (W, N).
            info: Infos, (W, N, ...) by name.
        """
        contacts = self._aviary.contacts.of_worlds(self._in_first)
        self._decisions.append(_Decision(action, reward, info, contacts))
        self._states.append(_state(self._aviary))
        self._log.record()

    def discard_history(self) -> None:
        """Discard all states but the last, from which the recording continues."""
        self._first += len(self._decisions)
        self._decisions.clear()
        del self._states[:-1]
        self._log.discard_history()

    def recording(self) -> Recording:
        """Return a recording of the decisions, of which there must be at least one."""
        states, decisions, aviary = self._states, self._decisions, self._aviary

        def column(name: str) -> np.ndarray:
            return np.array([decision.info[name][0] for decision in decisions])

        # Keep only infos that every decision has, with a row for each world, without Python
        # objects.
        kept = [
            name
            for name, values in decisions[0].info.items()
            if values.ndim
            and values.dtype.kind != "O"
            and all(name in decision.info for decision in decisions)
        ]
        return Recording(
            time=(self._first + np.arange(len(states))) / aviary.options.decision_hz,
            position=np.array([state.swarm.position[0] for state in states]),
            quaternion=np.array([state.swarm.quaternion[0] for state in states]),
            velocity=np.array([state.swarm.velocity[0] for state in states]),
            rates=np.array([state.swarm.rates[0] for state in states]),
            alive=np.array([state.alive for state in states]),
            action=np.array([decision.action[0] for decision in decisions]),
            reward=np.array([decision.reward[0] for decision in decisions]),
            success=column("success"),
            separation=column("separation"),
            conflicts=column("conflicts"),
            collision=column("collision"),
            **stack_contacts([decision.contacts for decision in decisions]),
            goal=np.array([state.goal for state in states]),
            obstacle=np.concatenate(
                [np.array([state.obstacle for state in states]), self._log.body_poses()[0]], axis=1
            ),
            obstacle_radius=np.append(
                [obstacle.radius for obstacle in aviary.task.obstacles()], self._log.body_radius
            ),
            obstacle_axis=_bar_axes(aviary, len(self._log.body_radius)),
            building=aviary.solids().bounds,
            target=np.array([state.target for state in states]),
            seen=np.array([state.seen for state in states]),
            info={name: column(name) for name in kept if name not in INFO_ARRAYS},
            reading=self._log.readings(),
            scene=self._log.scene(),
        )


def _state(aviary: Recorded) -> _State:
    """Copy the state of world 0."""
    scene = aviary.scene
    active = aviary.task.active_targets(scene)[0]
    seen = np.any(aviary.sight[0], axis=0)
    return _State(
        swarm=aviary.swarm.copy(),
        alive=aviary.alive[0].copy(),
        goal=scene.goal[0].copy() if aviary.task.has_goals else np.zeros((0, 3)),
        obstacle=scene.obstacle[0].copy(),
        target=aviary.task.targets(scene)[0, active],
        seen=seen[active],
    )


def _bar_axes(aviary: Recorded, num_pieces: int) -> np.ndarray:
    """Return the half axes of the bars among world 0's obstacles, (K, 3) m; they are constant.

    Those of the pieces of bodies are zero, as bodies may turn.
    """
    turn = aviary.scene.obstacle_quaternion[0].tolist()
    bodies = zip(aviary.task.obstacles(), turn, strict=True)
    axes = [to_world(tuple(one), body.long_axis) for body, one in bodies]
    return np.concatenate([np.array(axes).reshape(-1, 3), np.zeros((num_pieces, 3))])


def stack_contacts(contacts: list[Contacts]) -> dict[str, Any]:
    """Stack the contacts of all decisions, by their names in recordings."""
    step = np.repeat(np.arange(len(contacts)), [len(one.world) for one in contacts])
    columns = map(np.concatenate, zip(*contacts, strict=True))
    fields = dict(zip(Contacts._fields, columns, strict=True))
    del fields["world"], fields["depth"]  # compiled contacts meet at their surfaces
    return {"contact_step": step} | {f"contact_{name}": fields[name] for name in fields}
