"""Simulators under comparison: the environments that they are installed in, and their processes."""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
PACKAGES = {
    "PyFlyt": ["PyFlyt==0.29.0"],
    "crazyflow": ["crazyflow==0.4.0"],
    "VMAS": ["torch==2.13.0", "vmas==1.5.2"],
    "gym-pybullet-drones": [
        "pybullet==3.2.7",
        "numpy==1.26.4",
        "gymnasium==1.2.2",
        "scipy",
        "matplotlib",
        "transforms3d",
        "pillow",
        "setuptools<81",
    ],
    "gym-pybullet-drones-ppo": [
        "torch==2.13.0",
        "stable_baselines3==2.9.2",
        "gymnasium==1.2.2",
        "numpy==2.4.6",
        "pybullet==3.2.7",
        "matplotlib",
        "pillow",
        "scipy",
        "transforms3d",
        "setuptools<81",
    ],
    "urbanmarl": ["torch==2.13.0", "torchrl==0.14.1", "matplotlib"],
}
"""Packages in the environment of each peer, at the versions that were measured"""
WITHOUT_DEPENDENCIES = {"urbanmarl": ["urbanmarl==0.3.1"]}
"""Further packages, without what they ask for: there are no versions of it that go together"""
SINGLE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
"""Environment variables that keep a process to one thread on the CPU"""


def single_thread_variables(**more: str) -> dict[str, str]:
    """Give the environment variables of a process that is measured."""
    return {**os.environ, **SINGLE_THREAD, **more}


def install(peer: str, folder: Path) -> Path:
    """Make the environment of a peer below `folder`, unless it is there already.

    Returns:
        Its Python.
    """
    python = folder / peer / "bin" / "python"
    done = folder / peer / "packages.txt"
    further = WITHOUT_DEPENDENCIES.get(peer, [])
    wanted = "\n".join(PACKAGES[peer] + further)
    if done.exists() and done.read_text() == wanted:
        return python

    pip = [python, "-m", "pip", "install", "-q"]
    subprocess.run([sys.executable, "-m", "venv", folder / peer], check=True)
    subprocess.run([*pip, *PACKAGES[peer]], check=True)
    if further:
        subprocess.run([*pip, "--no-deps", *further], check=True)
    done.write_text(wanted)
    return python


class Server:
    """A simulator in a process of its own, which answers questions; see peers/serve.py."""

    def __init__(self, python: Path | str, script: str, *arguments: str):
        """Start the process.

        Args:
            python: Interpreter of the simulator's environment.
            script: File in peers/ that serves it.
            arguments: Arguments of the script.
        """
        command = [str(python), str(HERE / "peers" / script), *arguments]
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115, closed with the process
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env=single_thread_variables(),
            cwd=tempfile.gettempdir(),  # some leave logs where they run
        )

    def rate(self, case: str, seconds: float) -> float:
        """Measure the rate of a case for so many CPU-seconds.

        Raises:
            RuntimeError: The simulator failed; the message has its own words.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        # An ended process closes the pipe; then no answer comes either, which is told below.
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps({"case": case, "seconds": seconds}) + "\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        answer = json.loads(line) if line else {"error": self._last_words()}
        if "error" in answer:
            raise RuntimeError(f"{case}: {answer['error']}")
        return answer["rate"]

    def _last_words(self) -> str:
        """Tell how the process ended, with the last line that it wrote on standard error."""
        code = self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().strip().splitlines()
        return f"its process ended with code {code}" + (f": {lines[-1]}" if lines else "")

    def close(self) -> None:
        """End the process."""
        self._errors.close()
        self._process.kill()
        with contextlib.suppress(BrokenPipeError):
            self._process.communicate()
