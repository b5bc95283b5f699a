"""Non-stationary svBRDFs: maps of a flat material from photographs under a flash (paper section 4.1.4: from one)."""

from __future__ import annotations

from metapp.apps.svbrdf_nonstationary.options import SvbrdfNonstationaryOptions
from metapp.registry import Application, Registry

_HERE = "metapp.apps.svbrdf_nonstationary"
RECIPES = f"{_HERE}.recipes:RECIPES"


def register(registry: Registry) -> None:
    """Add the application and its recipes."""
    registry.applications["svbrdf_nonstationary"] = Application(
        f"{_HERE}.app:SvbrdfNonstationary",
        help="Maps of a flat material from one or several flash photographs.",
        options=SvbrdfNonstationaryOptions,
        kinds=("places", "photo"),
        protocols=("reference", "photo"),
        examples=(
            (
                "general svbrdf_nonstationary {}/mosaic.png --observe photo",
                "maps of a flash photo, by one forward pass",
            ),
            ("meta svbrdf_nonstationary {}/mosaic.png --observe photo", "maps fitted in a few learned steps"),
            (
                "meta svbrdf_nonstationary {}/mosaic.png --observe photo --export blender,gltf",
                "maps for Blender, and a material in glTF",
            ),
            ("quickft svbrdf_nonstationary {}/mosaic.png --observe photo", "maps fitted by a tuned Adam, to compare"),
            ("baseline svbrdf_nonstationary {}/mosaic.png --observe photo --method flat", "maps of one value each"),
        ),
        files="data_tools.synthetic.examples:write_example",
    )
    registry.add_recipes("svbrdf_nonstationary", RECIPES, "quick", "full", "paper", protocols=("reference", "photo"))
    registry.add_recipes("svbrdf_nonstationary", RECIPES, "paper-64", "paper-128", protocols=("reference",))
