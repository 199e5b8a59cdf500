"""Messages that name the wrong value and the remedy."""

import difflib
from collections.abc import Iterable


def unknown(what: str, name: object, choices: Iterable[str]) -> ValueError:
    """An error for a name that is not among `choices`, offering the nearest ones."""
    choices = sorted(choices)
    near = difflib.get_close_matches(str(name), choices, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"choose from {', '.join(choices)}"
    return ValueError(f"unknown {what} {name!r}: {hint}")


def pick(what: str, name: str, table: dict):
    """`table[name]`, or `unknown` when it is not there."""
    if name not in table:
        raise unknown(what, name, table)
    return table[name]
