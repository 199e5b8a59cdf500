"""Measure the error and the cost of each dynamics at several rates.

    python benchmarks/ladder.py --out docs/results

Errors of `rigid_body` and `bullet` are positions at the end of flights with constant rotor commands
against the equations of motion, solved by DOP853: tumbling in wind, gentle, near the ground and in
a wake, for 0.5 s (0.2 s in a wake, which tips the lower drone over). In the flight under commands,
all dynamics fly the same velocity setpoints, and are compared with `rigid_body` at 3840 Hz: there
the controllers' rate counts as well, and what cheaper dynamics leave out. Each error is the median
of several flights. The cost is that of 64 worlds with 8 drones that hover by velocity actions, 10
decisions a second. Writes ladder.md and ladder.png.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import pyplot
from rich.progress import track
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from reference import Reference

import bulletuav
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.files import replace_file

AIRFRAME = bulletuav.load_airframe("cf2x")
RATES = (60, 120, 240, 480, 960)
"""Substeps a second"""
DYNAMICS = ("single_integrator", "double_integrator", "point_mass", "bullet", "rigid_body")
NEWTONIAN = ("bullet", "rigid_body")
"""Dynamics with rotors"""
DECISIONS = 60
"""Decisions a second of flights under commands, at which setpoints change"""
WAY = ((2.0, -1.0, 0.5), (-1.0, 2.0, 0.0), (0.0, 0.0, -0.5), (0.0, 0.0, 0.0))
"""Velocity setpoints of these flights, each for half a second, m/s"""
COLOURS = ("#c8553d", "#d99a2b", "#5a8f3c", "#1b6ca8", "#6a4c93")


class Flight(NamedTuple):
    """Start and rotor commands of a flight of one or two drones.

    Attributes:
        seconds: Duration, s.
        position: (N, 3) m.
        quaternion: (N, 4) attitudes, body to world.
        velocity: (N, 3) m/s.
        rates: (N, 3) rad/s.
        speeds: (N, R) rotor speeds at the start, rad/s.
        command: (N, R) commanded rotor speeds, rad/s.
        wind: (3,) m/s.
    """

    seconds: float
    position: np.ndarray
    quaternion: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    speeds: np.ndarray
    command: np.ndarray
    wind: np.ndarray


def draw(rng: np.random.Generator, kind: str) -> Flight:
    """Draw a flight of a kind."""
    tumbles, near, pair = kind == "tumbling", kind == "near ground", kind == "in a wake"
    count, hover = 1 + pair, AIRFRAME.hover_speed()
    turn = Rotation.random(random_state=rng).as_rotvec() if tumbles else rng.normal(0, 0.08, 3)
    position = np.array([[0.0, 0.0, 5.0], [0.03, -0.02, 5.0 + 5 * AIRFRAME.arm]])[:count]
    if near:
        position[0, 2] = AIRFRAME.standing_height + rng.uniform(0.02, 0.06)
    low, high = (0.3, 1.5) if tumbles else (0.98, 1.05)
    speeds, command = hover * rng.uniform(low, high, (2, count, len(AIRFRAME.rotors)))
    upwards = [0.0, 0.0, 0.6 if near else 0.0]
    return Flight(
        seconds=0.2 if pair else 0.5,
        position=position,
        quaternion=np.tile(Rotation.from_rotvec(turn).as_quat(), (count, 1)),
        velocity=np.tile(rng.normal(0, 2.0 if tumbles else 0.2, 3) + upwards, (count, 1)),
        rates=np.tile(rng.normal(0, 10.0 if tumbles else 0.2, 3), (count, 1)),
        speeds=speeds,
        command=np.minimum(command, AIRFRAME.max_rotor_speed),
        wind=rng.normal(0, 3.0, 3) * tumbles,
    )


KINDS = ("tumbling", "gentle", "near ground", "in a wake")


def solve(flight: Flight) -> np.ndarray:
    """Solve the equations of motion of a flight; returns the positions (N, 3) at its end."""
    count = len(flight.position)
    models = [Reference(AIRFRAME, one, wind=tuple(flight.wind)) for one in flight.command]

    def slope(seconds: float, state: np.ndarray) -> np.ndarray:
        drones = state.reshape(count, 13)
        speeds = [
            model.speeds(start, seconds) for model, start in zip(models, flight.speeds, strict=True)
        ]
        if count == 2:
            way = drones[0, :3] - drones[1, :3]
            models[1].blow_on(models[0], way, speeds[1], _unit(drones[0, 3:7]))
        slopes = []
        for model, speed, drone in zip(models, speeds, drones, strict=True):
            turn, rates = _unit(drone[3:7]), drone[10:]
            winding = model.winding(speed)
            force, torque = model.wrench(drone[:3], turn, drone[7:10], speed, winding)
            x, y, z, w = turn
            across = np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]])
            spin = model.rates_slope(rates, torque, speed)
            turning, acceleration = 0.5 * (across @ rates), force / AIRFRAME.mass
            slopes.append(np.concatenate([drone[7:10], turning, acceleration, spin]))
        return np.concatenate(slopes)

    start = np.hstack([flight.position, flight.quaternion, flight.velocity, flight.rates])
    how: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12, "max_step": 0.005}
    end = solve_ivp(slope, (0.0, flight.seconds), start.ravel(), **how).y[:, -1]
    return np.asarray(end.reshape(count, 13)[:, :3])


def _unit(quaternion: np.ndarray) -> np.ndarray:
    """Normalise a quaternion."""
    return np.asarray(quaternion / np.linalg.norm(quaternion))


def fly(flight: Flight, dynamics: str, hz: int) -> np.ndarray:
    """Fly a flight; returns the positions (N, 3) at its end."""
    airspace = bulletuav.Airspace(
        flight.position,
        AIRFRAME.name,
        dynamics=dynamics,
        physics_hz=hz,
        decision_hz=hz,
        wind=tuple(flight.wind.tolist()),
    )
    for i in range(len(flight.position)):
        pose = (flight.position[i], flight.quaternion[i])
        airspace.place(i, *pose, flight.velocity[i], flight.rates[i], flight.speeds[i])
        airspace.command(i, SetpointLevel.ROTOR, flight.command[i])
    for _ in range(round(flight.seconds * hz)):
        airspace.step()
    end = airspace.swarm.position.copy()
    airspace.close()
    return end


def fly_commands(dynamics: str, hz: int) -> np.ndarray:
    """Fly the velocity setpoints of `WAY`; returns the positions (T, 3) after each decision."""
    airspace = bulletuav.Airspace(
        [(0.0, 0.0, 5.0)], AIRFRAME.name, dynamics=dynamics, physics_hz=hz, decision_hz=DECISIONS
    )
    places = []
    for velocity in WAY:
        airspace.command(0, SetpointLevel.VELOCITY, velocity)
        for _ in range(DECISIONS // 2):
            airspace.step()
            places.append(airspace.swarm.position[0].copy())
    airspace.close()
    return np.array(places)


def cost(dynamics: str, hz: int, rounds: int) -> Callable[[], float]:
    """Return a function that measures CPU time, us for a second of a drone's flight."""
    worlds, drones, decisions = 64, 8, 10
    environment = bulletuav.batch_env(
        "hover",
        worlds,
        num_drones=drones,
        dynamics=dynamics,
        action="velocity",
        physics_hz=hz,
        decision_hz=decisions,
    )
    environment.reset(seed=0)
    action = np.zeros((worlds, drones, *environment.action_space.shape))
    environment.step(action)

    def measure() -> float:
        begin = time.process_time()
        for _ in range(rounds):
            environment.step(action)
        return (time.process_time() - begin) / rounds / worlds / drones * decisions * 1e6

    return measure


