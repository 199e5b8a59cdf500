"""Draw the rooms of the package and what imports what: `python tools/rooms.py [--dot]`.

Prints each room with the rooms that it imports, lowest first; with --dot a graph for Graphviz. The order of the rooms
is the rule that `tests/test_architecture.py` holds.
"""

import argparse
import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "bulletuav"
ROOMS = (
    ("version", "errors", "files", "kernel", "registry"),
    ("geometry",),
    ("conflict", "vehicle"),
    ("engine", "control"),
    ("dynamics",),
    ("city",),
    ("network", "sensors"),
    ("tasks",),
    ("envs",),
    ("policies",),
    ("adapters",),
    ("analysis",),
    ("training",),
    ("report", "bridges", "identification"),
    ("commands",),
    ("cli", "__init__"),
    ("__main__",),
)
"""Rooms of one line do not import each other, except where `NEIGHBOURS` says so"""
NEIGHBOURS = {
    ("policies",),
    ("adapters",),
    ("kernel", "errors"),
    ("registry", "errors"),
    ("files", "errors"),
}


def imported(path: Path) -> Iterator[tuple[str, bool]]:
    """Yield (module, whether it is imported when the file is) of every import in a file."""
    tree = ast.parse(path.read_text())
    at_once = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, id(node) in at_once) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{path}: relative import"
            yield node.module, id(node) in at_once
            for alias in node.names:  # `from bulletuav.room import module`
                if (PACKAGE.parent / node.module.replace(".", "/") / f"{alias.name}.py").is_file():
                    yield f"{node.module}.{alias.name}", id(node) in at_once


def room_of(path: Path) -> str:
    """Name the room that a file of the package belongs to."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def graph() -> dict[str, set[str]]:
    """Map each room to the other rooms that its files import, imports for type checking included."""
    found: dict[str, set[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        others = found.setdefault(room_of(path), set())
        for module, _ in imported(path):
            parts = module.split(".")
            if parts[0] == "bulletuav" and len(parts) > 1:
                others.add(parts[1])
        others.discard(room_of(path))
    return found


def main() -> None:
    """Print the rooms."""
    parser = argparse.ArgumentParser(description="Draw the rooms of the package and their imports.")
    parser.add_argument("--dot", action="store_true", help="a graph for Graphviz")
    dot, rooms = parser.parse_args().dot, graph()
    if dot:
        edges = [f'  "{one}" -> "{other}";' for one in rooms for other in sorted(rooms[one])]
        print("\n".join(("digraph rooms {", "  rankdir=BT;", *edges, "}")))
        return
    for names in ROOMS:
        for name in names:
            if name in rooms:
                print(f"{name:12} <- {', '.join(sorted(rooms[name])) or 'nothing'}")


if __name__ == "__main__":
    main()
