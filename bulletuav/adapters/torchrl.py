"""Environment of TorchRL: W worlds as one batch, a group of agents for each team.

Tensors come of the batched environment as they are, so that one call flies all worlds:

    env = DroneTensorEnv("crossing", num_worlds=64, dynamics="point_mass")
    flight = env.rollout(100, break_when_any_done=False)
    flight["next", "drones", "reward"]  # (64, 100, 8, 1)

A drone whose episode ended is gone until its whole world starts anew. Its "mask" is False then:
it observes and earns zeros, its "done" stays True, and its actions are ignored.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bulletuav.control.actions import Action
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import Environment
from bulletuav.envs.reset_options import MASK
from bulletuav.envs.teams import team_rows
from bulletuav.envs.workers import batch_env
from bulletuav.errors import as_int, as_sequence, choose, missing, shown
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation

try:
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Bounded, Categorical, Composite, OneHot, Unbounded
    from torchrl.envs import EnvBase
    from torchrl.envs.utils import MarlGroupMapType, check_marl_grouping
except ImportError:
    raise missing("an environment of TorchRL", "torchrl") from None


ENDS = ("done", "terminated", "truncated")
"""Entries that tell ends, of each drone and of the whole world"""
STATE = ("state",)
"""Key of the global state, which is of no group"""
PROCESSES = ("workers", "start_method", "timeout")
"""Options of `batch_env` that are no options of an environment"""


Told = dict[tuple[str, ...], Any]
"""Arrays (W, N, ...) that are told of drones by their keys in a group, and the state (W, K)"""


class DroneTensorEnv(Environment, EnvBase):  # type: ignore[misc]  # has no types
    """W worlds of N drones as a batched `torchrl.envs.EnvBase`.

    Each team is a group; the one of a task without teams is "drones". A group of n drones has:

    - (group, "action"): (W, n, A), or (W, n) choices; one-hot if asked for.
    - (group, "observation"): (W, n, D), or nested entries of them by name.
    - (group, "mask"): (W, n) bool, drones that fly.
    - (group, "reward"): (W, n, 1).
    - (group, "done"), (group, "terminated"), (group, "truncated"): (W, n, 1) bool; they stay as
      they are when the drone is gone.
    - (group, "info", name): (W, n, 1), for the names asked for.

    "done", "terminated" and "truncated" (W, 1) are of whole worlds: done when nobody flies any
    more, terminated when the task ended the episodes of all, else truncated. "state" (W, K) is the
    global state.

    Attributes:
        batch: The batched environment; it has labels, pictures and snapshots.
        num_worlds: W.
        n_agents: N, by the name that TorchRL's tutorials use.
        group_map: Agents of each group, `drone_0` ... `drone_{N-1}`.
    """

    def __init__(
        self,
        task: TaskSource,
        num_worlds: int = 16,
        *,
        device: Any = None,
        group_map: Any = None,
        categorical_actions: bool = True,
        return_state: bool = False,
        infos: Sequence[str] = (),
        **options: Any,
    ) -> None:
        """Make the environment.

        Args:
            task: One of `list_tasks()`, `module:Name`, or a class of one's own.
            num_worlds: How many worlds are flown at once.
            device: Device of the tensors; worlds fly on the CPU.
            group_map: Agents of each group by its name, or one of TorchRL's `MarlGroupMapType` (or
                its name, "ALL_IN_ONE_GROUP"); a group for each team when left out.
            categorical_actions: Whether discrete actions are numbers, instead of one-hot.
            return_state: Whether "state" is told.
            infos: Names of the infos that are told.
            **options: Options of `batch_env`, such as `workers`, and of `parallel_env`.

        Raises:
            ValueError: An option cannot be.
        """
        own = {name: value for name, value in options.items() if name not in PROCESSES}
        spec = EnvSpec(task, num_worlds, own)
        self._infos = as_sequence("infos", infos)
        self.group_map = _groups(group_map, spec)
        super().__init__(device=device, batch_size=(num_worlds,))
        options["autoreset_mode"] = "Disabled"
        self.batch = batch_env(task, num_worlds, **options)
        self.is_closed = False
        self.num_worlds, self._tells_state = num_worlds, return_state
        self.n_agents = spec.options.num_drones
        rows = {group: [int(one[6:]) for one in own] for group, own in self.group_map.items()}
        self._rows = {group: _index(own) for group, own in rows.items()}
        drones, width = spec.action.low.shape
        chooses = spec.action.choices is not None
        self._one_hot = chooses and not categorical_actions
        self._given = np.zeros((num_worlds, drones) if chooses else (num_worlds, drones, width))
        # What has become of the drones, and the worlds that begin with the seed.
        self._alive, self._terminated, self._truncated = np.zeros((3, num_worlds, drones), bool)
        self._seed: int | None = None
        self._unseeded = np.zeros(num_worlds, dtype=bool)
        self._last: Told = {}
        self._make_specs(spec, rows)

    def _make_specs(self, spec: EnvSpec, groups: dict[str, list[int]]) -> None:
        """Tell TorchRL the shape and type of each entry."""
        # Entries of the whole world first, then those of each group
        action, seen, reward, done = (Composite(device=self.device) for _ in range(4))
        # An episode ends for all at once; groups tell their own ends, too
        done.update(dict.fromkeys(ENDS, self._flag(1)))
        if self._tells_state:
            seen["state"] = self._number(len(spec.state.labels))
        # Worlds share the shape, so a spec has the drones of the group alone
        for group, rows in groups.items():
            count = len(rows)
            chosen = _action_spec(spec.action, rows, self._one_hot).to(self.device)
            entries = {"observation": self._observed(count), "mask": self._flag(count)}
            if self._infos:
                told = dict.fromkeys(self._infos, self._number(count, 1))
                entries["info"] = Composite(told, shape=(count,))
            action[group] = Composite({"action": chosen}, shape=(count,))
            seen[group] = Composite(entries, shape=(count,))
            reward[group] = Composite({"reward": self._number(count, 1)}, shape=(count,))
            done[group] = Composite(dict.fromkeys(ENDS, self._flag(count, 1)), shape=(count,))
        # TorchRL adds the dimension of the worlds to these itself
        self.full_action_spec_unbatched = action
        self.full_observation_spec_unbatched = seen
        self.full_reward_spec_unbatched = reward
        self.full_done_spec_unbatched = done

    def _flag(self, *shape: int) -> Categorical:
        """Make the spec of bools."""
        return Categorical(2, shape=shape, dtype=torch.bool, device=self.device)

    def _number(self, *shape: int) -> Unbounded:
        """Make the spec of numbers; departed drones have zeros, whatever the bounds."""
        return Unbounded(shape=shape, dtype=torch.float32, device=self.device)

    def _observed(self, count: int) -> Any:
        """Make the spec of what so many drones observe."""
        space = self.batch.observation_space
        parts = getattr(space, "spaces", {"": space})
        specs = {
            name: Unbounded(
                shape=(count, *part.shape),
                dtype=torch.from_numpy(np.empty(0, part.dtype)).dtype,
                device=self.device,
            )
            for name, part in parts.items()
        }
        return specs.get("") or Composite(specs, shape=(count,))

    def _set_seed(self, seed: int | None) -> None:
        """Seed the worlds, each from its next reset on: world k has seed + k; None goes on."""
        self._seed = None if seed is None else as_int("seed", seed, 0)
        self._unseeded[:] = seed is not None

    def _reset(self, tensordict: TensorDictBase | None = None, **options: Any) -> TensorDictBase:
        """Start new episodes, in the worlds of "_reset" (W, 1) if it is there.

        Args:
            tensordict: What may have "_reset".
            **options: "start" and "goal", (N, 3) m each, for places instead of drawn ones.
        """
        asked = None if tensordict is None else tensordict.get("_reset", None)
        worlds = np.ones(self.num_worlds, dtype=bool)
        if asked is not None:
            worlds = asked.numpy(force=True).reshape(self.num_worlds)
        seeded = worlds & self._unseeded
        if seeded.any():
            self.batch.reset(seed=self._seed, options={MASK: seeded, **options})
        rest = {MASK: worlds & ~seeded, **options}
        observations, info = self.batch.reset(options=rest)
        # After it, as a start that cannot be leaves all as it was.
        self._unseeded &= ~worlds
        kept = ~worlds[:, None]
        self._terminated, self._truncated = self._terminated & kept, self._truncated & kept
        self._alive = self.batch.alive
        told = self._told(observations, info, self._alive)
        if kept.any():
            # Other worlds are as they were told, to the last bit.
            for name, array in told.items():
                mixed = self._last[name].copy()
                mixed[worlds] = array[worlds]
                told[name] = mixed
        return self._tensors(told)

    def _reset_proc_data(
        self, tensordict: TensorDictBase | None, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        """Take what a reset told as it is: all worlds are in it, those that fly on too."""
        if tensordict is None:
            return tensordict_reset
        tensordict.pop("_reset", None)
        return tensordict.update(tensordict_reset)

    @classmethod
    def _complete_done(cls, done_spec: Composite, data: TensorDictBase) -> TensorDictBase:
        """Take the ends as they are: none is left out."""
        return data

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Fly one decision of all worlds."""
        # Who flies at the start of the decision is told a reward for it
        flown = self._alive
        # Collectors hold worlds back by "_step"; a batch flies all or nothing
        asked = tensordict.get("_step", None)
        if asked is not None:
            held = ~asked.numpy(force=True).reshape(self.num_worlds)
            if flown[held].any():
                raise NotImplementedError(
                    f"'_step' is False in worlds that fly: all of the {self.num_worlds} worlds "
                    f"fly each decision, only those whose episode is over can be left out"
                )
        observations, rewards, terminated, truncated, info = self.batch.step(
            self._actions(tensordict)
        )
        # Ends stay until the reset: an episode goes on for the other drones
        self._terminated = self._terminated | terminated
        self._truncated = self._truncated | truncated
        self._alive = self.batch.alive
        # Observations after the step, and rewards in it, by group
        out = self._tensors(self._told(observations, info, flown))
        earned = rewards.astype(np.float32)[..., None]
        for group, rows in self._rows.items():
            out.get(group).set("reward", torch.from_numpy(earned[:, rows]))
        return out

    def _actions(self, tensordict: TensorDictBase) -> np.ndarray:
        """Take the actions of all groups: (W, N, A), or (W, N) choices."""
        for group, rows in self._rows.items():
            numbers = tensordict.get((group, "action")).numpy(force=True)
            if self._one_hot:
                numbers = numbers.argmax(-1)
            # In a mixed swarm a group may have fewer numbers than others.
            place = (slice(None), rows, *map(slice, numbers.shape[2:]))
            self._given[place] = numbers
        return self._given

    def _told(self, observations: Observation, info: dict[str, Any], flown: np.ndarray) -> Told:
        """Collect what is told of all worlds, zeros for drones that have not flown (W, N)."""
        told: Told = {("observation",): observations}
        if isinstance(observations, dict):
            told = {("observation", name): array for name, array in observations.items()}
        for name in self._infos:
            told["info", name] = choose("info", name, info).astype(np.float32)[..., None]
        if not flown.all():
            # In place: what a step told is nobody else's.
            for array in told.values():
                array[~flown] = 0
        if self._tells_state:
            told[STATE] = self.batch.state()
        return told

    def _tensors(self, told: Told) -> TensorDict:
        """Make tensors of what is told, and of what has become of the drones."""
        self._last = told
        over: np.ndarray = ~np.any(self._alive, axis=1)
        terminated: np.ndarray = np.all(self._terminated, axis=1)
        whole = (over, terminated, over & ~terminated)
        # Copies, as tensors are for their owner to write into.
        ends = (~self._alive, self._terminated.copy(), self._truncated.copy())
        source: dict[str, Any] = {
            name: torch.from_numpy(array[:, None]) for name, array in zip(ENDS, whole, strict=True)
        }
        of_drones = dict(told)
        if self._tells_state:
            source["state"] = torch.from_numpy(of_drones.pop(STATE))
        of_drones |= {(name,): array[..., None] for name, array in zip(ENDS, ends, strict=True)}
        of_drones["mask",] = self._alive.copy()
        for group, rows in self._rows.items():
            own = {key: torch.from_numpy(array[:, rows]) for key, array in of_drones.items()}
            drones = (self.num_worlds, len(self.group_map[group]))
            source[group] = TensorDict(own, batch_size=drones, device=self.device)
        return TensorDict(source, batch_size=self.batch_size, device=self.device)

    def render(self, world: int = 0) -> np.ndarray | None:
        """Take a picture of one world; see `BatchAviary.render`."""
        return self.batch.render(world)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free the engine; a second call does nothing."""
        super().close(raise_if_closed=raise_if_closed)
        self.batch.close()

    def __repr__(self) -> str:
        """Tell what flies."""
        return f"{type(self).__name__}({shown(self.made_from[0][0])}, {self.num_worlds} worlds)"


def _groups(given: Any, spec: EnvSpec) -> dict[str, list[str]]:
    """Make the map of groups: teams where none is given.

    Raises:
        ValueError: A drone is in none or in two of them, or there is none of that name.
    """
    if given is None:
        teams = team_rows(spec.task)
        return {team: [f"drone_{i}" for i in rows] for team, rows in teams.items()}
    agents = [f"drone_{i}" for i in range(spec.options.num_drones)]
    if isinstance(given, str):
        given = choose("group_map", given, MarlGroupMapType.__members__)
    if isinstance(given, MarlGroupMapType):
        given = given.get_group_map(agents)
    groups = {name: list(own) for name, own in given.items()}
    check_marl_grouping(groups, agents)
    return groups


def _index(rows: list[int]) -> Any:
    """Make an index of drones: a slice where they stand side by side, which copies nothing."""
    side_by_side = rows == list(range(rows[0], rows[-1] + 1))
    return slice(rows[0], rows[-1] + 1) if side_by_side else np.array(rows)


def _action_spec(action: Action, rows: list[int], one_hot: bool) -> Any:
    """Make the spec of the actions of some drones.

    In a mixed swarm all have as many numbers as the widest of them; others ignore the last ones.
    """
    count = len(rows)
    if action.choices is not None:
        if one_hot:
            return OneHot(action.choices, shape=(count, action.choices))
        return Categorical(action.choices, shape=(count,))
    sizes = [action.size(i) for i in rows]
    used = np.arange(max(sizes)) < np.array(sizes)[:, None]
    # Bounds apart, as policies divide by their difference.
    low = np.where(used, action.low[rows, : max(sizes)], -1.0).astype(np.float32)
    high = np.where(used, action.high[rows, : max(sizes)], 1.0).astype(np.float32)
    return Bounded(torch.from_numpy(low), torch.from_numpy(high), low.shape, dtype=torch.float32)
