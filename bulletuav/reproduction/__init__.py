"""Published tables, computed again: `bulletuav reproduce`.

Each file of `bulletuav.reproduction.tables` reproduces one published table: it states the
publication, where data comes from, and computes numbers that stand next to the published ones.
"""

import importlib
import pkgutil
from pathlib import Path

from bulletuav.errors import unknown
from bulletuav.reproduction.table import Reproduction

TABLES = "bulletuav.reproduction.tables"
"""Package of the tables"""


def list_reproductions() -> list[str]:
    """List the names of the published tables, sorted."""
    files = pkgutil.iter_modules([str(Path(__file__).parent / "tables")])
    return sorted(one.name.replace("_", "-") for one in files)


def find_reproduction(name: str) -> Reproduction:
    """Import the reproduction of a published table.

    Args:
        name: One of `list_reproductions()`.

    Raises:
        ValueError: If no table has this name.
    """
    if name not in list_reproductions():
        raise unknown("table", name, list_reproductions())
    module = importlib.import_module(f"{TABLES}.{name.replace('-', '_')}")
    found: Reproduction = module.REPRODUCTION
    return found
