"""Description of what determines the results of an evaluation, as stored in files."""

import functools
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numba

from bulletuav.analysis.episodes import BATCH, EpisodeJob
from bulletuav.analysis.metrics import MetricSpec
from bulletuav.envs.descriptions import canonical_text, describe_options, describe_parts
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.policies import PolicySpec
from bulletuav.policies.base import check_action
from bulletuav.policies.versus import Versus
from bulletuav.version import __version__

_PACKAGE = Path(__file__).parent.parent


def describe_flights(
    flights: EpisodeJob[Any],
    pilot: PolicySpec,
    call: str | None,
    measures: Sequence[MetricSpec] = (),
) -> dict[str, Any]:
    """Return a description of the flown episodes that can be stored as JSON.

    Args:
        flights: The episodes.
        pilot: The policy.
        call: Arguments of the call, as a Python literal.
        measures: Custom metrics, whose source code is part of the fingerprint.

    Returns:
        The description, as it would be read back from a file.

    Raises:
        ValueError: If the policy cannot output the action of the environment.
    """
    spec = EnvSpec(flights.task, BATCH, flights.options)
    check_action(pilot.name, pilot.actions, spec.options.action)
    about = {
        "bulletuav": __version__,
        "task": spec.task.name,
        "policy": pilot.name,
        "reads_swarm": pilot.reads_swarm,
        "episodes": flights.episodes,
        "seed": flights.seed,
        "batch": BATCH,
        "metrics": [metric.name for metric in measures],
        "fingerprint": _fingerprint(flights, spec, pilot.models, measures),
        "options": describe_options(spec.options, spec.task.config),
        "call": call,
    }
    # The description is compared with one from a file, so it must pass through JSON, too.
    return cast(dict[str, Any], json.loads(json.dumps(about)))


def hash_sources(package: Path = _PACKAGE) -> str:
    """Hash the Python files of a package, and the version of numba.

    Args:
        package: Folder of the package; all files below it are hashed with their paths.

    Returns:
        16 hexadecimal digits.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix().encode()
        digest.update(name + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@functools.cache
def _hash_own_sources() -> str:
    """Hash this package, once per process.

    Later edits of the files do not change the code that this process runs.
    """
    return hash_sources()


def _fingerprint(
    flights: EpisodeJob[Any], spec: EnvSpec, models: Sequence[Path], measures: Sequence[MetricSpec]
) -> str:
    """Hash whatever affects the results but has no comparable value.

    These are source code, airframes, cities, and model files.
    """
    # Source code of the package, and of policies and metrics from outside of it.
    digest = hashlib.sha256(_hash_own_sources().encode())
    policy = flights.policy
    policies = policy.sides.values() if isinstance(policy, Versus) else (policy,)
    # Names and paths are compared as values
    for source in (*policies, *(metric.source for metric in measures)):
        if not isinstance(source, str | Path):
            digest.update(canonical_text(source).encode())
    for model in models:
        digest.update(model.read_bytes())
    digest.update(canonical_text(describe_parts(spec.options, spec.task)).encode())
    return digest.hexdigest()[:16]
