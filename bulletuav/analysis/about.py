"""What decides the results of flights, as a file can tell it."""

import functools
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numba

from bulletuav.analysis.episodes import BATCH, Flights
from bulletuav.analysis.metrics import MetricSpec
from bulletuav.envs.descriptions import canonical_text, describe_options, describe_parts
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.policies import PolicySpec
from bulletuav.policies.base import check_action
from bulletuav.policies.versus import Versus
from bulletuav.version import __version__

_PACKAGE = Path(__file__).parent.parent


def about_flights(
    flights: Flights[Any],
    pilot: PolicySpec,
    call: str | None,
    measures: Sequence[MetricSpec] = (),
) -> dict[str, Any]:
    """Tell what is flown, as a JSON file can hold it.

    Args:
        flights: The episodes.
        pilot: Who flies them.
        call: The arguments that made them, as a Python literal.
        measures: Metrics of users, whose code counts, too.

    Raises:
        ValueError: The policy cannot give the action.
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
    # As it comes back from a file, with which it is compared.
    return cast(dict[str, Any], json.loads(json.dumps(about)))


def hash_sources(package: Path = _PACKAGE) -> str:
    """Hash the Python files of a package, and the version of numba.

    Args:
        package: Folder of the package; all files below it count, by path and content.

    Returns:
        16 hexadecimal digits.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix().encode()
        digest.update(name + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@functools.cache
def _own_sources() -> str:
    """Hash this package once: what is edited later is not what this process runs."""
    return hash_sources()


def _fingerprint(
    flights: Flights[Any],
    spec: EnvSpec,
    models: Sequence[Path],
    measures: Sequence[MetricSpec],
) -> str:
    """Hash what decides the results and has no value to compare.

    That is the code, the airframes, the cities, and files of models.
    """
    # Code of the package, and of what comes from outside of it.
    digest = hashlib.sha256(_own_sources().encode())
    policy = flights.policy
    policies = policy.sides.values() if isinstance(policy, Versus) else (policy,)
    # Names and paths are compared by themselves
    for source in (*policies, *(metric.source for metric in measures)):
        if not isinstance(source, str | Path):
            digest.update(canonical_text(source).encode())
    for model in models:
        digest.update(model.read_bytes())
    digest.update(canonical_text(describe_parts(spec.options, spec.task)).encode())
    return digest.hexdigest()[:16]
