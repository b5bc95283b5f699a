"""Baselines: methods without a network, fitted to the data that fits see and judged by the same errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metapp.registry import registry

if TYPE_CHECKING:
    from metapp.extensions.baselines.baseline import Baseline
    from metapp.learning.app import App


def baselines_of(app: App) -> tuple[Baseline, ...]:
    """The baselines of an application under its protocol; () if no extension has any."""
    functions = dict.fromkeys(registry().load_table("baselines", app.name).values())
    return tuple(method for function in functions for method in function(app))
