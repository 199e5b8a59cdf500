"""Print the rooms of the package and what imports what.

    python tools/rooms.py          # each room with the rooms that it imports, lowest first
    python tools/rooms.py --dot    # the same as a graph for Graphviz

A room is a folder or a single file right below `bulletuav/`. Their order in `ROOMS` is the rule
that `tests/test_architecture.py` holds.
"""

import argparse
import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "bulletuav"
ROOMS = (
    ("version", "errors", "interrupts", "cores", "deferred_import"),
    ("compiled", "files", "parsing", "registry"),
    ("catalogue",),
    ("geometry", "earth"),
    ("conflict", "vehicle"),
    ("engine", "control"),
    ("contact",),
    ("dynamics",),
    ("city",),
    ("network", "sensors"),
    ("tasks",),
    ("envs",),
    ("policies", "serving"),
    ("adapters",),
    ("analysis",),
    ("training",),
    ("report", "bridges", "identification"),
    ("reproduction",),
    ("commands",),
    ("cli", "__init__"),
    ("__main__",),
)
"""Rooms, lowest first; each imports only from lines above its own"""


def imported(path: Path) -> Iterator[tuple[str, bool]]:
    """Find all imports in a file, those inside of functions included.

    Args:
        path: A Python file.

    Yields:
        The name of a module, and whether it is imported as soon as the file is.
    """
    tree = ast.parse(path.read_text())
    at_once = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, id(node) in at_once) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None  # as only a relative import can lack it
            yield node.module, id(node) in at_once
            # In `from bulletuav.room import name` the name may be a module, too.
            folder = PACKAGE.parent / node.module.replace(".", "/")
            for alias in node.names:
                if (folder / f"{alias.name}.py").is_file():
                    yield f"{node.module}.{alias.name}", id(node) in at_once


def room_of(path: Path) -> str:
    """Name the room that a file of the package belongs to."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def graph() -> dict[str, set[str]]:
    """Map each room to the others that its files import, imports for type checking included."""
    imports: dict[str, set[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        room = room_of(path)
        others = imports.setdefault(room, set())
        for module, _ in imported(path):
            parts = module.split(".")
            if parts[0] == "bulletuav" and len(parts) > 1:
                others.add(parts[1])
        others.discard(room)
    return imports


def print_dot(imports: dict[str, set[str]]) -> None:
    """Print a graph for Graphviz, whose edges go from a room to those that it imports."""
    print("digraph rooms {")
    print("  rankdir=BT;")
    for room, others in imports.items():
        for other in sorted(others):
            print(f'  "{room}" -> "{other}";')
    print("}")


def print_list(imports: dict[str, set[str]]) -> None:
    """Print each room with the rooms that it imports, lowest first."""
    for line in ROOMS:
        for room in line:
            if room in imports:
                print(f"{room:12} <- {', '.join(sorted(imports[room])) or 'nothing'}")


def main() -> None:
    """Print the rooms."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--dot", action="store_true", help="print a graph for Graphviz")
    arguments = parser.parse_args()
    if arguments.dot:
        print_dot(graph())
    else:
        print_list(graph())


if __name__ == "__main__":
    main()
