"""Check contacts at length: landings, walls, pairs, heaps, slopes, speed.

    python benchmarks/contacts.py [--quick] [--only walls pairs]

Prints one row for each set of parameters: how many worlds there were, the worst figures, and in
which worlds a bound was missed (the first five). The exit code is 1 when any was. The rigs are
those of tests/contact. --quick takes a tenth of the worlds, two airframes and two rates.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import bulletuav
from bulletuav.compiled.deferred import compile_deferred
from bulletuav.dynamics import DYNAMICS, find_dynamics
from bulletuav.tasks import find_task

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from bench import MULTIROTORS
from contact.heaps import drop_heap, slide, stack
from contact.landings import PLACES, land
from contact.pairs import KINDS, meet_in_pairs
from contact.rig import Rig
from contact.shots import TARGETS, Range
from contact.trains import push

Row = tuple[str, str, dict[str, Any]]
"""What was done, the figures, and what was missed"""

IMPACT, RESTING = 8.0, 1.0
"""Most time of an impact, and of a resting drone and substep, us"""
ROUNDS = 4
"""Runs of which the fastest counts; the first loads compiled code"""
SECONDS = 10
"""Flight of which the rate of steps is measured, s"""
RANDOM_SHARE = 0.6
"""Least rate of random actions over that of hovering, where contacts end nothing"""
ENDING_SHARE = 0.7
"""The same where they do, and worlds begin anew"""
DECISIONS = 600
"""Decisions of which the latter rate is measured"""

THROUGH = ("beyond", "depth")
"""What drones that stop are not asked of obstacles that move"""


class Sizes:
    """How much is checked.

    Attributes:
        worlds: Worlds of a row.
        airframes: Names.
        rates: Substeps a second.
    """

    def __init__(self, quick: bool) -> None:
        """Choose the sizes."""
        self.worlds = 100 if quick else 1000
        self.airframes = ["cf2x", "iris"] if quick else MULTIROTORS
        self.rates = [60, 240] if quick else [60, 120, 240, 500, 1000]
        self.landing_rates = [60, 240] if quick else [60, 120, 240, 500, 1000, 2000]


def landings(sizes: Sizes) -> Iterator[Row]:
    """Drop drones from .05 to 10 m."""
    for airframe, hz, place in product(sizes.airframes, sizes.landing_rates, PLACES):
        for kind in ("flat", "random", "sideways"):
            ended = land(
                airframe,
                hz=hz,
                place=place,
                flat=kind == "flat",
                sideways=3.0 if kind == "sideways" else 0.0,
                worlds=sizes.worlds // 10 if kind == "flat" else 100,
            )
            figures = (
                f"rest {ended.rest.max():.2f} s, depth {1e3 * ended.depth.max():.3f} mm, "
                f"gain {1e3 * ended.gained.max():.3f} mm, upright {ended.upright.sum()}"
            )
            yield f"landing {airframe} {hz} Hz {place} {kind}", figures, ended.missed()


def walls(sizes: Sizes) -> Iterator[Row]:
    """Shoot at what stands and what moves."""
    for dynamics, airframe, hz in product(DYNAMICS, sizes.airframes, sizes.rates):
        shooting = Range(airframe, dynamics=dynamics, hz=hz, shots=sizes.worlds)
        spins = (0.0, 30.0) if dynamics in ("rigid_body", "bullet") else (0.0,)
        for name, drift, spin in product(TARGETS, (0.0, 10.0), spins):
            shots = shooting.shoot(name, drift=drift, spin=spin)
            figures = (
                f"{shots.hits.sum()} hits, {shots.misses.sum()} misses, "
                f"depth {1e3 * shots.depth.max():.3f} mm, gain {shots.gained.max():.1e}"
            )
            missed = shots.missed()
            if drift and find_dynamics(dynamics).contacts[0] == "stop":
                # An obstacle that moves goes on through a drone that stopped
                missed = {what: who for what, who in missed.items() if what not in THROUGH}
            title = f"wall {dynamics} {airframe} {hz} Hz {name} to {drift:g} m/s, {spin:g} rad/s"
            yield title, figures, missed
        shooting.rig.close()


def trains(sizes: Sizes) -> Iterator[Row]:
    """Let drones push one another against a wall."""
    thicknesses = (0.002, 0.02, 0.2)
    for airframe, hz, thick in product(sizes.airframes, sizes.rates, thicknesses):
        train = push(airframe, hz=hz, worlds=sizes.worlds // 5, thick=thick)
        figures = f"depth {1e3 * train.depth.max():.3f} mm, gain {train.gained.max():.1e}"
        yield f"train of 5 {airframe} {hz} Hz {1e3 * thick:g} mm", figures, train.missed()


def pairs(sizes: Sizes) -> Iterator[Row]:
    """Let pairs meet."""
    couples = [(one, one) for one in sizes.airframes] + [("cf2x", "iris"), ("racer", "hummingbird")]
    rebounds = (0.0, 0.5, 1.0)
    for couple, hz, kind, restitution in product(couples, sizes.rates, KINDS, rebounds):
        met = meet_in_pairs(kind, couple, hz=hz, restitution=restitution, worlds=sizes.worlds)
        missed = met.missed()
        wrong = np.abs(met.rebound - restitution) > 1e-8
        if kind == "head-on" and couple[0] == couple[1] and wrong.any():
            missed["restitution"] = np.flatnonzero(wrong)
        figures = (
            f"linear {met.linear.max():.1e}, angular {met.angular.max():.1e}, "
            f"gain {met.gained.max():.1e}, depth {1e3 * met.depth.max():.3f} mm"
        )
        yield f"pair {'/'.join(couple)} {hz} Hz {kind} e={restitution:g}", figures, missed


def heaps(sizes: Sizes) -> Iterator[Row]:
    """Let heaps come to rest, and stacks stand."""
    for airframe, hz in product(sizes.airframes, sizes.rates):
        began = time.process_time()
        for title, heap in (
            ("heap of 100", drop_heap(100, airframe, hz=hz, seconds=8.0)),
            ("stack of ten", stack(airframe=airframe, hz=hz)),
        ):
            found = {
                "speed": heap.speed > 0.01,
                "spin": heap.spin > 0.1,
                "depth": np.array([heap.depth > 5e-4]),
                "nobody on the ground": np.array([heap.height.min() > 2e-4]),
            }
            missed = {name: np.flatnonzero(bad) for name, bad in found.items() if bad.any()}
            spent = time.process_time() - began
            figures = (
                f"{heap.speed.max():.2g} m/s, {heap.spin.max():.2g} rad/s, "
                f"depth {1e3 * heap.depth:.3f} mm, {heap.seconds / spent:.2f} of real time"
            )
            yield f"{title} {airframe} {hz} Hz", figures, missed
            began = time.process_time()


def slopes(sizes: Sizes) -> Iterator[Row]:
    """Set drones on slopes about as steep as friction holds."""
    for airframe, hz, friction in product(sizes.airframes, sizes.rates, (0.1, 0.25, 0.5, 1.0)):
        tangents = friction * np.array([0.5, 0.9, 0.99, 0.999, 1.001, 1.01, 1.1, 1.5])
        slid, expected = slide(friction, tangents, airframe=airframe, hz=hz)
        wrong = np.abs(slid - expected) > 1e-3 * expected + 2e-4
        missed = {"way": np.flatnonzero(wrong)} if wrong.any() else {}
        ways = " ".join(f"{1e3 * one:.2f}" for one in slid)
        yield f"slope {airframe} {hz} Hz friction {friction:g}", f"slid {ways} mm", missed


def _seconds(work: Callable[[], object]) -> float:
    """Return the processor time of some work, s."""
    began = time.process_time()
    work()
    return time.process_time() - began


def _impact_cost() -> float:
    """Measure a rebound of pairs against the same flights far apart, us an impact."""
    spent = []
    worlds = 400
    for apart in (0.0, 5.0):
        with Rig(
            ["cf2x", "cf2x"], worlds=worlds, substeps=24, gravity=0.0, restitution=1.0, friction=0.0
        ) as rig:
            runs = []
            for _ in range(ROUNDS):
                rig.swarm.position[:, 0] = (0, 0, 50)
                rig.swarm.position[:, 1] = (0.2, 0.01 + apart, 50)
                rig.swarm.velocity[:] = 0
                rig.swarm.velocity[:, 0, 0] = 2.0
                rig.swarm.rates[:] = 0
                rig.swarm.quaternion[:] = (0, 0, 0, 1)
                rig.place()
                runs.append(_seconds(rig.fly))
            spent.append(min(runs))
    return 1e6 * (spent[0] - spent[1]) / worlds


def _resting_cost() -> float:
    """Measure drones that rest on the ground against those that hang in the air, us a substep."""
    spent = []
    worlds = 400
    for height, gravity in ((0.0, 9.81), (50.0, 0.0)):
        with Rig(worlds=worlds, substeps=240, gravity=gravity) as rig:
            rig.swarm.position[..., 2] = height + rig.airframes[0].shape.half[2] + 5e-5
            rig.place().fly()
            spent.append(_seconds(rig.fly))
    return 1e6 * (spent[0] - spent[1]) / (worlds * 240)


def _fly(aviary: bulletuav.Aviary, actions: np.ndarray) -> None:
    """Fly actions (T, W, N, A); all start anew where the horizon ends episodes."""
    for one in actions:
        if aviary.step(one).truncated.any():
            aviary.reset()


def _step_rate(dynamics: str, hz: int, random: bool) -> float:
    """Return environment steps a second of hover, 64 x 8, that no contact ends, with resets."""

    class Unending(find_task("hover")):  # type: ignore[misc]
        name = "unending"
        ends = ()

    rng = np.random.default_rng(0)
    options = {"num_drones": 8, "dynamics": dynamics, "decision_hz": hz, "action": "rotor"}
    aviary = bulletuav.Aviary(Unending, 64, **options)
    try:
        aviary.reset(seeds=0)
        shape = (hz * SECONDS, 64, 8, aviary.swarm.rotor_speed.shape[-1])
        actions = rng.uniform(-1, 1, shape) if random else np.zeros(shape)
        aviary.step(actions[0])
        compile_deferred()
        spent = _seconds(lambda: _fly(aviary, actions))
        return float(64 * len(actions) / spent)
    finally:
        aviary.close()


def _ending_rate(dynamics: str, random: bool) -> float:
    """Return environment steps a second of hover, 64 x 8, in which who crashes begins anew."""
    rng = np.random.default_rng(0)
    env = bulletuav.batch_env("hover", num_envs=64, num_drones=8, dynamics=dynamics)
    try:
        env.reset(seed=0)
        shape = (DECISIONS, *env.aviary.given.shape)
        actions = rng.uniform(-1, 1, shape) if random else np.zeros(shape)
        env.step(actions[0])
        compile_deferred()
        spent = min(_seconds(lambda: [env.step(one) for one in actions]) for _ in range(ROUNDS))
        return float(64 * DECISIONS / spent)
    finally:
        env.close()


TABLES = {
    "landings": landings,
    "walls": walls,
    "trains": trains,
    "pairs": pairs,
    "heaps": heaps,
    "slopes": slopes,
}
"""What can be asked for"""


def speeds() -> Iterator[Row]:
    """Measure what contacts cost."""
    for title, cost, most in (
        ("impact", _impact_cost(), IMPACT),
        ("resting drone and substep", _resting_cost(), RESTING),
    ):
        missed = {"time": np.array([0])} if cost > most else {}
        yield title, f"{cost:.2f} us, at most {most:g}", missed
    flights: list[tuple[str, Callable[[bool], float], float]] = [
        (f"{dynamics} {hz} Hz", partial(_step_rate, dynamics, hz), RANDOM_SHARE)
        for dynamics, hz in product(("rigid_body", "bullet"), (48, 10))
    ]
    flights += [
        (f"{dynamics}, crashes begin anew", partial(_ending_rate, dynamics), ENDING_SHARE)
        for dynamics in ("rigid_body", "bullet")
    ]
    for what, rate, share in flights:
        calm, wild = rate(False), rate(True)
        missed = {"rate": np.array([0])} if wild < share * calm else {}
        figures = f"{wild:.3g} of {calm:.3g} steps/s: {wild / calm:.2f}"
        yield f"random actions {what}", figures, missed


def report(rows: Iterator[Row]) -> int:
    """Print rows; return how many missed a bound."""
    bad = 0
    for title, figures, missed in rows:
        told = "; ".join(
            f"{name} in {len(where)} ({', '.join(map(str, where[:5]))})"
            for name, where in missed.items()
        )
        print(f"{title} | {figures} | {'MISSED ' + told if missed else 'ok'}", flush=True)
        bad += bool(missed)
    return bad


def main(argv: Sequence[str] | None = None) -> int:
    """Check, print; return 1 if a bound was missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of the worlds")
    parser.add_argument("--only", nargs="+", choices=[*TABLES, "speeds"], help="some tables")
    arguments = parser.parse_args(argv)
    sizes = Sizes(arguments.quick)
    bad = 0
    for name in arguments.only or [*TABLES, "speeds"]:
        bad += report(speeds() if name == "speeds" else TABLES[name](sizes))
    print(f"{bad} rows missed a bound")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
