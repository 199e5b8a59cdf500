"""Environment for TorchRL: W worlds in one batch, with a group of agents for each team.

Tensors are made from the arrays of the batched environment, so that one call steps all worlds:

    env = DroneTensorEnv("crossing", num_worlds=64, dynamics="point_mass")
    flight = env.rollout(100, break_when_any_done=False)
    flight["next", "drones", "reward"]  # (64, 100, 8, 1)

A drone whose episode has ended is absent until its whole world is reset. Meanwhile its "mask" is
False, its observation and reward are zero, its "done" stays True, and its actions are ignored.
"""

import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bulletuav.control.actions import Action
from bulletuav.envs.action_masks import ACTION_MASK
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import Environment
from bulletuav.envs.reset_options import MASK
from bulletuav.envs.teams import team_rows
from bulletuav.envs.workers import batch_env
from bulletuav.errors import as_int, as_sequence, find_choice, missing_extra, shown
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation

try:
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Bounded, Categorical, Composite, OneHot, Unbounded
    from torchrl.envs import EnvBase
    from torchrl.envs.utils import MarlGroupMapType, check_marl_grouping
except ImportError:
    raise missing_extra("an environment of TorchRL", "torchrl") from None


ENDS = ("done", "terminated", "truncated")
"""Entries of ends of episodes, for each drone and for the whole world"""
PROCESSES = ("workers", "start_method", "timeout")
"""Options of `batch_env` that are not options of the environment"""


PRESET_KEYS = frozenset({"next", "_step"})
"""Entries that change a step of TorchRL"""
GroupArrays = dict[str, Any]
"""Arrays (W, N, ...) of drones by their key in a group, or dicts of such arrays"""


