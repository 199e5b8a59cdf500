"""Operations: what is done to environments, each drawn at random, with what must hold after it."""

import copy
import pickle
from typing import Any

import numpy as np
from pettingzoo import ParallelEnv

from bulletuav.envs.env_spec import EnvSpec
from bulletuav.policies import find_policy
from bulletuav.registry import names

from . import airspace  # adds a face
from .at_work import BAD_MASKS, BAD_OPTIONS, BAD_SEEDS, SLOTS, Turn, operation
from .faces import FACES, Batch, Core, Curriculum, Face, Parallel, Turns, Workers
from .forms import draw, pick
from .invariants import attempt, digest_of, require, sample

PLAIN_POLICIES = ("straight", "stay", "random", "climb")


def build(turn: Turn) -> str:
    """Make an environment of a form that is drawn."""
    sim, rng = turn.sim, turn.rng
    rare = rng.random() < 0.02
    faces = ("workers",) if rare else (*(one for one in FACES if one != "workers"), "core", "core")
    form = draw(rng, faces, sim.wide)
    sim.notes = f"{form}"
    face, error = attempt(
        lambda: FACES[form.face](form, rng), must=False if form.is_plain else None
    )
    sim.slots[turn.slot] = face
    sim.digest.add((form.face, form.task, str(error)))
    return "ok" if error is None else type(error).__name__


@operation(5.0)
def rebuild(turn: Turn) -> str:
    """Close the environment and make another one."""
    turn.drop()
    return build(turn)


def fly(face: Face, action: Any) -> Any:
    """Fly one decision that has to be valid."""
    before = face.note()
    again = face.batched and not isinstance(face, Core)  # a world may start anew
    value, error = attempt(lambda: face.step(action), must=None if again else False)
    if error is not None:
        return no_start(error)
    face.check_step(value, before)
    return value


def no_start(error: Exception) -> str:
    """Tell an error of starts, which are drawn, and may find no room; others are no good."""
    found = any(word in str(error) for word in ("start", "room", "places"))
    require(found, f"refused what can be: {error}")
    return str(error)


def restart(face: Face, **keywords: Any) -> Any:
    """Start new episodes, which has to be valid."""
    value, error = attempt(lambda: face.reset(**keywords))
    if error is not None:
        return no_start(error)
    face.check_reset(value)
    return value


def ready(turn: Turn) -> bool:
    """Bring the environment to where it can fly; tell whether it can."""
    face = turn.face
    if not face.started or face.is_over():
        value = restart(face, seed=int(turn.rng.integers(1000)))
        turn.sim.digest.add(value)
    return face.started and not face.is_over()


@operation(6.0)
def plan(turn: Turn) -> str:
    """Check options of everything that there is, good and bad, without making an engine."""
    form = draw(turn.rng, ("core",), wide=True, badly=0.5)
    turn.sim.notes = f"planned {form}"
    _, error = attempt(
        lambda: EnvSpec(form.task, form.worlds, form.options),
        must=False if form.is_plain else None,
    )
    turn.sim.digest.add((form.task, str(error)))
    return "ok" if error is None else type(error).__name__


@operation(60.0)
def step(turn: Turn) -> str:
    """Fly a decision or some."""
    for _ in range(int(turn.rng.integers(1, 4))):
        if not ready(turn):
            return "no start"
        turn.sim.digest.add(fly(turn.face, turn.face.act(turn.rng)))
    return "ok"


@operation(1.0)
def step_unready(turn: Turn) -> str:
    """Fly a decision before the first reset, or after the end."""
    face, rng = turn.face, turn.rng
    if face.started or isinstance(face, airspace.Space | Turns):
        return "skipped"
    if isinstance(face, Batch):
        action = face.act(rng)
    else:
        action = {} if isinstance(face, Parallel) else sample(face.env.action_space, rng)
    _, error = attempt(lambda: face.step(action), must=True)
    return type(error).__name__


@operation(8.0)
def step_badly(turn: Turn) -> str:
    """Give an action that cannot be: a clear error, nobody has flown, and the next one flies."""
    if not ready(turn):
        return "no start"
    face = turn.face
    bad = face.spoil(turn.rng, face.act(turn.rng))
    if bad is None:
        return "skipped"
    turn.sim.notes = f"action {bad!r}"
    before = hash_of(face)
    _, error = attempt(lambda: face.step(bad), must=True)
    require(hash_of(face) == before, f"the state changed by a refused action: {error}")
    turn.sim.digest.add((str(error), fly(face, face.act(turn.rng))))
    return type(error).__name__


@operation(6.0)
def reset(turn: Turn) -> str:
    """Start new episodes in all worlds."""
    face, rng = turn.face, turn.rng
    seed = pick(rng, (0, 1, 2**40, int(rng.integers(1000)), *((None,) if face.started else ())))
    turn.sim.digest.add(restart(face, seed=seed))
    return "ok"


