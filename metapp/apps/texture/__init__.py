"""Textures: a network from noise to a texture with the visual statistics of an exemplar (paper section 4.1.1).

`texture_codec` makes pictures of noise or of pieces of the photograph, `app` has the statistics, the loss and files,
`presenter` pictures, `recipes` the sizes. The other components are in `metapp.apps.exemplar`, and so are the options.
"""

from __future__ import annotations

from metapp.application import Application, Format, RecipeEntry, SyntheticSet
from metapp.entries import Lazy
from metapp.registry import Command, Registry


def register(registry: Registry) -> None:
    """Add the application, its recipes and its format, and the converter of that."""
    texture = Application(
        name="texture",
        title="Texture",
        help="Textures that look like the photograph of an exemplar.",
        app=Lazy("metapp.apps.texture.app:Texture"),
        options=Lazy("metapp.apps.exemplar.options:ExemplarOptions"),
        assets={"texture": Lazy("metapp.apps.texture.tile:make_texture")},
        presenter=Lazy("metapp.apps.texture.presenter:TexturePresenter"),
        read_object=Lazy("data_tools.readers.square_photos:task_of_object"),
        synthetic=SyntheticSet(
            "data_tools.synthetic.texture", "photos of 20 kinds of flat materials; 0.2 MB (240 + 20)"
        ),
    )
    for name in ("quick", "full", "paper", "paper-64"):
        texture.recipes[name] = RecipeEntry(f"metapp.apps.texture.recipes:RECIPES.{name}")
    texture.formats["images"] = Format("data_tools.readers.square_photos", "images")
    registry.add(texture)
    registry.commands["data images"] = Command("data_tools.converters:ImagesConverter", position=60)
