"""What the extension registers: methods by name, a command, a table; and all without it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.apps import app_names, app_of, protocols_of, recipes_of
from metapp.evaluation.tables import table_names
from metapp.extensions.baselines import baselines_of
from metapp.extensions.examples.commands import lines_of
from metapp.registry import WITHOUT, registry


@pytest.mark.parametrize("name", app_names())
def test_the_methods_offered_are_those_of_all_protocols(name: str) -> None:
    apps = [app_of(name, recipes_of(name)["quick"], protocol) for protocol in protocols_of(name) or ("",)]
    methods = {baseline.name: None for app in apps for baseline in baselines_of(app)}
    assert list(registry().baselines.of(name)) == list(methods)


def test_without_it_its_command_and_table_are_refused_by_its_name(
    metapp: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(WITHOUT, "baselines")
    assert "a command of the extension baselines" in metapp("baseline", "texture", "wall.png").misuse
    assert "a table of the extension baselines" in metapp("evaluate", "--which", "baselines").misuse
    assert "baselines" not in table_names()
    assert not any(line.startswith("metapp baseline") for app in app_names() for line, _ in lines_of(app, Path()))
