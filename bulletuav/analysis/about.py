"""What decides the results of flights, as a file can tell it."""

import contextlib
import functools
import hashlib
import inspect
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numba
import numpy as np

from bulletuav.analysis.described import described
from bulletuav.analysis.episodes import BATCH, Flights
from bulletuav.analysis.metrics import MetricSpec
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
        "options": described(spec.options, spec.task.config),
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
    for source in (
        type(spec.task),
        *(policy.sides.values() if isinstance(policy, Versus) else (policy,)),
        *(metric.source for metric in measures),
        spec.options.dynamics,
        *(spec.options.observation or ()),
        *spec.options.sensors,
        *(term for term, _ in spec.options.reward.values()),
    ):
        digest.update(_code(source))
    for model in models:
        digest.update(model.read_bytes())
    # The numbers of airframes count, not where their files are.
    for airframe in spec.options.airframe:
        digest.update(repr(replace(airframe, urdf=Path())).encode())
    # Cities by their faces, and the arena that follows from them.
    for solids in spec.task.layouts():
        for corners, _ in solids.faces:
            digest.update(corners.tobytes())
    digest.update(np.concatenate([spec.task.arena_low, spec.task.arena_high]).tobytes())
    return digest.hexdigest()[:16]


def _code(source: object) -> bytes:
    """Tell a class, function or object from others: its name, and the file that it is from."""
    if isinstance(source, str | Path):
        return b""
    home: Any = source if inspect.isroutine(source) or inspect.isclass(source) else type(source)
    named = str(home.__qualname__)
    # What a function was made with counts, too.
    for cell in getattr(home, "__closure__", None) or ():
        named += repr(cell.cell_contents)
    # Parameters of an object count as well as its class.
    if home is not source:
        named += repr(getattr(source, "__dict__", {}))
    # The source of what is from an interactive session is not known.
    with contextlib.suppress(OSError, TypeError):
        return named.encode() + Path(inspect.getfile(home)).read_bytes()
    return named.encode()
