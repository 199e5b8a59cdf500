"""Write `uv.lock` with the versions of `constraints.txt`, with which the suite runs.

    python tools/lock.py

It needs uv, of the extra `dev`. uv takes no file of constraints for a project. Therefore the
project is locked twice in a temporary folder: first with the constraints in its settings, and then
without them, where uv keeps the versions that it finds in the first lock file. Finally it removes
wheels that no supported Python can install, which halves the file.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
WHEEL = re.compile(r'^    { url = "[^"]*-([\w.]+)-([\w.]+)\.whl"')
"""Line of a wheel, with its tags of ABI and platform"""
OTHER_SYSTEMS = ("musllinux", "android", "ios", "pyemscripten")
ABIS = tuple(f"cp3{minor}" for minor in range(11, 15))
"""ABIs of Pythons with which the suite is locked; not of those without a global lock"""
UPLOADED = re.compile(r', upload-time = "[^"]*"')
FILES = ("pyproject.toml", "setup.cfg", "setup.py", "README.md", "uv.lock")


def constraints() -> list[str]:
    """Return the lines of constraints.txt of which no extra needs another version."""
    lines = _lines(ROOT / "constraints.txt")
    others = {line for path in ROOT.glob("constraints/*.txt") for line in _lines(path)}
    varied = {_name(line) for line in others.difference(lines)}
    return [line for line in lines if _name(line) not in varied]


def _lines(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if line and line[0] != "#"]


def _name(line: str) -> str:
    return re.split("[=<> ;]", line)[0]


def lock(folder: Path) -> None:
    """Write the lock file of the project in a folder."""
    subprocess.run([sys.executable, "-m", "uv", "lock"], cwd=folder, check=True)


def is_usable(line: str) -> bool:
    """Return False for a wheel that CPython 3.11 to 3.14 on a supported system does not take."""
    found = WHEEL.match(line)
    if found is None:
        return True
    abi, platform = found.groups()
    for_python = abi in ("none", "abi3") or abi in ABIS
    return for_python and not all(one.startswith(OTHER_SYSTEMS) for one in platform.split("."))


def shorten(text: str) -> str:
    """Leave out wheels that are not usable, and the times of uploads."""
    lines = text.splitlines(keepends=True)
    return UPLOADED.sub("", "".join(line for line in lines if is_usable(line)))


def main() -> None:
    """Lock a copy of the project twice, and keep the lock file."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in FILES:
            if (ROOT / file).exists():
                shutil.copy(ROOT / file, folder)
        (folder / "bulletuav").mkdir()
        shutil.copy(ROOT / "bulletuav" / "version.py", folder / "bulletuav")
        project = folder / "pyproject.toml"
        settings = project.read_text()
        pins = f"[tool.uv]\nconstraint-dependencies = {json.dumps(constraints())}\n"
        project.write_text(settings.replace("[tool.uv]\n", pins))
        lock(folder)
        project.write_text(settings)
        lock(folder)
        (ROOT / "uv.lock").write_text(shorten((folder / "uv.lock").read_text()))


if __name__ == "__main__":
    main()
