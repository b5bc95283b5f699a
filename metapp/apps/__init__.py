"""The applications: one is a package here that defines APP, with a module `presentation` that defines PRESENTATION."""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from metapp.appearance.presentation import Presentation
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
    result: App = importlib.import_module(f"metapp.apps.{name}").APP
    return result


def presentation_of(app: App, size: tuple[int, int] | None = None) -> Presentation[Any]:
    """What screens and files need of an application, at its setup and under its protocol.

    Args:
        app: the application.
        size: of what fits make for their users, height and width in px; None for the application's own choice.
    """
    module = importlib.import_module(f"metapp.apps.{app.name}.presentation")
    result: Presentation[Any] = module.PRESENTATION(app, size)
    return result
