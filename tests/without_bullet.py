"""Flights in a process in which pybullet cannot be imported.

`python without_bullet.py RECORDING FOLDER` prints results by name as JSON on the last line; it also
verifies a recording that was flown with Bullet, and writes files to a folder.
"""

import contextlib
import hashlib
import io
import itertools
import json
import sys
import warnings
from pathlib import Path

TASKS = (
    ("converge", "single_integrator", "hard"),
    ("pursuit", "double_integrator", "easy"),
    ("obstacles", "point_mass", "hard"),
    ("lidar_navigation", "rigid_body", "easy"),
    ("crossing", "rigid_body", "extreme"),
)
"""Task, dynamics and difficulty of the digests"""
PICTURES = ("rgb", "depth", "segmentation", "ray_depth")
HULL = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
WALLS = [[(0.4, -3.0, 0.0), (1.0, 3.0, 9.0)], [(-9.0, 5.0, 0.0), (-5.0, 9.0, 4.0)]]


class Absent:
    """Finder of a machine on which PyBullet is not installed."""

    def find_spec(self, name, path=None, target=None):
        if name == "pybullet":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def table_lines():
    """Return lines as in `digests.txt`."""
    import digests

    chosen = [
        one
        for one in digests.variations()
        if (one["task"], one.get("dynamics"), one.get("difficulty")) in TASKS
    ]
    return [digests.line(one) for one in chosen[::2]]


def hashed(*arrays):
    return hashlib.sha256(b"".join(map(bytes, arrays))).hexdigest()[:16]


def airspace_hash(obj):
    """Fly among obstacles, walls, a hull and a mesh, with range finders, and save the state."""
    import numpy as np

    import bulletuav
    from bulletuav import SetpointLevel
    from bulletuav.geometry.obstacle import Obstacle
    from bulletuav.geometry.solids import Solids

    obj.write_text(
        "o one\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
    )
    options = {"dynamics": "rigid_body", "decision_hz": 48, "sensors": ("lidar", "optical_flow")}
    options |= {"obstacles": [Obstacle("sphere", (0.5,))], "layout": Solids(np.array(WALLS), ())}
    with bulletuav.Airspace([(0.0, 0.0, 1.0), (0.0, 2.0, 0.6)], "cf2x", seed=3, **options) as one:
        one.add_body(HULL, (2.0, 0.0, 0.0))
        one.place_obstacle(0, (0.0, -2.0, 1.0), velocity=(0.0, 0.5, 0.0))
        one.command(None, SetpointLevel.VELOCITY, (1.0, 0.0, 0.0))
        parts, touched = [], 0
        for k in range(60):
            if k == 20:
                saved = one.save_state()
                one.add_body(str(obj), (-3.0, 2.0, 0.0))
            one.step()
            touched += len(one.contacts.other)
            parts += [one.swarm.position, *map(np.ascontiguousarray, one.readings.values())]
        with contextlib.suppress(ValueError):  # the mesh came after it
            one.load_state(saved)
        return hashed(*parts, one.state_hash().encode()), touched


def pictures_hash():
    """Take pictures among obstacles and an added body."""
    import numpy as np

    import bulletuav

    options = {"observation": ("velocity", *PICTURES, "lidar"), "camera_size": (12, 8)}
    options |= {"observation_format": "dict", "dynamics": "point_mass"}
    options |= {"render_mode": "rgb_array", "render_size": (160, 120)}
    with contextlib.closing(bulletuav.Aviary("obstacles", 2, **options)) as aviary:
        aviary.add_body(HULL, (3.0, 3.0, 0.0))
        aviary.reset(seeds=5)
        saved = aviary.save_state()
        first = aviary.step(np.ones((2, aviary.num_drones, 3))).observations
        aviary.load_state(saved)
        again = aviary.step(np.ones((2, aviary.num_drones, 3))).observations
        assert all((first[name] == again[name]).all() for name in first)
        return hashed(aviary.render(1), *map(np.ascontiguousarray, first.values()))


def flights(folder):
    """Results that are the same with and without PyBullet."""
    return {
        "digests": table_lines(),
        "airspace": airspace_hash(folder / "one.obj"),
        "pictures": pictures_hash(),
    }


def error_of(call, *given, **options):
    """Return the error of a call as text."""
    try:
        made = call(*given, **options)
        made.reset(seeds=0)
        made.render()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "no error"


def errors():
    """Return the errors of all that needs PyBullet."""
    import bulletuav

    make, point = bulletuav.Aviary, {"dynamics": "point_mass"}
    return {
        "dynamics": error_of(make, "hover", dynamics="bullet"),
        "rays": error_of(make, "hover", rays="bullet", **point),
        "contacts": error_of(make, "hover", contacts="bullet"),
        "camera": error_of(make, "hover", observation="rgb", camera="bullet", **point),
        "airspace": error_of(bulletuav.Airspace, [(0, 0, 1)], dynamics="bullet"),
        "airspace contacts": error_of(bulletuav.Airspace, [(0, 0, 1)], contacts="bullet"),
    }


def warned():
    """Return the default dynamics of several environments, and all warnings."""
    import bulletuav

    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        made = [bulletuav.Aviary("hover"), bulletuav.Aviary("crossing"), bulletuav.Aviary("mec")]
        flown = [one.options.dynamics for one in made]
        with bulletuav.Airspace([(0, 0, 1)]) as airspace:
            flown.append(repr(airspace))
        for one in made:
            one.close()
    return {"flown": flown, "warnings": [str(one.message) for one in seen]}


def run(*words):
    """Return the exit code, output and errors of a command."""
    from bulletuav.cli import main

    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(words)
        except SystemExit as end:
            code = end.code
    return {"code": code, "out": out.getvalue(), "err": err.getvalue()}


def commands(recording, folder):
    """Return the results of commands."""
    own, short = str(folder / "own"), ("--horizon", "15", "--drones", "2")
    return {
        "fly": run("fly", "obstacles", "--out", own, "--animation", "none", "--html", *short),
        "verify": run("verify", own),
        "verify bullet": run("verify", recording),
        "doctor": run("doctor"),
        "benchmark": run("benchmark", "--drones", "1", "--seconds", "0.001"),
        "fly bullet": run("fly", "hover", "--dynamics", "bullet", "--out", str(folder / "none")),
    }


def main():
    """Print all results."""
    sys.meta_path.insert(0, Absent())
    recording, folder = sys.argv[1], Path(sys.argv[2])
    results = itertools.chain(
        [("warned", warned()), ("errors", errors())],
        flights(folder).items(),
        [("commands", commands(recording, folder))],
    )
    print(json.dumps(dict(results)))


if __name__ == "__main__":
    main()
