"""Handling of Ctrl-C: the command line ends with one line and exit status 130.

`bulletuav` imports this module first. While the package is being imported, and while Python exits,
no clean-up is needed, and a KeyboardInterrupt could be raised where nothing catches it: the handler
ends the process immediately. While a command runs, an interrupt raises KeyboardInterrupt as usual.
Only the command line installs handlers: programs that import the package keep their own.

Python runs signal handlers between two bytecode instructions. Therefore a call of compiled code
that takes seconds, such as a compilation by LLVM, returns before the interrupt is handled.

Machine code of numba calls Python functions to convert results to named tuples, and does not check
whether they raised: an exception there would end the process with a segmentation fault. Therefore
an interrupt in such a function is sent again a little later.
"""

import atexit
import contextlib
import os
import signal
import sys

# No other imports, such as `typing`: the handler must be installed as early as possible
from collections.abc import Iterator
from types import FrameType

EXIT_STATUS = 130
"""Exit status after an interrupt: 128 + SIGINT, as in shells"""
TEXT = "interrupted"
RETRY_DELAY = 0.05
"""Delay before an interrupt that could not be raised is sent again, s"""
_was_raised = False
"""True after an interrupt has raised KeyboardInterrupt"""


def is_command() -> bool:
    """Return True if this process runs the command line: `bulletuav` or `python -m bulletuav`."""
    # While `python -m` imports the package, sys.argv[0] is still "-m"
    if sys.argv[:1] == ["-m"]:
        return ("-m", "bulletuav") in zip(sys.orig_argv, sys.orig_argv[1:], strict=False)
    # Worker processes have the same sys.argv, but other original arguments
    name, _ = os.path.splitext(os.path.basename(sys.argv[0]))
    return name == "bulletuav" and sys.argv[0] in sys.orig_argv


def exit_on_interrupt(number: int, frame: object) -> None:
    """Write one line and end the process: the signal handler while no command runs."""
    os.write(2, f"{TEXT}\n".encode())
    os._exit(EXIT_STATUS)


@contextlib.contextmanager
def raise_interrupts() -> Iterator[None]:
    """Make interrupts raise KeyboardInterrupt inside the `with` block of a command."""
    global _was_raised
    if signal.getsignal(signal.SIGINT) is not exit_on_interrupt:
        yield
        return
    following: signal._HANDLER = exit_on_interrupt
    hook = sys.unraisablehook
    sys.unraisablehook = _resend_interrupt
    signal.signal(signal.SIGINT, _raise_interrupt)
    try:
        yield
    except KeyboardInterrupt:
        # A second interrupt, during clean-up, ends the process without another line
        following = signal.SIG_DFL
        _was_raised = True
        raise
    finally:
        signal.signal(signal.SIGINT, following)
        sys.unraisablehook = hook


def _exit_after_interrupt() -> None:
    """End the process with status 130 after an interrupt, as the last exit handler.

    Without this handler, Python ends by the signal, with another status, if KeyboardInterrupt has
    passed through `exec`.
    """
    if _was_raised:
        # A stream is None if the process was started without it
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
        os._exit(EXIT_STATUS)


def _resend_interrupt(lost: "sys.UnraisableHookArgs") -> None:
    """Send an interrupt again that arrived in a callback from C, where it cannot propagate."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        _send_later()
    else:
        sys.__unraisablehook__(lost)


def _send_later() -> None:
    """Send an interrupt to this process after `RETRY_DELAY`."""
    import threading
    from _thread import interrupt_main

    timer = threading.Timer(RETRY_DELAY, interrupt_main)
    timer.daemon = True
    timer.start()


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt where it can propagate: the signal handler while a command runs."""
    if _is_converting(frame):
        _send_later()
    else:
        signal.default_int_handler(number, frame)


def _is_converting(frame: FrameType | None) -> bool:
    """Return True if numba's machine code called the frame to make a named tuple of a result."""
    while frame is not None:
        # Numba looks up the class by this function, and then calls it
        if frame.f_code.co_name == "_numba_unpickle":
            return True
        if frame.f_globals.get("__name__", "").startswith("namedtuple_"):
            return True
        frame = frame.f_back
    return False


@contextlib.contextmanager
def block_interrupts() -> Iterator[None]:
    """Block interrupts in processes that are started inside the `with` block.

    A terminal sends an interrupt to all processes of a command. Only the parent process is to
    handle it, which it does when the block ends.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def interrupt_on_terminate() -> Iterator[None]:
    """Raise KeyboardInterrupt for SIGTERM, too, inside the `with` block."""
    before = signal.signal(signal.SIGTERM, _raise_interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


if is_command() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, exit_on_interrupt)
    atexit.register(_exit_after_interrupt)  # registered first, so called last
