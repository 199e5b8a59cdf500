"""`python -m bulletuav` is the command `bulletuav`."""

from bulletuav.cli import main

main()
