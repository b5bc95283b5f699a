"""BRDFs on half and difference vectors (paper section 4.1.2).

`app` puts the application together. Its decoders are networks, which share the base class in `brdf_network`: the
paper's in `nbrdf_network`, and one of learned features in `feature_network`, which reads anisotropic materials by
`anisotropic`. `sample_sight` has the samples that fits see, `held_out_judge` those that they are judged by.
`sample_augmentation` varies training materials, `energy` limits the light that fits reflect, and `highlight` the height
of their highlights; `recipes`, `options` and `presenter` are as in every application. `few` has fits of 4 to 200
samples.
"""

from __future__ import annotations

from metapp.application import Application, Export, Format, RecipeEntry, SyntheticSet
from metapp.entries import Lazy
from metapp.registry import Command, Registry


def register(registry: Registry) -> None:
    """Add the application, its recipes, networks, formats and exports, and the converters of its formats."""
    brdf = Application(
        name="brdf",
        title="BRDF",
        help="BRDFs: reflectance of a material over pairs of directions.",
        app=Lazy("metapp.apps.brdf.app:Brdf"),
        options=Lazy("metapp.apps.brdf.options:BrdfOptions"),
        assets={"reflectance": Lazy("metapp.apps.brdf.reflectance:make_reflectance")},
        presenter=Lazy("metapp.apps.brdf.presenter:BrdfPresenter"),
        facts=Lazy("data_tools.readers.brdf_task:facts_of"),
        read_object=Lazy("data_tools.readers.brdf_objects:task_of_object"),
        synthetic=SyntheticSet(
            "data_tools.synthetic.brdf", "metals, plastics, paints, fabrics; 1.6 MB, as MERL 35 MB (80 + 20)"
        ),
    )
    for name in ("quick", "full", "paper", "paper-long", "paper-smooth"):
        brdf.recipes[name] = RecipeEntry(f"metapp.apps.brdf.recipes:RECIPES.{name}")
    brdf.recipes["anisotropic"] = RecipeEntry(
        "metapp.apps.brdf.recipes:RECIPES.anisotropic",
        inputs="reflectance that depends on phi_h",
        suits={"anisotropic": True},
        paradigms=("meta", "overfit"),
    )
    brdf.recipes["few"] = RecipeEntry(
        "metapp.apps.brdf.few.app:FEW_RECIPE",
        inputs="200 samples or fewer",
        suits={"samples": (1, 200)},  # with more samples the recipe "full" has lower errors
        paradigms=("meta",),
    )
    brdf.networks["nbrdf"] = Lazy("metapp.apps.brdf.nbrdf_network:NBRDF_NETWORK")
    brdf.networks["featured"] = Lazy("metapp.apps.brdf.feature_network:FEATURED_NETWORK")
    brdf.networks["anisotropic"] = Lazy("metapp.apps.brdf.feature_network:ANISOTROPIC_NETWORK")
    brdf.networks["few"] = Lazy("metapp.apps.brdf.few.gaussian_model:FEW_NETWORK")
    brdf.formats["merl"] = Format("data_tools.readers.merl", "MERL .binary files")
    brdf.formats["nbrdf"] = Format("data_tools.readers.nbrdf_files", "NBRDF networks (.h5, folders of .npy)")
    brdf.formats["gonio"] = Format("data_tools.readers.gonio", "goniometer .csv files")
    registry.exports["reflectance", "merl"] = Export("data_tools.readers.merl:export")
    registry.exports["reflectance", "nbrdf"] = Export(
        "data_tools.readers.nbrdf_files:export", holds=("w1", "w2", "w3", "b1", "b2", "b3")
    )
    registry.add(brdf)
    registry.commands["data merl"] = Command("data_tools.converters:MerlConverter", position=20)
    registry.commands["data nbrdf"] = Command("data_tools.converters:NbrdfConverter", position=50)
    registry.commands["data gonio"] = Command("data_tools.converters:GonioConverter", position=40)
