"""Non-stationary svBRDFs: maps of a flat material from one to nine photographs under a flash.

Read `maps`, what maps are, and `flashes`, how they look under a flash; then `app`, the application that is put together
of components. `field_maps` has the decoder of maps by a field, with `photographed_maps`, its answers; `material_sight`
what all sights share, `maps_sight` fits that see the maps and `photo_sight` fits of one photograph; `map_judge` how
maps are judged, with the outer loss of fields in `field_judge`; `encoder` General's encoder; `variants` data
augmentation. `pretrained` has the components for one photograph by features of VGG-16, `multi_photo` those for several
photographs, and `rti` those for photographs under many lamps. People photograph from the `places` that are drawn for
training. `recipes` and `presenter` are as in every application.
"""

from __future__ import annotations

import math

from metapp.application import Application, Format, RecipeEntry, SyntheticSet
from metapp.entries import Lazy
from metapp.registry import Command, Registry


def register(registry: Registry) -> None:
    """Add the application, its recipes and formats, and the converters of these."""
    nonstationary = Application(
        name="svbrdf_nonstationary",
        title="svBRDF non-stat.",
        help="Maps of a flat material from one or several flash photographs.",
        app=Lazy("metapp.apps.svbrdf_nonstationary.app:SvbrdfNonstationary"),
        options=Lazy("metapp.apps.picture_options:FlashOptions"),
        assets={
            "surface": Lazy("metapp.apps.svbrdf_nonstationary.material_surface:make_surface"),
            "lit photos": Lazy("metapp.apps.svbrdf_nonstationary.rti.lit_photos:make_lit_photos"),
        },
        presenter=Lazy("metapp.apps.svbrdf_nonstationary.presenter:SvbrdfNonstationaryPresenter"),
        facts=Lazy("data_tools.readers.svbrdf_task:facts_of"),
        read_object=Lazy("data_tools.readers.svbrdf_inputs:task_of_object"),
        synthetic=SyntheticSet(
            "data_tools.synthetic.svbrdf_nonstationary", "maps and flash photos of 19 kinds; 0.4 MB (1,200 + 16)"
        ),
    )
    recipes, package = nonstationary.recipes, "metapp.apps.svbrdf_nonstationary"
    for name in ("quick", "full", "paper", "paper-64"):
        recipes["reference", name] = RecipeEntry(f"{package}.recipes:REFERENCE_RECIPES.{name}")
    for name in ("quick", "full", "paper"):
        recipes["photo", name] = RecipeEntry(f"{package}.recipes:PHOTO_RECIPES.{name}")
    recipes["photo", "pretrained"] = RecipeEntry(
        f"{package}.pretrained.recipe:PRETRAINED",
        inputs="one flash photo",
        suits={"photos": 1},
        paradigms=("general", "quickft", "meta"),
        describe_missing_file=Lazy(f"{package}.pretrained.encoder:describe_missing_weights"),
    )
    recipes["photo", "rti"] = RecipeEntry(
        f"{package}.rti.recipe:RTI", inputs="photos under many lamps (RTI)", suits={"lamps": (3, math.inf)}
    )
    recipes["photo", "several"] = RecipeEntry(
        f"{package}.multi_photo.recipe:SEVERAL", inputs="several photos", suits={"photos": (2, math.inf)}
    )
    formats = nonstationary.formats
    formats["svbrdf"] = Format("data_tools.readers.svbrdf_inputs", "flash photos, strips, a material's maps")
    formats["placed"] = Format(
        "data_tools.readers.placed_photos",
        "folders of rectified flash photos of one material with camera_pos.txt, light_pos.txt, image_size.txt",
    )
    formats["rti"] = Format("data_tools.readers.rti_photos", "folders of photos under many lamps (RTI) with a .lp")
    # what follows is converted to data sets alone
    formats["maps"] = Format("data_tools.readers.material_maps")
    formats["strips"] = Format("data_tools.readers.strips")
    formats["materials"] = Format("data_tools.readers.training_materials", data_sets=True)
    formats["domes"] = Format("data_tools.synthetic.domes")
    registry.add(nonstationary)
    registry.commands["data maps"] = Command("data_tools.converters:MapsConverter", position=80)
    registry.commands["data strips"] = Command("data_tools.converters:StripsConverter", position=90)
    registry.commands["data materials"] = Command("data_tools.converters:MaterialsConverter", position=100)
    registry.commands["data domes"] = Command("data_tools.converters:DomesConverter", position=105)
