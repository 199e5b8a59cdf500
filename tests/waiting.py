"""Waiting for what must happen, however busy the machine is.

No test asserts on how long something takes: a limit only finds what would never end.
"""

import time

PATIENCE = 300.0
"""Seconds until something that has not happened counts as a hang"""
LONG = 1800.0
"""Seconds until a process that installs, compiles or trains counts as a hang"""


def until(condition, patience=PATIENCE, every=0.005):
    """Wait until a condition holds.

    Args:
        condition: Function without arguments.
        patience: Seconds after which waiting ends with an AssertionError.
        every: Seconds between two calls of the condition.
    """
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, f"not within {patience:.0f} s: {condition}"
        time.sleep(every)
