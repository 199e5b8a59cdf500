"""Arguments of `bulletuav doctor`."""

import argparse

ABOUT = {
    "help": "print versions, and what is installed, active or missing",
    "description": (
        "Print the versions, whether the C extension is active, and how to install what is missing."
    ),
    "epilog": """example:
  bulletuav doctor""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing: the command takes no arguments."""