class DroneTensorEnv(Environment, EnvBase):  # type: ignore[misc]  # has no types
    """W worlds of N drones as a batched `torchrl.envs.EnvBase`.

    Each team is a group; a task without teams has one group "drones". A group of n drones has:

    - (group, "action"): (W, n, A), or (W, n) discrete, or one-hot without `categorical_actions`.
    - (group, "observation"): (W, n, D), or nested entries by name.
    - (group, "mask"): (W, n) bool, True for active drones.
    - (group, "action_mask"): (W, n, C) bool, valid actions, with the option `action_masks`; random
      actions of the environment respect it.
    - (group, "reward"): (W, n, 1).
    - (group, "done"), (group, "terminated"), (group, "truncated"): (W, n, 1) bool; unchanged once
      the drone has left.
    - (group, "info", name): (W, n, 1), for each name in `infos`.

    "done", "terminated" and "truncated" (W, 1) are those of whole worlds. A world is done when no
    drone is active; terminated if the task ended all episodes, else truncated. "state" (W, K) is
    the global state.

    Attributes:
        batch: The batched environment, with labels, images and snapshots.
        num_worlds: Number of worlds W.
        n_agents: Number of drones N, under the name that TorchRL's tutorials use.
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
            task: One of `list_tasks()`, `module:Name`, or a task class.
            num_worlds: Number of worlds that are stepped in one batch.
            device: Device of the tensors; the simulation runs on the CPU.
            group_map: Agents by the name of their group, or one of TorchRL's `MarlGroupMapType` (or
                its name, "ALL_IN_ONE_GROUP"); by default each team is a group.
            categorical_actions: If True, discrete actions are indices, else one-hot vectors.
            return_state: If True, steps contain the global "state".
            infos: Names of the infos that steps contain.
            **options: Options of `batch_env`, such as `workers`, and of `parallel_env`.

        Raises:
            ValueError: If an option is invalid.
        """
        own = {name: value for name, value in options.items() if name not in PROCESSES}
        spec = EnvSpec(task, num_worlds, own)
        self._infos = as_sequence("infos", infos)
        self.group_map = _groups(group_map, spec)
        super().__init__(device=device, batch_size=(num_worlds,))
        options["autoreset_mode"] = "Disabled"
        self.batch = batch_env(task, num_worlds, **options)
        self.is_closed = False
        self.num_worlds, self._has_state = num_worlds, return_state
        self.n_agents = spec.options.num_drones
        rows = {group: [int(one[6:]) for one in own] for group, own in self.group_map.items()}
        self._rows = {group: _index(own) for group, own in rows.items()}
        drones, width = spec.action.low.shape
        chooses = spec.action.choices is not None
        self._has_masks = spec.options.action_masks
        self._one_hot = chooses and not categorical_actions
        self._given = np.zeros((num_worlds, drones) if chooses else (num_worlds, drones, width))
        # Ends of the episodes, and the worlds still to be seeded
        self._alive, self._terminated, self._truncated = np.zeros((3, num_worlds, drones), bool)
        self._seed: int | None = None
        self._unseeded = np.zeros(num_worlds, dtype=bool)
        # Numbers that the drones of each group observe, if these differ
        kinds, of = spec.observer.kinds, spec.observer.of
        self._widths = {
            group: max(len(of(i).labels) for i in own) if len(kinds) > 1 else None
            for group, own in rows.items()
        }
        self._make_specs(spec, rows)
        if not chooses:
            # Not a method: TorchRL rejects transforms of actions if a class overrides `rand_action`
            self.rand_action = _make_sampler(self)
        # Arrays of the last step or reset, which resets of some worlds keep for the others
        self._last: GroupArrays = {}
        self._ends = np.empty((4, num_worlds, drones, 1), bool)
        self._world_ends = np.empty((3, num_worlds, 1), bool)
        self._write_ends()

    def _make_specs(self, spec: EnvSpec, groups: dict[str, list[int]]) -> None:
        """Set the specs: shape and type of each entry."""
        # First the entries of the whole world, then those of each group
        action, seen, reward, done = (Composite(device=self.device) for _ in range(4))
        # "done" of the world is that of all drones; groups have their own entries, too
        done.update(dict.fromkeys(ENDS, self._flag(1)))
        if self._has_state:
            seen["state"] = self._number(len(spec.state.labels))
        # The shape of a spec has no axis of worlds
        for group, rows in groups.items():
            count = len(rows)
            chosen = _action_spec(spec.action, rows, self._one_hot).to(self.device)
            width = self._widths[group]
            entries = {"observation": self._observed(count, width), "mask": self._flag(count)}
            if self._has_masks:
                entries[ACTION_MASK] = self._flag(count, int(spec.action.choices or 0))
            if self._infos:
                arrays = dict.fromkeys(self._infos, self._number(count, 1))
                entries["info"] = Composite(arrays, shape=(count,))
            action[group] = Composite({"action": chosen}, shape=(count,))
            seen[group] = Composite(entries, shape=(count,))
            reward[group] = Composite({"reward": self._number(count, 1)}, shape=(count,))
            done[group] = Composite(dict.fromkeys(ENDS, self._flag(count, 1)), shape=(count,))
        # TorchRL adds the axis of worlds to these specs
        self.full_action_spec_unbatched = action
        self.full_observation_spec_unbatched = seen
        self.full_reward_spec_unbatched = reward
        self.full_done_spec_unbatched = done

    def _flag(self, *shape: int) -> Categorical:
        """Return a spec of bools."""
        return Categorical(2, shape=shape, dtype=torch.bool, device=self.device)

    def _number(self, *shape: int) -> Unbounded:
        """Return an unbounded spec of floats: drones that have left have zeros."""
        return Unbounded(shape=shape, dtype=torch.float32, device=self.device)

    def _observed(self, count: int, width: int | None) -> Any:
        """Return the spec of the observations of `count` drones, of `width` numbers if given."""
        space = self.batch.observation_space
        if width is not None:
            return self._number(count, width)
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
        """Seed world k with seed + k at its next reset; None continues the random sequences."""
        self._seed = None if seed is None else as_int("seed", seed, 0)
        self._unseeded[:] = seed is not None

    def _reset(self, tensordict: TensorDictBase | None = None, **options: Any) -> TensorDictBase:
        """Start new episodes, in the worlds of the mask "_reset" (W, 1) if there is one.

        Args:
            tensordict: Data that may have "_reset".
            **options: Any of "start", "goal", "velocity", "quaternion", "rates" and "charge", which
                are set instead of drawn; see `Aviary.reset`.
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
        # After the reset, as an invalid start raises and leaves the state unchanged
        self._unseeded &= ~worlds
        kept = ~worlds[:, None]
        self._terminated, self._truncated = self._terminated & kept, self._truncated & kept
        self._alive = self.batch.alive
        # Absent drones have ended
        self._terminated |= worlds[:, None] & ~self._alive
        arrays = self._collect_arrays(observations, info, self._alive)
        if not worlds.all():
            _restore_worlds(arrays, self._last, ~worlds)
        self._last = arrays
        self._write_ends()
        return self._make_tensors(arrays)

    def _reset_proc_data(
        self, tensordict: TensorDictBase | None, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        """Return the data of a reset, which has the current values of all worlds."""
        if tensordict is None:
            return tensordict_reset
        tensordict.pop("_reset", None)
        return tensordict.update(tensordict_reset)

    def _step_proc_data(self, next_tensordict_out: TensorDictBase) -> TensorDictBase:
        """Return the data of a step, whose shapes are those of the specs, unchanged."""
        if self.run_type_checks:
            super()._step_proc_data(next_tensordict_out)
        return next_tensordict_out

    @classmethod
    def _complete_done(cls, done_spec: Composite, data: TensorDictBase) -> TensorDictBase:
        """Return the data unchanged: it has all entries of ends."""
        return data

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Step all worlds by one decision."""
        # Drones that are active at the start of the decision receive a reward for it
        flown = self._alive
        # Collectors can skip worlds by "_step"; here only worlds whose episode is over
        asked = tensordict.get("_step", None)
        if asked is not None:
            held = ~asked.numpy(force=True).reshape(self.num_worlds)
            if flown[held].any():
                raise NotImplementedError(
                    f"'_step' is False in active worlds: all of the {self.num_worlds} worlds "
                    f"are stepped together, only those whose episode is over can be left out"
                )
        observations, rewards, terminated, truncated, info = self.batch.step(
            self._actions(tensordict)
        )
        self._last = self._collect_arrays(observations, info, flown)
        if terminated.any() or truncated.any():
            # Ends persist until the reset, while the episodes of other drones continue
            self._terminated = self._terminated | terminated
            self._truncated = self._truncated | truncated
            self._alive = self.batch.alive
            self._write_ends()
        return self._make_tensors({**self._last, "reward": _to_float_column(rewards)})

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """Step all worlds, and reset those that are done; see `EnvBase.step_and_maybe_reset`.

        The data of the next decision are made from those of the step without searches by key.
        """
        if not self._is_plain(tensordict):
            usual: tuple[TensorDictBase, TensorDictBase] = super().step_and_maybe_reset(tensordict)
            return usual
        entries = _shallow_copy(tensordict)
        stepped = self._step(tensordict)
        tensordict.set("next", stepped)
        for key, one in stepped.items():
            if key in self._rows:
                # Other entries of the caller, such as actions, stay
                own = {**dict(entries[key].items()), **_shallow_copy(one)}
                del own["reward"]
                one = TensorDict._new_unsafe(own, batch_size=one.batch_size, device=self.device)
            entries[key] = one
        data = TensorDict._new_unsafe(entries, batch_size=self.batch_size, device=self.device)
        return tensordict, self.maybe_reset(data)

    def _is_plain(self, tensordict: TensorDictBase) -> bool:
        """Return True if TorchRL's own step would neither check nor change more than `_step`."""
        return (
            type(tensordict) is TensorDict
            and tensordict.batch_size == self.batch_size
            and tensordict.device == self.device
            and not any(tensordict.names)
            and PRESET_KEYS.isdisjoint(tensordict.keys())
            and not self.run_type_checks
            # torchrl 0.11 has no such attribute
            and getattr(self, "_post_step_mdp_hooks", None) is None
            and "_compiled_step_and_maybe_reset" not in self.__dict__
        )

    def _actions(self, tensordict: TensorDictBase) -> np.ndarray:
        """Collect the actions of all groups: (W, N, A), or (W, N) discrete."""
        for group, rows in self._rows.items():
            numbers = tensordict.get((group, "action")).numpy(force=True)
            if self._one_hot:
                numbers = numbers.argmax(-1)
            # In a heterogeneous swarm, a group may have smaller actions than others
            place = (slice(None), rows, *map(slice, numbers.shape[2:]))
            self._given[place] = numbers
        return self._given

    def _collect_arrays(
        self, observations: Observation, info: dict[str, Any], flown: np.ndarray
    ) -> GroupArrays:
        """Collect the arrays of all worlds, with zeros for drones not in `flown` (W, N)."""
        arrays: GroupArrays = {"observation": observations}
        if self._infos:
            arrays["info"] = {
                name: _to_float_column(find_choice("info", name, info)) for name in self._infos
            }
        if not flown.all():
            # In place: no other code uses these arrays
            _clear_drones(arrays, ~flown)
        if self._has_masks:
            arrays[ACTION_MASK] = info[ACTION_MASK].astype(bool)
        return arrays

    def _write_ends(self) -> None:
        """Write the ends of drones and worlds, as ordered in `ENDS`, and the active drones."""
        over: np.ndarray = ~np.any(self._alive, axis=1)
        terminated: np.ndarray = np.all(self._terminated, axis=1)
        self._world_ends[..., 0] = over, terminated, over & ~terminated
        self._ends[..., 0] = ~self._alive, self._terminated, self._truncated, self._alive

    def _make_tensors(self, arrays: GroupArrays) -> TensorDictBase:
        """Return new tensors of arrays and ends, which belong to the caller."""
        entries = dict(zip(ENDS, torch.from_numpy(self._world_ends.copy()).unbind(0), strict=True))
        if self._has_state:
            entries["state"] = torch.from_numpy(self.batch.state())
        for group, rows in self._rows.items():
            own = _copy_rows(arrays, rows)
            # One copy of all ends takes less time than four
            *ends, active = torch.from_numpy(self._ends[:, :, rows].copy()).unbind(0)
            own.update(zip(ENDS, ends, strict=True), mask=active.squeeze(-1))
            if self._widths[group] is not None:
                # A group may observe fewer numbers than others
                own["observation"] = own["observation"][..., : self._widths[group]].contiguous()
            size = torch.Size((self.num_worlds, len(self.group_map[group])))
            # Without checks of shapes and types, which take longer than the copies
            entries[group] = TensorDict._new_unsafe(own, batch_size=size)
        data = TensorDict._new_unsafe(entries, batch_size=self.batch_size)
        if self.device is not None:
            data = data.to(self.device)
        if self._has_masks:
            for group in self._rows:
                valid = data.get((group, ACTION_MASK)).clone()
                self.full_action_spec[group, "action"].update_mask(valid)
        return data

    def render(self, world: int = 0) -> np.ndarray | None:
        """Render an image of one world; see `BatchAviary.render`."""
        return self.batch.render(world)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Disconnect from the physics engine; further calls do nothing."""
        super().close(raise_if_closed=raise_if_closed)
        self.batch.close()

    def __repr__(self) -> str:
        """Return a description with the task and the number of worlds."""
        return f"{type(self).__name__}({shown(self.made_from[0][0])}, {self.num_worlds} worlds)"


def _groups(given: Any, spec: EnvSpec) -> dict[str, list[str]]:
    """Return the agents of each group, by default one group for each team.

    Raises:
        ValueError: If a drone is in no group or in two groups, or an agent is unknown.
    """
    if given is None:
        teams = team_rows(spec.task)
        return {team: [f"drone_{i}" for i in rows] for team, rows in teams.items()}
    agents = [f"drone_{i}" for i in range(spec.options.num_drones)]
    if isinstance(given, str):
        given = find_choice("group_map", given, MarlGroupMapType.__members__)
    if isinstance(given, MarlGroupMapType):
        given = given.get_group_map(agents)
    groups = {name: list(own) for name, own in given.items()}
    check_marl_grouping(groups, agents)
    return groups


def _index(rows: list[int]) -> Any:
    """Return an index of drones: a slice, which avoids copies, if they are consecutive."""
    side_by_side = rows == list(range(rows[0], rows[-1] + 1))
    return slice(rows[0], rows[-1] + 1) if side_by_side else np.array(rows)


def _make_sampler(env: EnvBase) -> Callable[..., TensorDictBase]:
    """Return a function that sets random actions, equal to those of the spec in less time.

    Once the action spec or the device has changed, it calls `EnvBase.rand_action`.
    """
    spec, device = env.full_action_spec, env.device
    bounds = _list_bounds(spec)
    spaces = {group: own["action"].space for group, own in spec.items()}
    low = torch.cat([one.low.flatten() for one in spaces.values()])
    high = torch.cat([one.high.flatten() for one in spaces.values()])
    span = high - low
    shapes = {group: one.low.shape for group, one in spaces.items()}
    sizes = [one.low.numel() for one in spaces.values()]
    empty = spec.zero()

    def rand_action(tensordict: TensorDictBase | None = None) -> TensorDictBase:
        is_same = env.full_action_spec is spec and env.device == device
        if not is_same or not all(map(operator.is_, _list_bounds(spec), bounds)):
            return EnvBase.rand_action(env, tensordict)
        drawn: Any = torch.rand_like(low).mul_(span).add_(low)
        # Rounding may leave the bounds
        torch.clamp(drawn, low, high, out=drawn)
        data = empty.copy() if tensordict is None else tensordict
        for (group, shape), own in zip(shapes.items(), drawn.split(sizes), strict=True):
            data.set((group, "action"), own.view(shape))
        return data

    return rand_action


def _list_bounds(spec: Composite) -> list[Any]:
    """Return the objects that define the bounds of actions; a change replaces some."""
    return [one for own in spec.values() for one in vars(own["action"].space).values()]


def _shallow_copy(data: TensorDictBase) -> dict[str, Any]:
    """Return the entries of data, with copies of nested data that share their tensors."""
    return {key: one if isinstance(one, torch.Tensor) else one.copy() for key, one in data.items()}


def _to_float_column(array: np.ndarray) -> np.ndarray:
    """Return numbers (W, N) as float32 (W, N, 1)."""
    return array.astype(np.float32)[..., None]


def _copy_rows(arrays: GroupArrays, rows: Any) -> dict[str, Any]:
    """Return tensors that are copies of some drones' rows of arrays (W, N, ...)."""
    return {
        key: _copy_rows(one, rows)
        if isinstance(one, dict)
        else torch.from_numpy(one[:, rows].copy())
        for key, one in arrays.items()
    }


