"""Damaged files from the command line; see `--help`."""

import argparse
import sys
from pathlib import Path

from .run import run


def main():
    """Run cases, and list what is wrong with how they ended."""
    from .formats import FORMATS

    parser = argparse.ArgumentParser(description="Damaged files of every format that is read")
    parser.add_argument("--seed", type=int, default=0, help="what the damage is drawn from")
    parser.add_argument("--cases", type=int, default=200, help="cases of each format")
    parser.add_argument("--only", choices=FORMATS, help="one format alone")
    parser.add_argument("--case", type=int, help="one case alone, whose files are kept in ./fuzz")
    arguments = parser.parse_args()
    names = [arguments.only] if arguments.only else list(FORMATS)
    if arguments.case is not None:
        keep(names[0], arguments.seed, arguments.case)
        wanted = {names[0]: (arguments.case, arguments.case + 1)}
    else:
        wanted = {
            name: (0, max(3, round(FORMATS[name].weight * arguments.cases))) for name in names
        }
    faults, count = run(wanted, arguments.seed)
    for fault in faults:
        print(fault)
    print(f"{count} cases, {len(faults)} faults")
    return int(bool(faults))


def keep(name, seed, index):
    """Write the files of a case into ./fuzz."""
    from .cases import files_of, write_damaged

    valid = Path("fuzz", "valid")
    valid.mkdir(parents=True, exist_ok=True)
    write_damaged(name, seed, index, files_of(name, valid), Path("fuzz", "damaged files"))


if __name__ == "__main__":
    sys.exit(main())
