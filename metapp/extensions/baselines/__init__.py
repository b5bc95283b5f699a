"""Baselines: what a reader would use instead of a network, fitted to what fits see and judged by the same errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metapp.registry import Entry, Registry, registry

if TYPE_CHECKING:
    from metapp.extensions.baselines.baseline import Baseline
    from metapp.learning.app import App

_HERE = "metapp.extensions.baselines"
_METHODS = {
    "brdf": ("pca_20", "pca_66", "pca_150", "ggx_2", "nearest"),
    "illumination": ("sh", "unwrap"),
    "svbrdf_nonstationary": ("flat", "predicted"),
    "svbrdf_stationary": ("nearest", "quilting"),
    "texture": ("nearest", "quilting"),
}


def register(registry: Registry) -> None:
    """Add the methods, of all protocols, their command and their table."""
    registry.commands["baseline"] = Entry(f"{_HERE}.commands:baseline")
    registry.tables["baselines"] = Entry(f"{_HERE}.table:BASELINES")
    for app, names in _METHODS.items():
        for name in names:
            registry.baselines[app, name] = Entry(f"{_HERE}.{app}:baselines")


def baselines_of(app: App) -> tuple[Baseline, ...]:
    """The baselines of an application under its protocol; () where no extension has any."""
    functions = dict.fromkeys(registry().loaded("baselines", app.name).values())
    return tuple(method for function in functions for method in function(app))
