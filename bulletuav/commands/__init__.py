"""Commands of the command line, one module each.

Each module has `ABOUT` (its help texts), `add_arguments(parser)` and `run(arguments)`.
"""
