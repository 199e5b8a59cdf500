"""Arguments of `bulletuav compile`."""

import argparse

ABOUT = {
    "help": "compile all functions now, so that no later flight has to wait",
    "description": (
        "Fly short flights in all tasks, dynamics, actions and policies, and keep the functions "
        "that are compiled for them. Code that comes with the package is not compiled again. "
        "Without this command, each flight compiles what no earlier one has needed. For "
        "containers and clusters, run it once, with NUMBA_CACHE_DIR=FOLDER in a folder that all "
        "of them read."
    ),
    "epilog": """examples:
  bulletuav compile
  bulletuav compile --native""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the processor to compile for."""
    parser.add_argument(
        "--native",
        action="store_true",
        help="compile for exactly this processor, and use that code from now on instead of the "
        "code that comes with the package; without --native, use the latter again",
    )
