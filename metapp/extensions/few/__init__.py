"""BRDFs of few samples: goniometer tables, the recipe that fits them, and what to measure."""

from __future__ import annotations

from metapp.registry import Entry, Format, Recipe, Registry

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


def register(registry: Registry) -> None:
    """Add goniometer tables, the network and the recipe of few samples, and `metapp plan`."""
    registry.formats["gonio"] = Format(
        f"{_HERE}.gonio",
        app="brdf",
        inputs="goniometer .csv files",
        kinds=(("phi_h", "is_anisotropic"), ("few", "has_few")),
        help=GONIO,
    )
    registry.networks["brdf", "few"] = Entry(f"{_HERE}.network:NETWORK")
    registry.recipes["brdf", "", "few"] = Recipe(
        f"{_HERE}.recipe:FEW",
        help="1,000 samples or fewer",
        kind="few",
        paradigms=("meta",),
        checkpoints=f"{_HERE}.checkpoints",
    )
    registry.commands["plan"] = Entry(f"{_HERE}.commands:plan")
