"""References to objects that are imported at first use.

A reference is a text, so that help and lists know what there is without importing it. Of metapp nothing is imported.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Contract = TypeVar("Contract")  # the type of the object that a reference names


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
