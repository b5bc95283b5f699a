"""Curves as a seventh application of metapp, with their files, an export and a baseline.

Importing the package is cheap: the registry names what it holds, and metapp imports that when it is asked for.
"""

from dataclasses import dataclass

from metapp.options import Converter
from metapp.registry import Application, Entry, Export, Format, RecipeEntry, Registry


@dataclass(frozen=True)
class Curve(Converter):
    """Convert curves, text files of 32 numbers.

    Example:
      metapp data curve curves --out set
    """


def register(registry: Registry) -> None:
    """Register the application and all that belongs to it."""
    registry.applications["curve"] = Application(
        "metapp_curve.app:Curve",
        title="Curve",
        help="Curves: a network of one variable.",
        presenter="metapp_curve.presenter:CurvePresenter",
    )
    registry.recipes["curve", "", "quick"] = RecipeEntry("metapp_curve.recipes:RECIPES.quick")
    registry.recipes["curve", "", "paper"] = RecipeEntry("metapp_curve.recipes:RECIPES.paper")
    registry.formats["curve"] = Format("metapp_curve.files", app="curve", inputs=".curve files of 32 numbers")
    registry.commands["data curve"] = Entry("metapp_curve:Curve")
    registry.exports["curve", "csv"] = Export("metapp_curve.files:export")
    registry.baselines["curve", "line"] = Entry("metapp_curve.line:baselines")
