"""Stationary svBRDFs: a network from noise to maps that look as a flash photo under its light (paper section 4.1.3)."""

from __future__ import annotations

from metapp.apps.svbrdf_stationary.options import SvbrdfStationaryOptions
from metapp.door import Application, recipes_in

_HERE = "metapp.apps.svbrdf_stationary"
OFFERS = (
    Application(
        "svbrdf_stationary",
        f"{_HERE}.app:SvbrdfStationary",
        help="Tiling maps of a flat material from one flash photograph.",
        options=SvbrdfStationaryOptions,
        examples=(
            (
                "baseline svbrdf_stationary {}/leather.png --method quilting",
                "maps quilted of a flash photo, without a network",
            ),
            ("general svbrdf_stationary {}/leather.png", "tiling maps of a flash photo, by one forward pass"),
            ("general svbrdf_stationary {}/leather.png --export gltf", "maps as a material in glTF"),
            ("meta svbrdf_stationary {}/leather.png", "maps fitted in a few learned steps"),
            ("meta svbrdf_stationary {}/leather.png --size 512x512 --export blender", "maps of 512 px for Blender"),
        ),
        files="data_tools.synthetic.examples:write_example",
        needs_vgg=True,
    ),
    *recipes_in("svbrdf_stationary", f"{_HERE}.recipes:RECIPES", "quick", "full", "paper", "paper-64", "paper-128"),
)
