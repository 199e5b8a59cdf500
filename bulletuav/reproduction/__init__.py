"""Published tables, computed again: `bulletuav reproduce`.

Each file of `bulletuav.reproduction.tables` reproduces one published table: it states the
publication, where data comes from, and computes numbers that stand next to the published ones.
"""

import importlib
import pkgutil

from bulletuav.errors import unknown
from bulletuav.reproduction import tables
from bulletuav.reproduction.table import Reproduction


def list_reproductions() -> list[str]:
    """List the names of the published tables, sorted."""
    return sorted(one.name.replace("_", "-") for one in pkgutil.iter_modules(tables.__path__))


def find_reproduction(name: str) -> Reproduction:
    """Import the reproduction of a published table.

    Args:
        name: One of `list_reproductions()`.

    Raises:
        ValueError: If no table has this name.
    """
    if name not in list_reproductions():
        raise unknown("table", name, list_reproductions())
    module = importlib.import_module(f"{tables.__name__}.{name.replace('-', '_')}")
    found: Reproduction = module.REPRODUCTION
    return found
