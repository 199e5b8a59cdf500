"""Machine code that comes with the package, for three levels of x86-64 processors.

A wheel has machine code for the levels of `LEVELS`, so that a first run compiles nothing. The
import of this module selects the best level that the processor supports, and sets numba's target
to it: code that is compiled later fits to the shipped code. The target is that of the process,
user functions included. Numba is left unchanged, and code is compiled for the processor itself,

- if the package has no machine code, as in a source checkout,
- if the user has set `NUMBA_CPU_NAME` or `NUMBA_CPU_FEATURES`,
- if something else has initialised numba before, or
- after `bulletuav compile --native`.

`tools/build_code.py` builds the machine code.
"""

import hashlib
import sys
from pathlib import Path
from typing import NamedTuple

import llvmlite
import llvmlite.binding as llvm
import numba
from numba import config
from numba.core.registry import cpu_target

from bulletuav.compiled.folders import cache_folder
from bulletuav.version import __version__

BUILT = Path(__file__).with_name("shipped")
"""Folder of the machine code, with a subfolder for each level; absent if none was built"""
_V2 = ("cx16", "popcnt", "sahf", "sse4.2", "ssse3")
_V3 = (*_V2, "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave")
_V4 = (*_V3, "avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl")


class ProcessorLevel(NamedTuple):
    """A level of processors.

    Attributes:
        name: LLVM's name of the level.
        features: LLVM's names of the features that a processor of this level has.
        settings: Numba's setting of features. LLVM derives the others from the name; without any
            setting numba would add the features of the processor that compiles.
    """

    name: str
    features: tuple[str, ...]
    settings: str = ""


LEVELS = (
    # The setting makes blocks of lanes eight wide: see `bulletuav.compiled.lanes`
    ProcessorLevel("x86-64-v4", _V4, "+avx512f"),
    ProcessorLevel("x86-64-v3", _V3),
    ProcessorLevel("x86-64-v2", _V2),
)
"""Levels of the psABI of x86-64, the best first"""


def find_level(folder: Path) -> ProcessorLevel | None:
    """Return the best level that the processor supports and a folder has machine code for."""
    features = _host_features()
    if not config.ENABLE_AVX:
        features = {name: has and not name.startswith("avx") for name, has in features.items()}
    return next(
        (
            level
            for level in LEVELS
            if all(features.get(name) for name in level.features) and (folder / level.name).is_dir()
        ),
        None,
    )


def _host_features() -> dict[str, bool]:
    """Return LLVM's features of the processor; none if LLVM does not know them."""
    try:
        return dict(llvm.get_host_cpu_features())
    except RuntimeError:
        return {}


def target_features() -> str:
    """Return the features of numba's target in this process, such as "+avx2,-avx512f"."""
    features: str = cpu_target.target_context.codegen().magic_tuple()[2]
    return features


def native_mark() -> Path:
    """Return the file whose existence selects code for the processor itself.

    Its name depends on the processor, as computers may share a folder, and on the versions.
    """
    target = llvm.get_host_cpu_name(), sorted(_host_features().items())
    versions = __version__, numba.__version__, llvmlite.__version__, sys.implementation.cache_tag
    name = hashlib.sha256(repr((target, versions)).encode()).hexdigest()[:16]
    return cache_folder() / f"native-{name}"


def select_code(folder: Path) -> Path | None:
    """Set numba's target to a level for which there is machine code.

    Args:
        folder: Folder with a subfolder of machine code for each level.

    Returns:
        The subfolder; None if numba's target was left unchanged.
    """
    if config.CPU_NAME is not None or config.CPU_FEATURES is not None:
        return None
    level = find_level(folder)
    if level is None or native_mark().is_file():
        return None
    config.CPU_NAME, config.CPU_FEATURES = level.name, level.settings
    # The features of a target that was set up before are those of the processor
    if target_features() != level.settings:
        config.CPU_NAME = config.CPU_FEATURES = None
        return None
    return folder / level.name


CODE = select_code(BUILT)
"""Folder of the shipped machine code that this process uses; None if it uses none"""
