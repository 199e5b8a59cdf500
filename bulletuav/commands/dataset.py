"""`bulletuav dataset`: flights of a policy, for others to learn from."""

import argparse
from pathlib import Path

from bulletuav.commands.arguments import (
    POLICY_HELP,
    add_episodes,
    add_options,
    add_sharing,
    print_piece,
    show_episodes,
)
from bulletuav.commands.evaluate import completed_case, shared_episodes
from bulletuav.commands.output import print_files

ABOUT = {
    "help": "fly episodes and keep every transition, as Parquet tables and for Minari",
    "description": (
        "Fly episodes and keep what drones observed and did (extra dataset): Parquet tables of all "
        "drones, and a dataset of Minari for each. The same command continues where it was "
        "interrupted."
    ),
    "epilog": """examples:
  bulletuav dataset crossing --policy orca --episodes 100 --workers 2 --out flights
  bulletuav dataset crossing --dynamics point_mass --piece 3/8 --out flights""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the task, the policy, how many episodes, where to write, and the options."""
    parser.add_argument("task", help="one of `bulletuav tasks`")
    parser.add_argument("--policy", help=f"who flies: {POLICY_HELP} (default: the task's)")
    add_episodes(parser)
    add_sharing(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in datasets/)"
    )
    add_options(parser)


def run(arguments: argparse.Namespace) -> None:
    """Collect, and tell what was written."""
    from bulletuav.analysis.dataset import collect  # which needs an extra

    # Bad arguments end the command before anything is flown
    task, policy, options, out = completed_case(arguments, "datasets")
    with show_episodes(shared_episodes(arguments)) as advance:
        files = collect(
            task,
            policy,
            episodes=arguments.episodes,
            seed=arguments.seed,
            workers=arguments.workers,
            out=out,
            progress=advance,
            trust=arguments.trust,
            piece=arguments.piece,
            ray=arguments.ray,
            **options,
        )
    # A piece is a share of the episodes: nothing is complete yet
    if arguments.piece is not None:
        print_piece(arguments.piece, out)
        return
    # Tables are many: their folder stands for them
    tables = [path for path in files if path.suffix == ".parquet"]
    print_files([tables[0].parent, *files[len(tables) :]])
