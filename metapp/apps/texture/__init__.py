"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1)."""

from __future__ import annotations

from metapp.networks.options import ExemplarOptions
from metapp.registry import Application, Registry

_HERE = "metapp.apps.texture"
RECIPES = f"{_HERE}.recipes:RECIPES"


def register(registry: Registry) -> None:
    """Add the application and its recipes."""
    registry.applications["texture"] = Application(
        f"{_HERE}.app:Texture",
        help="Textures that look like the photograph of an exemplar.",
        options=ExemplarOptions,
        examples=(
            ("baseline texture {}/bricks.png --method quilting", "a texture quilted of the photo, without a network"),
            ("general texture {}/bricks.png", "a texture like the photo, by one forward pass"),
            ("meta texture {}/bricks.png", "a texture fitted in a few learned steps"),
            ("meta texture {}/bricks.png --size 512x768 --export png16", "a texture of 512 x 768 px as PNG of 16 bits"),
            ("quickft texture {}/bricks.png", "a texture fitted by a tuned Adam of as many steps, to compare"),
        ),
        files="data_tools.synthetic.examples:write_example",
        needs_vgg=True,
    )
    registry.add_recipes("texture", RECIPES, "quick", "full", "paper", "paper-64", "paper-128")
