"""BRDFs on half and difference vectors (paper section 4.1.2): the NBRDF network, or one of learned features."""

from __future__ import annotations

from metapp.apps.brdf.options import BrdfOptions
from metapp.door import Application, Chosen, Network, Recipe, recipes_in

_HERE = "metapp.apps.brdf"
OFFERS = (
    Application(
        "brdf",
        f"{_HERE}.app:Brdf",
        help="BRDFs: reflectance of a material over pairs of directions.",
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
        options=BrdfOptions,
    ),
    *recipes_in("brdf", f"{_HERE}.recipes:RECIPES", "quick", "full", "paper"),
    Recipe(
        "brdf",
        "anisotropic",
        f"{_HERE}.recipes:RECIPES.anisotropic",
        chosen=Chosen(
            ("bsdf", "gonio"),
            has="reflectance that depends on phi_h",
            tensor="phi_h",
            tells="is_anisotropic",
            paradigms=("meta", "overfit"),
        ),
    ),
    Network("brdf", f"{_HERE}.nbrdf:NBRDF"),
    Network("brdf", f"{_HERE}.featured:FEATURED"),
    Network("brdf", f"{_HERE}.featured:ANISOTROPIC"),
)
