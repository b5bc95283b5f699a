"""Stationary svBRDFs: a network from noise to maps that look as a flash photo under its light (paper section 4.1.3)."""

from __future__ import annotations

from metapp.apps.svbrdf_stationary.options import SvbrdfStationaryOptions
from metapp.registry import Application, Registry

_HERE = "metapp.apps.svbrdf_stationary"
RECIPES = f"{_HERE}.recipes:RECIPES"


def register(registry: Registry) -> None:
    """Add the application and its recipes."""
    registry.applications["svbrdf_stationary"] = Application(
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
    )
    registry.add_recipes("svbrdf_stationary", RECIPES, "quick", "full", "paper", "paper-64", "paper-128")
