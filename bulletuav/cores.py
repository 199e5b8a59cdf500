"""Number of cores that this process may use: affinity, and quotas of control groups."""

import os
from collections.abc import Iterator
from pathlib import Path

ROOT = Path("/")


def count_cores(root: Path = ROOT) -> float:
    """Return the number of cores that this process may use at a time.

    This is the number of cores of its affinity, or less by the quotas of its control groups
    (version 1 or 2) and their ancestors, which containers and batch systems set.

    Args:
        root: Folder with `proc` and `sys`.

    Returns:
        Cores, above 0; 1.5 for a quota of 150 ms in 100 ms.

    References:
        Linux kernel documentation, "Control Group v2" (cpu.max) and "CFS Bandwidth Control".
    """
    if hasattr(os, "sched_getaffinity"):
        cores = float(len(os.sched_getaffinity(0)))
    else:
        cores = float(os.cpu_count() or 1)
    return min([cores, *_list_quotas(root)])


def _list_quotas(root: Path) -> Iterator[float]:
    """List the quotas of the control groups of this process, in cores."""
    mounts = root / "sys" / "fs" / "cgroup"
    for line in _read(root / "proc" / "self" / "cgroup").splitlines():
        # Number of the hierarchy, controllers (none in version 2), and path of the group
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if controllers and "cpu" not in controllers.split(","):
            continue
        # Names of a hierarchy of version 1 differ between distributions
        for mount in (mounts / controllers, mounts / "cpu") if controllers else (mounts,):
            group = mount / path.lstrip("/")
            # Containers may see the path on the host, of which only the mount exists
            for folder in (group, *group.parents):
                if not folder.is_relative_to(mount):
                    break
                yield from _read_quota(folder)


def _read_quota(folder: Path) -> Iterator[float]:
    """Yield the quota of one control group in cores, if it has one."""
    words = _read(folder / "cpu.max").split()
    if not words:
        names = ("cpu.cfs_quota_us", "cpu.cfs_period_us")
        words = [_read(folder / name).strip() for name in names]
    # "max" and -1 are no quota
    if len(words) == 2 and all(word.isdecimal() and int(word) for word in words):
        yield int(words[0]) / int(words[1])


def _read(path: Path) -> str:
    """Return the text of a file, "" if it cannot be read."""
    try:
        return path.read_text()
    except OSError:
        return ""
