"""`bulletuav dataset`: record transitions of a policy for offline learning."""

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
    "help": "record the transitions of a policy as Parquet tables and Minari datasets",
    "description": (
        "Fly episodes and record observations, actions and rewards (extra dataset): Parquet tables "
        "of all drones, and a Minari dataset of each drone. The same command resumes an "
        "interrupted recording."
    ),
    "epilog": """examples:
  bulletuav dataset crossing --policy orca --episodes 100 --workers 2 --out flights
  bulletuav dataset crossing --dynamics point_mass --piece 3/8 --out flights""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add task, policy, episodes, output folder and environment options."""
    parser.add_argument("task", help="one of `bulletuav tasks`")
    parser.add_argument("--policy", help=f"{POLICY_HELP} (default: the baseline of the task)")
    add_episodes(parser)
    add_sharing(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in datasets/)"
    )
    add_options(parser)


def run(arguments: argparse.Namespace) -> None:
    """Record the dataset, and print the written files."""
    from bulletuav.analysis.dataset import collect  # which needs an extra

    # Check arguments before any episode is flown
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
    # A piece has only a part of the episodes
    if arguments.piece is not None:
        print_piece(arguments.piece, out)
        return
    # Print the folder of the tables, which are many
    tables = [path for path in files if path.suffix == ".parquet"]
    print_files([tables[0].parent, *files[len(tables) :]])
