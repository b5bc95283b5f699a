"""The applications; one is a module here that defines APP, and a further one needs nothing else."""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metapp.learning.app import App


def app_names() -> list[str]:
    """All applications, found by listing this folder; nothing is imported."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__))


def load_app(name: str) -> App:
    """The application of that name.

    Raises:
        ValueError: there is none; the message lists those that exist.
    """
    if name not in app_names():
        raise ValueError(f"application '{name}': not known, expected one of {', '.join(app_names())}.")
    return importlib.import_module(f"metapp.apps.{name}").APP
