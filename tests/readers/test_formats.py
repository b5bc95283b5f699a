"""Every entry of a format, of an export and of objects in memory names what does what the entry says."""

from __future__ import annotations

import inspect
from dataclasses import fields

import pytest

from data_tools.formats import formats
from metapp.registry import Export, Format, registry


@pytest.mark.parametrize("form", formats().values(), ids=formats())
def test_modules_have_what_entries_say(form: Format) -> None:
    module = form.load()
    assert callable(module.find)
    assert not form.inputs or callable(module.recognises)
    assert set(form.takes) <= set(inspect.signature(module.read_task).parameters)
    if form.help:
        assert module.UNITS
        options = {field.name for field in fields(form.options)} if form.options else set()
        assert options <= set(inspect.signature(module.read_task).parameters)


@pytest.mark.parametrize("form", registry().exports.values(), ids=map("-".join, registry().exports))
def test_writers_take_a_surface_or_parameters(form: Export) -> None:
    parameters = list(inspect.signature(form.load()).parameters)
    assert parameters[:2] == (["surface", "path"] if form.of_surface else ["app", "theta"])
    assert len(parameters) == 3
