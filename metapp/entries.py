"""References to objects that are imported at first use, and tables of such references by name.

A reference is a text, so that help and lists know what there is without importing it. Of metapp nothing is imported.
"""

from __future__ import annotations

import contextlib
import difflib
import importlib
import warnings
from collections import UserDict
from collections.abc import Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from typing_extensions import override

METAPP_PACKAGE = "metapp"  # the package whose entries must be there; entries of other packages may be left out

Value = TypeVar("Value")  # the type of a table's entries
Contract = TypeVar("Contract")  # the type of the object that a reference names
_REGISTERING_PACKAGE: ContextVar[str] = ContextVar("package", default=METAPP_PACKAGE)


def load_reference(reference: str) -> Any:
    """Import what a reference names, and return it.

    Args:
        reference: "module:attribute", "module:TABLE.key" for the entry of a table, or "module".

    Raises:
        ImportError: there is no such module, attribute or entry, or an error ends the import.

    >>> load_reference("math:tau")
    6.283185307179586
    """
    name, _, path = reference.partition(":")
    try:
        found: Any = importlib.import_module(name)
        for part in path.split(".") if path else ():
            found = found[part] if isinstance(found, Mapping) else getattr(found, part)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise ImportError(f"{reference} cannot be loaded: {describe_error(error)}") from error
    return found


def describe_error(error: BaseException) -> str:
    """Return the type and the message of an error, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """Return a question that ends an error about an unknown word, if names begin with it or resemble it; else "".

    >>> did_you_mean("mreta", ["general", "meta"])
    " Did you mean 'meta'?"
    """
    choices = list(names)
    similar = [name for name in choices if word and name.startswith(word)] or difflib.get_close_matches(
        word, choices, 1
    )
    return f" Did you mean {' or '.join(map(repr, similar))}?" if similar else ""


@dataclass(frozen=True)
class Lazy(Generic[Contract]):
    """A reference to an object, which is imported when it is loaded for the first time.

    Attributes:
        reference: "module:attribute"; "module:TABLE.key" for an entry of a dictionary; "module" for the module itself.

    >>> Lazy("math:gcd").load()(12, 18)
    6
    """

    reference: str

    def load(self) -> Contract:
        """Import and return the object.

        Raises:
            ImportError: there is no such module or attribute, or an error ends the import.
        """
        loaded: Contract = load_reference(self.reference)
        return loaded


class SetOnce:
    """A base class of objects that extensions fill: only fields that a class states can be set, and each only once.

    A subclass is a dataclass with an attribute `name`, with which errors begin; a field that is None is not set.
    """

    name: str

    @override
    def __setattr__(self, name: str, value: object) -> None:
        if name not in self.__dataclass_fields__:  # type: ignore[attr-defined]
            raise AttributeError(f"{name} of {self.name}: there is no such field")
        if vars(self).get(name) is not None:
            raise ValueError(f"{name} of {self.name}: is set already")
        super().__setattr__(name, value)


@contextlib.contextmanager
def registering(package: str) -> Iterator[None]:
    """Take a package as the owner of all entries that are set in a `with` block."""
    token = _REGISTERING_PACKAGE.set(package)
    try:
        yield
    finally:
        _REGISTERING_PACKAGE.reset(token)


class Entries(UserDict[Any, Value]):
    """A table of entries by name, each of which can be set once.

    Args:
        kind: the type of all entries.
        title: the name of the table, with which errors begin.
        pairs: whether keys may also be pairs of names.
        owners: the package that set each key.

    >>> commands = Entries(Lazy, "commands")
    >>> commands["count"] = Lazy("mine:count")
    >>> commands["count"] = Lazy("mine:count_all")
    Traceback (most recent call last):
    ValueError: commands count: registered by metapp, but metapp has registered it already
    """

    def __init__(self, kind: type[Value], title: str, *, pairs: bool = False) -> None:
        super().__init__()
        self.kind, self.title, self.pairs = kind, title, pairs
        self.owners: dict[Any, str] = {}

    @override
    def __setitem__(self, key: Any, value: Value) -> None:
        words = key if self.pairs and isinstance(key, tuple) and len(key) == 2 else (key,)
        if not all(isinstance(word, str) and word for word in words):
            raise TypeError(f"{self.title} {key!r}: expected a name{' or a pair of names' if self.pairs else ''}")
        name = " ".join((self.title, *words))
        if not isinstance(value, self.kind):
            raise TypeError(f"{name}: a {type(value).__name__}, expected {self.kind.__name__}")
        package = _REGISTERING_PACKAGE.get()
        if key in self.owners:
            raise ValueError(f"{name}: registered by {package}, but {self.owners[key]} has registered it already")
        self.data[key], self.owners[key] = value, package

    def load_all(self) -> dict[Any, Any]:
        """Load the objects of all entries, by name.

        Entries of other packages that cannot be loaded are left out with a warning.

        Raises:
            ImportError: an entry of metapp itself cannot be loaded.
        """
        objects = {}
        for name, entry in self.items():
            try:
                objects[name] = entry.load()  # type: ignore[attr-defined]
            except ImportError as error:
                if self.owners[name] == METAPP_PACKAGE:
                    raise
                warnings.warn(f"extension of {self.owners[name]}: {error}; {name} is left out.", stacklevel=2)
        return objects
