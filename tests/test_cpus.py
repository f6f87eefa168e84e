"""CPUs that are there, and those that neighbours use."""

from __future__ import annotations

import collections
import os
import subprocess
import sys
import time

import psutil
import pytest

from benchmarks.busy_neighbour import busy_processes
from torchrl_atr import _cpus
from torchrl_atr._cpus import NeighbourLoad, available_cpus, cgroup_quota, cpu_mask


def test_available_cpus_are_those_of_the_affinity_mask():
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("no affinity masks here")
    mask = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(mask)})
        assert available_cpus() == 1
    finally:
        os.sched_setaffinity(0, mask)
    assert 1 <= available_cpus() <= len(mask)


def write_group(folder, **files):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(text)


class TestQuota:
    def test_version_2_takes_the_smallest_of_the_groups_above(self, tmp_path):
        write_group(tmp_path / "slice/job", cpu__max="max 100000\n")
        write_group(tmp_path / "slice", cpu__max="250000 100000\n")
        write_group(tmp_path, cpu__max="400000 100000\n")
        (tmp_path / "self").write_text("0::/slice/job\n")
        assert cgroup_quota(tmp_path, tmp_path / "self") == 2.5

    def test_version_1_reads_the_hierarchy_of_cpu_alone(self, tmp_path):
        write_group(tmp_path / "cpu,cpuacct/job", cpu__cfs_quota_us="50000", cpu__cfs_period_us="100000")
        write_group(tmp_path / "cpuset/job", cpu__cfs_quota_us="10000", cpu__cfs_period_us="100000")
        (tmp_path / "self").write_text("3:cpuset:/job\n2:cpu,cpuacct:/job\n")
        assert cgroup_quota(tmp_path, tmp_path / "self") == 0.5

    @pytest.mark.parametrize("text", ["max 100000", "-1", "", "many 100000"])
    def test_no_quota_is_none(self, tmp_path, text):
        write_group(tmp_path, cpu__max=text)
        (tmp_path / "self").write_text("0::/\n1:cpu:/gone\n")
        assert cgroup_quota(tmp_path, tmp_path / "self") is None

    def test_version_1_mounts_of_another_name_and_names_that_are_no_text(self, tmp_path):
        write_group(tmp_path / "cpu", cpu__cfs_quota_us="150000", cpu__cfs_period_us="100000")
        (tmp_path / "self").write_bytes(b"2:cpuacct,cpu:/j\xff\n1:name=systemd:/a:b\n")
        assert cgroup_quota(tmp_path, tmp_path / "self") == 1.5

    def test_without_cgroups_is_none(self, tmp_path):
        assert cgroup_quota(tmp_path, tmp_path / "nowhere") is None


def orphan(seconds):
    """Start a busy process that is no descendant of this one."""
    code = f"import time; end = time.monotonic() + {seconds}\nwhile time.monotonic() < end: pass"
    subprocess.run(["sh", "-c", '"$0" -c "$1" &', sys.executable, code], check=True, stdout=subprocess.DEVNULL)


def test_contention_is_detected():
    if not sys.platform.startswith("linux"):
        pytest.skip("measured on Linux alone")
    load = NeighbourLoad()
    orphan(3.0)
    time.sleep(0.5)
    load.measure()
    time.sleep(1.5)
    assert load.measure() > 0.25  # all of a CPU, unless other tests share it


def test_work_of_its_own_and_of_descendants_is_no_contention():
    load = NeighbourLoad()
    own = load._read()[2]
    with busy_processes(1):
        time.sleep(1.0)
        assert load._read()[2] - own > 0.1


def readings(monkeypatch, load, *values):
    """Have the next readings be these."""
    pending = list(values)
    monkeypatch.setattr(load, "_read", lambda: pending.pop(0))


def test_a_descendant_that_ends_while_it_is_read_is_no_neighbour(monkeypatch):
    load = NeighbourLoad()
    load._last = (0.0, 0.0, 0.0)
    # the child's 900 s are lost in one reading, and counted with the parent's in the next
    readings(monkeypatch, load, (2.0, 2.0, 902.0), (4.0, 4.0, 4.0), (6.0, 6.0, 906.0))
    assert [load.measure() for _ in range(3)] == [0.0, 0.0, 0.0]


def test_a_load_is_at_most_all_cpus(monkeypatch):
    load = NeighbourLoad()
    load._last = (0.0, 0.0, 0.0)
    readings(monkeypatch, load, (1.0, 1e6, 0.0))
    assert load.measure() == len(cpu_mask())


@pytest.mark.parametrize("error", [psutil.AccessDenied(1), PermissionError("/proc/stat"), NotImplementedError()])
@pytest.mark.parametrize("what", ["children", "cpu_times"])
def test_a_system_that_does_not_tell_has_no_neighbours(monkeypatch, what, error):
    def refuse(*_, **__):
        raise error

    monkeypatch.setattr(psutil if what == "cpu_times" else psutil.Process, what, refuse)
    load = NeighbourLoad()
    assert load.measure() == 0.0


@pytest.mark.parametrize(
    ("mask", "listed", "busy"),
    [([0, 1], 4, 3.0), ([2, 3], 4, 7.0), ([0, 2, 3], 3, 6.0), ([6, 7], 2, 3.0), ([8], 4, 0.0)],
    ids=["part", "other-part", "one-offline", "renumbered", "unknown"],
)
def test_cpus_are_those_of_the_mask(monkeypatch, mask, listed, busy):
    times = collections.namedtuple("times", "user idle guest")
    monkeypatch.setattr(_cpus, "cpu_mask", lambda: mask)
    monkeypatch.setattr(psutil, "cpu_times", lambda percpu: [times(cpu + 1.0, 50.0, 1.0) for cpu in range(listed)])
    assert NeighbourLoad()._last[1] == busy
