"""Datasets of flights, for learning from what others have flown: Parquet tables and Minari."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from bulletuav.adapters.minari import Flight, write_minari
from bulletuav.adapters.parquet import read_about, read_table, write_table
from bulletuav.analysis.description import describe_flights
from bulletuav.analysis.episodes import fly_batches
from bulletuav.analysis.pieces import WorkPiece, parse_piece
from bulletuav.analysis.results_folder import RUN, check_same_run
from bulletuav.analysis.seals import add_seal, format_call, hash_files
from bulletuav.analysis.transitions import DATASET, DatasetJob, Transitions
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.spaces import widest_action_space
from bulletuav.errors import as_int, reason_of
from bulletuav.files import replace_file
from bulletuav.parsing import read_json
from bulletuav.policies import PolicySource, find_policy
from bulletuav.tasks import TaskSource, find_task

TABLES = "parquet"
"""Folder of its tables, one for each batch of episodes"""
MINARI = "minari"
"""Folder that MINARI_DATASETS_PATH names to read it with Minari"""
MAX_EPISODES = 1_000_000


def collect(
    task: TaskSource,
    policy: PolicySource | None = None,
    episodes: int = 100,
    seed: int = 0,
    workers: int = 1,
    *,
    out: str | Path,
    progress: Callable[[int], None] = lambda episodes: None,
    trust: bool = False,
    piece: WorkPiece | str | None = None,
    ray: str | None = None,
    **options: Any,
) -> list[Path]:
    """Fly episodes and keep all that drones observed and did.

    The files are the same to the last byte, however the work is divided. A second call goes on
    where the first one was interrupted.

    Args:
        task: What is flown: a name or a class.
        policy: Who flies, as of `evaluate`; the task's baseline when left out.
        episodes: How many; episode e begins from `seed` + e.
        seed: Seed of the first episode.
        workers: Processes, which change nothing but the time.
        out: Folder of the files.
        progress: Told how many more episodes are done.
        trust: Whether a model may be read that can run code meanwhile.
        piece: Which part of the episodes to fly, such as "2/8"; `bulletuav merge` makes a dataset
            of all.
        ray: Address of a Ray cluster that flies them; needs the extra `ray`.
        **options: Those of `parallel_env`.

    Returns:
        Paths of the tables; where no piece was asked for those of datasets of Minari, too, and last
        that of `dataset.json`.

    Raises:
        ValueError: An argument is none that can be, drones observe pictures or dicts, or `out`
            holds something else.
        ImportError: The extra `dataset` is not installed.
    """
    # What is flown, with the options that the policy asks for
    chosen = find_task(task).baseline if policy is None else policy
    pilot = find_policy(chosen, task, trust)
    options = pilot.complete(task, options)
    flights = DatasetJob(
        task=task,
        policy=chosen,
        seed=as_int("seed", seed, 0),
        episodes=as_int("episodes", episodes, 1, MAX_EPISODES),
        options=options,
        trust=trust,
    )
    # Bad arguments are told before anything is written
    part = None if piece is None else parse_piece(piece)
    as_int("workers", workers, 1)
    spec = EnvSpec(task, 1, options)
    if not isinstance(spec.observer.space(), Box) or len(spec.observer.space().shape or ()) != 1:
        raise ValueError(
            "a dataset holds vectors of numbers: choose observation_format='vector' and no pictures"
        )
    # The folder remembers the call, and refuses to go on with another one
    call = format_call({"task": task, "policy": chosen, "seed": seed, "options": options})
    about = describe_flights(flights, pilot, call)
    folder = _open(Path(out), about)
    # Only batches without a file are flown: an interrupted call goes on
    batches = flights.batches()
    mine = batches if part is None else part.share(batches)
    missing = [batch for batch in mine if not _path(folder, batch).exists()]
    progress(sum(map(len, mine)) - sum(map(len, missing)))
    for transitions in fly_batches(flights, missing, workers, ray):
        _write(transitions, folder)
        progress(len(transitions.ends))
    # A piece leaves the index to the call that finds all tables
    tables = [_path(folder, batch) for batch in mine]
    return tables if part is not None else [*tables, *_finish(folder, tables, about, spec)]


def missing_batches(out: Path, episodes: int) -> list[range]:
    """List the batches of a dataset whose tables are not there."""
    batches = DatasetJob("", "", 0, episodes, {}).batches()
    return [batch for batch in batches if not _path(out, batch).exists()]


def _open(folder: Path, about: dict[str, Any]) -> Path:
    """Make the folder, or go on with one that is of the same flights."""
    (folder / TABLES).mkdir(parents=True, exist_ok=True)
    run = folder / RUN
    if run.exists():
        try:
            known = read_json(run)
            {**known, **known["options"]}
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"{run} is damaged ({reason_of(error)}): choose another folder"
            ) from None
        check_same_run(known, about, folder)
    replace_file(run, json.dumps(about, indent=2) + "\n")
    return folder


def _path(folder: Path, batch: range) -> Path:
    return folder / TABLES / f"episodes-{batch.start:06d}.parquet"


def _write(transitions: Transitions, folder: Path) -> None:
    """Write the table of a batch."""
    count = len(transitions.episode)
    columns = {
        "episode": transitions.episode.astype(np.int32),
        "drone": transitions.drone.astype(np.int32),
        "step": transitions.step.astype(np.int32),
        "observation": transitions.observation,
        "action": transitions.action,
        "reward": transitions.reward,
        "terminated": transitions.terminated,
        "truncated": transitions.truncated,
        "final_observation": (transitions.last, transitions.final_observation, count),
    }
    names = ("episode", "seed", "decisions", "state_hash")
    ends = [dict(zip(names, end, strict=True)) for end in transitions.ends]
    first = transitions.ends[0][0]
    write_table(columns, ends, _path(folder, range(first, first + len(ends))))


def _finish(folder: Path, tables: list[Path], about: dict[str, Any], spec: EnvSpec) -> list[Path]:
    """Write datasets of Minari, one for each drone, and what tells of all."""
    ends = {end["episode"]: end for path in tables for end in read_about(path)}
    spaces = (spec.observer.space(), widest_action_space(spec.action))
    policy = "".join(letter if letter.isalnum() else "_" for letter in about["policy"])
    told = {"algorithm_name": about["policy"], "bulletuav": about["bulletuav"]}
    written = []
    for drone in range(spec.options.num_drones):
        name = f"{about['task']}/{policy}/drone_{drone}-v0"
        flights = _flights(tables, drone, ends)
        written.append(write_minari(flights, spaces, told, name, folder / MINARI))
    files = hash_files(folder, [f"{TABLES}/{path.name}" for path in tables])
    path = folder / DATASET
    whole = add_seal({**about, "ends": list(ends.values()), "files": files})
    replace_file(path, json.dumps(whole, indent=2) + "\n")
    return [*written, path]


def _flights(tables: list[Path], drone: int, ends: dict[int, Any]) -> Iterator[Flight]:
    """Read what one drone did, episode by episode."""
    for path in tables:
        rows = read_table(path)
        finals = rows["final_observation"]
        # Rows are sorted by episode and drone: a new flight begins where these change
        begins = np.diff(rows["episode"], prepend=-1) | np.diff(rows["drone"], prepend=-1)
        first = np.flatnonzero(begins)
        bounds = np.append(first, len(rows["drone"])).tolist()
        for k, begin in enumerate(first.tolist()):
            # Other drones' flights stand between
            if rows["drone"][begin] != drone:
                continue
            # The last observation stands in a list of its own, one a flight
            own = slice(begin, bounds[k + 1])
            end = ends[int(rows["episode"][begin])]
            yield Flight(
                seed=end["seed"],
                observations=np.concatenate([rows["observation"][own], finals[k : k + 1]]),
                actions=rows["action"][own],
                rewards=rows["reward"][own],
                terminations=rows["terminated"][own],
                truncations=rows["truncated"][own],
                about={"episode": end["episode"], "state_hash": end["state_hash"]},
            )
