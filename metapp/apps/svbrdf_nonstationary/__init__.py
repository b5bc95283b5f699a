"""Non-stationary svBRDFs: maps of a flat material from photographs under a flash (paper section 4.1.4: from one)."""

from __future__ import annotations

from metapp.apps.svbrdf_nonstationary.options import SvbrdfNonstationaryOptions
from metapp.door import Application, recipes_in

_HERE = "metapp.apps.svbrdf_nonstationary"
OFFERS = (
    Application(
        "svbrdf_nonstationary",
        f"{_HERE}.app:SvbrdfNonstationary",
        help="Maps of a flat material from one or several flash photographs.",
        protocols=("reference", "photo"),
        options=SvbrdfNonstationaryOptions,
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
    ),
    *recipes_in(
        "svbrdf_nonstationary", f"{_HERE}.recipes:RECIPES", "quick", "full", "paper", protocols=("reference", "photo")
    ),
    *recipes_in("svbrdf_nonstationary", f"{_HERE}.recipes:RECIPES", "paper-64", "paper-128", protocols=("reference",)),
)
