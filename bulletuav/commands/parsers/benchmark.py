"""Arguments of `bulletuav benchmark`."""

import argparse

from bulletuav.commands.parsers.deferred import DeferredHelp

SECONDS = 0.3
"""CPU time of one measurement, s"""


ABOUT = {
    "help": "measure the speed of this machine for each dynamics model",
    "description": (
        "Print physics steps of drones per CPU-second for each dynamics model, the same for bare "
        "calls of the physics engine, and the duration of a reset. With --stages, print the "
        "duration of each stage of a decision of a task instead."
    ),
    "epilog": """examples:
  bulletuav benchmark
  bulletuav benchmark --drones 1 10 100 --seconds 1
  bulletuav benchmark --stages crossing""",
}


@DeferredHelp
def _swarm_sizes() -> str:
    from bulletuav.analysis.benchmark import SWARM_SIZES

    return f"numbers of drones (default: {' '.join(map(str, SWARM_SIZES))})"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --drones, --seconds and --stages."""
    parser.add_argument(
        "--drones",
        type=int,
        nargs="+",
        metavar="N",
        help=_swarm_sizes,
    )
    parser.add_argument(
        "--seconds",
        type=float,
        help=f"CPU time of one measurement in s (default: {SECONDS})",
    )
    parser.add_argument("--stages", metavar="TASK", help="measure the stages of this task")
