"""Server of a simulator under comparison: one line asked, one line answered.

It imports only the standard library, as each simulator has an environment of its own.
"""

import gc
import json
import math
import os
import sys
import time
from collections.abc import Callable

# What the simulator prints, from its import on, is not an answer. So answers have a copy of
# standard output, and for everything else standard output becomes standard error.
ANSWERS = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)

SUBSTEPS = 24
"""Substeps of a decision: 240 Hz physics, 10 Hz decisions"""
GROUP = 1e-3
"""Least time between two looks at the clock, s"""
Call = Callable[[], object]
Case = Callable[[], tuple[Call, float]]
"""Function that builds what it measures and returns (call, count)"""


def grid(num_drones: int) -> list[tuple[float, float, float]]:
    """List where drones start: 2 m apart, 1 m up."""
    side = math.ceil(math.sqrt(num_drones))
    return [(2.0 * (i % side), 2.0 * (i // side), 1.0) for i in range(num_drones)]


def serve(cases: dict[str, Case], compile_rest: Callable[[], None] | None = None) -> None:
    """Answer each line {"case", "seconds"} on standard input until it ends.

    The answer on standard output is {"rate"}: the count of the case times its calls per CPU-second
    of this process, after a first call that compiles. What was built stays for the next question,
    until another case is asked for. A case that fails answers {"error"}.

    Args:
        cases: What can be asked for.
        compile_rest: What compiles all that the first call did not get to.
    """
    kept: dict[str, tuple[Call, float]] = {}
    for line in sys.stdin:
        question = json.loads(line)
        try:
            # Free what the last case built before the next one builds.
            if question["case"] not in kept:
                kept.clear()
                gc.collect()
                call, count = cases[question["case"]]()
                call()
                if compile_rest is not None:
                    compile_rest()
                kept[question["case"]] = call, count
            answer = {"rate": measure(*kept[question["case"]], question["seconds"])}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=ANSWERS, flush=True)


def measure(call: Call, count: float, seconds: float) -> float:
    """Measure `count` times the calls per CPU-second, with all threads of the process.

    The clock takes half a microsecond: fast calls are timed in groups of some milliseconds.
    """
    calls, group, before = 0, 1, 0.0
    begin = time.process_time()
    while (spent := time.process_time() - begin) < seconds:
        if spent - before < GROUP:
            group *= 2
        before = spent
        for _ in range(group):
            call()
        calls += group
    return count * calls / spent
