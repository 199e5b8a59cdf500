"""`bulletuav serve`: drones that programs of others fly."""

import argparse
from typing import Any

from rich.console import Console

from bulletuav.bridges import airsim, crazyflie, hil, mavlink
from bulletuav.bridges.airsim_world import World
from bulletuav.bridges.crazyflie_fleet import Fleet
from bulletuav.bridges.hil_bodies import HilBodies
from bulletuav.bridges.mavlink_fleet import MavlinkFleet
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
COMPILING = "compiling what flies; minutes at the first time"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the kind of server, where it listens, and what flies."""
    parser.add_argument("kind", help=f"one of: {', '.join(KINDS)}")
    parser.add_argument("--drones", type=int, default=1, metavar="N", help="how many (default: 1)")
    parser.add_argument("--airframe", help="name or URDF (default: iris; for crazyflie cf2x)")
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
    parser.add_argument("--dynamics", default="bullet", help="default: bullet")
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


def _serve_crazyflie(arguments: argparse.Namespace) -> None:
    """Serve virtual Crazyflies."""
    console = Console()
    fleet = Fleet(arguments.drones, arguments.airframe or "cf2x", **_options(arguments))
    port = crazyflie.PORT if arguments.port is None else arguments.port
    server = crazyflie.CrazyflieServer(fleet, arguments.host, port, arguments.speed)
    try:
        with console.status(COMPILING):
            fleet.warm_up()
        console.print(
            f"{len(fleet)} drones at {server.uris[0]} to {server.uris[-1]}", soft_wrap=True
        )
        server.run(arguments.seconds)
    finally:
        server.close()
        fleet.close()


def _serve_airsim(arguments: argparse.Namespace) -> None:
    """Serve vehicles of AirSim's calls."""
    console = Console()
    frame = arguments.airframe or "iris"
    world = World(arguments.drones, frame, lidar=arguments.lidar, **_options(arguments))
    world.paused = arguments.paused
    port = airsim.PORT if arguments.port is None else arguments.port
    try:
        server = airsim.AirsimServer(world, arguments.host, port, arguments.speed)
        try:
            with console.status(COMPILING):
                world.warm_up()
            names = ", ".join(world.vehicles)
            console.print(f"{names} at {server.host}:{server.port}", soft_wrap=True)
            server.run(arguments.seconds)
        finally:
            server.close()
    finally:
        world.close()


def _serve_mavlink(arguments: argparse.Namespace) -> None:
    """Serve MAVLink vehicles."""
    console = Console()
    frame = arguments.airframe or "iris"
    fleet = MavlinkFleet(arguments.drones, frame, **_options(arguments))
    port = mavlink.PORT if arguments.port is None else arguments.port
    clients = arguments.client_port
    try:
        server = mavlink.MavlinkServer(fleet, arguments.host, port, arguments.speed, clients)
        try:
            with console.status(COMPILING):
                fleet.warm_up()
            count = len(fleet) - 1
            console.print(
                f"{len(fleet)} vehicles at {arguments.host}:{server.ports[0]} to "
                f"{server.ports[-1]}; they send to ports {clients} to {clients + count}",
                soft_wrap=True,
            )
            server.run(arguments.seconds)
        finally:
            server.close()
    finally:
        fleet.close()


def _serve_hil(arguments: argparse.Namespace) -> None:
    """Serve bodies to autopilots, by PX4's protocol for simulators."""
    console = Console()
    seed = 0 if arguments.seed is None else arguments.seed
    options = {**_options(arguments), "seed": seed}
    bodies = HilBodies(arguments.drones, arguments.airframe or "iris", **options)
    port = hil.PORT if arguments.port is None else arguments.port
    try:
        server = hil.HilServer(bodies, arguments.host, port, arguments.speed)
        try:
            with console.status(COMPILING):
                bodies.warm_up()
            console.print(
                f"{len(bodies)} bodies wait for autopilots at {arguments.host}:{server.ports[0]} "
                f"to {server.ports[-1]}",
                soft_wrap=True,
            )
            server.run(arguments.seconds)
        finally:
            server.close()
    finally:
        bodies.close()


KINDS = {
    "crazyflie": _serve_crazyflie,
    "airsim": _serve_airsim,
    "mavlink": _serve_mavlink,
    "hil": _serve_hil,
}
"""Servers by name"""
