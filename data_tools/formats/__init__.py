"""The formats of files that tasks come from or fits are written in; `data_tools.readers` has their readers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from metapp.registry import Export, Format, registry


@dataclass(frozen=True)
class Converter:
    """The command `metapp data NAME` that converts files of the format NAME: its options are fields, its help the text.

    Attributes:
        split_help: of --split, if files or names tell more than the general rule.
    """

    split_help: ClassVar[str] = (
        "Where the tasks belong. auto: of the sorted names, every fifth is a test task (80 give 64 + 16)."
    )

    def arguments(self) -> dict[str, object]:
        """The options as keywords of the format's `read_task`."""
        return dict(vars(self))


def formats() -> dict[str, Format]:
    """Return all formats that tasks come from, sorted by name."""
    return dict(sorted(registry().formats.items()))


def inputs_of(app: str) -> dict[str, Format]:
    """Return the formats that fits of an application take as INPUT, by name."""
    return {name: form for name, form in formats().items() if form.app == app and form.inputs}


def exports_of(app: str) -> dict[str, Export]:
    """Return the forms that fits of an application can be written in, sorted by name."""
    return dict(sorted(registry().exports.of(app).items()))
