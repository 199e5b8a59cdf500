"""Build of the optional C extension, and a plain message where pybullet cannot be built.

Everything else about the package is in pyproject.toml.
"""

import os
import shutil
import sys
import sysconfig
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_py import build_py

FLAGS = [] if sys.platform == "win32" else ["-g0", "-ffp-contract=off"]
"""Of compilers: no paths of the machine, so that two builds are equal; no rounding of their own"""
WHEELS_UNTIL = (3, 11)  # the newest Python for which pybullet 3.2.7 has wheels


class BuildWithAssets(build_py):
    """Build that copies the top-level `assets/` into the package.

    An editable install reads them where they are.
    """

    def run(self) -> None:
        """Build, then copy."""
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib, "bulletuav", "assets")
            shutil.copytree("assets", target, dirs_exist_ok=True)


def lacks_compiler() -> bool:
    """Tell whether pybullet has to be built here and cannot be."""
    has_wheel = sys.version_info[:2] <= WHEELS_UNTIL
    # On Windows setuptools finds its compiler by itself, not by its name.
    if has_wheel or sys.platform == "win32":
        return False
    # A pybullet that was built elsewhere may be there already.
    if list(Path(sysconfig.get_path("platlib")).glob("pybullet*")):
        return False
    compiler = os.environ.get("CXX") or sysconfig.get_config_var("CXX") or "c++"
    return shutil.which(compiler.split()[0]) is None


if lacks_compiler():
    version = f"{sys.version_info[0]}.{sys.version_info[1]}"
    raise SystemExit(
        f"bulletuav needs pybullet, which has no wheel for Python {version}: "
        "building it takes a C++ compiler, and there is none. "
        "Install one (on Debian or Ubuntu: apt-get install g++), or a pybullet built elsewhere "
        "first, or use Python 3.11."
    )
setup(
    ext_modules=[
        Extension(name, [f"{name.replace('.', '/')}.c"], extra_compile_args=FLAGS, optional=True)
        for name in ("bulletuav.engine._batch", "bulletuav.envs._agents")
    ],
    cmdclass={"build_py": BuildWithAssets},
)
