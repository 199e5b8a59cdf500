"""A headless Chromium for tests, by its DevTools protocol over a pipe: no driver, no port."""

import contextlib
import itertools
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

from waiting import PATIENCE

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--remote-debugging-pipe", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--mute-audio", "--hide-scrollbars", "--force-device-scale-factor=1"),
)
"""Everything is drawn by the processor, so that machines without a graphics card are alike"""
"""s that an answer may take"""


def found():
    """Path of a Chromium, or None: $CHROMIUM, or one on the PATH."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)


class Page:
    """A page of a browser of its own, with what its console said and what it asked for.

    Attributes:
        messages: Errors and warnings of the console, and errors of scripts.
        requests: Addresses that were asked for, but for `data:` ones, which need no network.
    """

    def __init__(self, width=1280, height=760):
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        # The pipe is to have the numbers 3 and 4 there; the copies keep both out of their way.
        ends = [os.dup(to_browser), os.dup(from_browser)]
        shell = f'exec 3<&{ends[0]} 4>&{ends[1]}; exec "$@"'
        command = [
            "bash",
            "-c",
            shell,
            "bash",
            found(),
            *FLAGS,
            f"--user-data-dir={self._profile.name}",
        ]
        self._process = subprocess.Popen(
            command, pass_fds=ends, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for end in (*ends, to_browser, from_browser):
            os.close(end)
        self._numbers = itertools.count(1)
        self._buffer = b""
        self._session = None
        self.messages = []
        self.requests = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        with contextlib.suppress(Exception):
            self._session = None
            self.call("Browser.close")
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(10)
        self._process.kill()
        self._process.wait()
        for end in (self._read, self._write):
            os.close(end)
        self._profile.cleanup()

    def call(self, method, **parameters):
        """Call a method of the protocol, and wait for its answer."""
        number = next(self._numbers)
        told = {"id": number, "method": method, "params": parameters}
        if self._session:
            told["sessionId"] = self._session
        os.write(self._write, json.dumps(told).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    def _next(self):
        """Take the next message, and note it if it is an event."""
        end = time.monotonic() + PATIENCE
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], max(0.0, end - time.monotonic()))
            assert ready, "the browser does not answer"
            data = os.read(self._read, 1 << 20)
            assert data, "the browser has ended"
            self._buffer += data
        text, self._buffer = self._buffer.split(b"\0", 1)
        message = json.loads(text)
        self._note(message.get("method"), message.get("params"))
        return message

    def _note(self, method, told):
        if method == "Runtime.consoleAPICalled" and told["type"] in ("error", "warning", "assert"):
            self.messages.append(" ".join(str(one.get("value")) for one in told["args"]))
        elif method == "Runtime.exceptionThrown":
            self.messages.append(str(told["exceptionDetails"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] in ("error", "warning"):
            self.messages.append(told["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            url = told["request"]["url"]
            if not url.startswith("data:"):
                self.requests.append(url)

    def open(self, path, where=""):
        """Open a replay, and wait until it has drawn its first picture."""
        self.call("Page.navigate", url="about:blank")
        self.requests.clear()
        self.call("Page.navigate", url=f"{Path(path).resolve().as_uri()}{where}")
        self.wait("globalThis.replay !== undefined && replay.stats.pictures > 0")

    def tell(self, expression):
        """Value of an expression in the page."""
        given = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        answer = self.call("Runtime.evaluate", **given)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition, patience=PATIENCE):
        """Wait until a condition holds in the page."""
        end = time.monotonic() + patience
        while not self.tell(f"Boolean({condition})"):
            assert time.monotonic() < end, f"{condition} does not come true: {self.messages}"
            time.sleep(0.05)

    def click(self, selector):
        """Click the middle of an element."""
        box = self.tell(
            f"(() => {{ const b = document.querySelector({json.dumps(selector)})"
            f".getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; }})()"
        )
        self.press_mouse(*box)

    def press_mouse(self, x, y, to=None):
        """Click at a point, or drag from it to another."""
        button = {"button": "left", "buttons": 1, "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **button)
        if to:
            for share in (0.25, 0.5, 0.75, 1.0):
                place = {"x": x + share * (to[0] - x), "y": y + share * (to[1] - y)}
                self.call("Input.dispatchMouseEvent", type="mouseMoved", **place, **button)
        end = {"x": (to or (x, y))[0], "y": (to or (x, y))[1]}
        self.call("Input.dispatchMouseEvent", type="mouseReleased", **end, **button)

    def press(self, key, code="", number=0):
        """Press a key."""
        told = {"key": key, "code": code or f"Key{key.upper()}", "windowsVirtualKeyCode": number}
        self.call("Input.dispatchKeyEvent", type="keyDown", **told)
        self.call("Input.dispatchKeyEvent", type="keyUp", **told)

    def picture(self):
        """Bytes of a PNG of what is to be seen."""
        from base64 import b64decode

        return b64decode(self.call("Page.captureScreenshot", format="png")["data"])
