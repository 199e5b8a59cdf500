"""`bulletuav export`: a flight for viewers of others, or a policy for other programs."""

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bulletuav.adapters.c_source import PRECISIONS, compiler, run_c, write_c
from bulletuav.adapters.deployed import Deployed, deployed
from bulletuav.analysis.recorded import Recording
from bulletuav.analysis.recording import REMEDY
from bulletuav.commands.arguments import add_trust
from bulletuav.commands.output import print_files
from bulletuav.errors import choose, reason_of
from bulletuav.report.figures import drone_colours
from bulletuav.report.replay import read_run

ABOUT = {
    "help": "write a flight for ROS 2 or Rerun, or a trained policy as C or ONNX",
    "description": (
        "Write what `bulletuav fly` recorded as one file for programs of others: MCAP with "
        "messages of ROS 2 (extra mcap), or .rrd of the viewer Rerun (extra rerun). Or write what "
        "`bulletuav train` learned, from raw observations to setpoints: as plain C, or as ONNX "
        "(extra onnx). A written policy is compared with its own."
    ),
    "epilog": """examples:
  bulletuav fly crossing --out flight && bulletuav export flight --to mcap
  bulletuav export flight --to rerun --out crossing.rrd
  bulletuav train crossing --out crossing-run && bulletuav export crossing-run --to c
  bulletuav export crossing-run --to onnx --precision double""",
}


def _write_mcap(recording: Recording, path: Path) -> None:
    from bulletuav.adapters.mcap import write_mcap  # which needs an extra

    write_mcap(recording.everything(), path)


def _write_rrd(recording: Recording, path: Path) -> None:
    from bulletuav.adapters.rerun import write_rrd  # which needs an extra

    colours = drone_colours(recording.alive.shape[-1])
    # Seals hold for whoever made them: what is in a sealed scene can still be odd.
    try:
        write_rrd(recording.everything(), colours, path)
    except (KeyError, TypeError, IndexError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(
            f"the scene of the recording is damaged ({reason_of(error)}): {REMEDY}"
        ) from None


FORMATS: dict[str, tuple[str, Callable[[Recording, Path], None]]] = {
    "mcap": ("flight.mcap", _write_mcap),
    "rerun": ("flight.rrd", _write_rrd),
}
"""Name of the file beside the recording, and what writes it, by format"""


def _write_c(policy: Deployed, path: Path, precision: str) -> tuple[list[Path], float]:
    files = write_c(policy, path, precision)
    # Where there is no compiler there is nothing to compare by.
    if compiler() is None:
        return files, math.nan
    return files, _difference(policy, run_c(path, policy.observations(), policy, precision))


def _write_onnx(policy: Deployed, path: Path, precision: str) -> tuple[list[Path], float]:
    from bulletuav.adapters.onnx import run_onnx, write_onnx  # which needs an extra

    files = write_onnx(policy, path, precision)
    return files, _difference(policy, run_onnx(path, policy.observations(), policy, precision))


def _difference(policy: Deployed, given: np.ndarray) -> float:
    """Give the largest difference from the policy's own setpoints."""
    return float(np.abs(given - policy.act(policy.observations())).max())


POLICIES: dict[str, tuple[str, Callable[[Deployed, Path, str], tuple[list[Path], float]]]] = {
    "c": ("policy.c", _write_c),
    "onnx": ("policy.onnx", _write_onnx),
}
"""The same for policies; what writes tells its files and the largest difference of setpoints"""
AGREEMENT = 1e-6
"""Largest difference of setpoints in double precision, in their units"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flight or the policy, the format, and where to write."""
    parser.add_argument(
        "run",
        type=Path,
        metavar="RUN",
        help="folder that `bulletuav fly` wrote; of a policy that of `bulletuav train`, or of one "
        "of its checkpoints",
    )
    parser.add_argument(
        "--to",
        required=True,
        metavar="FORMAT",
        help=f"flights: {' or '.join(FORMATS)}; policies: {' or '.join(POLICIES)}",
    )
    parser.add_argument(
        "--precision", help=f"numbers of a policy: {' or '.join(PRECISIONS)} (default: float)"
    )
    add_trust(parser)
    names = ", ".join(name for name, _ in [*FORMATS.values(), *POLICIES.values()])
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help=f"the file (default: {names} in the folder)"
    )


def run(arguments: argparse.Namespace) -> None:
    """Write the file."""
    choose("format", arguments.to, {**FORMATS, **POLICIES})
    if arguments.to in POLICIES:
        _export_policy(arguments)
        return
    if arguments.precision is not None:
        raise ValueError("--precision is of policies: a flight has that of its format")
    name, write = FORMATS[arguments.to]
    recording, _ = read_run(arguments.run)
    folder = arguments.run if arguments.run.is_dir() else arguments.run.parent
    path = arguments.out or folder / name
    write(recording, path)
    print_files([path])


def _export_policy(arguments: argparse.Namespace) -> None:
    """Write a policy, and tell how well the file agrees with it."""
    name, write = POLICIES[arguments.to]
    precision = arguments.precision or PRECISIONS[0]
    choose("precision", precision, dict.fromkeys(PRECISIONS))
    files, difference = write(
        deployed(arguments.run, arguments.trust), arguments.out or arguments.run / name, precision
    )
    if precision == "double" and difference > AGREEMENT:
        raise ValueError(f"{files[0]} differs from the policy by {difference:.2g}: report it")
    print_files(files)
    told = (
        "not compared: no C compiler is installed"
        if math.isnan(difference)
        else f"setpoints agree with the policy to {difference:.1g}"
    )
    print(f"{told} ({precision})")
