"""Forms of JSON documents, which anybody may have written: what they must hold."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

NUMBER, OPTIONAL = int | float, int | float | None


def holds(value: object, form: object) -> bool:
    """True if a JSON document has a form, as `misfits` reads it."""
    return next(misfits(value, form), None) is None


def misfits(value: object, form: object, place: str = "") -> Iterator[str]:
    """The places of a JSON document, such as `.settings.seed`, that have not a form.

    A form is a type, or a union of several, of which numbers must be finite; a range of whole numbers; a list of one
    form, that of all items; a tuple of forms, one for each item of a list; a dictionary of the forms of those entries
    that must be there, or, where `?` follows the name, may be; where `...` is the name, the form of all.
    """
    if isinstance(form, dict) and isinstance(value, dict):
        if ... in form:
            for key, each in value.items():
                yield from misfits(each, form[...], f"{place}.{key}")
            return
        for key, of in form.items():
            name = key.removesuffix("?")
            if name in value:
                yield from misfits(value[name], of, f"{place}.{name}")
            elif name == key:
                yield f"{place}.{name}"
    elif isinstance(form, list | tuple) and isinstance(value, list):
        forms = form if isinstance(form, tuple) else form * len(value)
        if len(forms) != len(value):
            yield place
        else:
            for i, (each, of) in enumerate(zip(value, forms, strict=True)):
                yield from misfits(each, of, f"{place}.{i}")
    elif isinstance(form, dict | list | tuple) or not _is(value, form):
        yield place


def _is(value: object, form: Any) -> bool:
    """True if a value is of a type, finite if a number, or in a range."""
    if isinstance(form, range):
        return type(value) is int and value in form
    if isinstance(value, bool) or not isinstance(value, form):
        return False
    return not isinstance(value, int | float) or abs(value) <= sys.float_info.max
