"""Check whether a live window can be opened."""

import ctypes
import ctypes.util
import os
import sys


def require_screen() -> None:
    """Check that an X screen is available; without one Bullet would end the process.

    Raises:
        RuntimeError: If no screen is available.
    """
    if not sys.platform.startswith("linux"):
        return
    # Use the X library, as Bullet does
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
