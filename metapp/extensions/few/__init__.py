"""BRDFs of few samples: goniometer tables, the recipe that fits them, and what to measure."""

from __future__ import annotations

from metapp.door import Chosen, Command, Converter, Format, Network, Recipe

_HERE = "metapp.extensions.few"

GONIO = """Convert goniometer measurements, CSV files.

A line of column names, then a row for each pair of directions: theta_i_deg, phi_i_deg (light), theta_o_deg, phi_o_deg
(detector), or _rad for radians, and the BRDF in 1/sr as r, g, b (linear RGB) or as wavelengths (400nm, 410nm, ...).
Lines that begin with # are comments. The measurements themselves are the samples, in random order; a bad file that
was named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

Examples:
  metapp data gonio paint.csv --out measured
  metapp data gonio measurements --split test --out measured
"""

OFFERS = (
    Format(
        "gonio",
        "brdf",
        f"{_HERE}.gonio",
        "goniometer .csv files",
        command=Converter(GONIO, "CSV file", "FILES...", ".csv files, and folders searched at any depth."),
    ),
    Network("brdf", f"{_HERE}.network:NETWORK"),
    Recipe(
        "brdf",
        "few",
        f"{_HERE}.recipe:FEW",
        chosen=Chosen(("gonio",), has="1,000 samples or fewer", tells="has_few", paradigms=("meta",)),
        checkpoints=f"{_HERE}.checkpoints",
    ),
    Command("plan", f"{_HERE}.commands:plan"),
)
