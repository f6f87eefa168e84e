"""Policies of a reproduction are found by their pair and task."""

from __future__ import annotations

from torchrl_atr.reproduction import policies as module


def test_installed_policies_are_those_of_the_task(untrained, monkeypatch):
    tasks = {"a1-single_board": "riding", "a1-walking": "walking", "again": "riding"}
    monkeypatch.setattr(module, "policies", lambda: tasks)
    monkeypatch.setattr(module, "read_manifest", lambda name: {"task": tasks[name]})
    loaded = []
    monkeypatch.setattr(module, "load_rider", lambda name, imports: loaded.append(name) or untrained)
    assert module.installed_policies() == [untrained]  # the first of each pair
    assert loaded == ["a1-single_board", "again"]
    assert module.installed_policies(task="walking") == [untrained]
    assert loaded[2:] == ["a1-walking"]
