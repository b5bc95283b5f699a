"""Illumination: HDR environment maps, from themselves or from an LDR photograph of a sphere (paper section 4.1.5)."""

from __future__ import annotations

from metapp.apps.illumination.options import IlluminationOptions
from metapp.registry import Application, Registry

_HERE = "metapp.apps.illumination"
RECIPES = f"{_HERE}.recipes:RECIPES"


def register(registry: Registry) -> None:
    """Add the application and its recipes."""
    registry.applications["illumination"] = Application(
        f"{_HERE}.app:Illumination",
        help="HDR environment maps, from themselves or from the photograph of a mirror ball.",
        options=IlluminationOptions,
        protocols=("reference", "photo"),
        examples=(
            ("general illumination {}/courtyard.exr", "an environment map as a network, by one forward pass"),
            (
                "meta illumination {}/courtyard.exr --size 256x512",
                "a map fitted in a few learned steps, as EXR of 256 rows",
            ),
            ("meta illumination {}/ball.png --observe photo", "an HDR map of one LDR photo of a mirror ball"),
            ("data ball {}/ball.png --out {}/ball", "the light that the ball mirrors, without a network"),
            ("baseline illumination {}/courtyard.exr --method sh", "the map as spherical harmonics, to compare"),
        ),
        files="data_tools.synthetic.examples:write_example",
    )
    registry.add_recipes("illumination", RECIPES, "quick", "full", "paper", protocols=("reference", "photo"))
