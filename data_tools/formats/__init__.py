"""The formats of files that tasks come from or fits are written in.

Each module here registers some: what a format is called, whose tasks it holds, which options its conversion takes;
commands and help texts are made of these. What finds, reads and writes the files is a module of `data_tools.readers`,
imported on first use.
"""

from __future__ import annotations

from data_tools.formats import brdf, light, pictures
from metapp.registry import Export, Format, Registry, registry


def register(registry: Registry) -> None:
    """Add the formats that ship."""
    for module in (brdf, pictures, light):
        module.register(registry)


def formats() -> dict[str, Format]:
    """Return all formats that tasks come from, sorted by name."""
    return dict(sorted(registry().formats.items()))


def inputs_of(app: str) -> dict[str, Format]:
    """Return the formats that fits of an application take as INPUT, by name."""
    return {name: form for name, form in sorted(registry().formats.items()) if form.app == app and form.inputs}


def exports_of(app: str) -> dict[str, Export]:
    """Return the forms that fits of an application can be written in, sorted by name."""
    return dict(sorted(registry().exports.of(app).items()))
