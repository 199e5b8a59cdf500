"""Arguments of the commands, one module each, which take no time to import.

Each module has `ABOUT` (its help texts) and `add_arguments(parser)`. The command itself, with all
that it imports, is the module of the same name in `bulletuav.commands`. Help texts that list names
of other modules are `DeferredHelp`: help of other commands and completion do not import these.
"""