def _clear_drones(arrays: GroupArrays, drones: np.ndarray) -> None:
    """Set the values of drones (W, N) bool to zero."""
    for one in arrays.values():
        if isinstance(one, dict):
            _clear_drones(one, drones)
        else:
            one[drones] = 0


def _restore_worlds(arrays: GroupArrays, last: GroupArrays, worlds: np.ndarray) -> None:
    """Set the values of worlds (W,) bool to the last ones, which are zeros if there are none."""
    for key, one in arrays.items():
        if isinstance(one, dict):
            _restore_worlds(one, last.get(key, {}), worlds)
        else:
            one[worlds] = last[key][worlds] if key in last else 0


def _action_spec(action: Action, rows: list[int], one_hot: bool) -> Any:
    """Return the spec of the actions of some drones.

    In a heterogeneous swarm all actions have the size of the largest; drones ignore excess numbers.
    """
    count = len(rows)
    if action.choices is not None:
        if one_hot:
            return OneHot(action.choices, shape=(count, action.choices))
        return Categorical(action.choices, shape=(count,))
    sizes = [action.size(i) for i in rows]
    used = np.arange(max(sizes)) < np.array(sizes)[:, None]
    # Unused numbers get distinct bounds, as policies divide by their difference
    low = np.where(used, action.low[rows, : max(sizes)], -1.0).astype(np.float32)
    high = np.where(used, action.high[rows, : max(sizes)], 1.0).astype(np.float32)
    return Bounded(torch.from_numpy(low), torch.from_numpy(high), low.shape, dtype=torch.float32)
