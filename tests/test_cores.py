"""Cores of the process, read from files of control groups as Linux writes them."""

import os

import pytest

from bulletuav.cores import count_cores

AFFINITY = float(len(os.sched_getaffinity(0)))


def write_files(root, files):
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


V2 = {"proc/self/cgroup": "0::/job/task\n"}
V1 = {"proc/self/cgroup": "5:memory:/x\n3:cpu,cpuacct:/docker/abc\n1:cpuset:/\n0::/\n"}
GROUP = "sys/fs/cgroup"


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, AFFINITY),
        (V2 | {f"{GROUP}/job/task/cpu.max": "max 100000\n"}, AFFINITY),
        (V2 | {f"{GROUP}/job/task/cpu.max": "50000 100000\n"}, 0.5),
        # The quota of an ancestor limits its children
        (V2 | {f"{GROUP}/job/cpu.max": "20000 50000\n"}, 0.4),
        (
            V2
            | {
                f"{GROUP}/job/cpu.max": "80000 100000\n",
                f"{GROUP}/job/task/cpu.max": "70000 100000\n",
            },
            0.7,
        ),
        # A container that sees the root of its own control group only
        ({"proc/self/cgroup": "0::/\n", f"{GROUP}/cpu.max": "30000 100000\n"}, 0.3),
        (V2 | {f"{GROUP}/job/task/cpu.max": "100000000 100000\n"}, AFFINITY),
        (
            V1
            | {
                f"{GROUP}/cpu,cpuacct/docker/abc/cpu.cfs_quota_us": "60000\n",
                f"{GROUP}/cpu,cpuacct/docker/abc/cpu.cfs_period_us": "100000\n",
            },
            0.6,
        ),
        # The path of the host, of which a container mounts the last folder
        (
            V1
            | {
                f"{GROUP}/cpu/cpu.cfs_quota_us": "25000\n",
                f"{GROUP}/cpu/cpu.cfs_period_us": "100000\n",
            },
            0.25,
        ),
        (
            V1
            | {
                f"{GROUP}/cpu/cpu.cfs_quota_us": "-1\n",
                f"{GROUP}/cpu/cpu.cfs_period_us": "100000\n",
            },
            AFFINITY,
        ),
        # Quotas of other controllers, and files that are no numbers
        ({"proc/self/cgroup": "5:memory:/x\n", f"{GROUP}/cpu.max": "30000 100000\n"}, AFFINITY),
        (V2 | {f"{GROUP}/job/task/cpu.max": "a few\n"}, AFFINITY),
    ],
)
def test_cores_follow_from_affinity_and_quotas(files, expected, tmp_path):
    write_files(tmp_path, files)
    assert count_cores(tmp_path) == expected


def test_one_core_of_affinity_is_the_most(tmp_path):
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert count_cores(tmp_path) == 1.0
    finally:
        os.sched_setaffinity(0, before)
