"""Curves as a seventh application of metapp, with their files, an export and a baseline."""

from metapp.door import Application, Baselines, Converter, Export, Format, recipes_in

HELP = """Convert curves, text files of 32 numbers.

Example:
  metapp data curve curves --out set
"""

OFFERS = (
    Application("curve", "metapp_curve.app:Curve"),
    *recipes_in("curve", "metapp_curve.recipes:RECIPES", "quick", "paper"),
    Format(
        "curve",
        "curve",
        "metapp_curve.files",
        ".curve files of 32 numbers",
        command=Converter(HELP, "curve", "FILES...", ".curve files, and folders of them."),
    ),
    Export("csv", ("curve",), "metapp_curve.files:export"),
    Baselines("curve", ("line",), "metapp_curve.line:baselines"),
)
