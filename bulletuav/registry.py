"""One registry of ingredients by name: tasks, dynamics, sensors, policies and other choices.

An ingredient is given by its name, as `module:Name`, or as the object itself. Names come from
three places: the decorator `register`, entry points of other packages in the group
`bulletuav.<kind>`, and the files of airframes. Nothing is imported before somebody asks for its
kind.
"""

import difflib
import functools
import importlib
import importlib.metadata
import inspect
import pkgutil
import sys
import threading
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

from bulletuav.errors import nearest, shown, unknown

Ingredient = TypeVar("Ingredient")

PACKAGES = {
    "task": "bulletuav.tasks",
    "airframe": "bulletuav.vehicle.airframe",
    "dynamics": "bulletuav.dynamics",
    "action": "bulletuav.control.actions",
    "controller": "bulletuav.control.cascade",
    "sensor": "bulletuav.sensors",
    "observation": "bulletuav.tasks.observations",
    "reward": "bulletuav.tasks.rewards",
    "metric": "bulletuav.analysis.metrics",
    "policy": "bulletuav.policies",
    "mobility": "bulletuav.network.mobility",
}
"""Where the package's own ingredients of each kind are.

Either a module, or a package whose modules are all imported.
"""

_registered: dict[str, dict[str, Any]] = {kind: {} for kind in PACKAGES}
_loaded: set[str] = set()
"""Kinds whose ingredients are all registered"""
_in_progress = threading.local()
"""Kinds that each thread is loading, as the attribute `kinds`"""


def register(kind: str, name: str | None = None) -> Callable[[Ingredient], Ingredient]:
    """Make a decorator that gives an ingredient its name.

    Args:
        kind: One of `PACKAGES`, such as "sensor".
        name: What users call it; the object's `name`, or else `__name__`, when left out.

    Returns:
        The decorator; it returns the object unchanged.

    Raises:
        ValueError: There is no such kind, or the name belongs to another ingredient already.
    """
    table = _table(kind)

    def decorated(ingredient: Ingredient) -> Ingredient:
        own = name or getattr(ingredient, "name", None) or getattr(ingredient, "__name__", None)
        if not isinstance(own, str) or not own.isidentifier():
            raise ValueError(
                f"name of {kind} {shown(ingredient)} is {shown(own)}: a word is needed"
            )
        # Atomic: of two threads with different ingredients of a name, one finds that of the other
        kept = table.setdefault(own, ingredient)
        if kept is not ingredient and not _is_same(kept, ingredient):
            raise ValueError(f"{kind} {own!r} is registered already: choose another name")
        table[own] = ingredient
        return ingredient

    return decorated


def find(kind: str, source: Any, accepts: Callable[[Any], bool]) -> Any:
    """Find an ingredient.

    Args:
        kind: One of `PACKAGES`.
        source: Its name; `module:Name`, which imports that module; or the object itself.
        accepts: Whether an object can be an ingredient of this kind.

    Returns:
        The object.

    Raises:
        ValueError: There is none of that name (the nearest are told), the module cannot be
            imported, or what was given is no ingredient of this kind.
    """
    if not isinstance(source, str):
        if accepts(source):
            return source
        raise unknown(kind, source, names(kind))
    module, colon, attribute = source.partition(":")
    if colon:
        return _imported(kind, module, attribute, accepts)
    _load(kind)
    if source not in _table(kind):
        raise unknown(kind, source, names(kind))
    found = _table(kind)[source]
    if not accepts(found):
        raise ValueError(f"{kind} {source!r} is registered as {shown(found)}: that is no {kind}")
    return found


def names(kind: str) -> list[str]:
    """List the names of all ingredients of a kind, sorted."""
    _load(kind)
    return sorted(_table(kind))


