"""Every entry of a format, of an export and of objects in memory names what does what the entry says."""

from __future__ import annotations

import inspect
from dataclasses import is_dataclass

import pytest

from metapp.registry import Export, registry


@pytest.mark.parametrize("name", sorted(registry().formats))
def test_modules_have_what_entries_say(name: str) -> None:
    form = registry().formats[name]
    module = form.load()
    assert callable(module.find)
    assert not form.inputs or callable(module.recognises)
    command = registry().commands.get(f"data {name}")
    if command and is_dataclass(converter := command.load()):
        options = list(converter().arguments())
        if hasattr(module, "conversion"):
            assert list(inspect.signature(module.conversion).parameters)[2:] == options
        else:
            assert module.UNITS
            assert set(options) <= set(inspect.signature(module.read_task).parameters)


@pytest.mark.parametrize("form", registry().exports.values(), ids=map("-".join, registry().exports))
def test_writers_take_a_surface_or_parameters(form: Export) -> None:
    parameters = list(inspect.signature(form.load()).parameters)
    assert parameters[:2] == (["surface", "path"] if form.of_surface else ["app", "theta"])
    assert len(parameters) == 3
