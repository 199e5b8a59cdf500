"""A check that a live window can open."""

import ctypes
import ctypes.util
import os
import sys


def require_screen() -> None:
    """Make sure that an X screen answers; without one Bullet would end the process.

    Raises:
        RuntimeError: No screen answers.
    """
    if not sys.platform.startswith("linux"):
        return
    # The library of X itself is asked, as Bullet will ask it
    name = ctypes.util.find_library("X11")
    display = os.environ.get("DISPLAY")
    if name and display:
        x11 = ctypes.CDLL(name)
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
        screen = x11.XOpenDisplay(None)
        if screen:
            x11.XCloseDisplay(screen)
            return
    raise RuntimeError(
        f'render_mode="human" needs a screen, and none answers (DISPLAY is {display!r}); '
        'use render_mode="rgb_array" for pictures without one'
    )
