"""Every record of a format, of an export and of objects in memory names what does what the record says."""

from __future__ import annotations

import inspect

import pytest

from data_tools.formats import formats
from metapp.registry import Export, Format, keyword_of, registry


@pytest.mark.parametrize("form", formats().values(), ids=formats())
def test_modules_have_what_records_say(form: Format) -> None:
    module = form.load()
    assert callable(module.recognises)
    assert callable(module.find)
    takes = {*form.takes, *(keyword_of(option) for option in form.options)}
    assert takes <= set(inspect.signature(module.read_task).parameters)
    if form.command:
        options = [option.name for option in form.command.options]
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
