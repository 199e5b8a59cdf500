"""Ctrl-C ends the command line with one line and exit status 130, whenever it comes.

`bulletuav` imports this module first. While the package is loading, and again while Python exits,
there is nothing to tidy up, and an exception could be raised where nothing catches it: the process
ends there and then. While a command runs, an interrupt raises KeyboardInterrupt as usual. Programs
that import the package keep their own handlers: only the command line sets any.

Python acts on a signal between two of its own instructions. So a call of compiled code that takes
seconds, such as one of LLVM, returns first.
"""

import atexit
import contextlib
import os
import signal
import sys

# No others, such as `typing`: the handler is to be there as soon as possible
from collections.abc import Iterator

STATUS = 130
"""Exit status after an interrupt: 128 + SIGINT, as shells report it"""
TEXT = "interrupted"
RETRY = 0.05
"""Time after which an interrupt comes again that could not be raised, s"""
_was_raised = False
"""Whether an interrupt has raised KeyboardInterrupt"""


def is_command() -> bool:
    """Return True if this process is `bulletuav` or `python -m bulletuav`, not a program's."""
    # While `python -m` imports the package it has no better name for its own program
    if sys.argv[:1] == ["-m"]:
        return ("-m", "bulletuav") in zip(sys.orig_argv, sys.orig_argv[1:], strict=False)
    # Workers have the words of the command line, too, but were not started by them
    name, _ = os.path.splitext(os.path.basename(sys.argv[0]))
    return name == "bulletuav" and sys.argv[0] in sys.orig_argv


def end(number: int, frame: object) -> None:
    """Write one line and end the process; the handler while no command runs."""
    os.write(2, f"{TEXT}\n".encode())
    os._exit(STATUS)


@contextlib.contextmanager
def raising() -> Iterator[None]:
    """Make interrupts raise KeyboardInterrupt meanwhile, if they ended the process before."""
    global _was_raised
    if signal.getsignal(signal.SIGINT) is not end:
        yield
        return
    following: signal._HANDLER = end
    hook = sys.unraisablehook
    sys.unraisablehook = _retry
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        # A second one, while things are tidied up, ends the process without another line
        following = signal.SIG_DFL
        _was_raised = True
        raise
    finally:
        signal.signal(signal.SIGINT, following)
        sys.unraisablehook = hook


def _leave() -> None:
    """End the process with our status after an interrupt; the last thing that Python does.

    Python itself ends by the signal where KeyboardInterrupt has passed through `exec`, whatever the
    status is.
    """
    if _was_raised:
        # A stream is None where the process was started without it
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
        os._exit(STATUS)


def _retry(lost: "sys.UnraisableHookArgs") -> None:
    """Send an interrupt again that came in a callback of C code, which cannot pass it on."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        import threading
        from _thread import interrupt_main

        timer = threading.Timer(RETRY, interrupt_main)
        timer.daemon = True
        timer.start()
    else:
        sys.__unraisablehook__(lost)


@contextlib.contextmanager
def kept_from_children() -> Iterator[None]:
    """Keep interrupts from processes that are started meanwhile, from their first instruction on.

    A terminal sends an interrupt to all processes of a command. It is for the one that asks, which
    gets it as soon as the others are started.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


if is_command() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, end)
    atexit.register(_leave)  # the first one, which is called last
