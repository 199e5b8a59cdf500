"""`bulletuav serve`: drones that programs of others fly."""

import argparse
from collections.abc import Callable
from typing import Any

from bulletuav.bridges import airsim, crazyflie, hil, mavlink
from bulletuav.bridges.airsim_world import World
from bulletuav.bridges.crazyflie_fleet import Fleet
from bulletuav.bridges.hil_bodies import HilBodies
from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.commands.progress import show_progress
from bulletuav.envs.viewer import join_address
from bulletuav.errors import choose

ABOUT = {
    "help": "let programs for other drones fly ours",
    "description": (
        "Serve drones to programs that were written for others. They fly in real time until the "
        "server is interrupted. It listens to this machine alone, unless --host says otherwise."
    ),
    "epilog": """examples:
  bulletuav serve crazyflie --drones 10
  bulletuav serve crazyflie --drones 4 --wind 2 0 0 --port 19860
  bulletuav serve airsim --drones 2 --lidar
  bulletuav serve mavlink --drones 3
  bulletuav serve hil --wind 3 0 0""",
}
LOOPBACK = "127.0.0.1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the kind of server, where it listens, and what flies."""
    # Who flies
    parser.add_argument("kind", help=f"one of: {', '.join(KINDS)}")
    parser.add_argument("--drones", type=int, default=1, metavar="N", help="how many (default: 1)")
    parser.add_argument("--airframe", help="name or URDF (default: iris; for crazyflie cf2x)")
    # Where to listen; only this machine unless told otherwise
    parser.add_argument(
        "--host",
        default=LOOPBACK,
        help=f"address to listen at (default: {LOOPBACK}); whoever reaches it can fly the drones",
    )
    parser.add_argument("--port", type=int, help="first port (default: the client's)")
    parser.add_argument(
        "--client-port",
        type=int,
        default=mavlink.CLIENT_PORT,
        help=f"mavlink: where the first vehicle's client listens (default: {mavlink.CLIENT_PORT})",
    )
    parser.add_argument(
        "--speed", type=float, default=1.0, help="simulated seconds a second (default: 1)"
    )
    # The world and its clock
    parser.add_argument(
        "--dynamics",
        default="bullet",
        help="bullet or rigid_body, which have motors (default: bullet)",
    )
    parser.add_argument(
        "--wind",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("EAST", "NORTH", "UP"),
        help="steady wind in m/s",
    )
    parser.add_argument("--seed", type=int, help="of gusts and noise (default: another each time)")
    parser.add_argument("--lidar", action="store_true", help="airsim: carry a range finder")
    parser.add_argument(
        "--paused", action="store_true", help="airsim: time stands still until a client lets it go"
    )
    parser.add_argument(
        "--seconds", type=float, help="how long to serve (default: until interrupted)"
    )


def run(arguments: argparse.Namespace) -> None:
    """Start a server, and serve."""
    choose("kind of server", arguments.kind, KINDS)(arguments)


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Collect the options of the airspace."""
    return {
        "dynamics": arguments.dynamics,
        "wind": tuple(arguments.wind),
        "seed": arguments.seed,
    }


def _serve(
    flown: Any, make: Callable[[], Any], told: Callable[[Any], str], seconds: float | None
) -> None:
    """Open the ports, compile, tell where they are, and serve; close all at the end.

    Args:
        flown: What flies.
        make: Function that opens the ports.
        told: Function of the server that gives the line to print.
        seconds: How long to serve.
    """
    try:
        server = make()
        try:
            with show_progress("compiling", 1, "servers"):
                flown.warm_up()
            print(told(server), flush=True)
            server.run(seconds)
        finally:
            server.close()
    finally:
        flown.close()


def _at(arguments: argparse.Namespace, usual: int) -> tuple[str, int, float]:
    """Tell address, port and speed."""
    port = usual if arguments.port is None else arguments.port
    return arguments.host, port, arguments.speed


def _places(host: str, ports: list[int], scheme: str = "") -> str:
    """List where a server listens: the first and the last address if ports are consecutive."""
    places = [f"{scheme}{join_address(host, port)}" for port in ports]
    if len(ports) > 2 and ports == list(range(ports[0], ports[0] + len(ports))):
        return f"{places[0]} to {places[-1]}"
    return ", ".join(places)


def _serve_crazyflie(arguments: argparse.Namespace) -> None:
    """Serve virtual Crazyflies."""
    fleet = Fleet(arguments.drones, arguments.airframe or "cf2x", **_options(arguments))
    _serve(
        fleet,
        lambda: crazyflie.CrazyflieServer(fleet, *_at(arguments, crazyflie.PORT)),
        lambda server: f"{len(fleet)} drones at {_places(arguments.host, server.ports, 'udp://')}",
        arguments.seconds,
    )


def _serve_airsim(arguments: argparse.Namespace) -> None:
    """Serve vehicles of AirSim's calls."""
    frame = arguments.airframe or "iris"
    world = World(arguments.drones, frame, lidar=arguments.lidar, **_options(arguments))
    world.paused = arguments.paused
    _serve(
        world,
        lambda: airsim.AirsimServer(world, *_at(arguments, airsim.PORT)),
        lambda server: f"{', '.join(world.vehicles)} at {join_address(server.host, server.port)}",
        arguments.seconds,
    )


def _serve_mavlink(arguments: argparse.Namespace) -> None:
    """Serve MAVLink vehicles."""
    fleet = MavlinkFleet(arguments.drones, arguments.airframe or "iris", **_options(arguments))
    clients = arguments.client_port
    _serve(
        fleet,
        lambda: mavlink.MavlinkServer(fleet, *_at(arguments, mavlink.PORT), clients),
        lambda server: (
            f"{len(fleet)} vehicles at {_places(arguments.host, server.ports)}; "
            f"they send to ports {clients} to {clients + len(fleet) - 1}"
        ),
        arguments.seconds,
    )


def _serve_hil(arguments: argparse.Namespace) -> None:
    """Serve bodies to autopilots, by PX4's protocol for simulators."""
    options = {**_options(arguments), "seed": arguments.seed or 0}
    bodies = HilBodies(arguments.drones, arguments.airframe or "iris", **options)
    _serve(
        bodies,
        lambda: hil.HilServer(bodies, *_at(arguments, hil.PORT)),
        lambda server: (
            f"{len(bodies)} bodies wait for autopilots at {_places(arguments.host, server.ports)}"
        ),
        arguments.seconds,
    )


KINDS = {
    "crazyflie": _serve_crazyflie,
    "airsim": _serve_airsim,
    "mavlink": _serve_mavlink,
    "hil": _serve_hil,
}
"""Servers by name"""
