"""How a simulator under comparison answers: one line asked, one line told. Imports nothing but the standard library."""

import gc
import json
import math
import os
import sys
import time
from collections.abc import Callable

# What the simulator prints, from its import on, is not an answer: standard output becomes standard error for it.
ANSWERS = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)

SUBSTEPS = 24  # a decision: 240 Hz physics, 10 Hz decisions


def grid(num_drones: int) -> list[tuple[float, float, float]]:
    """Where drones start, 2 m apart, 1 m up."""
    side = math.ceil(math.sqrt(num_drones))
    return [(2.0 * (i % side), 2.0 * (i // side), 1.0) for i in range(num_drones)]


def serve(cases: dict[str, Callable[[], tuple[Callable[[], object], float]]]) -> None:
    """Answer each line {"case", "seconds"} on standard input with {"rate"} on standard output until it ends.

    A case builds what it measures and returns (call, count): rate is count times calls per CPU-second of this process, after
    a first call that compiles. What was built stays for the next question, as long as no other case is asked for. A case
    that fails answers {"error"}.
    """
    kept: dict[str, tuple[Callable[[], object], float]] = {}
    for line in sys.stdin:
        question = json.loads(line)
        try:
            if question["case"] not in kept:
                kept.clear()
                gc.collect()
                call, count = cases[question["case"]]()
                call()
                kept[question["case"]] = call, count
            answer = {"rate": measure(*kept[question["case"]], question["seconds"])}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=ANSWERS, flush=True)


def measure(call: Callable[[], object], count: float, seconds: float) -> float:
    """`count` times calls per CPU-second, all threads of the process counted."""
    calls, begin = 0, time.process_time()
    while (spent := time.process_time() - begin) < seconds:
        call()
        calls += 1
    return count * calls / spent
