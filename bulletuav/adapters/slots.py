"""Slots: the drones of a batch of worlds as rows of arrays, for learners of one shared policy.

A drone whose episode has ended is absent until its whole world is reset. The reward of a slot
without a drone is NaN.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.adapters.totals import EpisodeTotals
from bulletuav.envs.action_masks import STAY
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.common_spaces import common_observation
from bulletuav.envs.curriculum import Curriculum
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.spaces import widest_action_space
from bulletuav.envs.viewer import require_single
from bulletuav.errors import as_int
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation, part

Info = dict[str, Any]
"""Info of one slot in a step"""


class DroneSlots(Environment):
    """W worlds of N drones with W * N slots: slot w * N + i is drone i of world w.

    Each slot has the observation of its drone. A world is reset when all its drones are done.

    Infos are empty except at the end of the episode of a drone. There they have
    "terminal_observation", "TimeLimit.truncated" (True if only the horizon, or a change of stage,
    ended the episode), "is_success", and "episode" with the totals of that drone: return "r",
    decisions "l", seconds "t", "conflicts", "collision" and the return of each reward term
    ("reward/goal", ...). With `has_terminal_states` they also have "terminal_state", the state of
    the world before its reset.

    With several stages, all worlds are in the same stage, which the success rate of the last
    episodes determines, see `Curriculum`. The number of slots is that of the largest stage.

    Attributes:
        num_envs: Number of slots.
        num_worlds: Number of worlds W.
        num_drones: Number of drones N of the largest stage.
        curriculum: Rule that selects the stage, with its current stage.
        decisions: Number of decisions of drones so far, without empty slots.
        observation_space: Observation space of a drone.
        action_space: Action space of a drone.
        labels: Labels of the numbers of an observation, the same in all stages.
        has_terminal_states: Whether infos have "terminal_state"; False, unless a learner with a
            central critic sets it.
    """

    def __init__(
        self,
        task: TaskSource,
        num_worlds: int = 16,
        stages: Sequence[Mapping[str, Any]] = ({},),
        curriculum: Curriculum | None = None,
        shared_reward: bool = False,
        staggered: bool = False,
        **options: Any,
    ) -> None:
        """Make the environment.

        Args:
            task: Name or class of the task.
            num_worlds: Number of worlds that are stepped in one batch.
            stages: Further options of each stage, from easy to hard, such as
                [{"num_drones": 2}, {"num_drones": 8}].
            curriculum: Rule that selects the stage, with its current stage; its defaults if None.
            shared_reward: If True, each drone receives the mean of the rewards of all drones of its
                world, where absent drones count as 0. Infos have the reward of each drone itself.
            staggered: If True, the first episodes after `reset` are cut short, that of world w of W
                after the fraction (w + 1) / W of the horizon. Otherwise worlds whose episodes last
                until the horizon stay in step, and a short rollout has only one phase of them. Cut
                episodes have no "episode" in their infos, and do not count in the curriculum.
            **options: Options of `Aviary`.

        Raises:
            ValueError: If an option is invalid, the curriculum has another number of stages, stages
                differ in the blocks or shapes of their observations or in the kind of action, or
                there is a live view of several stages.
        """
        self._shared_reward = shared_reward
        self._staggered = staggered
        # Decisions after which the first episode of each world is cut; 0 for never
        self._cut_after = np.zeros(num_worlds, dtype=int)
        self._has_cuts = False
        self._task = task
        self._stage_options = [{**options, **stage} for stage in stages]
        self.curriculum = curriculum or Curriculum(len(self._stage_options))
        if self.curriculum.count != len(self._stage_options):
            raise ValueError(
                f"the curriculum has {self.curriculum.count} stages, "
                f"and {len(self._stage_options)} are given"
            )
        # Check all stages now; the largest determines the number of slots
        specs = [EnvSpec(task, num_worlds, stage) for stage in self._stage_options]
        widest = max(specs, key=lambda spec: spec.options.num_drones)
        self.num_worlds = num_worlds
        self.labels = widest.observer.labels
        self._state_sizes = [len(spec.state.labels) for spec in specs]
        self.has_terminal_states = False
        self.num_drones = widest.options.num_drones
        self._render_mode = widest.options.render_mode
        require_single(self._render_mode, len(specs))
        # Worlds by stage, created on first use, and the stages still to be seeded
        self._aviaries: dict[int, Aviary] = {}
        self._totals: dict[int, EpisodeTotals] = {}
        self._seed: int | None = None
        self._unseeded: set[int] = set()
        self._stage = self.curriculum.stage
        self.decisions = 0
        self._all_present = False  # whether each slot has an active drone
        self._actions: np.ndarray = np.empty(0)
        self.num_envs = num_worlds * self.num_drones
        self.observation_space = common_observation(specs)
        self.action_space = widest_action_space(widest.action)

    @property
    def aviary(self) -> Aviary:
        """The worlds of the current stage."""
        if self._stage not in self._aviaries:
            made = Aviary(self._task, self.num_worlds, **self._stage_options[self._stage])
            self._totals[self._stage] = EpisodeTotals(made)
            self._aviaries[self._stage] = made
        return self._aviaries[self._stage]

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the worlds of every stage, from the next `reset` or first episodes of a stage on.

        Args:
            seed: World k gets seed + k; None continues the random sequences.

        Returns:
            The seed of each slot.

        Raises:
            ValueError: If the seed is not an integer of at least 0.
        """
        self._seed = None if seed is None else as_int("seed", seed, 0)
        self._unseeded = set(range(len(self._stage_options)))
        return [
            None if seed is None else seed + slot // self.num_drones
            for slot in range(self.num_envs)
        ]

    @exclusive
    def reset(self) -> Any:
        """Start new episodes in all worlds, in the current stage of the curriculum.

        Returns:
            Observations (slots, D), or a dict of such arrays.
        """
        everywhere = np.ones(self.num_worlds, dtype=bool)
        observations = self._start(everywhere, True)
        # An episode is not cut below 1 decision
        horizon = self.aviary.options.horizon if self._staggered else 0
        self._cut_after = horizon * np.arange(1, self.num_worlds + 1) // self.num_worlds
        self._has_cuts = bool(self._cut_after.any())
        return self._rows(observations)

    def _start(self, worlds: np.ndarray, uses_seed: bool = False) -> Observation:
        """Reset the worlds of a mask (W,), or all if the stage changes; return observations.

        The seed is used if the stage changes, or if `uses_seed`. Otherwise single worlds would use
        it up.
        """
        if self.curriculum.stage != self._stage or not self._aviaries:
            uses_seed = True
            self._stage = self.curriculum.stage
            worlds = np.ones(self.num_worlds, dtype=bool)
        # Each stage is seeded once, and then continues its random sequence
        aviary = self.aviary
        seed = None
        if uses_seed and self._stage in self._unseeded:
            seed = self._seed
            self._unseeded.discard(self._stage)
        observations = aviary.reset(worlds, seed)
        self._all_present = aviary.num_drones == self.num_drones and bool(aviary.alive.all())
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Set the actions for the next `step_wait`.

        Args:
            actions: (slots, A), or (slots,) discrete; those of slots without a drone are ignored.
        """
        self._actions = np.asarray(actions).reshape(self.num_worlds, self.num_drones, -1)

    @exclusive
    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[Info]]:
        """Step all worlds by one decision, and reset the worlds whose drones are all done.

        Returns:
            Observations (slots, D), or a dict of such arrays, after the reset of a world; rewards
            (slots,), NaN for slots without a drone; dones (slots,), which are True at the end of
            the episode of a drone, of all slots of a world at its reset, and of slots that the
            stage does not use; and infos of the slots.
        """
        aviary = self.aviary
        aviary.require_started()
        aviary.write_actions(self._actions[:, : aviary.num_drones])
        aviary.decide()
        if not self._all_present or aviary.any_left or self._has_cuts:
            return self._end_episodes(aviary)
        # Most decisions: each slot has a drone, and its episode continues
        self.decisions += self.num_envs
        rewards = self._shared(aviary.rewards).astype(np.float32).reshape(-1)
        infos: list[Info] = [{} for _ in range(self.num_envs)]
        seen = _by_slot(aviary.observations(), lambda array: array.reshape(-1, *array.shape[2:]))
        return seen, rewards, np.zeros(self.num_envs, dtype=bool), infos

    def _end_episodes(self, aviary: Aviary) -> tuple[Any, np.ndarray, np.ndarray, list[Info]]:
        """Return the results of a decision, after a reset of the worlds whose drones are done."""
        flown = aviary.worlds.state.flown.copy()
        self.decisions += int(flown.sum())
        over = np.any(flown, axis=1) & ~np.any(aviary.alive, axis=1)
        cut = (aviary.steps == self._cut_after) & ~over
        # Finished episodes of whole worlds may change the stage
        successes = aviary.mean_of_members(self._totals[self._stage].success)
        for world in np.flatnonzero(over):
            # Otherwise the episode belongs to a previous stage
            if self.curriculum.stage == self._stage:
                self.curriculum.record(float(successes[world]))
        change = self.curriculum.stage != self._stage
        # Finished episodes of drones
        ended = flown & (change | cut[:, None] | ~aviary.alive)
        observations = aviary.observations()
        infos = self._infos(observations, ended, cut)
        over |= cut
        if self._has_cuts:
            self._cut_after[over | change] = 0
            self._has_cuts = bool(self._cut_after.any())
        dones = self._wide(ended | over[:, None] | change, True)
        # Rewards are NaN without a drone
        earned = self._shared(np.where(flown, aviary.rewards, 0.0))
        rewards = self._wide(np.where(flown, earned, np.nan), np.nan).astype(np.float32)
        self._all_present = False
        if over.any():
            observations = self._start(over)
        return self._rows(observations), rewards, dones, infos

    def _shared(self, rewards: np.ndarray) -> np.ndarray:
        """Return rewards (W, N), or the mean of each world for all its drones if they share it."""
        if not self._shared_reward:
            return rewards
        return np.broadcast_to(rewards.mean(axis=1, keepdims=True), rewards.shape)

    def _infos(self, observations: Observation, ended: np.ndarray, cut: np.ndarray) -> list[Info]:
        """Return the infos of all slots.

        They have totals for the episodes that ended (W, N), except in worlds that are cut (W,).
        """
        infos: list[Info] = [{} for _ in range(self.num_envs)]
        aviary, totals = self.aviary, self._totals[self._stage]
        states = aviary.state() if self.has_terminal_states and ended.any() else None
        # One info for each drone whose episode ended; all others stay empty
        for w, i in np.argwhere(ended).tolist():
            info: Info = {
                "terminal_observation": part(observations, (w, i)),
                "TimeLimit.truncated": not aviary.terminated[w, i],
            }
            if states is not None:
                info["terminal_state"] = states[w]
            if not cut[w]:
                own, decisions = totals.of_drone(w, i), int(aviary.steps[w])
                info["is_success"] = bool(own.pop("success"))
                info["episode"] = {
                    "r": totals.return_of(w, i),
                    "l": decisions,
                    "t": decisions / aviary.options.decision_hz,
                    **own,
                }
            infos[w * self.num_drones + i] = info
        return infos

    def _wide(self, array: np.ndarray, fill: float) -> np.ndarray:
        """Reshape (W, N, ...) to (slots, ...), padded if the stage has fewer drones."""
        lacking = self.num_drones - array.shape[1]
        if lacking:
            shape = (len(array), lacking, *array.shape[2:])
            empty = np.full(shape, fill, array.dtype)
            array = np.concatenate([array, empty], axis=1)
        return array.reshape(-1, *array.shape[2:])

    def _rows(self, observations: Observation) -> Any:
        """Return observations by slot, zeros for slots without a drone."""
        alive = self._wide(self.aviary.alive, False)

        def rows(array: np.ndarray) -> np.ndarray:
            wide = self._wide(array, 0)
            mask = alive.reshape(-1, *[1] * (wide.ndim - 1))
            kept = np.where(mask, wide, 0)
            return kept.astype(array.dtype, copy=False)

        return _by_slot(observations, rows)

    @property
    def state_size(self) -> int:
        """Number K of numbers of the global state.

        Raises:
            ValueError: If stages differ in it.
        """
        if len(set(self._state_sizes)) > 1:
            sizes = ", ".join(map(str, self._state_sizes))
            raise ValueError(
                f"the global states of the stages have {sizes} numbers, and one size is needed: "
                f"use the same num_drones, and the same numbers of other objects, in all stages"
            )
        return self._state_sizes[0]

    def state(self) -> np.ndarray:
        """Return the global state of each world.

        Returns:
            (W, K) float32; see `Aviary.state`.
        """
        return self.aviary.state()

    def action_masks(self) -> np.ndarray:
        """Return the mask of each slot, as MaskablePPO of sb3-contrib asks for it.

        Returns:
            (slots, C) bool; only action 0 (stay) for slots without a drone.

        Raises:
            ValueError: Without the option `action_masks`.
        """
        masks = self._wide(self.aviary.action_masks().astype(bool), False)
        masks[:, STAY] = True
        return masks

    @exclusive
    def close(self) -> None:
        """Disconnect from the physics engines; calling it again does nothing."""
        for aviary in self._aviaries.values():
            aviary.close()


def _by_slot(observations: Observation, rows: Callable[[np.ndarray], np.ndarray]) -> Any:
    """Convert each array (W, N, ...) of observations to rows (slots, ...)."""
    if isinstance(observations, dict):
        return {name: rows(array) for name, array in observations.items()}
    return rows(observations)