@operation(2.0)
def reset_badly(turn: Turn) -> str:
    """Give a seed, options or a mask that cannot be: everything stays as it was."""
    face, rng = turn.face, turn.rng
    if isinstance(face, airspace.Space):
        return "skipped"
    kind = int(rng.integers(3 if face.batched else 2))
    keywords: dict[str, Any] = {"seed": 0}
    if kind == 0:
        keywords["seed"] = pick(rng, BAD_SEEDS)
    elif kind == 1:
        keywords["options"] = copy.deepcopy(pick(rng, BAD_OPTIONS))
        if isinstance(face, Core) and not isinstance(keywords["options"], dict):
            return "skipped"
    else:
        keywords["options"] = {"reset_mask": pick(rng, BAD_MASKS)}
    turn.sim.notes = f"reset of {keywords}"
    before = hash_of(face)
    known = not isinstance(face, Curriculum) or kind == 0
    _, error = attempt(lambda: face.reset(**keywords), must=True if known else None)
    require(hash_of(face) == before or error is None, f"a refused reset left traces: {error}")
    turn.sim.digest.add(str(error))
    return type(error).__name__


@operation(4.0)
def reset_some(turn: Turn) -> str:
    """Start new episodes in some worlds: the others stay as they are."""
    face, rng = turn.face, turn.rng
    if not face.batched or not face.started:
        return "skipped"
    worlds = face.form.worlds if face.core is None else face.core.num_worlds
    worlds = getattr(face.env, "num_envs", worlds)
    mask = rng.random(worlds) < 0.5
    seed = pick(rng, (None, 3, rng.integers(0, 99, worlds).tolist()))
    before = hash_of(face)
    turn.sim.digest.add(restart(face, seed=seed, options={"reset_mask": mask}))
    if before is not None:
        same = [a == b for a, b in zip(before, hash_of(face), strict=True)]
        require(np.array(same)[~mask].all(), "a world that was not reset changed")
    return "ok"


@operation(1.5)
def reset_places(turn: Turn) -> str:
    """Start from given places, which the task may refuse."""
    face, rng = turn.face, turn.rng
    if isinstance(face, airspace.Space | Curriculum):
        return "skipped"
    drones = face.form.options.get("num_drones", 4)
    drones = drones if isinstance(drones, int) and 0 < drones < 9 else 4
    middle = np.array([(12.0 * k - 30.0, 0.0, 30.0) for k in range(drones)])
    places = {"start": middle + rng.normal(0, 0.5, middle.shape)}
    if rng.random() < 0.5:
        places["goal"] = middle[::-1] + (0.0, 20.0, 0.0)
    value, error = attempt(lambda: face.reset(seed=1, options=places))
    if error is None:
        face.check_reset(value)
    turn.sim.digest.add(str(error) if error else value)
    return "ok" if error is None else type(error).__name__


def has(env: Any, name: str) -> bool:
    """Tell whether a class has a method of its own, not one of PettingZoo that is not there."""
    own = getattr(type(env), name, None)
    return own is not None and own is not getattr(ParallelEnv, name, None)


def hash_of(face: Face) -> Any:
    """Hash the state, where the class can and there is one."""
    if not face.started or not hasattr(type(face.plain), "state_hash"):
        return None
    return face.plain.state_hash()


def rollout(face: Face, seed: int, decisions: int) -> list[Any]:
    """Fly some decisions by random actions, up to the end of the episodes."""
    rng = np.random.default_rng(seed)
    told = []
    for _ in range(decisions):
        if face.is_over():
            break
        told.append(digest_of(fly(face, face.act(rng))))
    return [*told, hash_of(face)]


@operation(2.0)
def save(turn: Turn) -> str:
    """Save, fly on, load, fly on: the same bits."""
    if not hasattr(type(turn.face.plain), "save_state") or not ready(turn):
        return "skipped"
    face, env, rng = turn.face, turn.face.plain, turn.rng
    snapshot, error = attempt(env.save_state)
    if error is not None:
        require("contacts='bullet'" in str(error), f"not saved: {error}")
        return type(error).__name__
    if rng.random() < 0.3:
        snapshot = pickle.loads(pickle.dumps(snapshot))
    elif rng.random() < 0.3:
        snapshot = copy.deepcopy(snapshot)
    hashed, seed = hash_of(face), int(rng.integers(1000))
    first = rollout(face, seed, 3)
    load_into(face, snapshot)
    require(hash_of(face) == hashed, "the state after loading is not the one that was saved")
    require(rollout(face, seed, 3) == first, "a flight does not go on as it did from there")
    load_into(face, snapshot)
    face.snapshots = [*face.snapshots[-3:], (snapshot, hashed)]
    turn.sim.digest.add([first, hashed])
    return "ok"


def load_into(face: Face, snapshot: Any) -> None:
    """Load a state that has to fit."""
    attempt(lambda: face.plain.load_state(snapshot), must=False)
    face.started = True
    if hasattr(face, "ended"):
        face.ended = not face.core.alive.any()


