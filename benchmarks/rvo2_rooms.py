"""Compute the success of RVO2 in the rooms of GLAS: constant RVO2_ROBOTS of table `glas`.

Usage: python benchmarks/rvo2_rooms.py PROGRAM GLAS, with the program of rvo2_rooms.cpp, and the
data of the table.
"""

import subprocess
import sys
from pathlib import Path

from bulletuav.reproduction.planar_rooms import PlanarRoom
from bulletuav.reproduction.tables.glas import OBSTACLES, ROBOTS, ROOMS, read_glas_rooms


def describe_room(room: PlanarRoom) -> str:
    """Return a room as numbers for the program."""
    rows = [[len(room.start), len(room.square), *room.size]]
    rows += [[*start, *goal] for start, goal in zip(room.start, room.goal, strict=True)]
    rows += room.square.tolist()
    return "\n".join(" ".join(f"{number:.9g}" for number in row) for row in rows)


def main() -> None:
    """Print the number of robots that succeed in each room of each case."""
    program, data = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    for obstacles in OBSTACLES:
        for robots in ROBOTS:
            rooms = read_glas_rooms(data, obstacles, robots, ROOMS)
            given = "\n".join(map(describe_room, rooms))
            ran = subprocess.run([program], input=given, text=True, capture_output=True, check=True)
            print(obstacles, robots, ", ".join(ran.stdout.split()), flush=True)


if __name__ == "__main__":
    main()
