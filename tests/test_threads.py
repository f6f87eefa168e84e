"""Torch's threads follow the CPUs that neighbours leave free."""

from __future__ import annotations

import sys
import time

import pytest
import torch

from torchrl_atr import _threads
from torchrl_atr._threads import TorchThreads, one_torch_thread_if_small
from torchrl_atr.cli.printing import StepCounter


@pytest.fixture
def threads(monkeypatch):
    """Eight threads on eight CPUs, entered."""
    monkeypatch.setattr(_threads, "available_cpus", lambda: 8)
    monkeypatch.setattr(_threads, "cpu_mask", lambda: list(range(8)))
    with TorchThreads(8) as entered:
        yield entered


@pytest.mark.parametrize(
    ("others", "count"), [(0.0, 8), (0.3, 8), (0.5, 4), (1.0, 4), (4.3, 4), (4.5, 2), (6.5, 1), (8.0, 1), (12.0, 1)]
)
def test_they_are_halved_until_they_fit(threads, others, count):
    threads.adapt(others)
    assert threads.count == torch.get_num_threads() == count


def test_they_come_back_after_three_quiet_measurements_in_a_row(threads):
    counts = []
    for others in (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0):
        threads.adapt(others)
        counts.append(torch.get_num_threads())
    assert counts == [4, 4, 4, 4, 4, 4, 8]


def test_it_is_said_once(threads, capsys):
    for others in (7.5, 0.0, 0.0, 0.0, 7.5):
        threads.adapt(others)
    said = capsys.readouterr().out.splitlines()
    assert said == ["other processes keep 7.5 of 8 CPUs busy: until they are free torch works with 1 of 8 threads"]


def test_it_is_said_by_one_process_of_a_run(threads, capsys):
    threads._announce = None
    threads.adapt(7.5)
    assert threads.count == 1
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(("others", "count"), [(0.0, 4), (50.0, 4), (61.0, 2), (64.0, 1)])
def test_a_quota_on_a_large_machine_leaves_room_for_neighbours(monkeypatch, others, count):
    monkeypatch.setattr(_threads, "available_cpus", lambda: 4)
    monkeypatch.setattr(_threads, "cpu_mask", lambda: list(range(64)))
    with TorchThreads(4) as threads:
        threads.adapt(others)
        assert threads.count == count


def test_slow_measurements_are_rare(threads, monkeypatch):
    def measure():
        time.sleep(0.05)
        return 0.0

    monkeypatch.setattr(threads._load, "measure", measure)
    threads._next = 0.0
    threads.update()
    assert threads._next - time.monotonic() > 4.0


def test_the_number_before_is_restored():
    before = torch.get_num_threads()
    with TorchThreads(before + 1):
        assert torch.get_num_threads() == before + 1
    assert torch.get_num_threads() == before


def test_update_measures_at_intervals(threads, monkeypatch):
    monkeypatch.setattr(threads._load, "measure", lambda: 7.9)
    threads.update()
    assert threads.count == 8  # too early
    threads._next = 0.0
    threads.update()
    assert threads.count == 1
    threads._load.measure = lambda: 0.0
    threads.update()
    assert threads._calm == 0  # too early again


@pytest.mark.parametrize("arguments", [{"limit": 8, "adaptive": False}, {"limit": 1}])
def test_a_fixed_number_stays(arguments, monkeypatch):
    with TorchThreads(**arguments) as threads:
        threads._next = 0.0
        threads.update()
        assert torch.get_num_threads() == arguments["limit"]


def test_the_default_is_torchs_own_within_the_available_cpus(monkeypatch):
    monkeypatch.setattr(_threads, "available_cpus", lambda: 1)
    assert TorchThreads().limit == 1


def test_the_line_is_not_appended_to_the_one_that_is_redrawn(threads, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    with StepCounter("evaluating", every=1) as counter:
        threads._announce = counter.note
        counter(1, 2)
        threads.adapt(7.5)
        counter(2, 2)
    lines = capsys.readouterr().out.replace("\r", "").splitlines()
    assert [line.split()[0] for line in lines] == ["evaluating:", "other", "evaluating:"]
    assert all(len(line) <= 120 for line in lines)


@pytest.mark.parametrize(("rows", "count"), [(1, 1), (2048, 1), (2049, 2)])
def test_a_small_batch_is_computed_with_one_thread_and_a_large_one_with_all(rows, count):
    class Batch:
        batch_size = torch.Size([rows])

        @one_torch_thread_if_small
        def threads(self, fail=False):
            if fail:
                raise RuntimeError
            return torch.get_num_threads()

    with TorchThreads(2, adaptive=False):
        assert Batch().threads() == count
        with pytest.raises(RuntimeError):
            Batch().threads(fail=True)
        assert torch.get_num_threads() == 2
