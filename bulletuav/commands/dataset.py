"""`bulletuav dataset`: record transitions of a policy for offline learning."""

import argparse

from bulletuav.commands.arguments import (
    print_piece,
    show_episodes,
)
from bulletuav.commands.evaluate import completed_case, shared_episodes
from bulletuav.commands.output import print_files


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
