"""The optional extension, and a clear word where pybullet could not be built; everything else is in setup.cfg."""

import os
import shutil
import sys
import sysconfig
from pathlib import Path

from setuptools import Extension, setup

WHEELS_UNTIL = (3, 11)  # the newest Python for which pybullet 3.2.7 has wheels


def lacks_compiler() -> bool:
    """Tell whether pybullet has to be built here and cannot be."""
    if sys.version_info[:2] <= WHEELS_UNTIL or sys.platform == "win32":  # where setuptools finds its compiler itself
        return False
    if list(Path(sysconfig.get_path("platlib")).glob("pybullet*")):
        return False
    compiler = os.environ.get("CXX") or sysconfig.get_config_var("CXX") or "c++"
    return shutil.which(compiler.split()[0]) is None


if lacks_compiler():
    raise SystemExit(
        f"bulletuav needs pybullet, which has no wheel for Python {sys.version_info[0]}.{sys.version_info[1]}: "
        "building it takes a C++ compiler, and there is none. "
        "Install one (on Debian or Ubuntu: apt-get install g++), or a pybullet built elsewhere first, or use Python 3.11."
    )
setup(ext_modules=[Extension("bulletuav.physics._batch", ["bulletuav/physics/_batch.c"], optional=True)])
