"""`bulletuav serve`: simulated drones for external client programs."""

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bulletuav.analysis.fleet_recorder import FleetRecorder
from bulletuav.bridges import airsim, crazyflie, hil, mavlink
from bulletuav.bridges.airsim_settings import AirsimSettings, list_ignored, read_airsim_settings
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.crazyflie_fleet import CrazyflieFleet
from bulletuav.bridges.hil_bodies import HilBodies
from bulletuav.bridges.links import LinkQuality
from bulletuav.bridges.mavlink_fleet import MavlinkFleet
from bulletuav.bridges.radio_loss import STATION, RadioLoss
from bulletuav.commands.output import print_files
from bulletuav.commands.progress import show_progress
from bulletuav.commands.replay import PAGES
from bulletuav.envs.airspace import Airspace
from bulletuav.envs.viewer import join_address
from bulletuav.errors import find_choice, shown
from bulletuav.interrupts import interrupt_on_terminate
from bulletuav.report.replay import write_replay


def run(arguments: argparse.Namespace) -> None:
    """Start the server of the given protocol."""
    serve = find_choice("kind of server", arguments.kind, KINDS)
    given = {
        "loss": (arguments.loss != 0, (_serve_crazyflie, _serve_mavlink)),
        "delay": (arguments.delay != 0, (_serve_crazyflie, _serve_mavlink)),
        "station": (arguments.station is not None, (_serve_crazyflie, _serve_mavlink)),
        "positions": (
            arguments.positions is not None,
            (_serve_crazyflie, _serve_mavlink, _serve_hil),
        ),
        "pictures": (arguments.pictures is not None, (_serve_mavlink,)),
        "settings": (arguments.settings is not None, (_serve_airsim,)),
        "recordings": (arguments.recordings is not None, (_serve_airsim,)),
        "lidar": (arguments.lidar, (_serve_airsim,)),
        "paused": (arguments.paused, (_serve_airsim,)),
        "client-port": (arguments.client_port is not None, (_serve_mavlink,)),
    }
    for name, (is_given, servers) in given.items():
        if is_given and serve not in servers:
            raise ValueError(f"--{name} has no effect on {arguments.kind}: omit it")
    if arguments.replay is not None:
        _check_page(arguments.replay)
    serve(arguments)


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Collect the options of the airspace."""
    named = {} if arguments.dynamics is None else {"dynamics": arguments.dynamics}
    return {**named, "wind": tuple(arguments.wind), "seed": arguments.seed}


def _check_page(path: Path) -> None:
    """Raise an error, before the flight, if the file of the replay cannot be written."""
    if path.suffix not in PAGES:
        raise ValueError(f"--replay is {path}: its name has to end in .html")
    if not path.parent.is_dir():
        raise NotADirectoryError(f"no folder {shown(str(path.parent))}: create it for the replay")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise PermissionError(f"{shown(str(path))} cannot be written: name another file")


def _serve(
    flown: Any,
    make: Callable[[], Any],
    describe: Callable[[Any], str],
    arguments: argparse.Namespace,
) -> None:
    """Open the ports, compile, print the addresses, and serve; close everything at the end.

    Args:
        flown: The simulated drones.
        make: Function that opens the ports and returns the server.
        describe: Function that returns the line to print for a server.
        arguments: Parsed arguments, of which `seconds` and `replay` are used.
    """
    try:
        server = make()
        try:
            with show_progress("compiling", 1, "servers"):
                flown.warm_up()
            print(describe(server), flush=True)
            if arguments.replay is None:
                server.run(arguments.seconds)
            else:
                _serve_recorded(flown, server, arguments)
        finally:
            server.close()
    finally:
        flown.close()


def _serve_recorded(flown: Any, server: Any, arguments: argparse.Namespace) -> None:
    """Serve, and write the replay at the end, also after SIGINT, SIGTERM or an error."""
    with FleetRecorder(flown) as recorder:
        if isinstance(flown, AirsimWorld):
            flown.markers = recorder.markers
        try:
            with interrupt_on_terminate():
                server.run(arguments.seconds)
        finally:
            if recorder.has_rows:
                recording = recorder.recording()
                drones = recording.position.shape[1]
                title = f"serve {arguments.kind}: {drones} {'drones' if drones > 1 else 'drone'}"
                write_replay(recording, title, arguments.replay)
                print_files([arguments.replay])
            else:
                print(f"{arguments.replay} was not written: nothing has flown")


def _address(
    arguments: argparse.Namespace, default_port: int, default_speed: float | None = None
) -> tuple[str, int, float]:
    """Return address, port and speed."""
    port = default_port if arguments.port is None else arguments.port
    speed = default_speed if arguments.speed is None else arguments.speed
    return arguments.host, port, 1.0 if speed is None else speed


def _format_addresses(host: str, ports: list[int], scheme: str = "") -> str:
    """Return the addresses of a server: the first and the last if ports are consecutive."""
    places = [f"{scheme}{join_address(host, port)}" for port in ports]
    if len(ports) > 2 and ports == list(range(ports[0], ports[0] + len(ports))):
        return f"{places[0]} to {places[-1]}"
    return ", ".join(places)


def _drones(arguments: argparse.Namespace) -> int | list[tuple[float, float]]:
    """Return the number of drones, or their positions.

    Raises:
        ValueError: If both are given, or the positions are not pairs.
    """
    given = arguments.positions
    if given is None:
        return 1 if arguments.drones is None else int(arguments.drones)
    if arguments.drones is not None:
        raise ValueError("--drones and --positions are given: leave one out")
    if len(given) % 2:
        raise ValueError(f"--positions has {len(given)} numbers: two for each drone are needed")
    return list(zip(given[::2], given[1::2], strict=True))


def _quality(arguments: argparse.Namespace, airspace: Airspace) -> LinkQuality:
    """Return losses and delay of the links."""
    loss = arguments.loss
    if loss == "radio":
        loss = RadioLoss(airspace, arguments.station or STATION, seed=arguments.seed)
    elif arguments.station is not None:
        raise ValueError("--station has no effect without --loss radio: omit it")
    return LinkQuality(loss, arguments.delay, arguments.seed)


def _serve_crazyflie(arguments: argparse.Namespace) -> None:
    """Serve virtual Crazyflies."""
    fleet = CrazyflieFleet(_drones(arguments), arguments.airframe or "cf2x", **_options(arguments))
    _serve(
        fleet,
        lambda: crazyflie.CrazyflieServer(
            fleet, *_address(arguments, crazyflie.PORT), quality=_quality(arguments, fleet.airspace)
        ),
        lambda server: (
            f"{len(fleet)} drones at {_format_addresses(arguments.host, server.ports, 'udp://')}"
        ),
        arguments,
    )


def _serve_airsim(arguments: argparse.Namespace) -> None:
    """Serve vehicles to AirSim clients."""
    frame = arguments.airframe or "iris"
    drones = 1 if arguments.drones is None else arguments.drones
    path = arguments.settings
    settings = AirsimSettings() if path is None else read_airsim_settings(path)
    options = _options(arguments)
    if settings.wind is not None and any(options.pop("wind")):
        raise ValueError("--wind is given, and Wind in the settings file: leave one out")
    if settings.ignored:
        print(f"{path}: these keys have no effect: {list_ignored(settings.ignored)}", flush=True)
    world = AirsimWorld(drones, frame, lidar=arguments.lidar, settings=settings, **options)
    world.paused = arguments.paused
    recordings = None if arguments.recordings is None else Path(arguments.recordings)
    port = airsim.PORT if settings.port is None else settings.port
    address = _address(arguments, port, settings.clock_speed)
    _serve(
        world,
        lambda: airsim.AirsimServer(world, *address, recordings=recordings),
        lambda server: f"{', '.join(world.vehicles)} at {join_address(server.host, server.port)}",
        arguments,
    )


def _serve_mavlink(arguments: argparse.Namespace) -> None:
    """Serve MAVLink vehicles."""
    options = {**_options(arguments), "pictures": arguments.pictures}
    fleet = MavlinkFleet(_drones(arguments), arguments.airframe or "iris", **options)
    given = arguments.client_port
    clients = mavlink.CLIENT_PORT if given is None else given
    _serve(
        fleet,
        lambda: mavlink.MavlinkServer(
            fleet,
            *_address(arguments, mavlink.PORT),
            clients,
            quality=_quality(arguments, fleet.airspace),
        ),
        lambda server: (
            f"{len(fleet)} vehicles at {_format_addresses(arguments.host, server.ports)}; "
            f"they send to ports {clients} to {clients + len(fleet) - 1}"
        ),
        arguments,
    )


def _serve_hil(arguments: argparse.Namespace) -> None:
    """Serve simulated bodies to autopilots, by PX4's simulator protocol."""
    options = {**_options(arguments), "seed": arguments.seed or 0}
    bodies = HilBodies(_drones(arguments), arguments.airframe or "iris", **options)
    _serve(
        bodies,
        lambda: hil.HilServer(bodies, *_address(arguments, hil.PORT)),
        lambda server: (
            f"{len(bodies)} bodies wait for autopilots at "
            f"{_format_addresses(arguments.host, server.ports)}"
        ),
        arguments,
    )


KINDS = {
    "crazyflie": _serve_crazyflie,
    "airsim": _serve_airsim,
    "mavlink": _serve_mavlink,
    "hil": _serve_hil,
}
"""Servers by name"""
