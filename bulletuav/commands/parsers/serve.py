"""Arguments of `bulletuav serve`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp

ABOUT = {
    "help": "serve simulated drones to cflib, AirSim, MAVLink or PX4 programs",
    "description": (
        "Serve simulated drones to programs written for real drones or other simulators. They "
        "fly in real time until the server is interrupted. By default the server accepts only "
        "clients on this machine."
    ),
    "epilog": """examples:
  bulletuav serve crazyflie --drones 10
  bulletuav serve crazyflie --drones 4 --wind 2 0 0 --port 19860
  bulletuav serve airsim --drones 2 --lidar
  bulletuav serve airsim --replay flight.html
  bulletuav serve mavlink --drones 3
  bulletuav serve mavlink --loss 0.1 --delay 0.05
  bulletuav serve mavlink --loss radio --station 100 0 2
  bulletuav serve hil --wind 3 0 0""",
}


LOOPBACK = "127.0.0.1"


@DeferredHelp
def _kinds() -> str:
    from bulletuav.commands.serve import KINDS

    return f"protocol: {', '.join(KINDS)}"


@DeferredHelp
def _client_port() -> str:
    from bulletuav.bridges.mavlink import CLIENT_PORT

    return f"mavlink: port of the client of the first vehicle (default: {CLIENT_PORT})"


def _parse_loss(text: str) -> float | str:
    """Return a probability, or "radio"."""
    try:
        return text if text == "radio" else float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: a number, or radio, is needed") from None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the type of server, its address, drones and world."""
    # Drones
    parser.add_argument("kind", help=_kinds)
    parser.add_argument(
        "--drones", type=int, metavar="N", help="number of drones, on a grid (default: 1)"
    )
    parser.add_argument(
        "--positions",
        type=float,
        nargs="+",
        metavar="EAST NORTH",
        help="start positions in m, two numbers for each drone, instead of --drones",
    )
    parser.add_argument("--airframe", help="name or URDF file (default: iris; for crazyflie cf2x)")
    # Address; by default only this machine has access
    parser.add_argument(
        "--host",
        default=LOOPBACK,
        help=f"address to listen on (default: {LOOPBACK}); any client can fly the drones",
    )
    parser.add_argument("--port", type=int, help="first port (default: that of the protocol)")
    parser.add_argument(
        "--client-port",
        type=int,
        help=_client_port,
    )
    parser.add_argument(
        "--speed", type=float, help="speed relative to real time, above 0 (default: 1)"
    )
    parser.add_argument(
        "--loss",
        type=_parse_loss,
        default=0.0,
        metavar="LOSS",
        help="crazyflie, mavlink: probability that a datagram is lost, each way; or 'radio': from "
        "the radio model, by distance and line of sight (default: 0)",
    )
    parser.add_argument(
        "--station",
        type=float,
        nargs=3,
        metavar=("EAST", "NORTH", "UP"),
        help="--loss radio: antenna of the ground station in m (default: 0 0 1.5)",
    )
    parser.add_argument(
        "--delay",
        type=float,
        default=0.0,
        help="crazyflie, mavlink: delay of datagrams in s, each way (default: 0)",
    )
    # World and clock
    parser.add_argument(
        "--dynamics",
        help="bullet or rigid_body, the models with motors (default: bullet, or rigid_body without "
        "PyBullet)",
    )
    parser.add_argument(
        "--wind",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("EAST", "NORTH", "UP"),
        help="steady wind in m/s",
    )
    parser.add_argument("--seed", type=int, help="seed of gusts, noise and losses (default random)")
    parser.add_argument(
        "--settings", metavar="FILE", help="airsim: AirSim's settings.json: vehicles, cameras, ..."
    )
    parser.add_argument(
        "--recordings", metavar="FOLDER", help="airsim: folder for what clients record"
    )
    parser.add_argument(
        "--pictures",
        metavar="FOLDER",
        help="mavlink: equip drones with cameras, whose pictures are written there",
    )
    parser.add_argument(
        "--replay",
        type=Path,
        metavar="FILE",
        help="write a 3-D replay of the flight, as a web page (.html), when the server ends",
    )
    parser.add_argument("--lidar", action="store_true", help="airsim: equip drones with a lidar")
    parser.add_argument(
        "--paused", action="store_true", help="airsim: start paused, until a client continues"
    )
    parser.add_argument(
        "--seconds", type=float, help="duration of the server in s (default: until interrupted)"
    )