def require_declared(kind: str, ingredient: type, base: type, remedy: str = "") -> None:
    """Check that a class of an author has no public attribute that nothing reads, such as a typo.

    Known names are those of the classes of this package that the class derives from. Helpers of
    authors begin with an underscore, are annotated in the class (`gain: float = 0.5`), or come from
    a class beside it that is no ingredient.

    Args:
        kind: What the class is, for the message.
        ingredient: The class.
        base: Base class of all ingredients of the kind.
        remedy: What else the author may have meant, for the message.

    Raises:
        ValueError: There is such an attribute; the nearest known names are listed.
    """
    home = f"{__package__}."
    own = [one for one in ingredient.__mro__ if not one.__module__.startswith(home)]
    if not own:
        return
    package = (one for one in ingredient.__mro__ if one not in own)
    known = {name for one in package for name in (*vars(one), *inspect.get_annotations(one))}
    public = sorted(name for name in known if name[0] != "_")
    annotated = {name for one in own for name in inspect.get_annotations(one)}
    for one in own:
        if not issubclass(one, base):
            continue
        for name in sorted({*vars(one), *inspect.get_annotations(one)}):
            is_helper = name[0] == "_" or (name in annotated and not _is_near(name, public))
            if name not in known and not is_helper:
                raise ValueError(
                    f"{kind} {one.__name__} has {name!r}, which is no attribute of a {kind}: "
                    f"{nearest(name, public)} {remedy}Names of helpers begin with an underscore, "
                    f"or are annotated in the class"
                )


def _is_near(name: str, known: list[str]) -> bool:
    """Return True if a name is likely a typo of a known one."""
    return bool(difflib.get_close_matches(name, known, n=1, cutoff=0.85))


def _table(kind: str) -> dict[str, Any]:
    if kind not in _registered:
        raise unknown("kind of ingredient", kind, PACKAGES)
    return _registered[kind]


def _is_same(one: Any, other: Any) -> bool:
    """Tell whether two objects come from the same code, such as before and after a reload."""
    return all(
        getattr(one, name, one) == getattr(other, name, other)
        for name in ("__module__", "__qualname__")
    )


def _load(kind: str) -> None:
    """Import the package's own ingredients of a kind, and those of entry points.

    There is no lock. Threads that load a kind at the same time each import all of its modules, and
    Python's import locks make each wait for modules that another thread is importing. A thread that
    imports under a lock of ours could wait for a module whose importing thread waits for that lock.
    """
    _table(kind)
    if kind in _loaded:
        return
    loading = vars(_in_progress).setdefault("kinds", set())
    if kind in loading:  # a module asks for names of its own kind while it is imported
        return
    loading.add(kind)
    try:
        home = importlib.import_module(PACKAGES[kind])
        for found in pkgutil.iter_modules(getattr(home, "__path__", ())):
            importlib.import_module(f"{PACKAGES[kind]}.{found.name}")
        refused = _register_entry_points(kind)
    finally:
        loading.discard(kind)
    _loaded.add(kind)  # not before: another thread would not find what is still being imported
    for warning in refused:
        warnings.warn(warning, stacklevel=4)


def _register_entry_points(kind: str) -> list[str]:
    """Register what other packages offer of a kind; return a warning for each that fails."""
    group = f"bulletuav.{kind}"
    refused = []
    for point in _entry_points(tuple(sys.path)).select(group=group):
        try:
            register(kind, point.name)(point.load())
        except Exception as error:  # other packages' errors do not make ours unusable
            refused.append(f"entry point {point.name!r} of {group} is left out: {error}")
    return refused


@functools.lru_cache(maxsize=1)
def _entry_points(_: tuple[str, ...]) -> Any:
    """Read what all packages of a search path offer, once for all kinds: it takes long."""
    return importlib.metadata.entry_points()


def _imported(kind: str, module: str, attribute: str, accepts: Callable[[Any], bool]) -> Any:
    """Import `module:attribute`."""
    given = f"{kind} {module}:{attribute}"
    if not all(module.split(".")):  # of which only some are errors of the import
        raise ValueError(
            f"{given} cannot be imported: {module!r} is no whole name of a module, such as "
            f"'package.module'"
        )
    try:
        home = importlib.import_module(module)
    except ImportError as error:
        raise ValueError(f"{given} cannot be imported: {error}") from None
    if not hasattr(home, attribute):
        public = [one for one in vars(home) if one[0] != "_"]
        raise ValueError(f"{given} is not there: {nearest(attribute, public)}")
    found = getattr(home, attribute)
    if not accepts(found):
        raise ValueError(f"{given} is {shown(found)}: that is no {kind}")
    return found
