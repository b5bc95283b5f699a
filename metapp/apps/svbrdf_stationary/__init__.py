"""Stationary svBRDFs: a network from noise to maps that look like a flash photo under its light (paper section 4.1.3).

Read `windows`, statistics in parts of a picture, and `material_codec`, maps and their gloss; then `flash_statistics`,
what describes a flash photo, and losses and errors, `true_maps`, what training compares, `app`, maps in files, and
`presenter`, pictures. `options` and `recipes` are as in every application. The other components are in
`metapp.apps.exemplar`.
"""

from __future__ import annotations

from metapp.application import Application, Format, RecipeEntry, SyntheticSet
from metapp.entries import Lazy
from metapp.registry import Command, Registry


def register(registry: Registry) -> None:
    """Add the application, its recipes and its format, and the converter of that."""
    stationary = Application(
        name="svbrdf_stationary",
        title="svBRDF stat.",
        help="Tiling maps of a flat material from one flash photograph.",
        app=Lazy("metapp.apps.svbrdf_stationary.app:SvbrdfStationary"),
        options=Lazy("metapp.apps.svbrdf_stationary.options:FlashExemplarOptions"),
        assets={"surface": Lazy("metapp.apps.svbrdf_stationary.tile_surface:make_surface")},
        presenter=Lazy("metapp.apps.svbrdf_stationary.presenter:SvbrdfStationaryPresenter"),
        read_object=Lazy("data_tools.readers.flash_photos:task_of_object"),
        synthetic=SyntheticSet(
            "data_tools.synthetic.svbrdf_stationary", "flash photos of 16 of these kinds; 0.2 MB (120 + 16)"
        ),
    )
    for name in ("quick", "full", "paper", "paper-64"):
        stationary.recipes[name] = RecipeEntry(f"metapp.apps.svbrdf_stationary.recipes:RECIPES.{name}")
    stationary.formats["flash"] = Format("data_tools.readers.flash_photos", "flash photos")
    registry.add(stationary)
    registry.commands["data flash"] = Command("data_tools.converters:FlashConverter", position=70)
