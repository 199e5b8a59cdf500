"""Runs cases in a process, which may die, and lists what is wrong."""

import json
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PROGRAM = ["-m", "tests.fuzz.cases"]


class Fault(NamedTuple):
    """A case that ended otherwise than with a result or one clear error."""

    name: str
    seed: int
    index: int
    what: str

    def __str__(self):
        again = f"python -m tests.fuzz --only '{self.name}' --seed {self.seed} --case {self.index}"
        return f"{self.name}, seed {self.seed}, case {self.index}: {self.what}\n  again: {again}"


def run(wanted, seed, patience=3600):
    """Run cases.

    Args:
        wanted: First and last number, exclusive, of the cases of each format by its name.
        seed: What the damage is drawn from.
        patience: Seconds for all of them; cases that hang end by themselves, with a traceback.

    Returns:
        The faults, and the number of cases that were run.
    """
    waiting = dict(wanted)
    faults, count = [], 0
    while waiting:
        words = [f"{name}:{seed}:{first}:{last}" for name, (first, last) in waiting.items()]
        with tempfile.TemporaryFile() as errors:
            command = [sys.executable, *PROGRAM, *words]
            ended = subprocess.run(
                command, stdout=subprocess.PIPE, stderr=errors, cwd=ROOT, timeout=patience
            )
            errors.seek(0)
            told = errors.read().decode(errors="replace")
        lines = [json.loads(line) for line in ended.stdout.splitlines() if line.startswith(b"{")]
        done = [line for line in lines if "fault" in line]
        count += len(done)
        faults += [
            Fault(line["name"], seed, line["index"], line["fault"])
            for line in done
            if line["fault"]
        ]
        if ended.returncode == 0:
            break
        # It died in a case: go on with the next one
        last = lines[-1] if lines else {"name": next(iter(waiting)), "index": 10**9}
        code = ended.returncode
        how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        faults.append(Fault(last["name"], seed, last["index"], f"{how}\n{told[-3000:]}"))
        count += 1
        names = list(waiting)
        waiting = {name: waiting[name] for name in names[names.index(last["name"]) :]}
        waiting[last["name"]] = (last["index"] + 1, waiting[last["name"]][1])
        waiting = {name: (first, end) for name, (first, end) in waiting.items() if first < end}
    return faults, count
