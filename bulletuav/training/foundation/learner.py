"""Learner `foundation`: one recurrent policy that flies any quadrotor.

Each rollout flies airframes that are drawn for it. The student commands rotors, and the regulator
of each airframe, which knows its constants, labels each observation with its own action. The
student learns these actions by supervised learning on whole episodes, and so infers the airframe
from the motion that follows its commands. Weights have the same bits on any x86-64.

References:
    S. Ross, G. J. Gordon, J. A. Bagnell, A reduction of imitation learning and structured
    prediction to no-regret online learning (2011); J. Eschmann, D. Albani, G. Loianno, RAPTOR: a
    foundation policy for quadrotor control (2025), whose teachers are learned policies.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.adapters.slots import DroneSlots, Info
from bulletuav.errors import require_available_memory
from bulletuav.policies.neural_network import HIGH, LOW, read_weights, write_weights
from bulletuav.policies.recurrent import LIMIT, NUM_INPUTS, NUM_ROTORS, SCALE
from bulletuav.policies.run import POLICY, RunConfig
from bulletuav.sensors.imu import MAX_BODY_RATE
from bulletuav.training.foundation.airframes import draw_airframe
from bulletuav.training.foundation.gru import (
    GruSizes,
    add_gru_gradient,
    count_gru,
    gru_arrays,
    make_changes,
    make_steps,
    run_gru,
    step_adam,
)
from bulletuav.training.foundation.settings import check_foundation_settings
from bulletuav.training.foundation.teacher import (
    REACH,
    command_teachers,
    teacher_gains,
)
from bulletuav.training.segments import Note, Progress, learn_in_segments, make_slots
from bulletuav.training.store import TRAINING, Store
from bulletuav.training.trackers import Log
from bulletuav.vehicle.airframe import Airframe

INPUT_LIMIT = (REACH,) * 3 + (5.0,) * 3 + (1.0,) * 3 + (20.0,) * 3 + (1.0,) * NUM_ROTORS
"""Largest magnitude of each input, m, m/s, 1, rad/s and 1; beyond, it looks the same"""
INPUT_SCALE = (2.0,) * 3 + (0.5,) * 3 + (2.0, 2.0, 1.0) + (0.2,) * 3 + (1.0,) * NUM_ROTORS
"""Factor on each input, so that usual values are close to 1"""
RATES = slice(9, 12)
"""Columns of the body rates in an observation"""
FIRST_DECODER = 0.1
"""Factor on the initial weights of the last layer"""
TAUGHT = 0.05
"""Fraction of a run in which teachers fly some drones, at first all, so that episodes are long"""


def learn_foundation(
    config: RunConfig, store: Store, progress: Progress, note: Note, log: Log
) -> None:
    """Train until all steps are done.

    Args:
        config: Settings of the run.
        store: Storage of the run; if it has rows, the last checkpoint is restored.
        progress: Called with the number of finished steps.
        note: Called with a text when episodes end.
        log: Called with the statistics of updates, and with the rows of the curve.

    Raises:
        ValueError: If a setting is invalid.
    """
    check_foundation_settings(config)
    with contextlib.closing(make_slots(config, AirframeSlots)) as env:
        learn_in_segments(config, env, Student(config, env), store, progress, note, log)


class AirframeSlots(DroneSlots):
    """Slots whose airframes can be replaced."""

    def replace_airframes(self, airframes: Sequence[Airframe], seed: int) -> Any:
        """Start new episodes with one drone of each airframe in each world.

        Args:
            airframes: The airframes.
            seed: World k gets seed + k.

        Returns:
            Observations (slots, D).
        """
        self.close()
        self._aviaries.clear()
        self._totals.clear()
        drones = {"airframe": list(airframes), "num_drones": len(airframes)}
        self._stage_options = [{**options, **drones} for options in self._stage_options]
        self.num_drones = len(airframes)
        self.num_envs = self.num_worlds * self.num_drones
        self.seed(seed)
        return self.reset()


class Student:
    """Recurrent network of all drones, and its training state.

    Attributes:
        num_steps: Number of finished steps of all slots.
        parameters: (P,) float32, parameters of the network.
        sizes: Widths of the network.
    """

    def __init__(self, config: RunConfig, env: AirframeSlots) -> None:
        """Draw initial weights from the seed of the run.

        Args:
            config: Settings of the run.
            env: The training environment.

        Raises:
            ValueError: If a setting is invalid.
        """
        own = self._settings = check_foundation_settings(config)
        self._env = env
        self._total = config.steps
        self._horizon = env.aviary.options.horizon
        self.sizes = GruSizes(NUM_INPUTS, own.hidden_size, NUM_ROTORS)
        self.num_steps = 0
        self._num_updates = 0
        self._loss = math.nan
        # Whole rollouts are kept
        flown = config.worlds * own.airframes
        size = -(-own.buffer_size // flown) * flown
        require_available_memory(
            f"{size} episodes of {self._horizon} decisions",
            size * self._horizon * (NUM_INPUTS + NUM_ROTORS) * 4,
            "lower buffer_size, airframes or worlds",
        )
        self._rows = np.zeros((size, self._horizon, NUM_INPUTS), np.float32)
        self._labels = np.zeros((size, self._horizon, NUM_ROTORS), np.float32)
        self._lengths = np.zeros(size, np.int64)
        self._filled = self._next = 0
        self._limit, self._scale = (
            np.array(values, np.float32) for values in (INPUT_LIMIT, INPUT_SCALE)
        )
        self._step = make_steps(self.sizes, 1)
        self._steps = make_steps(self.sizes, self._horizon)
        self._changes = make_changes(self.sizes)
        count = count_gru(self.sizes)
        self.parameters, self._gradient = np.zeros((2, count), np.float32)
        self._moments = np.zeros((2, count), np.float32)
        self._rng = np.random.default_rng(config.seed)
        self._draw_weights()

    def _draw_weights(self) -> None:
        """Draw initial weights, distributed as those of PyTorch; biases are zero."""
        for name, array in gru_arrays(self.parameters, self.sizes).items():
            if array.ndim == 2:
                bound = 1.0 / math.sqrt(array.shape[1])
                bound *= FIRST_DECODER if name.startswith("decoder") else 1.0
                array[:] = self._rng.uniform(-bound, bound, array.shape)

    def begin_segment(self, seed: int) -> None:
        """Seed all random numbers, and forget earlier episodes, which checkpoints do not hold."""
        self._rng = np.random.default_rng(seed)
        self._filled = self._next = 0

    def collect(self, report: Callable[[list[Info]], None] = lambda infos: None) -> None:
        """Fly one episode of newly drawn airframes in each world, and store it.

        Args:
            report: Called with the infos of the slots after each decision.
        """
        env, own = self._env, self._settings
        airframes = [draw_airframe(self._rng) for _ in range(own.airframes)]
        hertz = env.aviary.options.decision_hz
        gains = np.array([teacher_gains(one, hertz) for one in airframes])
        most = np.array([one.max_rotor_speed for one in airframes])
        hover = np.square([one.hover_speed() / one.max_rotor_speed for one in airframes])
        seen = env.replace_airframes(airframes, int(self._rng.integers(2**31)))
        taught = self._rng.random(env.num_envs) >= self.num_steps / (TAUGHT * self._total)
        hidden = np.zeros((env.num_envs, own.hidden_size), np.float32)
        outputs, labels = np.zeros((2, env.num_envs, NUM_ROTORS), np.float32)
        here = slice(self._next, self._next + env.num_envs)
        lengths = np.full(env.num_envs, self._horizon)
        for t in range(self._horizon):
            rows = np.clip(seen, -self._limit, self._limit) * self._scale
            run_gru(self.parameters, self.sizes, self._step, rows, hidden, outputs)
            speeds = env.aviary.swarm.rotor_speed
            command_teachers(seen, speeds, most, hover, gains, labels)
            self._rows[here, t], self._labels[here, t] = rows, labels
            actions = np.where(taught[:, None], labels, np.clip(outputs, -1.0, 1.0))
            # Rotors stop beyond the measured rates, so that drones do not spin faster and faster
            actions[(np.abs(seen[:, RATES]) >= MAX_BODY_RATE).any(axis=1)] = -1.0
            env.step_async(actions)
            seen, _, done, infos = env.step_wait()
            # A world whose drones are all done starts again, which the sequences leave out
            lengths[done & (lengths == self._horizon)] = t + 1
            self.num_steps += env.num_envs
            report(infos)
        self._lengths[here] = lengths
        self._filled = max(self._filled, here.stop)
        self._next = here.stop % len(self._rows)

    def update(self) -> None:
        """Make gradient steps on stored episodes."""
        own = self._settings
        first, last = own.learning_rate
        rate = first + (last - first) * min(self.num_steps / self._total, 1.0)
        total = 0.0
        for _ in range(own.gradient_steps):
            total += add_gru_gradient(
                self.parameters,
                self._gradient,
                self.sizes,
                self._steps,
                self._changes,
                self._rows,
                self._labels,
                self._lengths,
                self._rng.integers(self._filled, size=own.batch_size),
            )
            self._num_updates += 1
            norm = own.max_grad_norm
            step_adam(self.parameters, self._gradient, self._moments, self._num_updates, rate, norm)
        self._loss = total / own.gradient_steps

    def statistics(self) -> dict[str, float]:
        """Return the mean squared error of the actions in the last update."""
        return {"train/loss": self._loss}

    def save(self, folder: Path) -> None:
        """Write a checkpoint.

        Args:
            folder: Folder for the policy and the training state.

        Raises:
            OSError: If a file cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        high = np.ones(NUM_ROTORS, np.float32)
        inputs = {LIMIT: self._limit, SCALE: self._scale, LOW: -high, HIGH: high}
        own = gru_arrays(self.parameters, self.sizes)
        write_weights(
            {name: array.copy() for name, array in (own | inputs).items()}, folder / POLICY
        )
        # Exact in double precision
        counters = np.array([self.num_steps, self._num_updates], dtype=float)
        state = {"parameters": self.parameters, "moments": self._moments, "counters": counters}
        write_weights(state, folder / TRAINING)

    def restore(self, folder: Path) -> None:
        """Restore a checkpoint.

        Args:
            folder: Folder of the checkpoint.

        Raises:
            ValueError: If the files are damaged, or belong to a learner of other settings.
        """
        try:
            state = read_weights(folder / TRAINING)
            if state["parameters"].shape != self.parameters.shape:
                raise ValueError("parameters have another size")
            self.parameters[:], self._moments[:] = state["parameters"], state["moments"]
            self.num_steps, self._num_updates = map(int, state["counters"])
        except (LookupError, OSError, ValueError) as error:
            raise ValueError(
                f"{folder} holds no checkpoint of this run ({error}): choose another folder"
            ) from None
