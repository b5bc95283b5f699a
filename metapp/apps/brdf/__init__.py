"""BRDFs on half and difference vectors (paper section 4.1.2): the NBRDF network, or one of learned features."""

from __future__ import annotations

from metapp.apps.brdf.options import BrdfOptions
from metapp.registry import Application, Entry, Recipe, Registry

_HERE = "metapp.apps.brdf"
RECIPES = f"{_HERE}.recipes:RECIPES"


def register(registry: Registry) -> None:
    """Add the application and its recipes."""
    registry.applications["brdf"] = Application(
        f"{_HERE}.app:Brdf",
        help="BRDFs: reflectance of a material over pairs of directions.",
        options=BrdfOptions,
        kinds=("phi_h",),
        examples=(
            ("meta brdf {}/paint.csv", "a network fitted to a table of measurements, and a picture of both"),
            (
                "meta brdf {}/paint.csv --export merl,mitsuba",
                "that network as a MERL table and as a material for Mitsuba",
            ),
            ("quickft brdf {}/paint.csv", "the network fitted by a tuned Adam of as many steps, to compare"),
            ("baseline brdf {}/paint.csv --method ggx_2", "two GGX lobes fitted without a network"),
            (
                "plan brdf --samples 16 --out {}/plan.csv",
                "which 16 pairs of directions to measure, as a table to fill in",
            ),
        ),
        files="data_tools.synthetic.examples:write_example",
    )
    registry.add_recipes("brdf", RECIPES, "quick", "full", "paper")
    registry.recipes["brdf", "", "anisotropic"] = Recipe(
        f"{RECIPES}.anisotropic",
        help="reflectance that depends on phi_h",
        kind="phi_h",
        paradigms=("meta", "overfit"),
    )
    registry.networks["brdf", "nbrdf"] = Entry(f"{_HERE}.nbrdf:NBRDF")
    registry.networks["brdf", "featured"] = Entry(f"{_HERE}.featured:FEATURED")
    registry.networks["brdf", "anisotropic"] = Entry(f"{_HERE}.featured:ANISOTROPIC")
