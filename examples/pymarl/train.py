"""Train drones with QMIX, VDN, MAPPO or MADDPG of the unmodified EPyMARL or pymarlzooplus.

The first argument is a checkout of EPyMARL, or the word `pymarlzooplus` for the package that pip
installs. The algorithm is the name of a YAML file next to this script. Further arguments are passed
to the program, such as `with t_max=100000 env_args.num_drones=3`. The files `bulletuav.yaml` (the
task) and `qmix.yaml`, `vdn.yaml`, `mappo.yaml` and `maddpg.yaml` are templates to copy and change.

Run it:

    python examples/pymarl/train.py path/to/epymarl qmix
    python examples/pymarl/train.py pymarlzooplus mappo with t_max=20000

Results are in the folder `results` of the EPyMARL checkout, or next to this script.
"""

import importlib.util
import logging
import runpy
import sys
import types
from pathlib import Path

from bulletuav.adapters.pymarl import register_pymarl

HERE = Path(__file__).parent.resolve()


def run_epymarl(checkout: Path, arguments: list[str]) -> None:
    """Run the main program of EPyMARL."""
    source = checkout / "src"
    sys.path.insert(0, str(source))
    # EPyMARL always imports this environment, which is in no package index
    if importlib.util.find_spec("smaclite") is None:
        sys.modules["smaclite"] = types.ModuleType("smaclite")
    # EPyMARL logs everything, and Numba's log of a compilation has 100,000 lines
    logging.getLogger("numba").setLevel(logging.WARNING)
    from envs import REGISTRY

    register_pymarl(REGISTRY)
    sys.argv = ["main.py", *arguments]
    runpy.run_path(str(source / "main.py"), run_name="__main__")


def run_pymarlzooplus(arguments: list[str]) -> None:
    """Run pymarlzooplus."""
    from pymarlzooplus import pymarlzooplus
    from pymarlzooplus.envs import REGISTRY

    register_pymarl(REGISTRY, flavour="pymarl")
    pymarlzooplus(["main.py", *arguments])


def main() -> None:
    """Pass the files next to this script to the program, as full paths without extension."""
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    program, algorithm, *rest = sys.argv[1:]
    files = [f"--config={HERE / algorithm}", f"--env-config={HERE / 'bulletuav'}"]
    if program == "pymarlzooplus":
        run_pymarlzooplus([*files, *rest])
    else:
        run_epymarl(Path(program), [*files, *rest])


# The programs start environments in processes that import this file
if __name__ == "__main__":
    main()
