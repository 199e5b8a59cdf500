"""The simulation from the command line; see `--help`."""

import argparse
import sys
import tempfile
import time

from .invariants import resident
from .run import PATIENCE, Outcome, run, shrink, table
from .soak import soak


def main() -> int:
    """Run the simulation, and tell how to replay what fails."""
    parser = argparse.ArgumentParser(description="Random operations and faults on all of bulletuav")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--operations", type=int, default=1000, help="operations of all seeds")
    parser.add_argument("--each", type=int, default=500, help="operations of one seed")
    parser.add_argument("--narrow", action="store_true", help="draw forms as the test suite does")
    parser.add_argument("--only", help="numbers of the operations to do, such as 3,17,18")
    parser.add_argument("--skip", default="", help="names of operations to leave out")
    parser.add_argument("--patience", type=float, default=PATIENCE, help="s until a hang is told")
    parser.add_argument("--soak", type=int, metavar="STEPS", help="fly for long instead")
    arguments = parser.parse_args()
    if arguments.soak:
        return soak(arguments.soak)
    outcomes: list[Outcome] = []
    failed, begin = 0, time.perf_counter()
    wide, seed, done = not arguments.narrow, arguments.seed, 0
    skip = arguments.skip.split(",")
    only = None if arguments.only is None else [int(one) for one in arguments.only.split(",")]
    with tempfile.TemporaryDirectory() as folder:
        while done < arguments.operations:
            count = min(arguments.each, arguments.operations - done)
            one = run(seed, count, folder, wide, only, arguments.patience, skip)
            outcomes.append(one)
            done += count
            took = time.perf_counter() - begin
            print(f"seed {seed}: {one.digest} {resident():.0f} MB {took:.0f} s", flush=True)
            if one.failure is not None:
                failed += 1
                report(one, folder, wide)
            if only is not None:
                break
            seed += 1
    print(table(outcomes))
    done = sum(sum(one.counts.values()) for one in outcomes)
    print(f"{done} operations, {failed} failures, {time.perf_counter() - begin:.0f} s")
    return int(failed > 0)


def report(outcome: Outcome, folder: str, wide: bool) -> None:
    """Tell what failed, and the few operations that replay it."""
    failure = outcome.failure
    assert failure is not None
    print(f"  operation {failure.operation}, {failure.name}", flush=True)
    print(f"  {failure.what}\n  {failure.notes}", flush=True)
    if failure.operation >= 0:
        numbers = ",".join(map(str, shrink(failure, outcome.ran, folder, wide)))
        narrow = "" if wide else " --narrow"
        print(f"  python -m tests.simulation --seed {failure.seed}{narrow} --only {numbers}")


if __name__ == "__main__":
    sys.exit(main())
