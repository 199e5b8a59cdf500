"""Shell of a MAVLink vehicle: a few commands of PX4's NSH, over SERIAL_CONTROL.

Source: https://mavlink.io/en/messages/common.html#SERIAL_CONTROL.
"""

from collections.abc import Mapping

from bulletuav.bridges.mavlink_protocol import Message, OutgoingMessage
from bulletuav.version import __version__

SHELL_DEVICE = 10
"""SERIAL_CONTROL_DEV_SHELL"""
REPLY_FLAG, RESPOND_FLAG = 1, 2
CHUNK = 70
"""Bytes in the data of a SERIAL_CONTROL"""
MAX_LINE = 256
"""Maximum length of a line, bytes; longer lines are cut"""
PROMPT = "nsh> "
HELP = "help\nparam show [NAME]\nver"


class Shell:
    """Shell of one vehicle; lines may arrive in pieces."""

    def __init__(self, values: Mapping[str, float]) -> None:
        """Initialise with the values of the parameters."""
        self._values = values
        self._line = ""

    def answer(self, message: Message) -> list[OutgoingMessage]:
        """Return the output for a SERIAL_CONTROL; none for other devices than the shell."""
        if message.device != SHELL_DEVICE:
            return []
        data = bytes(message.data[: message.count]).decode("ascii", "replace")
        *lines, rest = (self._line + data.replace("\r", "\n")).split("\n")
        self._line = rest[:MAX_LINE]
        output = "".join(f"{self._run(line)}{PROMPT}" for line in lines).encode()
        return [
            OutgoingMessage(
                "serial_control",
                (SHELL_DEVICE, REPLY_FLAG, 0, 0, len(chunk), [*chunk, *[0] * (CHUNK - len(chunk))]),
            )
            for chunk in (output[k : k + CHUNK] for k in range(0, len(output), CHUNK))
        ]

    def _run(self, line: str) -> str:
        """Return the output of a command, with a line feed at its end."""
        words = line[:MAX_LINE].split()
        if not words:
            return ""
        if words[0] == "help":
            return f"{HELP}\n"
        if words[0] == "ver":
            return f"bulletuav {__version__}\n"
        if words[:2] == ["param", "show"]:
            names = [name for name in self._values if words[2:3] in ([], [name])]
            lines = [f"{name}: {self._values[name]:g}\n" for name in names]
            return "".join(lines) or f"no parameter {words[2]}\n"
        return f"nsh: {words[0]}: command not found\n"
