"""The rule study: `metapp evaluate --which rules` and its figure."""

from metapp.door import Figure, Option, Table

_HERE = "metapp.extensions.rule_study"
_OPTIONS = (
    Option("steps", 0, "Numbers of gradient steps; default: 5 10 20 40.", "N", low=1, several=True),
    Option("train_steps", 0, "Outer steps of each training; default: 500.", "N", low=1),
    Option("seeds", 0, "Seeds of training from --seed on; default: 3.", "N", low=1),
    Option(
        "initialisation",
        "",
        "What each training begins at: random, mean (of General's predictions) or encoder (General's own); default: "
        "encoder.",
        choices=("random", "mean", "encoder"),
    ),
)
OFFERS = (
    Table("rules", f"{_HERE}.table:RULES", study=True, options=_OPTIONS),
    Figure("rules", f"{_HERE}.figure:rules", table="rules"),
)
