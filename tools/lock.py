"""Write `uv.lock` with the versions of `constraints.txt`, with which the suite runs.

    python tools/lock.py

It needs uv, of the extra `dev`. uv takes no file of constraints for a project. Therefore the
project is locked twice in a temporary folder: first with the constraints in its settings, and then
without them, where uv keeps the versions that it finds in the first lock file.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
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
        shutil.copy(folder / "uv.lock", ROOT)


if __name__ == "__main__":
    main()
