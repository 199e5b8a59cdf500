"""Datasets of flights for offline learning and imitation: Parquet tables and Minari datasets."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from bulletuav.adapters.minari import MinariEpisode, write_minari
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
from bulletuav.tasks.observations.observer import ObservationBuilder

TABLES = "parquet"
"""Folder of the Parquet tables, one for each batch of episodes"""
MINARI = "minari"
"""Folder of the Minari datasets, for MINARI_DATASETS_PATH"""
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
    """Fly episodes and store all observations, actions and rewards of all drones.

    The files are identical to the last byte for any number of workers and pieces. A second call
    resumes an interrupted one.

    Args:
        task: Name or class of the task.
        policy: Policy as for `evaluate`; by default the task's baseline.
        episodes: Number of episodes; episode e has the seed `seed` + e.
        seed: Seed of the first episode.
        workers: Number of processes; it only affects the speed.
        out: Folder of the files.
        progress: Callback that receives the number of newly finished episodes.
        trust: Whether to load models that can run code on loading.
        piece: Piece of the episodes to fly, such as "2/8"; `bulletuav merge` joins all pieces to a
            dataset.
        ray: Address of a Ray cluster that flies the episodes; needs the extra `ray`.
        **options: Options of `parallel_env`.

    Returns:
        Paths of the tables; without `piece` also those of the Minari datasets, and last that of
        `dataset.json`.

    Raises:
        ValueError: If an argument is invalid, observations are pictures or dicts, or `out` holds
            another dataset.
        ImportError: If the extra `dataset` is not installed.
    """
    # Complete the options with those that the policy requires
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
    # Validate all arguments before any file is written
    part = None if piece is None else parse_piece(piece)
    as_int("workers", workers, 1)
    spec = EnvSpec(task, 1, options)
    if not isinstance(spec.observer.space(), Box) or len(spec.observer.space().shape or ()) != 1:
        raise ValueError(
            "a dataset holds vectors of numbers: choose observation_format='vector' and no pictures"
        )
    # The folder stores the call, so that another one cannot continue it
    call = format_call({"task": task, "policy": chosen, "seed": seed, "options": options})
    about = describe_flights(flights, pilot, call)
    folder = _open(Path(out), about)
    # Fly only the batches without a file, to resume an interrupted call
    batches = flights.batches()
    mine = batches if part is None else part.select(batches)
    missing = [batch for batch in mine if not _path(folder, batch).exists()]
    progress(sum(map(len, mine)) - sum(map(len, missing)))
    for transitions in fly_batches(flights, missing, workers, ray):
        _write(transitions, folder)
        progress(len(transitions.ends))
    # The index is written by the call that finds the tables of all pieces
    tables = [_path(folder, batch) for batch in mine]
    return tables if part is not None else [*tables, *_finish(folder, tables, about, spec)]


def missing_batches(out: Path, episodes: int) -> list[range]:
    """List the batches of a dataset whose tables do not exist."""
    batches = DatasetJob("", "", 0, episodes, {}).batches()
    return [batch for batch in batches if not _path(out, batch).exists()]


def _open(folder: Path, about: dict[str, Any]) -> Path:
    """Create the folder, or check that it holds the same flights."""
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
    """Write a Minari dataset for each drone, and the index `dataset.json`."""
    ends = {end["episode"]: end for path in tables for end in read_about(path)}
    action, observer = widest_action_space(spec.action), spec.observer
    policy = "".join(letter if letter.isalnum() else "_" for letter in about["policy"])
    metadata = {"algorithm_name": about["policy"], "bulletuav": about["bulletuav"]}
    written = []
    for drone in range(spec.options.num_drones):
        name = f"{about['task']}/{policy}/drone_{drone}-v0"
        flights = _flights(tables, drone, ends, observer)
        spaces = (observer.of(drone).space(), action)
        written.append(write_minari(flights, spaces, metadata, name, folder / MINARI))
    files = hash_files(folder, [f"{TABLES}/{path.name}" for path in tables])
    path = folder / DATASET
    whole = add_seal({**about, "ends": list(ends.values()), "files": files})
    replace_file(path, json.dumps(whole, indent=2) + "\n")
    return [*written, path]


def _flights(
    tables: list[Path], drone: int, ends: dict[int, Any], observer: ObservationBuilder
) -> Iterator[MinariEpisode]:
    """Read the flights of one drone, episode by episode."""
    for path in tables:
        rows = read_table(path)
        finals = rows["final_observation"]
        # Rows are sorted by episode and drone: a flight starts where either changes
        begins = np.diff(rows["episode"], prepend=-1) | np.diff(rows["drone"], prepend=-1)
        first = np.flatnonzero(begins)
        bounds = np.append(first, len(rows["drone"])).tolist()
        for k, begin in enumerate(first.tolist()):
            # Skip the flights of other drones
            if rows["drone"][begin] != drone:
                continue
            # Final observations are stored separately, one per flight
            own = slice(begin, bounds[k + 1])
            end = ends[int(rows["episode"][begin])]
            observed = np.concatenate([rows["observation"][own], finals[k : k + 1]])
            yield MinariEpisode(
                seed=end["seed"],
                observations=observer.unpadded(observed, drone),
                actions=rows["action"][own],
                rewards=rows["reward"][own],
                terminations=rows["terminated"][own],
                truncations=rows["truncated"][own],
                about={"episode": end["episode"], "state_hash": end["state_hash"]},
            )
