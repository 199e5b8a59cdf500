"""`bulletuav fly --mission`: fly a mission of a ground station, and write its track."""

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from bulletuav.analysis.airspace_recorder import AirspaceRecorder
from bulletuav.bridges.mission_files import NO_CHANGE, Mission, read_mission
from bulletuav.bridges.mission_flight import MissionFlight
from bulletuav.commands.arguments import given_options
from bulletuav.commands.output import print_files, print_table
from bulletuav.commands.progress import show_progress
from bulletuav.errors import as_int
from bulletuav.files import replace_file
from bulletuav.identification.example import write_example_log
from bulletuav.report.missions import plot_mission
from bulletuav.report.replay import replay_run

COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "p", "q", "r")
"""Columns of flight.csv before the rotor speeds"""
TASK_ARGUMENTS = ("task", "policy", "live", "foxglove", "trust")
"""Arguments that apply to tasks only"""
NAMES = {
    16: "waypoint",
    17: "loiter",
    19: "loiter for a time",
    20: "return",
    21: "land",
    22: "take-off",
    93: "delay",
    177: "jump",
    178: "change of speed",
}
"""Names of the supported commands, by number"""


def run(arguments: argparse.Namespace, prepare_folder: Callable[[Path], None]) -> None:
    """Fly a mission, print its items and what is not flown, and write its files.

    Args:
        arguments: Parsed arguments of `bulletuav fly`.
        prepare_folder: Function that creates the output folder, or clears it.
    """
    for name in TASK_ARGUMENTS:
        if getattr(arguments, name):
            raise ValueError(f"{name} has no effect on a mission: omit it, or omit --mission")
    if arguments.animation not in (None, "none"):
        raise ValueError(
            "--animation has no effect on a mission: omit it, and use bulletuav replay for films"
        )
    as_int("seed", arguments.seed, 0)
    options = given_options(arguments)
    if "num_drones" in options:
        raise ValueError("--drones has no effect on a mission, which one drone flies: omit it")
    mission = read_mission(arguments.mission, arguments.home)
    airframe = options.pop("airframe", "iris")
    with MissionFlight(
        mission, airframe, speed=arguments.speed, seed=arguments.seed, **options
    ) as flight:
        prepare_folder(arguments.out)
        out, rows = arguments.out, []
        numbers = [k for k, item in enumerate(mission.items) if item is not NO_CHANGE]

        with show_progress("flying", len(numbers), "items") as report:

            def record() -> None:
                swarm = flight.airspace.swarm
                state = (swarm.position, swarm.quaternion, swarm.velocity, swarm.rates)
                rows.append(
                    np.concatenate(
                        [[flight.fleet.time], *(array[0] for array in state), flight.rotor_speeds]
                    )
                )
                report(min(len(flight.reached), len(numbers)))

            with AirspaceRecorder(flight.airspace) as recorder:
                flight.fly(record)
        table = np.array(rows)
        names = [*COLUMNS, *(f"w{r + 1}" for r in range(table.shape[1] - len(COLUMNS)))]
        report_path, picture = out / "mission.json", out / "mission.png"
        files = [*recorder.save(out), write_example_log(out / "flight.csv", table, names)]
        replace_file(report_path, json.dumps(_summarize(flight), indent=1) + "\n")
        title = f"{mission.path.name}: {flight.airspace.airframes[0].name}"
        plot_mission(table[:, 0], table[:, 1:4], mission.waypoints(), title, picture)
        files += [report_path, picture]
        if arguments.html:
            files.append(replay_run(out))
    print_table(_table(mission, flight))
    for time, text in flight.texts:
        print(f"{time:.2f} s: {text}")
    for note in mission.notes:
        print(note)
    print(f"outcome: {flight.outcome}")
    print_files(files)


def _summarize(flight: MissionFlight) -> dict[str, Any]:
    """Return the results of a flight as plain values."""
    return {
        "mission": flight.mission.path.name,
        "home": flight.mission.home,
        "outcome": flight.outcome,
        "seconds": flight.fleet.time,
        "reached": [
            {
                "item": one.number,
                "time": one.time,
                "distance": one.distance if math.isfinite(one.distance) else None,
            }
            for one in flight.reached
        ],
        "texts": [{"time": time, "text": text} for time, text in flight.texts],
        "notes": list(flight.mission.notes),
    }


def _table(mission: Mission, flight: MissionFlight) -> Table:
    """Return a table of the items, with the time of the last arrival."""
    last = {one.number: one for one in flight.reached}
    table = Table(
        title=f"{mission.path.name}: {len(mission.items)} items, {flight.fleet.time:.2f} s",
        caption="time and distance from the item when it was reached last",
    )
    for heading in ("item", "command", "time (s)", "distance (m)"):
        table.add_column(heading, justify="right")
    for number, item in enumerate(mission.items):
        if item is NO_CHANGE:
            continue
        cells = ["-", "-"]
        if number in last:
            distance = last[number].distance
            cells = [
                f"{last[number].time:.2f}",
                f"{distance:.2f}" if math.isfinite(distance) else "-",
            ]
        table.add_row(str(number), NAMES[item.command], *cells)
    return table
