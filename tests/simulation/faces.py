"""Environment classes behind one interface: make, reset, act, step, and check what comes out."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

import bulletuav
from bulletuav.adapters.self_play import TeamAviary
from bulletuav.envs.gymnasium import CentralAviary, CentralVectorAviary, environment_id
from bulletuav.tasks import find_task

from .face import OTHERS, Face
from .forms import Form, pick
from .invariants import (
    require,
    require_flags,
    require_infos,
    require_inside,
    require_rewards,
    sample,
)


class Batch(Face):
    """`batch_env`: many worlds that start anew by themselves."""

    batched = True
    workers = 1

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        self.mode = pick(rng, (*AutoresetMode, AutoresetMode.NEXT_STEP))
        return bulletuav.batch_env(
            form.task,
            max(form.worlds, self.workers),
            workers=self.workers,
            autoreset_mode=self.mode,
            **form.options,
        )

    def act(self, rng: np.random.Generator) -> Any:
        space, lead = self.env.action_space, (self.env.num_envs, self.env.num_drones)
        rows = [sample(space, rng) for _ in range(lead[0] * lead[1])]
        return np.array(rows).reshape(*lead, *space.shape)

    def spoil(self, rng: np.random.Generator, action: Any) -> Any:
        return super().spoil(rng, action) if self.env.alive.any() else None

    def is_over(self) -> bool:
        return self.mode == AutoresetMode.DISABLED and not self.env.alive.any()

    def check_reset(self, value: Any) -> None:
        lead = (self.env.num_envs, self.env.num_drones)
        require_inside(self.env.observation_space, value[0], lead)
        require_infos(value[1], lead)

    def check_step(self, value: Any, before: Any) -> None:
        observations, rewards, terminated, truncated, infos = value
        lead = (self.env.num_envs, self.env.num_drones)
        require_inside(self.env.observation_space, observations, lead)
        require_rewards(rewards, lead)
        require_flags(terminated, lead, "terminated")
        require_flags(truncated, lead, "truncated")
        require(not (terminated & truncated).any(), "both terminated and truncated")
        require_infos(infos, lead)
        if before is not None:
            alive, steps = before
            require(not ((terminated | truncated) & ~alive).any(), "who has left ended again")
            require(not rewards[~alive].any(), "who has left was rewarded")
            ended = ~(alive & ~(terminated | truncated)).any(axis=1)
            fresh = np.zeros(lead[0], dtype=bool)
            if self.mode == AutoresetMode.NEXT_STEP:
                fresh = ~alive.any(axis=1)
            elif self.mode == AutoresetMode.SAME_STEP:
                fresh = ended
            if steps.any() or not fresh.any():
                self.check_counters(before, fresh)


class Workers(Batch):
    """`batch_env` over two processes."""

    workers = 2


class Core(Batch):
    """`Aviary`, which never starts anew by itself."""

    mode = AutoresetMode.DISABLED

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        return bulletuav.Aviary(form.task, form.worlds, **form.options)

    @property
    def plain(self) -> Any:
        return self.env

    def __init__(self, form: Form, rng: np.random.Generator) -> None:
        super().__init__(form, rng)
        self.core = self.env

    def twin(self, copy: Any) -> Face:
        face = super().twin(copy)
        face.core = copy
        return face

    def reset(self, **keywords: Any) -> Any:
        options = keywords.pop("options", None) or {}
        mask = options.pop("reset_mask", None)
        value = self.env.reset(mask, keywords.pop("seed", None), **options, **keywords)
        self.started = True
        return value

    def act(self, rng: np.random.Generator) -> Any:
        low, high = self.env.action.low, self.env.action.high
        share = rng.random((self.env.num_worlds, *low.shape))
        actions = low + share * (high - low)
        return actions if self.env.action.choices is None else np.round(actions)

    def is_over(self) -> bool:
        return not self.env.alive.any()

    def check_reset(self, value: Any) -> None:
        require_inside(self.env.observer.space(), value, self.env.alive.shape)

    def check_step(self, value: Any, before: Any) -> None:
        alive, _ = before
        require_inside(self.env.observer.space(), value.observations, alive.shape)
        require_rewards(value.rewards, alive.shape)
        over = value.terminated | value.truncated
        require((self.env.alive == (alive & ~over)).all(), "alive is not who flew and did not end")
        require(not value.rewards[~alive].any(), "who has left was rewarded")
        require_infos(value.info, alive.shape)
        self.check_counters(before)


class Parallel(Face):
    """`parallel_env`."""

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        return bulletuav.parallel_env(form.task, **form.options)

    def act(self, rng: np.random.Generator) -> Any:
        return {one: sample(self.env.action_space(one), rng) for one in self.env.agents}

    def spoil(self, rng: np.random.Generator, action: Any) -> Any:
        if not self.env.agents:
            return None
        bad, agent = dict(action), pick(rng, self.env.agents)
        kind = int(rng.integers(4))
        if kind == 0:
            return pick(rng, OTHERS[:3])
        if kind == 1:
            del bad[agent]
        elif kind == 2:
            bad["nobody"] = bad[agent]
        else:
            bad[agent] = super().spoil(rng, bad[agent])
        return bad

    def is_over(self) -> bool:
        return not self.env.agents

    def note(self) -> Any:
        return list(self.env.agents), super().note()

    def check_reset(self, value: Any) -> None:
        observations, infos = value
        require(list(observations) == self.env.agents == list(infos), "agents differ")
        for agent, one in observations.items():
            require_inside(self.env.observation_space(agent), one)
            require_infos(infos[agent], ())

    def check_step(self, value: Any, before: Any) -> None:
        agents, counters = before
        for told in value:
            require(list(told) == agents, "told of {}, and {} flew", list(told), agents)
        observations, rewards, terminated, truncated, infos = value
        for agent in agents:
            require_inside(self.env.observation_space(agent), observations[agent])
            require(np.isfinite(rewards[agent]), "a reward is not finite")
            require_infos(infos[agent], ())
        left = [one for one in agents if not (terminated[one] or truncated[one])]
        require(self.env.agents == left, "{} fly, and {} should", self.env.agents, left)
        if counters is not None:
            self.check_counters(counters)


class Team(Parallel):
    """`team_env` of the chasers."""

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        team = pick(rng, find_task("pursuit_evasion").team_names)
        foe = pick(rng, ("stay", "wander", "random"))
        return bulletuav.team_env("pursuit_evasion", team, foe, **form.options)

    def __init__(self, form: Form, rng: np.random.Generator) -> None:
        if form.task != "pursuit_evasion":
            form = form._replace(
                task="pursuit_evasion", options={"horizon": 12, "dynamics": "point_mass"}
            )
        super().__init__(form, rng)
        assert isinstance(self.env, TeamAviary)


class Curriculum(Parallel):
    """`curriculum_env` of two stages."""

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        stages = ({}, {})
        return bulletuav.curriculum_env(form.task, stages, window=2, **form.options)


class Turns(Face):
    """`aec_env`: a decision is a turn of each agent."""

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        return bulletuav.aec_env(form.task, **form.options)

    def act(self, rng: np.random.Generator) -> Any:
        agent = self.env.agent_selection
        if self.env.terminations[agent] or self.env.truncations[agent]:
            return None
        return sample(self.env.action_space(agent), rng)

    def spoil(self, rng: np.random.Generator, action: Any) -> Any:
        return None if action is None else super().spoil(rng, action)

    def step(self, action: Any) -> Any:
        self.env.step(action)
        if not self.env.agents:
            return None
        observation, *results = self.env.last()
        return self.env.agent_selection, observation, results

    def is_over(self) -> bool:
        return not self.env.agents

    def check_step(self, value: Any, before: Any) -> None:
        if value is not None:
            agent, observation, (reward, *_, infos) = value
            require_inside(self.env.observation_space(agent), observation)
            require(np.isfinite(reward), "a reward is not finite")
            require_infos(infos, ())


class Central(Face):
    """The Gymnasium environment, made by its id or by its class."""

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        self.wrapped = bool(rng.integers(2))
        self.ended = False
        if self.wrapped:
            # Its checker breaks when a first reset is refused
            options = {"disable_env_checker": True, **form.options}
            return gymnasium.make(environment_id(form.task), **options)
        return CentralAviary(form.task, **form.options)

    @property
    def plain(self) -> Any:
        return self.env.unwrapped

    def act(self, rng: np.random.Generator) -> Any:
        return sample(self.env.action_space, rng)

    def is_over(self) -> bool:
        return self.ended

    def reset(self, **keywords: Any) -> Any:
        value = super().reset(**keywords)
        self.ended = False
        return value

    def spoil(self, rng: np.random.Generator, action: Any) -> Any:
        return super().spoil(rng, action) if self.core.alive.all() else None

    def step(self, action: Any) -> Any:
        value = self.env.step(action)
        self.ended = bool(value[2] or value[3])
        return value

    def check_reset(self, value: Any) -> None:
        require_inside(self.env.observation_space, value[0])
        require_infos(value[1], (self.core.num_drones,))

    def check_step(self, value: Any, before: Any) -> None:
        observation, reward, terminated, truncated, infos = value
        require_inside(self.env.observation_space, observation)
        require(isinstance(reward, float) and np.isfinite(reward), f"the reward is {reward!r}")
        over = not self.core.alive.any()
        require((terminated or truncated) == over, "over, and not told, or the other way round")
        require_infos(infos, (self.core.num_drones,))
        self.check_counters(before)


class Vector(Face):
    """The Gymnasium vector environment."""

    batched = True

    def make(self, form: Form, rng: np.random.Generator) -> Any:
        self.mode = pick(rng, tuple(AutoresetMode))
        options = {"autoreset_mode": self.mode, **form.options}
        if rng.integers(2):
            return gymnasium.make_vec(environment_id(form.task), form.worlds, **options)
        return CentralVectorAviary(form.task, form.worlds, **options)

    @property
    def plain(self) -> Any:
        return self.env.unwrapped

    def act(self, rng: np.random.Generator) -> Any:
        space = self.env.single_action_space
        return np.array([sample(space, rng) for _ in range(self.env.num_envs)])

    def spoil(self, rng: np.random.Generator, action: Any) -> Any:
        return super().spoil(rng, action) if self.core.alive.all() else None

    def is_over(self) -> bool:
        return self.mode == AutoresetMode.DISABLED and not self.core.alive.any()

    def check_reset(self, value: Any) -> None:
        worlds = self.env.num_envs
        require_inside(self.env.single_observation_space, value[0], (worlds,))
        require_infos(value[1], (worlds,))

    def check_step(self, value: Any, before: Any) -> None:
        observations, rewards, terminated, truncated, infos = value
        worlds = self.env.num_envs
        require_inside(self.env.single_observation_space, observations, (worlds,))
        require_rewards(rewards, (worlds,))
        require_flags(terminated, (worlds,), "terminated")
        require_flags(truncated, (worlds,), "truncated")
        require_infos(infos, (worlds,))


FACES: dict[str, type[Face]] = {
    one.__name__.lower(): one
    for one in (Core, Batch, Parallel, Turns, Central, Vector, Team, Curriculum, Workers)
}
