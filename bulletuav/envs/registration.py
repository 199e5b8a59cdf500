"""Registration of all tasks with Gymnasium and PettingZoo, when these are imported.

Gymnasium 1 has no plugins any more: a package registers its ids when it is imported. Importing
Gymnasium and PettingZoo for that purpose would make `import bulletuav` slow. Therefore each of them
gets the ids as soon as it is imported, whichever package is imported first.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

from bulletuav.deferred_import import import_name

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

ENTRY_POINTS = {
    "CentralAviary": "bulletuav.envs.gymnasium",
    "CentralVectorAviary": "bulletuav.envs.gymnasium",
    "aec_env": "bulletuav.envs.parallel",
    "parallel_env": "bulletuav.envs.parallel",
}
"""Module of each class or function that makes an environment; imported on first use"""


def __getattr__(name: str) -> Any:
    """Import what makes an environment, for `make` of Gymnasium and PettingZoo."""
    if name not in ENTRY_POINTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_name(ENTRY_POINTS[name], name)


def format_id(task: str, version: int) -> str:
    """Return the id of a task for Gymnasium and PettingZoo: `bulletuav/Hover-v2` for hover."""
    return f"bulletuav/{task.title().replace('_', '')}-v{version}"


def register_gymnasium(tasks: Mapping[str, str]) -> None:
    """Register tasks, by id, for `gymnasium.make` and `gymnasium.make_vec`."""
    import gymnasium

    for name in tasks.keys() - gymnasium.registry:
        gymnasium.register(
            name,
            entry_point=f"{__name__}:CentralAviary",
            vector_entry_point=f"{__name__}:CentralVectorAviary",
            kwargs={"task": tasks[name]},
        )


def register_pettingzoo(tasks: Mapping[str, str]) -> None:
    """Register tasks, by id, for `pettingzoo.make`."""
    import pettingzoo

    # PettingZoo before 1.27 has no registry
    if not hasattr(pettingzoo, "register"):
        return
    for kind in ("parallel", "aec"):
        for name in tasks.keys() - getattr(pettingzoo, f"{kind}_registry"):
            entry_point = f"{__name__}:{kind}_env"
            pettingzoo.register(kind, name, entry_point, kwargs={"task": tasks[name]})


PACKAGES: dict[str, Callable[[Mapping[str, str]], None]] = {
    "gymnasium": register_gymnasium,
    "pettingzoo": register_pettingzoo,
}
"""Function that registers tasks with a package, by the name of the package"""


def _own_tasks() -> dict[str, str]:
    """Return the tasks of this package by id, without importing them."""
    from bulletuav.catalogue import declarations

    return {format_id(name, one.version): name for name, one in declarations("task").items()}


def register_plugins() -> None:
    """Register the tasks of other packages with the imported packages of `PACKAGES`.

    Only the class of such a task has its version. It cannot be imported while modules of this
    package are being imported, such as by the first import of Gymnasium.
    """
    imported = [register for name, register in PACKAGES.items() if name in sys.modules]
    if not imported:
        return
    from bulletuav.registry import entry_points

    points = entry_points("task")
    if not points:
        return
    from bulletuav.tasks import find_task, list_tasks

    names = {point.name for point in points}.intersection(list_tasks())
    tasks = {format_id(name, find_task(name).version): name for name in names}
    for register in imported:
        register(tasks)


class _Finder:
    """Finder of `PACKAGES`, which finds as the others do, and adds registration to the import."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> "ModuleSpec | None":
        """Find a package of `PACKAGES` by the other finders."""
        if name not in PACKAGES:
            return None
        others = [finder for finder in sys.meta_path if finder is not self]
        specs = (finder.find_spec(name, path, target) for finder in others)
        spec = next(filter(None, specs), None)
        if spec is None or spec.loader is None:
            return spec
        import_module = spec.loader.exec_module

        def import_and_register(module: ModuleType) -> None:
            import_module(module)
            PACKAGES[name](_own_tasks())
            if "bulletuav.tasks" not in sys.modules:
                register_plugins()

        # Each import has a loader object of its own
        spec.loader.exec_module = import_and_register  # type: ignore[method-assign]
        return spec


def register_on_import() -> None:
    """Register all tasks with Gymnasium and PettingZoo, now or when they are imported."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
    for name, register in PACKAGES.items():
        if name in sys.modules:
            register(_own_tasks())
    register_plugins()
