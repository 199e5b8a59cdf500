"""Folders for the Hugging Face Hub: a policy with its model card, and its environment.

The environment is a file `env.py` with `make_env`, as LeRobot's EnvHub loads it
(https://huggingface.co/docs/lerobot/envhub). The card has a `model-index` with the scores.
"""

import csv
import pprint
import shutil
from pathlib import Path
from typing import Any

import yaml

from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.gymnasium import environment_id
from bulletuav.errors import shown
from bulletuav.files import replace_file
from bulletuav.policies.find import config_file, read_run_config
from bulletuav.policies.run import CONFIG, CURVE, POLICY, SHIPPED, RunConfig, plain_value
from bulletuav.policies.scores import read_scores
from bulletuav.tasks import find_task, list_tasks
from bulletuav.version import REPOSITORY, __version__

CARD = "README.md"
ENVIRONMENT = "env.py"
REQUIREMENTS = "requirements.txt"
Score = tuple[str, str, float]
"""Conditions, metric and mean"""
MEASURED = ("safe_success", "return", "conflict", "collision")
"""Metrics of a learning curve that the card shows"""
ENV_TEXT = '''\
"""Environment of the task {task}: one agent commands all drones of a world."""

import bulletuav  # registers the environments
import gymnasium

ID = "{identifier}"
OPTIONS = {options}


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """Return the worlds as {{suite: {{task id: gymnasium.vector.VectorEnv}}}}.

    Args:
        n_envs: Number of worlds.
        use_async_envs: Whether each world has a process of its own; else all are one batch, which
            is faster.
        cfg: Must be None: `OPTIONS` has the settings.
    """
    if cfg is not None:
        raise ValueError(f"cfg is {{cfg!r}}: must be None; change OPTIONS of this file instead")
    mode = "async" if use_async_envs else "vector_entry_point"
    worlds = gymnasium.make_vec(ID, num_envs=n_envs, vectorization_mode=mode, **OPTIONS)
    return {{"bulletuav": {{0: worlds}}}}
'''
CARD_TEXT = """\
---
{data}---

# {name}

A policy for the task `{task}` of [bulletuav]({repository}) {version}: {title}.

All drones share the policy, and each one acts on its own observation. It was trained and measured
in simulation only.

| | |
|---|---|
| settings | `{config}`: `{algo}`, {steps:,} decisions, seed {seed} |
{notes}| observes | {observes} |
| action | `{action}` |
| train with these settings | `bulletuav train --config {config}` |

## Scores

{scores}

## Fly it

After `pip install -r {requirements}`, in the folder of these files:

```sh
bulletuav fly {task} --policy . --seed 0 --out flight
```

```python
import bulletuav

print(bulletuav.evaluate("{task}", ".", episodes=20, seed=0).estimates()["safe_success"])
```

## Environment

`{environment}` makes worlds with the observation and action of this policy, for LeRobot's
`make_env` or any program for Gymnasium. One agent commands all drones of a world there; for an
agent for each drone see `bulletuav.parallel_env`.

```python
from env import make_env

worlds = make_env(n_envs=4)["bulletuav"][0]
observations, infos = worlds.reset(seed=0)
```
"""


def write_hub(run: Path, place: Path, trust: bool = False) -> list[Path]:
    """Write the folder of a policy for the Hugging Face Hub.

    Args:
        run: Folder of a training run, or of one of its checkpoints.
        place: Folder to write; other files in it are kept.
        trust: If True, modules that `run.yaml` names may be imported.

    Returns:
        The files.

    Raises:
        ValueError: If the folder is not a run of a task of the package.
        FileNotFoundError: If the folder, or its policy, does not exist.
    """
    config = read_run_config(run, trust)
    if config.task not in list_tasks():
        raise ValueError(
            f"{run} flies the task {shown(config.task)}, which others do not have: publish the "
            f"policies of {', '.join(list_tasks())}"
        )
    if not (run / POLICY).is_file():
        raise FileNotFoundError(f"{run / POLICY} is missing: train until the first checkpoint")
    place.mkdir(parents=True, exist_ok=True)
    if place.resolve() == run.resolve():
        raise ValueError(f"{place} is the folder of the run: choose another one by --out FOLDER")
    shutil.copyfile(run / POLICY, place / POLICY)
    # With its comments, which say where the policy comes from
    shutil.copyfile(config_file(run), place / CONFIG)
    texts = {
        ENVIRONMENT: ENV_TEXT.format(
            task=config.task,
            identifier=environment_id(config.task),
            options=pprint.pformat(plain_value(config.evaluated), width=96),
        ),
        REQUIREMENTS: f"bulletuav=={__version__}\n",
        CARD: card(run, config),
    }
    for name, text in texts.items():
        replace_file(place / name, text)
    return [place / name for name in (POLICY, CONFIG, *texts)]


