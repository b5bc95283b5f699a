"""Curves as a seventh application of metapp, with their files, an export and a baseline.

Importing the package is cheap: the registry names what it holds, and metapp imports that when it is asked for.
"""

from dataclasses import dataclass

from metapp.application import Application, Export, Format, RecipeEntry
from metapp.entries import Lazy
from metapp.options import Converter
from metapp.registry import Command, Registry


@dataclass(frozen=True)
class Curve(Converter):
    """Convert curves, text files of 32 numbers.

    Example:
      metapp data curve curves --out set
    """


def register(registry: Registry) -> None:
    """Register the application and all that belongs to it."""
    curve = Application(
        name="curve",
        title="Curve",
        help="Curves: a network of one variable.",
        app=Lazy("metapp_curve.app:Curve"),
        assets={"curve": Lazy("metapp_curve.app:make_plot")},
    )
    for name in ("quick", "paper"):
        curve.recipes[name] = RecipeEntry(f"metapp_curve.recipes:RECIPES.{name}")
    curve.formats["curve"] = Format("metapp_curve.files", ".curve files of 32 numbers")
    curve.baselines["line"] = Lazy("metapp_curve.line:baselines")
    registry.add(curve)
    registry.exports["curve", "csv"] = Export("metapp_curve.plot:write_csv")
    registry.commands["data curve"] = Command("metapp_curve:Curve")
