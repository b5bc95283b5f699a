"""The formats of files that tasks come from or fits are written in.

Each module here offers some: what a format is called, whose tasks it holds, which options its conversion takes;
commands and help texts are made of these. What finds, reads and writes the files is a module of `data_tools.readers`,
imported on first use.
"""

from __future__ import annotations

from data_tools.formats import brdf, light, pictures
from metapp import door

AUTO = "auto"  # the split by a rule: train and test tasks
OFFERS = (*brdf.OFFERS, *pictures.OFFERS, *light.OFFERS)


def formats() -> tuple[door.Format, ...]:
    """Return all formats that tasks come from, by name."""
    return tuple(sorted(door.offers(door.Format), key=lambda form: form.name))


def inputs_of(app: str) -> tuple[door.Format, ...]:
    """Return the formats that fits of an application take as INPUT."""
    return tuple(form for form in formats() if form.app == app and form.inputs)


def exports_of(app: str) -> dict[str, door.Export]:
    """Return the forms that fits of an application can be written in, by name."""
    forms = (form for form in door.offers(door.Export) if app in form.apps)
    return {form.name: form for form in sorted(forms, key=lambda form: form.name)}
