"""Learner `fast_ppo`: PPO of one policy for all drones, without PyTorch.

Weights have the same bits on any x86-64, as kernels sum in a fixed order. The files of a run are
those of the algorithm `ppo` of stable-baselines3, without TensorBoard.
"""

import contextlib
import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from gymnasium.spaces import Box, Discrete
from safetensors import SafetensorError, safe_open

from bulletuav.adapters.slots import DroneSlots, Info
from bulletuav.errors import require_available_memory
from bulletuav.parsing import parse_json
from bulletuav.policies.neural_network import HIGH, LOW, read_weights, write_weights
from bulletuav.policies.run import FAST, POLICY, RunConfig
from bulletuav.policies.swarm_features import ObservationLayout, find_layout
from bulletuav.training.fast.dense import BLOCK, count_parameters, draw_orthogonal
from bulletuav.training.fast.ppo import (
    Networks,
    Rollout,
    Work,
    compute_advantages,
    run_networks,
    sample_actions,
    sample_choices,
    update_networks,
)
from bulletuav.training.fast.sets import (
    Sets,
    count_encoded,
    count_features,
    encode,
    make_sets,
    make_sets_work,
)
from bulletuav.training.fast.settings import REMEDY, FastSettings, check_fast_settings
from bulletuav.training.segments import Note, Progress, learn_in_segments, make_slots
from bulletuav.training.store import TRAINING, Store
from bulletuav.training.trackers import Log

EXTRACTORS = ("features_extractor", "pi_features_extractor", "vf_features_extractor")
"""Names under which stable-baselines3 stores the features that actor and critic share"""
LAST_FEATURE = 0.02
"""Bound of the initial weights of the last layer of entities, so that own numbers come first"""
STATISTICS = (
    "policy_gradient_loss",
    "value_loss",
    "entropy_loss",
    "clip_fraction",
    "approx_kl",
)
"""Names of the statistics of an update, those of stable-baselines3 after "train/" """


def learn_fast(config: RunConfig, store: Store, progress: Progress, note: Note, log: Log) -> None:
    """Train until all steps are done.

    Args:
        config: Settings of the run.
        store: Storage of the run; if it has rows, the last checkpoint is restored.
        progress: Called with the number of finished steps.
        note: Called with a text when episodes end.
        log: Called with the statistics of updates, and with the rows of the curve.

    Raises:
        ValueError: If a setting is invalid, or needs stable-baselines3.
    """
    with contextlib.closing(make_slots(config, DroneSlots)) as env:
        learn_in_segments(config, env, FastPPO(config, env), store, progress, note, log)


