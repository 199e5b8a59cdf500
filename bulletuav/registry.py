"""Registry of ingredients by name: tasks, dynamics, sensors, policies and other components.

An ingredient is specified by its name, as `module:Name`, or as the object itself. Names come from
three sources: the decorator `register`, entry points of other packages in the group
`bulletuav.<kind>`, and the files of airframes. The modules of a kind are imported when a name of
that kind is looked up for the first time.
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

from bulletuav.errors import shown, suggest_names, unknown

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
"""Where the package defines its own ingredients of each kind.

Either a module, or a package of which all modules are imported, those of its subpackages too.
"""

_registered: dict[str, dict[str, Any]] = {kind: {} for kind in PACKAGES}
_loaded: set[str] = set()
"""Kinds whose ingredients are all registered"""
_in_progress = threading.local()
"""Kinds that each thread is loading, as the attribute `kinds`"""


def register(kind: str, name: str | None = None) -> Callable[[Ingredient], Ingredient]:
    """Return a decorator that registers an ingredient under a name.

    Args:
        kind: One of `PACKAGES`, such as "sensor".
        name: Name of the ingredient; defaults to its attribute `name`, or else to its `__name__`.

    Returns:
        The decorator, which returns the decorated object unchanged.

    Raises:
        ValueError: If the kind is unknown, or the name is already registered for another
            ingredient.
    """
    table = _table(kind)

    def decorated(ingredient: Ingredient) -> Ingredient:
        own = name or getattr(ingredient, "name", None) or getattr(ingredient, "__name__", None)
        if not isinstance(own, str) or not own.isidentifier():
            raise ValueError(
                f"name of {kind} {shown(ingredient)} is {shown(own)}: a word is needed"
            )
        # Atomic: if two threads register different ingredients under one name, one of them fails
        kept = table.setdefault(own, ingredient)
        if kept is not ingredient and not _is_same(kept, ingredient):
            raise ValueError(f"{kind} {own!r} is registered already: choose another name")
        table[own] = ingredient
        return ingredient

    return decorated


def find(kind: str, source: Any, accepts: Callable[[Any], bool]) -> Any:
    """Return an ingredient by name, by `module:Name`, or the object itself if it is valid.

    Args:
        kind: One of `PACKAGES`.
        source: A registered name; `module:Name`, which imports that module; or an object.
        accepts: Function that returns True if an object is an ingredient of this kind.

    Returns:
        The ingredient.

    Raises:
        ValueError: If the name is unknown (the message suggests the closest matches), the module
            cannot be imported, or the object is not an ingredient of this kind.
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
    """Return the sorted names of all ingredients of a kind."""
    _load(kind)
    return sorted(_table(kind))


def require_declared(kind: str, ingredient: type, base: type, remedy: str = "") -> None:
    """Check that a user-defined class has no unknown public attribute, such as a typo.

    Known names are those of the classes of this package that the class derives from. Helper
    attributes of users begin with an underscore, are annotated in the class (`gain: float = 0.5`),
    or come from a base class that is not an ingredient.

    Args:
        kind: Kind of the ingredient, for the message.
        ingredient: The class.
        base: Base class of all ingredients of the kind.
        remedy: Further hint for the message.

    Raises:
        ValueError: If there is an unknown attribute. The message suggests the closest matches.
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
                    f"{suggest_names(name, public)} {remedy}Names of helpers begin with an "
                    f"underscore, or are annotated in the class"
                )


def _is_near(name: str, known: list[str]) -> bool:
    """Return True if a name is probably a misspelling of a known name."""
    return bool(difflib.get_close_matches(name, known, n=1, cutoff=0.85))


def _table(kind: str) -> dict[str, Any]:
    if kind not in _registered:
        raise unknown("kind of ingredient", kind, PACKAGES)
    return _registered[kind]


def _is_same(one: Any, other: Any) -> bool:
    """Return True if two objects are the same code, as before and after a module reload."""
    return all(
        getattr(one, name, one) == getattr(other, name, other)
        for name in ("__module__", "__qualname__")
    )


def _load(kind: str) -> None:
    """Import the package's own ingredients of a kind, and those of entry points.

    There is no lock. Threads that load a kind at the same time each import all of its modules, and
    Python's import locks make each wait for modules that another thread is importing. With a lock
    of this package, a thread that imports while it holds the lock could wait for a module that is
    being imported by a thread which waits for the lock: a deadlock.
    """
    _table(kind)
    if kind in _loaded:
        return
    loading = vars(_in_progress).setdefault("kinds", set())
    if kind in loading:  # a module looks up names of its own kind while it is imported
        return
    loading.add(kind)
    try:
        home = importlib.import_module(PACKAGES[kind])
        path = getattr(home, "__path__", ())
        for found in pkgutil.walk_packages(path, f"{PACKAGES[kind]}."):
            importlib.import_module(found.name)
        refused = _register_entry_points(kind)
    finally:
        loading.discard(kind)
    _loaded.add(kind)  # only now: other threads would miss ingredients still being imported
    for warning in refused:
        warnings.warn(warning, stacklevel=4)


def _register_entry_points(kind: str) -> list[str]:
    """Register the entry points of a kind; return a warning for each that fails."""
    refused = []
    for point in entry_points(kind):
        try:
            register(kind, point.name)(point.load())
        except Exception as error:  # errors of other packages must not break this package
            refused.append(f"entry point {point.name!r} of bulletuav.{kind} is ignored: {error}")
    return refused


def entry_points(kind: str) -> list[importlib.metadata.EntryPoint]:
    """Return the entry points by which other packages declare ingredients of a kind."""
    return list(_entry_points(tuple(sys.path)).select(group=f"bulletuav.{kind}"))


@functools.lru_cache(maxsize=1)
def _entry_points(_: tuple[str, ...]) -> Any:
    """Return the entry points of all packages on a search path; cached, as this is slow."""
    return importlib.metadata.entry_points()


def _imported(kind: str, module: str, attribute: str, accepts: Callable[[Any], bool]) -> Any:
    given = f"{kind} {module}:{attribute}"
    if not all(module.split(".")):  # only some of these raise ImportError
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
        raise ValueError(f"{given} is not there: {suggest_names(attribute, public)}")
    found = getattr(home, attribute)
    if not accepts(found):
        raise ValueError(f"{given} is {shown(found)}: that is no {kind}")
    return found
