"""Curves as a seventh application of metapp, with their files, an export and a baseline."""

from metapp.registry import Application, Entry, Export, Format, Registry

HELP = """Convert curves, text files of 32 numbers.

Example:
  metapp data curve curves --out set
"""


def register(registry: Registry) -> None:
    """Add the application and all that it has."""
    registry.applications["curve"] = Application("metapp_curve.app:Curve", help="Curves: a network of one variable.")
    registry.add_recipes("curve", "metapp_curve.recipes:RECIPES", "quick", "paper")
    registry.formats["curve"] = Format(
        "metapp_curve.files",
        app="curve",
        inputs=".curve files of 32 numbers",
        help=HELP,
    )
    registry.exports["curve", "csv"] = Export("metapp_curve.files:export")
    registry.baselines["curve", "line"] = Entry("metapp_curve.line:baselines")
