"""Names of ingredients, read from source files: for help, completion and registration.

To list its tasks, the registry imports them, and with them Numba and SciPy, which takes a second.
Here nothing is imported. Functions read the declarations of the package's own ingredients: classes
and functions decorated with `@register(kind)`.
"""

import functools
import re
from pathlib import Path
from typing import NamedTuple

from bulletuav.registry import PACKAGES, entry_points

PACKAGE = Path(__file__).parent
DECLARED = re.compile(
    r'^@register\("(?P<kind>\w+)"\)\n(?:class|def) (?P<own>\w+).*?:\n    r?"""(?P<summary>.+)'
    r"(?P<body>(?:\n(?: .*)?)*)",
    re.MULTILINE,
)
"""An ingredient: a decorated class or function, the first line of its docstring, and the rest"""
SHIPPED_NAMES = ("trained", "untrained", "foundation")
"""Names of trained policies in the package; the first two select a different one for each task"""
NAME = re.compile(r'^    name(?:: .*)? = "(\w+)"', re.MULTILINE)
VERSION = re.compile(r"^    version(?:: .*)? = (\d+)", re.MULTILINE)


class Declaration(NamedTuple):
    """An ingredient of the package.

    Attributes:
        summary: First line of its docstring.
        version: Version of the environments of a task, 1 if the class does not set it.
    """

    summary: str
    version: int


@functools.cache
def declarations(kind: str) -> dict[str, Declaration]:
    """Return the package's own ingredients of a kind by name, sorted, without importing them.

    Args:
        kind: A kind of which the registry imports all modules of a package, such as "task".
    """
    home = PACKAGE.joinpath(*PACKAGES[kind].split(".")[1:])
    found = {}
    for path in home.rglob("*.py"):
        for match in DECLARED.finditer(path.read_text(encoding="utf-8")):
            if match["kind"] == kind:
                name, version = NAME.search(match["body"]), VERSION.search(match["body"])
                found[name[1] if name else match["own"]] = Declaration(
                    match["summary"].removesuffix('"""'), int(version[1]) if version else 1
                )
    return dict(sorted(found.items()))


def list_names(kind: str) -> list[str]:
    """Return the names of all installed ingredients of a kind, sorted, without importing them."""
    return sorted({*declarations(kind), *(point.name for point in entry_points(kind))})


def list_policies() -> list[str]:
    """Return the names of all policies, as `bulletuav.policies.policy_names` does."""
    return [*list_names("policy"), *SHIPPED_NAMES]
