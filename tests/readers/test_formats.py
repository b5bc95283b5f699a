"""Every record of a format names a module that does what the record says."""

from __future__ import annotations

import importlib
import inspect

import pytest

from data_tools.formats import EXPORTS, Export, Format, formats


@pytest.mark.parametrize("form", formats(), ids=lambda form: f"{form.name}-{form.app}")
def test_modules_have_what_records_say(form: Format) -> None:
    module = importlib.import_module(form.module)
    if form.inputs or form.command:
        assert callable(module.recognises)
        assert callable(module.find)
        assert set(form.takes) <= set(inspect.signature(module.read_task).parameters)
    assert callable(getattr(module, "export", None)) is form.exports
    if form.command:
        settings = [setting.name for setting in form.command.settings]
        if hasattr(module, "conversion"):
            assert list(inspect.signature(module.conversion).parameters)[2:] == settings
        else:
            assert module.UNITS
            assert set(settings) <= set(inspect.signature(module.read_task).parameters)


@pytest.mark.parametrize("form", EXPORTS, ids=lambda form: form.name)
def test_writers_take_a_surface(form: Export) -> None:
    writer = getattr(importlib.import_module(f"data_tools.assets.{form.module}"), f"write_{form.name}")
    assert list(inspect.signature(writer).parameters) == ["surface", "path", "provenance"]
