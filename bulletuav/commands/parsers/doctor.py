"""Arguments of `bulletuav doctor`."""

import argparse

ABOUT = {
    "help": "print versions, and what is installed, active or missing",
    "description": (
        "Print a summary and how to install missing parts, then all versions and active features."
    ),
    "epilog": """example:
  bulletuav doctor""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing: the command takes no arguments."""