class FastPPO:
    """Actor and critic that all drones share, and their training state.

    Attributes:
        num_steps: Number of finished steps of all slots.
        parameters: (P,) float32, parameters of all networks.
        networks: Layout of the networks in `parameters`.
    """

    def __init__(self, config: RunConfig, env: DroneSlots) -> None:
        """Draw initial weights from the seed of the run.

        Args:
            config: Settings of the run.
            env: The training environment.

        Raises:
            ValueError: If a setting is invalid, or needs stable-baselines3.
        """
        own = self._settings = check_fast_settings(config)
        self._env = env
        self._total = config.steps
        observed, acted = env.observation_space, env.action_space
        if not isinstance(observed, Box) or len(observed.shape) != 1:
            raise ValueError(f"{FAST} learns from vectors, not from pictures: {REMEDY}")
        choices = int(acted.n) if isinstance(acted, Discrete) else 0
        # Choices have neither bounds nor standard deviations
        self._bounds = (acted.low, acted.high) if isinstance(acted, Box) else None
        self._has_masks = config.action_masks
        columns = tuple(range(observed.shape[0]))
        layout = (
            find_layout(env.labels) if own.features == "swarm" else ObservationLayout(columns, {})
        )
        self._words = list(layout.kinds)
        try:
            size = env.state_size if own.is_central else 0
        except ValueError as error:
            raise ValueError(f"critic is 'state': {error}; or choose critic=own") from None
        # States are compressed as own numbers of scale 1
        self._state_sets = make_sets(ObservationLayout(tuple(range(size)), {}), 1, 1.0)
        env.has_terminal_states = own.is_central
        outputs = choices if self._bounds is None else len(self._bounds[0])
        sets = make_sets(layout, own.size, own.scale)
        self.networks = _arrange(own, sets, outputs, choices, size)
        self.num_steps = 0
        self._num_updates = 0
        self._statistics = dict.fromkeys(STATISTICS, math.nan)
        # Arrays of a rollout
        shape = own.n_steps, env.num_envs
        row = count_encoded(sets) + outputs + 6 + size / env.num_drones
        require_available_memory(
            f"rollouts of n_steps {own.n_steps} in {env.num_envs} slots (worlds times drones)",
            int(math.prod(shape) * row * 4),
            "lower n_steps or worlds",
        )
        self._rollout = Rollout(
            _zeros(shape[0] + 1, shape[1], count_encoded(sets)),
            _zeros(shape[0] + 1, env.num_worlds, size),
            _zeros(*shape, 1 if choices else outputs),
            np.zeros((*shape, choices * self._has_masks), bool),
            _zeros(*shape),
            _zeros(shape[0] + 1, shape[1]),
            *(_zeros(*shape) for _ in range(4)),
        )
        self._work = _make_work(self.networks)
        self._outputs = _zeros(env.num_envs, outputs)
        count = self.networks.critic_start + count_parameters(self.networks.critic)
        count += 0 if choices else outputs
        self.parameters, self._gradient = _zeros(count), _zeros(count)
        self._moments = _zeros(2, len(self.parameters))
        self._rng = np.random.default_rng(config.seed)
        self._draw_weights()
        self._seen: np.ndarray = np.empty(0)

    def _draw_weights(self) -> None:
        """Draw initial weights, distributed as those of stable-baselines3."""
        rng, own = self._rng, self.named_weights()
        for name, array in own.items():
            if name == "log_std":
                array[:] = self._settings.log_std
            elif name.startswith("features_extractor") and array.ndim == 2:
                # As PyTorch's, with small outputs; see `SwarmFeatures.reset_parameters`
                is_last = name.endswith(".2.weight")
                bound = LAST_FEATURE if is_last else 1.0 / math.sqrt(array.shape[1])
                array[:] = rng.uniform(-bound, bound, array.shape)
                if not is_last:
                    bias = own[name.replace("weight", "bias")]
                    bias[:] = rng.uniform(-bound, bound, bias.shape)
            elif array.ndim == 2:
                gain = {"action_net.weight": 0.01, "value_net.weight": 1.0}.get(name, math.sqrt(2))
                outputs, inputs = array.shape
                array[:] = draw_orthogonal(rng, outputs, inputs, gain)

    def named_weights(self) -> dict[str, np.ndarray]:
        """Return views of the parameters by the names of stable-baselines3's `state_dict`."""
        networks = self.networks
        found: dict[str, np.ndarray] = {}
        for word, start, widths in zip(
            self._words, networks.set_starts, networks.set_widths, strict=True
        ):
            names = [f"{EXTRACTORS[0]}.each.{word}.{k}" for k in (0, 2)]
            found |= self._layers(int(start), widths, names)
        for kind, last, start, widths in (
            ("policy", "action_net", networks.actor_start, networks.actor),
            ("value", "value_net", networks.critic_start, networks.critic),
        ):
            hidden = [f"mlp_extractor.{kind}_net.{2 * k}" for k in range(len(widths) - 2)]
            found |= self._layers(start, widths, [*hidden, last])
        if self._bounds is not None:
            found["log_std"] = self.parameters[len(self.parameters) - len(self._bounds[0]) :]
        return found

    def _layers(self, start: int, widths: np.ndarray, names: list[str]) -> dict[str, np.ndarray]:
        """Return views of the weights and biases of a network by name."""
        found = {}
        for name, (inputs, outputs) in zip(names, itertools.pairwise(widths.tolist()), strict=True):
            end = start + inputs * outputs
            found[f"{name}.weight"] = self.parameters[start:end].reshape(outputs, inputs)
            found[f"{name}.bias"] = self.parameters[end : end + outputs]
            start = end + outputs
        return found

    def begin_segment(self, seed: int) -> None:
        """Reset the environment, and seed all random numbers."""
        self._rng = np.random.default_rng(seed)
        self._env.seed(seed)
        self._seen = self._env.reset()

    def collect(self, report: Callable[[list[Info]], None] = lambda infos: None) -> None:
        """Fill the rollout with the following decisions of all slots.

        Args:
            report: Called with the infos of the slots after each decision.
        """
        env, rollout = self._env, self._rollout
        for t in range(self._settings.n_steps):
            self._observe(t)
            self._run(rollout.encoded[t], rollout.states[t], self._outputs, rollout.values[t])
            env.step_async(self._act(t))
            self._seen, rollout.rewards[t], rollout.done[t], infos = env.step_wait()
            self._add_cut_values(t, infos)
            self.num_steps += env.num_envs
            report(infos)
        self._observe(-1)
        self._run(rollout.encoded[-1], rollout.states[-1], self._outputs, rollout.values[-1])

    def _observe(self, t: int) -> None:
        """Write the present observations and states to row t of the rollout."""
        encode(self._seen, self.networks.sets, self._rollout.encoded[t])
        if self._settings.is_central:
            encode(self._env.state(), self._state_sets, self._rollout.states[t])

    def _run(
        self, encoded: np.ndarray, states: np.ndarray, outputs: np.ndarray, values: np.ndarray
    ) -> None:
        run_networks(self.parameters, self.networks, self._work, encoded, states, outputs, values)

    def _act(self, t: int) -> np.ndarray:
        """Draw actions from the outputs of the actor, and return those to take."""
        rollout, rng, outputs = self._rollout, self._rng, self._outputs
        actions, log_densities = rollout.actions[t], rollout.log_densities[t]
        if self._bounds is None:
            uniform = rng.random(len(outputs), dtype=np.float32)
            if self._has_masks:
                rollout.masks[t] = self._env.action_masks()
            sample_choices(uniform, outputs, rollout.masks[t], actions, log_densities)
            return np.asarray(actions)
        actions[:] = outputs
        noise = rng.standard_normal(actions.shape, dtype=np.float32)
        sample_actions(self.parameters, noise, actions, log_densities)
        return np.asarray(np.clip(actions, *self._bounds))

    def _add_cut_values(self, t: int, infos: list[Info]) -> None:
        """Add the discounted values of the last observations of episodes that were truncated."""
        cut = [k for k, info in enumerate(infos) if info.get("TimeLimit.truncated", False)]
        if not cut:
            return
        rows = np.stack([infos[k]["terminal_observation"] for k in cut]).astype(np.float32)
        encoded, values = _zeros(len(cut), self._rollout.encoded.shape[2]), _zeros(len(cut))
        encode(rows, self.networks.sets, encoded)
        states = _zeros(len(cut), self._rollout.states.shape[2])
        if self._settings.is_central:
            given = np.stack([infos[k]["terminal_state"] for k in cut])
            encode(given, self._state_sets, states)
        self._run(encoded, states, np.empty_like(self._outputs[: len(cut)]), values)
        self._rollout.rewards[t, cut] += np.float32(self._settings.gamma) * values

    def update(self) -> None:
        """Update the networks on the rollout."""
        own, rollout = self._settings, self._rollout
        compute_advantages(rollout, own.gamma, own.gae_lambda)
        flown = np.flatnonzero(~np.isnan(rollout.rewards))
        if not len(flown):
            return
        batches = -(-len(flown) // own.batch_size)
        # Sizes of minibatches differ by at most one
        bounds = np.arange(batches + 1) * len(flown) // batches
        epochs = range(own.n_epochs)
        order = np.concatenate([self._rng.permutation(flown) for _ in epochs])
        ends = np.concatenate([[0], *(bounds[1:] + k * len(flown) for k in epochs)])
        first, last = own.learning_rate
        rate = first + (last - first) * min(self.num_steps / self._total, 1.0)
        found = np.zeros(len(STATISTICS))
        update_networks(
            self.parameters,
            self._gradient,
            self._moments,
            self.networks,
            self._work,
            rollout,
            order,
            ends,
            self._num_updates,
            rate,
            own.losses,
            found,
        )
        self._num_updates += len(ends) - 1
        means = (found / (len(ends) - 1)).tolist()
        self._statistics = dict(zip(STATISTICS, means, strict=True))

    def statistics(self) -> dict[str, float]:
        """Return the statistics of the last update by name."""
        named = {f"train/{name}": value for name, value in self._statistics.items()}
        if self._bounds is not None:
            named["train/std"] = float(np.exp(self.named_weights()["log_std"]).mean())
        return named

    def save(self, folder: Path) -> None:
        """Write a checkpoint.

        Args:
            folder: Folder for the policy and the training state.

        Raises:
            OSError: If a file cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        named = self.named_weights()
        shared = [name for name in named if name.startswith(EXTRACTORS[0])]
        for extractor in EXTRACTORS[1:]:
            named |= {name.replace(EXTRACTORS[0], extractor): named[name] for name in shared}
        arrays = {name: array.copy() for name, array in named.items()}
        if self._bounds is not None:
            arrays[LOW], arrays[HIGH] = self._bounds
        write_weights(arrays, folder / POLICY)
        counters = {"num_steps": self.num_steps, "num_updates": self._num_updates}
        state = {"parameters": self.parameters, "moments": self._moments}
        write_weights(state, folder / TRAINING, {"counters": json.dumps(counters)})

    def restore(self, folder: Path) -> None:
        """Restore a checkpoint.

        Args:
            folder: Folder of the checkpoint.

        Raises:
            ValueError: If the files are damaged, or belong to a learner of other settings.
        """
        try:
            state = read_weights(folder / TRAINING)
            with safe_open(folder / TRAINING, "numpy") as file:
                counters = parse_json(file.metadata()["counters"], "its metadata")
            for name, array in (("parameters", self.parameters), ("moments", self._moments)):
                if state[name].shape != array.shape:
                    raise ValueError(f"{name} have another size")
                array[:] = state[name]
            self.num_steps = int(counters["num_steps"])
            self._num_updates = int(counters["num_updates"])
        except (LookupError, TypeError, OSError, ValueError, SafetensorError) as error:
            raise ValueError(
                f"{folder} holds no checkpoint of this run ({error}): choose another folder"
            ) from None


def _zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


def _arrange(own: FastSettings, sets: Sets, outputs: int, choices: int, state: int) -> Networks:
    """Lay out the networks in the array of parameters: entities, actor, critic."""
    start, starts, widths = 0, [], []
    for kind in sets.kinds:
        each = np.array([kind[2] + len(sets.own), sets.size, sets.size])
        starts.append(start)
        widths.append(each)
        start += count_parameters(each)
    inputs = count_features(sets)
    actor = np.array([inputs, *own.actor, outputs])
    return Networks(
        sets,
        np.array(starts, dtype=np.int64),
        np.array(widths, dtype=np.int64).reshape(-1, 3),
        start,
        actor,
        start + count_parameters(actor),
        np.array([inputs + state, *own.critic, 1]),
        choices,
    )


def _make_work(networks: Networks) -> Work:
    """Allocate the work arrays of a learner."""
    actor, critic = networks.actor, networks.critic
    width = max(*actor, *critic)
    return Work(
        make_sets_work(networks.sets),
        _zeros(len(actor), max(actor), BLOCK),
        _zeros(len(actor), max(actor), BLOCK),
        _zeros(len(critic), max(critic), BLOCK),
        _zeros(len(critic), max(critic), BLOCK),
        _zeros(BLOCK, width),
        np.zeros(BLOCK, np.int64),
    )
