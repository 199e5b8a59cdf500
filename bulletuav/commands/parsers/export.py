"""Arguments of `bulletuav export`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp
from bulletuav.commands.parsers.shared import add_trust

ABOUT = {
    "help": "export a flight for ROS 2 or Rerun, or a trained policy as C, as ONNX or for a hub",
    "description": (
        "Export a recording of `bulletuav fly` as one file for other programs: MCAP with "
        "messages of ROS 2 (extra mcap), or .rrd of the viewer Rerun (extra rerun). Or export a "
        "policy of `bulletuav train`, from raw observations to setpoints: as C99, or as ONNX "
        "(extra onnx). The exported policy is compared with the original. Or write a policy of "
        "`bulletuav train`, or of the package, as a folder for the Hugging Face Hub, with a model "
        "card and its environment."
    ),
    "epilog": """examples:
  bulletuav fly crossing --out flight && bulletuav export flight --to mcap
  bulletuav export flight --to rerun --out crossing.rrd
  bulletuav train crossing --out crossing-run && bulletuav export crossing-run --to c
  bulletuav export crossing-run --to onnx --precision double
  bulletuav export crossing-run --to c --airframe racer
  bulletuav export interception --to hub --out interception-hub""",
}


@DeferredHelp
def _formats() -> str:
    from bulletuav.commands.export import FORMATS, HUB, POLICIES

    return f"flights: {' or '.join(FORMATS)}; policies: {', '.join(POLICIES)} or {HUB}"


@DeferredHelp
def _files() -> str:
    from bulletuav.commands.export import FORMATS, HUB, POLICIES

    names = ", ".join(name for name, _ in [*FORMATS.values(), *POLICIES.values()])
    return f"output file, or the folder for a hub (default: {names}, {HUB} in the folder)"


@DeferredHelp
def _precisions() -> str:
    from bulletuav.adapters.c_source import PRECISIONS

    return f"precision of a policy: {' or '.join(PRECISIONS)} (default: float)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flight or the policy, the format, and the output file."""
    parser.add_argument(
        "run",
        type=Path,
        metavar="RUN",
        help="folder of `bulletuav fly`; for policies the folder of `bulletuav train`, or of one "
        "of its checkpoints; for a hub also the name of a task with a policy in the package",
    )
    parser.add_argument(
        "--to",
        required=True,
        metavar="FORMAT",
        help=_formats,
    )
    parser.add_argument("--precision", help=_precisions)
    parser.add_argument(
        "--airframe",
        metavar="NAME",
        help="airframe of a policy that flies several: a name, or the path of a URDF",
    )
    add_trust(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help=_files)