class Row(NamedTuple):
    """Result of one dynamics at one rate.

    Attributes:
        dynamics: Its name.
        hz: Substeps a second.
        errors: Error in each kind of flight, m; None where there are no rotors.
        commanded: Largest error under velocity commands, m.
        cost: CPU time of a second of a drone's flight, us.
    """

    dynamics: str
    hz: int
    errors: tuple[float | None, ...]
    commanded: float
    cost: float


def table(rows: Sequence[Row]) -> str:
    """Write the rows as Markdown."""
    head = "| dynamics | Hz | " + " | ".join(f"{kind}, m" for kind in KINDS)
    head += " | under commands, m | us for a drone's second |"
    lines = ["# Errors and costs of the dynamics", "", head]
    lines.append("|---|---|" + "---|" * (len(KINDS) + 2))
    for row in rows:
        cells = ["-" if error is None else f"{error:.1e}" for error in row.errors]
        cells += [f"{row.commanded:.1e}", f"{row.cost:.0f}"]
        lines.append(f"| `{row.dynamics}` | {row.hz} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def draw_picture(rows: Sequence[Row], path: Path) -> None:
    """Draw errors over costs."""
    figure, pair = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained", sharex=True)
    for dynamics, colour in zip(DYNAMICS, COLOURS, strict=True):
        own = [row for row in rows if row.dynamics == dynamics]
        costs = [row.cost for row in own]
        pair[0].plot(costs, [row.commanded for row in own], "o-", color=colour, label=dynamics)
        if dynamics in NEWTONIAN:
            pair[1].plot(costs, [row.errors[0] for row in own], "o-", color=colour)
    for axes, title in zip(pair, ("under velocity commands", "tumbling"), strict=True):
        axes.set(xscale="log", yscale="log", title=title, xlabel="CPU time of a drone's second, us")
        axes.grid(alpha=0.3)
    pair[0].set_ylabel("error of the position, m")
    pair[0].legend(frameon=False)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/ladder"), help="folder for the files")
    parser.add_argument("--flights", type=int, default=5, help="flights of each kind")
    parser.add_argument("--rates", type=int, nargs="+", default=RATES, help="substeps a second")
    parser.add_argument("--rounds", type=int, default=5, help="measurements of each cost")
    given = parser.parse_args(argv)
    rng = np.random.default_rng(0)
    flights = {kind: [draw(rng, kind) for _ in range(given.flights)] for kind in KINDS}
    ends = {
        kind: [solve(flight) for flight in several]
        for kind, several in track(flights.items(), description="solving")
    }
    exact = fly_commands("rigid_body", 3840)
    cases = [(dynamics, hz) for dynamics in DYNAMICS for hz in given.rates]
    measures = {
        case: cost(*case, rounds=3) for case in track(cases, description="making environments")
    }
    costs: dict[tuple[str, int], list[float]] = {case: [] for case in cases}
    # In turn, so that all cases meet the same load
    for _ in track(range(given.rounds), description="measuring costs"):
        for case in cases:
            costs[case].append(measures[case]())
    rows = []
    for dynamics, hz in track(cases, description="flying"):
        errors: list[float | None] = [None for _ in KINDS]
        if dynamics in NEWTONIAN:
            errors = [
                statistics.median(
                    float(np.linalg.norm(fly(flight, dynamics, hz) - end, axis=1).max())
                    for flight, end in zip(flights[kind], ends[kind], strict=True)
                )
                for kind in KINDS
            ]
        commanded = np.linalg.norm(fly_commands(dynamics, hz) - exact, axis=1).max()
        price = statistics.median(costs[dynamics, hz])
        rows.append(Row(dynamics, hz, tuple(errors), float(commanded), price))
    given.out.mkdir(parents=True, exist_ok=True)
    replace_file(given.out / "ladder.md", table(rows))
    draw_picture(rows, given.out / "ladder.png")
    sys.stdout.write(table(rows))


if __name__ == "__main__":
    main()
