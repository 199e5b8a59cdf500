"""Build of the optional C extensions.

Everything else about the package is in pyproject.toml.
"""

import shutil
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_py import build_py

FLAGS = [] if sys.platform == "win32" else ["-g0", "-ffp-contract=off"]
"""Of compilers: no paths of the machine, so that two builds are equal; no rounding of their own"""


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


setup(
    ext_modules=[
        Extension(name, [f"{name.replace('.', '/')}.c"], extra_compile_args=FLAGS, optional=True)
        for name in ("bulletuav.engine._batch", "bulletuav.envs._agents")
    ],
    cmdclass={"build_py": BuildWithAssets},
)