def card(run: Path, config: RunConfig) -> str:
    """Return the model card of a policy: data of the Hub, and a text.

    Args:
        run: Folder of the training run.
        config: Its settings.
    """
    spec = EnvSpec(config.task, 1, config.evaluated)
    measured = scores(run, config)
    # The policy for any quadrotor has the task hover
    name = f"bulletuav-{run.resolve().name if _is_shipped(run) else config.task}"
    data: dict[str, Any] = {
        "library_name": "bulletuav",
        "license": "mit",
        "pipeline_tag": "reinforcement-learning",
        "tags": ["reinforcement-learning", "multi-agent", "drones", "robotics", config.algo],
    }
    if measured:
        data["model-index"] = [
            {"name": name, "results": [_result(config.task, *one) for one in measured]}
        ]
    blocks = config.evaluated.get("observation") or find_task(config.task).observation
    return CARD_TEXT.format(
        data=yaml.safe_dump(data, sort_keys=False),
        name=name,
        task=config.task,
        title=str(find_task(config.task).__doc__).splitlines()[0].rstrip("."),
        repository=REPOSITORY,
        version=__version__,
        algo=config.algo,
        steps=config.steps,
        seed=config.seed,
        notes="".join(f"| note | {note} |\n" for note in _notes(run)),
        observes=", ".join(f"`{block}`" for block in blocks),
        action=spec.options.action,
        config=CONFIG,
        requirements=REQUIREMENTS,
        environment=ENVIRONMENT,
        scores=_table(measured),
    )


def _is_shipped(run: Path) -> bool:
    """Return whether the folder of a run is in the package."""
    return run.resolve().parent == SHIPPED.resolve()


def _notes(run: Path) -> list[str]:
    """Return remarks on the origin of a policy: comments of its settings, and its checkpoint."""
    file = config_file(run)
    lines = file.read_text(encoding="utf-8").splitlines()
    comments = " ".join(line.removeprefix("#").strip() for line in lines if line.startswith("#"))
    checkpoint = "" if file.parent == run else f"checkpoint {run.name} of this training"
    return [note for note in (comments, checkpoint) if note]


def scores(run: Path, config: RunConfig) -> list[Score]:
    """Return the measured scores of a policy.

    Those of the package are in its tables, and those of other runs at the end of their curves.

    Args:
        run: Folder of the training run.
        config: Its settings.
    """
    if _is_shipped(run):
        return [
            (
                f"difficulty {level}, {found['episodes']} episodes",
                "safe_success",
                found["trained"][0],
            )
            for level, found in read_scores(run.name).items()
        ]
    curve = run / CURVE
    if not curve.is_file():
        return []
    with curve.open(newline="", encoding="utf-8") as file:
        row = list(csv.DictReader(file))[-1]
    conditions = (
        f"difficulty {row['difficulty']}, dynamics {row['dynamics']}, {row['episodes']} episodes"
    )
    return [(conditions, metric, round(float(row[metric]), 4)) for metric in MEASURED]


def _result(task: str, conditions: str, metric: str, mean: float) -> dict[str, Any]:
    """Return a result of the Hub's `model-index`."""
    return {
        "task": {"type": "reinforcement-learning", "name": "reinforcement-learning"},
        "dataset": {"type": environment_id(task), "name": f"{task}, {conditions}"},
        "metrics": [{"type": metric, "name": metric.replace("_", " "), "value": mean}],
    }


def _table(measured: list[Score]) -> str:
    """Return the scores as a table."""
    if not measured:
        return "Not measured."
    rows = [
        f"| {conditions} | {metric.replace('_', ' ')} | {mean:g} |"
        for conditions, metric, mean in measured
    ]
    return "\n".join(["| conditions | metric | mean |", "|---|---|---|", *rows])
