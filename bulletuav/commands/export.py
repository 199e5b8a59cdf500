"""`bulletuav export`: export a flight for other viewers, or a policy for other programs."""

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bulletuav.adapters.c_source import PRECISIONS, find_compiler, run_c, write_c
from bulletuav.adapters.deployed import Deployed, deployed
from bulletuav.adapters.hub import write_hub
from bulletuav.analysis.recorded import Recording
from bulletuav.analysis.recording import REMEDY
from bulletuav.commands.output import print_files
from bulletuav.errors import find_choice, reason_of
from bulletuav.policies.run import shipped, shipped_tasks
from bulletuav.report.figures import drone_colours
from bulletuav.report.replay import read_run


def _write_mcap(recording: Recording, path: Path) -> None:
    from bulletuav.adapters.mcap import write_mcap  # which needs an extra

    write_mcap(recording.everything(), path)


def _write_rrd(recording: Recording, path: Path) -> None:
    from bulletuav.adapters.rerun import write_rrd  # which needs an extra

    colours = drone_colours(recording.alive.shape[-1])
    # A seal proves only that a file is unchanged: its scene can still be invalid
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
"""Default file name and writer, by format of flights"""


def _write_c(policy: Deployed, path: Path, precision: str) -> tuple[list[Path], float]:
    files = write_c(policy, path, precision)
    # The comparison needs a compiler
    if find_compiler() is None:
        return files, math.nan
    return files, _difference(policy, run_c(path, policy.observations(), policy, precision))


def _write_onnx(policy: Deployed, path: Path, precision: str) -> tuple[list[Path], float]:
    from bulletuav.adapters.onnx import run_onnx, write_onnx  # which needs an extra

    files = write_onnx(policy, path, precision)
    return files, _difference(policy, run_onnx(path, policy.observations(), policy, precision))


def _difference(policy: Deployed, given: np.ndarray) -> float:
    """Return the maximum difference from the setpoints of the original policy."""
    return float(np.abs(given - policy.act(policy.observations())).max())


POLICIES: dict[str, tuple[str, Callable[[Deployed, Path, str], tuple[list[Path], float]]]] = {
    "c": ("policy.c", _write_c),
    "onnx": ("policy.onnx", _write_onnx),
}
"""Default file name and writer, by format of policies

A writer returns the files and the maximum difference of setpoints.
"""
HUB = "hub"
"""Format of folders for the Hugging Face Hub, and the name of such a folder in that of the run"""
AGREEMENT = 1e-6
"""Maximum difference of setpoints in double precision, in their units"""


def run(arguments: argparse.Namespace) -> None:
    """Write the file of a flight or a policy."""
    find_choice("format", arguments.to, {**FORMATS, **POLICIES, HUB: None})
    if arguments.to == HUB:
        _export_to_hub(arguments)
        return
    if arguments.to in POLICIES:
        _export_policy(arguments)
        return
    if arguments.precision is not None:
        raise ValueError(
            "--precision is for policies: the format of a flight defines its precision"
        )
    if arguments.airframe is not None:
        raise ValueError("--airframe is for policies: the airframes of a flight are recorded")
    name, write = FORMATS[arguments.to]
    recording, _ = read_run(arguments.run)
    folder = arguments.run if arguments.run.is_dir() else arguments.run.parent
    path = arguments.out or folder / name
    write(recording, path)
    print_files([path])


def _export_to_hub(arguments: argparse.Namespace) -> None:
    """Write the folder of a policy and its environment for the Hugging Face Hub."""
    for name in ("precision", "airframe"):
        if getattr(arguments, name) is not None:
            raise ValueError(f"--{name} is for the formats {', '.join(POLICIES)}: leave it out")
    run = arguments.run
    if not run.exists() and str(run) in shipped_tasks():
        run = shipped(str(run))
        if arguments.out is None:
            raise ValueError(f"--out is missing: say where the policy for {run.name} goes")
    print_files(write_hub(run, arguments.out or run / HUB, arguments.trust))


def _export_policy(arguments: argparse.Namespace) -> None:
    """Write a policy, and print how well the file agrees with the original."""
    name, write = POLICIES[arguments.to]
    precision = arguments.precision or PRECISIONS[0]
    find_choice("precision", precision, dict.fromkeys(PRECISIONS))
    files, difference = write(
        deployed(arguments.run, arguments.trust, arguments.airframe),
        arguments.out or arguments.run / name,
        precision,
    )
    if precision == "double" and difference > AGREEMENT:
        raise ValueError(f"{files[0]} differs from the policy by {difference:.2g}: report it")
    print_files(files)
    text = (
        "not compared: no C compiler is installed"
        if math.isnan(difference)
        else f"setpoints agree with the policy to {difference:.1g}"
    )
    print(f"{text} ({precision})")
