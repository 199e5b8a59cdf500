"""Entry point of `python -m bulletuav`, which is the same as the command `bulletuav`."""

from bulletuav.cli import main

main()
