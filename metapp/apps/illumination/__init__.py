"""Illumination: HDR environment maps, from themselves or from the LDR photograph of a sphere (paper section 4.1.5).

`app` puts the application together: `lighting` has the decoder, `map_sight` and `ball_sight` what fits see,
`relit_judge` how maps are judged, and `ball_encoder` General's encoder. `mirror` is about the light that a photographed
mirror shows, `suns` about lights too small for the network, `radiance_losses` and `spheres` about what losses and
errors look at, and `map_augmentation` varies training maps; `recipes`, `options` and `presenter` are as in every
application.
"""

from __future__ import annotations

from metapp.application import Application, Format, RecipeEntry, SyntheticSet
from metapp.entries import Lazy
from metapp.registry import Command, Registry


def register(registry: Registry) -> None:
    """Add the application, its recipes and its format, and the converter of that."""
    illumination = Application(
        name="illumination",
        title="Illumination",
        help="HDR environment maps, from themselves or from the photograph of a mirror ball.",
        app=Lazy("metapp.apps.illumination.app:Illumination"),
        options=Lazy("metapp.apps.illumination.options:IlluminationOptions"),
        assets={"radiance": Lazy("metapp.apps.illumination.radiance:make_radiance")},
        presenter=Lazy("metapp.apps.illumination.presenter:IlluminationPresenter"),
        facts=Lazy("data_tools.readers.environment_maps:facts_of"),
        read_object=Lazy("data_tools.readers.environment_maps:task_of_object"),
        synthetic=SyntheticSet(
            "data_tools.synthetic.illumination", "HDR maps of 16 kinds, photos of spheres; 0.15 MB (900 + 16)"
        ),
    )
    for name in ("quick", "full", "paper", "paper-long"):
        illumination.recipes["reference", name] = RecipeEntry(
            f"metapp.apps.illumination.recipes:REFERENCE_RECIPES.{name}"
        )
    for name in ("quick", "full", "paper"):
        illumination.recipes["photo", name] = RecipeEntry(f"metapp.apps.illumination.recipes:PHOTO_RECIPES.{name}")
    illumination.formats["laval"] = Format("data_tools.readers.environment_maps", "HDR maps (.exr, .hdr)")
    registry.add(illumination)
    registry.commands["data laval"] = Command("data_tools.converters:LavalConverter", position=110)
