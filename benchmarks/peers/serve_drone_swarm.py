"""PufferLib's drone_swarm (S. Turner, F. Sanders 2025), C alone, from a checkout of stmio/drone.

The path of the checkout is the first argument. gcc builds the environment without its pictures.
"double" is the same in double precision, and with the arithmetic that was written down. Constants
stay as they are, and the four functions of the C library that it calls become those of doubles.
"""

from serve import serve  # first: it takes care of what others print

# isort: split

import ctypes
import subprocess
import sys
import tempfile
from functools import cache, partial
from pathlib import Path

SOURCES = Path(sys.argv[1], "drone_swarm")
WORLDS, DRONES = 64, 8
DECISIONS = 10
"""Decisions of a call"""
FLAGS = {
    "single": ["-O3", "-ffast-math"],
    "double": [
        "-O3",
        "-Dfloat=double",
        *(f"-D{name}f={name}" for name in ("cos", "sin", "sqrt", "pow")),
    ],
}
PICTURES = """
#define PI 3.14159265358979323846f
typedef struct { unsigned char r, g, b, a; } Color;
typedef struct { float x, y; } Vector2;
typedef struct { float x, y, z; } Vector3;
typedef struct { Vector3 position, target, up; float fovy; int projection; } Camera3D;
"""
"""What the sources name of the library that draws"""
BEHIND = "void c_close_client("
"""Where the sources begin to draw"""
DRIVER = f"""
#include "headless.h"
static DroneSwarm worlds[{WORLDS}];
void begin(void) {{
    srand(0);
    for (int w = 0; w < {WORLDS}; w++) {{
        DroneSwarm *one = &worlds[w];
        one->num_agents = {DRONES};
        one->max_rings = 10;
        one->observations = calloc({DRONES} * 64, sizeof(float));
        one->actions = calloc({DRONES} * 4, sizeof(float));
        one->rewards = calloc({DRONES}, sizeof(float));
        one->terminals = calloc({DRONES}, 1);
        init(one);
        c_reset(one);
    }}
}}
void fly(int decisions, int percent) {{
    for (int k = 0; k < decisions; k++)
        for (int w = 0; w < {WORLDS}; w++) {{
            for (int a = 0; a < {DRONES} * 4; a++)
                worlds[w].actions[a] = rndf(-0.01f * percent, 0.01f * percent);
            c_step(&worlds[w]);
        }}
}}
"""


@cache
def build(precision: str, folder: Path) -> ctypes.CDLL:
    """Build the environment with a driver of ours in a folder, load it, and make the worlds."""
    whole = (SOURCES / "drone_swarm.h").read_text()
    (folder / "headless.h").write_text(whole[: whole.index(BEHIND)])
    (folder / "raylib.h").write_text(f"#pragma once\n{PICTURES}")
    (folder / "driver.c").write_text(DRIVER)
    command = [
        "gcc",
        *FLAGS[precision],
        "-shared",
        "-fPIC",
        "-fno-semantic-interposition",
        f"-I{folder}",
        f"-I{SOURCES}",
    ]
    built = folder / f"{precision}.so"
    subprocess.run([*command, folder / "driver.c", "-o", built, "-lm"], check=True)
    library = ctypes.CDLL(str(built))
    library.begin()
    return library


def random_flight(precision: str, percent: int, folder: Path):
    """Fly random actions up to a share of the rotors' range, resets among them."""
    library = build(precision, folder)
    return partial(library.fly, DECISIONS, percent), WORLDS * DRONES * DECISIONS


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        serve(
            {
                f"{precision}, {percent} %": partial(random_flight, precision, percent, Path(name))
                for precision in FLAGS
                for percent in (10, 100)
            }
        )
