"""Finding extensions by their entry points, and loading what their records name."""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.metadata
import os
from collections.abc import Iterator, Mapping, Sequence
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

GROUP = "metapp.extensions"
WITHOUT = "METAPP_WITHOUT"  # environment variable: names of extensions to leave out, separated by commas
SHIPPED = "metapp"  # the distribution whose extensions come first

Kind = TypeVar("Kind")


class Extension(NamedTuple):
    """A module that offers something.

    Attributes:
        name: of its entry point.
        package: the distribution that it is installed with.
        offers: records of this package; () where the module cannot be imported.
        problem: why not, in one line; "" where it can.
    """

    name: str
    package: str
    offers: tuple[object, ...]
    problem: str = ""


_added: list[Extension] = []  # by programs, for as long as `extended` says


def load(reference: str) -> Any:
    """The object that a "module:attribute" names, or "module:TABLE.key" an entry of; the module is imported now.

    Raises:
        ImportError: there is no such module.
        AttributeError: it has no such attribute.
        KeyError: the table has no such entry.
    """
    name, _, path = reference.partition(":")
    thing: Any = module_of(name)
    for part in path.split("."):
        thing = thing[part] if isinstance(thing, Mapping) else getattr(thing, part)
    return thing


def module_of(name: str) -> ModuleType:
    """The module of a dotted name, imported now."""
    return importlib.import_module(name)


def offers(kind: type[Kind]) -> tuple[Kind, ...]:
    """All records of a kind, those of metapp first, in the order of extensions and of their OFFERS."""
    return tuple(offer for extension in extensions() for offer in extension.offers if isinstance(offer, kind))


def offers_of(kind: type[Kind], app: str) -> tuple[Kind, ...]:
    """The records of a kind that are for an application."""
    return tuple(offer for offer in offers(kind) if getattr(offer, "app") == app)  # noqa: B009  # kinds have it


def extensions() -> tuple[Extension, ...]:
    """All extensions but those that METAPP_WITHOUT names."""
    names = _left_out(os.environ.get(WITHOUT, ""))
    return tuple(extension for extension in (*_installed(), *_added) if extension.name not in names)


def left_out() -> tuple[Extension, ...]:
    """The extensions that METAPP_WITHOUT leaves out."""
    names = _left_out(os.environ.get(WITHOUT, ""))
    return tuple(extension for extension in (*_installed(), *_added) if extension.name in names)


def switched_off(kind: type[object], name: str) -> str:
    """The extension that METAPP_WITHOUT leaves out and that offers a record of this kind and name; "" for none."""
    for extension in left_out():
        if any(isinstance(offer, kind) and getattr(offer, "name", "") == name for offer in extension.offers):
            return extension.name
    return ""


def problems() -> list[str]:
    """A line for each extension that cannot be used."""
    return [
        f"extension {extension.name} of {extension.package}: {extension.problem}; it is left out."
        for extension in extensions()
        if extension.problem
    ]


@contextlib.contextmanager
def extended(name: str, records: Sequence[object]) -> Iterator[None]:
    """Offer records in this process, without a package, as tests and notebooks do."""
    extension = Extension(name, "", tuple(records))
    _added.append(extension)
    try:
        yield
    finally:
        _added.remove(extension)


@functools.cache
def _left_out(text: str) -> frozenset[str]:
    return frozenset(filter(None, (name.strip() for name in text.split(","))))


@functools.cache
def _installed() -> tuple[Extension, ...]:
    """The extensions of all installed packages, those of metapp first, else by package and module."""
    points = importlib.metadata.entry_points(group=GROUP)
    by_place = sorted(points, key=lambda point: (_package(point) != SHIPPED, _package(point), point.value))
    return tuple(map(_opened, by_place))


def _package(point: importlib.metadata.EntryPoint) -> str:
    return _name_of(point.dist) if point.dist else ""


@functools.cache  # each look at a name parses the package's metadata
def _name_of(package: importlib.metadata.Distribution) -> str:
    return package.name


def _opened(point: importlib.metadata.EntryPoint) -> Extension:
    try:
        records = load(f"{point.value}:OFFERS" if ":" not in point.value else point.value)
    except Exception as error:  # whatever a stranger's module does, the rest of metapp works
        if _package(point) == SHIPPED:
            raise
        return Extension(point.name, _package(point), (), f"{type(error).__name__}: {error}")
    return Extension(point.name, _package(point), tuple(records))