@operation(3.0)
def load(turn: Turn) -> str:
    """Load a state that was saved here or elsewhere, or what is none."""
    sim, face, rng = turn.sim, turn.face, turn.rng
    if not hasattr(type(face.plain), "load_state"):
        return "skipped"
    other = sim.slots[int(rng.integers(SLOTS))]
    if face.snapshots and rng.random() < 0.6:
        snapshot, hashed = pick(rng, face.snapshots)
        load_into(face, snapshot)
        require(hash_of(face) == hashed, "the state after loading is not the one that was saved")
        sim.digest.add(rollout(face, 1, 2))
        return "ok"
    foreign = other.snapshots[0][0] if other is not None and other.snapshots else None
    bad = pick(rng, (None, b"bytes", 7, foreign))
    before, started = hash_of(face), face.started
    _, error = attempt(lambda: face.plain.load_state(bad), must=None if bad is foreign else True)
    if error is None:
        load_into(face, bad)
        return "ok"
    require(not started or hash_of(face) == before, "a refused snapshot left traces")
    if not started:
        restart(face, seed=0)
    return type(error).__name__


@operation(1.5)
def twin(turn: Turn) -> str:
    """Copy the environment: the copy flies as the original does, after a reset of both."""
    if isinstance(turn.face, Workers) and turn.rng.random() < 0.7:
        return "skipped"
    compare(turn)
    return "ok"


def compare(turn: Turn) -> None:
    """Compare the environment with a copy that was never flown, from the same seed."""
    face, rng, seed = turn.face, turn.rng, int(turn.rng.integers(1000))
    env = face.plain
    made = copy.deepcopy(env) if rng.random() < 0.5 else pickle.loads(pickle.dumps(env))
    other = face.twin(made)
    again = face
    if isinstance(face, Curriculum | airspace.Space):
        again = face.twin(copy.deepcopy(env))  # they go on from what was, also with a seed
    try:
        one, two = restart(again, seed=seed), restart(other, seed=seed)
        require(digest_of(one) == digest_of(two), "a copy starts otherwise than the original")
        if other.started and again.started:
            same = rollout(again, seed, 4) == rollout(other, seed, 4)
            require(same, "a copy flies otherwise than the original")
    finally:
        made.close()
        if again is not face:
            again.env.close()


@operation(2.0)
def look(turn: Turn) -> str:
    """Ask for what changes nothing, twice: it gives the same."""
    if not ready(turn):
        return "no start"
    env, before = turn.face.plain, hash_of(turn.face)
    for name in ("state", "state_hash", "observation_labels", "alive", "ended", "contacts"):
        if not has(env, name):
            continue
        one, two = (getattr(env, name) for _ in range(2))
        if callable(one):
            one, two = one(), two()
        require(digest_of(one) == digest_of(two), f"{name} changes by being asked")
    repr(env)
    require(hash_of(turn.face) == before, "looking changed the state")
    turn.sim.digest.add(fly(turn.face, turn.face.act(turn.rng)))
    return "ok"


@operation(0.5)
def render(turn: Turn) -> str:
    """Take a picture, which changes nothing."""
    if isinstance(turn.face, airspace.Space) or not ready(turn):
        return "skipped"
    env, before = turn.face.plain, hash_of(turn.face)
    picture = env.render()
    options = turn.face.form.options
    if options.get("render_mode") == "rgb_array":
        picture = picture[0] if isinstance(picture, tuple) else picture
        require(picture is not None and picture.dtype == np.uint8, f"a picture is {picture}")
        require(picture.ndim == 3 and picture.shape[2] == 3, f"a picture is {picture.shape}")
    require(hash_of(turn.face) == before, "a picture changed the state")
    return "ok"


@operation(1.0)
def close(turn: Turn) -> str:
    """Close twice; what is asked after that is refused."""
    face = turn.face
    action = face.act(turn.rng) if face.started and not face.is_over() else None
    face.env.close()
    face.env.close()
    if action is not None:
        _, error = attempt(lambda: face.step(action), must=True)
        require(isinstance(error, RuntimeError), f"after close: {error!r}")
    for name in ("reset", "state", "state_hash", "save_state"):
        if has(face.plain, name):
            _, error = attempt(getattr(face.plain, name), must=True)
            require("closed" in str(error), f"{name} after close: {error!r}")
    turn.sim.slots[turn.slot] = None
    return "ok"


@operation(2.0)
def fly_policy(turn: Turn) -> str:
    """Let a policy fly, which may refuse the task."""
    face, rng = turn.face, turn.rng
    if not isinstance(face, Core):
        return "skipped"
    name = pick(rng, names("policy") if turn.sim.wide else PLAIN_POLICIES)
    turn.sim.notes = f"policy {name}"
    policy, error = attempt(lambda: find_policy(name, face.form.task)(face.env))
    if error is not None:
        return type(error).__name__
    observations = restart(face, seed=2)
    if not face.started or isinstance(observations, str):
        return "no start"
    policy.reset(np.ones(face.env.num_worlds, dtype=bool))
    for _ in range(3):
        actions, error = attempt(lambda seen=observations: policy.act(seen, face.env.swarm))
        if error is not None:
            return type(error).__name__
        value = fly(face, actions)
        observations = value.observations
        turn.sim.digest.add(value)
        if face.is_over():
            break
    return "ok"
