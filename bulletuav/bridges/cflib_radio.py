"""Radio addresses for virtual Crazyflies: run a cflib program with `radio://` URIs, unmodified.

    python -m bulletuav.bridges.cflib_radio sbs_swarm.py
    python -m bulletuav.bridges.cflib_radio --addresses E7E7E7E7AA,E7E7E7E7BB own_swarm.py

Address k belongs to the drone at port 19850 + k of `bulletuav serve crazyflie`. By default the
addresses are E7E7E7E701 to E7E7E7E7FF; the address of new Crazyflies, E7E7E7E7E7, is the first
drone, too. The program runs in the process of cflib, which sends to UDP ports instead of a
Crazyradio, and repeats packets without an answer, as it does on the radio.

The module needs cflib alone: `python .../bulletuav/bridges/cflib_radio.py` runs it where this
package is not installed.
"""

import argparse
import os
import runpy
import sys
from collections.abc import Mapping
from typing import Any

SCHEME = "radio://"
FIRST_PORT = 19850
NEW_ADDRESS = 0xE7E7E7E7E7
"""Address of a new Crazyflie, and of URIs without an address"""
FIRST_ADDRESS, LAST_ADDRESS = 0xE7E7E7E701, 0xE7E7E7E7FF


def list_ports(addresses: str | None, first_port: int) -> dict[int, int]:
    """Return the port of each radio address.

    Args:
        addresses: Addresses of the drones in hexadecimal digits, separated by commas; None for the
            default addresses.
        first_port: Port of the first drone.
    """
    if addresses is not None:
        return {int(text, 16): first_port + k for k, text in enumerate(addresses.split(","))}
    ports = {
        one: first_port + one - FIRST_ADDRESS for one in range(FIRST_ADDRESS, LAST_ADDRESS + 1)
    }
    return {**ports, NEW_ADDRESS: first_port}


def find_uri(uri: str, ports: Mapping[int, int], host: str) -> str:
    """Return the `udp://` URI of a `radio://` URI.

    Raises:
        ValueError: If no drone has the address.
    """
    # radio://<radio>/<channel>/<rate>/<address>?<options>
    parts = uri.removeprefix(SCHEME).partition("?")[0].strip("/").split("/")
    address = int(parts[3], 16) if len(parts) > 3 else NEW_ADDRESS
    if address not in ports:
        raise ValueError(f"no drone has the address {address:010X}: name it in --addresses")
    return f"udp://{host}:{ports[address]}"


def replace_radio(ports: Mapping[int, int], host: str = "127.0.0.1") -> None:
    """Replace cflib's driver of the Crazyradio in this process; call it before `init_drivers`.

    Args:
        ports: Port of each radio address; see `list_ports`.
        host: Address of the server.

    Raises:
        ImportError: If cflib is not installed.
    """
    try:
        from cflib import crtp
        from cflib.crtp.exceptions import WrongUriType
        from cflib.crtp.udpdriver import UdpDriver
    except ImportError:
        raise ImportError("radio addresses need cflib: pip install cflib") from None

    class VirtualRadio(UdpDriver):  # type: ignore[misc]  # cflib has no types
        """Driver of cflib for `radio://` URIs that sends to UDP ports."""

        def connect(self, uri: str, *callbacks: Any) -> None:
            """Open the link of a radio address."""
            if not uri.startswith(SCHEME):
                raise WrongUriType("not a radio URI")
            super().connect(find_uri(uri, ports, host), *callbacks)
            self.uri, self.needs_resending = uri, True

        def scan_interface(self, address: int | None = None) -> list[list[str]]:
            """Return the URI of the drone with an address, by default a new one's."""
            uri = f"{SCHEME}0/80/2M/{NEW_ADDRESS if address is None else address:010X}"
            found = [one for one, _ in super().scan_interface()]
            return [[uri, ""]] if find_uri(uri, ports, host) in found else []

        def get_name(self) -> str:
            """Return the name that cflib shows."""
            return "radio"

    crtp.RadioDriver = VirtualRadio


def main() -> None:
    """Run a program with the virtual radio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--addresses", help="radio addresses, separated by commas")
    parser.add_argument("--host", default="127.0.0.1", help="address of the server")
    parser.add_argument("--port", type=int, default=FIRST_PORT, help="port of the first drone")
    parser.add_argument("program", help="program to run")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="arguments of the program")
    given = parser.parse_args()
    replace_radio(list_ports(given.addresses, given.port), given.host)
    sys.argv = [given.program, *given.arguments]
    sys.path[0] = os.path.dirname(os.path.abspath(given.program))
    runpy.run_path(given.program, run_name="__main__")


if __name__ == "__main__":
    main()
