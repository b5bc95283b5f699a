"""All that the core registers, by name, on one page; the code of an entry is imported at its first use.

Extensions register their entries in modules of their own. Every command imports this module, so it imports nothing but
the registry and the table of paradigms, which are quick to import.
"""

import math

from metapp.paradigms import PARADIGMS
from metapp.registry import Application, Command, Entry, Export, Format, RecipeEntry, Registry

APPLICATIONS = {
    "brdf": Application(
        "metapp.apps.brdf.app:Brdf",
        title="BRDF",
        help="BRDFs: reflectance of a material over pairs of directions.",
        options="metapp.apps.brdf.options:BrdfOptions",
        presenter="metapp.apps.brdf.presenter:BrdfPresenter",
        facts="data_tools.readers.brdf_task:facts_of",
    ),
    "texture": Application(
        "metapp.apps.texture.app:Texture",
        title="Texture",
        help="Textures that look like the photograph of an exemplar.",
        options="metapp.apps.exemplar.options:ExemplarOptions",
        presenter="metapp.apps.texture.presenter:TexturePresenter",
    ),
    "svbrdf_stationary": Application(
        "metapp.apps.svbrdf_stationary.app:SvbrdfStationary",
        title="svBRDF stat.",
        help="Tiling maps of a flat material from one flash photograph.",
        options="metapp.apps.svbrdf_stationary.options:FlashExemplarOptions",
        presenter="metapp.apps.svbrdf_stationary.presenter:SvbrdfStationaryPresenter",
    ),
    "svbrdf_nonstationary": Application(
        "metapp.apps.svbrdf_nonstationary.app:SvbrdfNonstationary",
        title="svBRDF non-stat.",
        help="Maps of a flat material from one or several flash photographs.",
        options="metapp.networks.picture_options:FlashOptions",
        facts="data_tools.readers.svbrdf_task:facts_of",
        presenter="metapp.apps.svbrdf_nonstationary.presenter:SvbrdfNonstationaryPresenter",
        protocols={"reference": "maps", "photo": "photo"},
    ),
    "illumination": Application(
        "metapp.apps.illumination.app:Illumination",
        title="Illumination",
        help="HDR environment maps, from themselves or from the photograph of a mirror ball.",
        options="metapp.apps.illumination.options:IlluminationOptions",
        presenter="metapp.apps.illumination.presenter:IlluminationPresenter",
        protocols={"reference": "map", "photo": "photos"},
    ),
    "transport": Application(
        "metapp.apps.transport.app:Transport",
        title="Transport",
        help="Light transport of a scene: densities that guide its paths.",
        options="metapp.apps.transport.options:TransportOptions",
        presenter="metapp.apps.transport.presenter:TransportPresenter",
    ),
}
NONSTATIONARY_PACKAGE = "metapp.apps.svbrdf_nonstationary"  # the package of non-stationary svBRDFs
FURTHER_RECIPES = {  # names of recipes beside quick, full and paper, for fits that observe the reference
    **dict.fromkeys(("texture", "svbrdf_stationary", "svbrdf_nonstationary"), ("paper-64",)),
    **dict.fromkeys(("illumination", "transport"), ("paper-long",)),
    "brdf": ("paper-long", "paper-smooth"),
}
SYNTHETIC_SET_HELP = {  # help on each application's embedded data set, with numbers of training + test tasks
    "brdf": "metals, plastics, paints, fabrics; 1.6 MB, as MERL 35 MB (80 + 20)",
    "texture": "photos of 20 kinds of flat materials; 0.2 MB (240 + 20)",
    "svbrdf_stationary": "flash photos of 16 of these kinds; 0.2 MB (120 + 16)",
    "svbrdf_nonstationary": "maps and flash photos of 19 kinds; 0.4 MB (1,200 + 16)",
    "illumination": "HDR maps of 16 kinds, photos of spheres; 0.15 MB (900 + 16)",
    "transport": "light paths of Cornell boxes; 0.7 MB and 2 s each (40 + 8)",
}
OBJECT_READERS = {  # module and function of data_tools.readers that make a task of an object in memory
    "brdf": "brdf_objects:task_of_object",
    "texture": "square_photos:task_of_object",
    "svbrdf_stationary": "flash_photos:task_of_object",
    "svbrdf_nonstationary": "svbrdf_inputs:task_of_object",
    "illumination": "environment_maps:task_of_object",
}
# module of data_tools.readers, application, what fits accept as INPUT, and the position in help of `metapp data NAME`
INPUT_FORMATS = {
    "merl": ("merl", "brdf", "MERL .binary files", 20),
    "nbrdf": ("nbrdf_files", "brdf", "NBRDF networks (.h5, folders of .npy)", 50),
    "gonio": ("gonio", "brdf", "goniometer .csv files", 40),
    "images": ("square_photos", "texture", "images", 60),
    "flash": ("flash_photos", "svbrdf_stationary", "flash photos", 70),
    "maps": ("material_maps", "svbrdf_nonstationary", "", 80),
    "strips": ("strips", "svbrdf_nonstationary", "", 90),
    "laval": ("environment_maps", "illumination", "HDR maps (.exr, .hdr)", 110),
}
RULE_PARTS = {  # module and class of metapp.learning.rules, in the order in which parts act on a step
    "sgd": "parts:SignedRates",
    "rates": "parts:Rates",
    "shared": "parts:SharedRates",
    "solve": "solve:Solve",
    "betas": "parts:Betas",
    "loss": "parts:LossParameters",
    "pace": "parts:Paces",
    "eps": "parts:Eps",
    "curvature": "parts:Curvature",
    "network": "network:StepNetwork",
    "average": "parts:Average",
    "basis": "parts:Basis",
}
TABLES = {  # module and function of metapp.evaluation.tables, and the heading in a report
    "results": ("results:results", "Error and time"),
    "quickft": ("results:quickft", "Against as many steps of fine-tuning"),
    "image": ("image:image", "In image space"),
    "ablation": ("ablation:ablation", "Ablation: initialisation and rule"),
    "storage": ("storage:storage", "Storage"),
    "samples": ("storage:samples", "Samples seen"),
    "convergence": ("convergence:convergence", "Convergence"),
}


def register(registry: Registry) -> None:
    """Add the core's applications and all that belongs to them, rules, tables and commands."""
    for app, entry in APPLICATIONS.items():
        registry.applications[app] = entry
        for protocol in entry.protocols or ("",):
            further_recipes = FURTHER_RECIPES[app] if protocol in ("", "reference") else ()
            for name in ("quick", "full", "paper", *further_recipes):
                path = ".".join(filter(None, ("RECIPES", protocol, name)))
                registry.recipes[app, protocol, name] = RecipeEntry(f"metapp.apps.{app}.recipes:{path}")
        registry.synthetic[app] = Entry(f"data_tools.synthetic.{app}", SYNTHETIC_SET_HELP[app])
        if app in OBJECT_READERS:
            registry.objects[app] = Entry(f"data_tools.readers.{OBJECT_READERS[app]}")
    for name, (module, app, inputs, position) in INPUT_FORMATS.items():
        registry.formats[name] = Format(f"data_tools.readers.{module}", app=app, inputs=inputs)
        converter = f"data_tools.converters:{name.capitalize()}Converter"
        registry.commands[f"data {name}"] = Command(converter, position=position)
    registry.formats["svbrdf"] = Format(  # inputs of fits; "maps" and "strips" above only convert data sets
        "data_tools.readers.svbrdf_inputs",
        app="svbrdf_nonstationary",
        inputs="flash photos, strips, a material's maps",
    )
    registry.formats["placed"] = Format(
        "data_tools.readers.placed_photos",
        app="svbrdf_nonstationary",
        inputs="folders of rectified flash photos of one material with camera_pos.txt, light_pos.txt, image_size.txt, "
        "or of RTI with a .lp",
    )
    registry.formats["materials"] = Format(
        "data_tools.readers.training_materials", app="svbrdf_nonstationary", data_sets=True
    )
    registry.commands["data materials"] = Command("data_tools.converters:MaterialsConverter", position=100)
    registry.recipes["brdf", "", "anisotropic"] = RecipeEntry(
        "metapp.apps.brdf.recipes:RECIPES.anisotropic",
        help="reflectance that depends on phi_h",
        suits={"anisotropic": True},
        mixed_recipe="anisotropic",  # its network can also fit isotropic materials
        paradigms=("meta", "overfit"),
    )
    registry.recipes["brdf", "", "few"] = RecipeEntry(
        "metapp.apps.brdf.few.app:FEW_RECIPE",
        help="200 samples or fewer",
        suits={"samples": (1, 200)},  # with more samples the recipe "full" has lower errors
        mixed_recipe="full",
        paradigms=("meta",),
    )
    registry.recipes["svbrdf_nonstationary", "photo", "pretrained"] = RecipeEntry(
        f"{NONSTATIONARY_PACKAGE}.pretrained.recipe:PRETRAINED",
        help="one flash photo",
        suits={"photos": 1},
        paradigms=("general", "quickft", "meta"),
        describe_missing_file=f"{NONSTATIONARY_PACKAGE}.pretrained.encoder:describe_missing_weights",
    )
    registry.recipes["svbrdf_nonstationary", "photo", "several"] = RecipeEntry(
        f"{NONSTATIONARY_PACKAGE}.several.recipe:SEVERAL",
        help="several photos",
        suits={"photos": (2, math.inf)},
    )
    registry.networks["brdf", "nbrdf"] = Entry("metapp.apps.brdf.nbrdf_network:NBRDF_NETWORK")
    registry.networks["brdf", "featured"] = Entry("metapp.apps.brdf.feature_network:FEATURED_NETWORK")
    registry.networks["brdf", "anisotropic"] = Entry("metapp.apps.brdf.feature_network:ANISOTROPIC_NETWORK")
    registry.networks["brdf", "few"] = Entry("metapp.apps.brdf.few.gaussian_model:FEW_NETWORK")
    registry.exports["brdf", "merl"] = Export("data_tools.readers.merl:export")
    weights = ("w1", "w2", "w3", "b1", "b2", "b3")
    registry.exports["brdf", "nbrdf"] = Export("data_tools.readers.nbrdf_files:export", holds=weights)

    for name, part in RULE_PARTS.items():
        registry.parts[name] = Entry(f"metapp.learning.rules.{part}")
    registry.parts["newton"] = Entry(f"{NONSTATIONARY_PACKAGE}.several.newton:Newton")
    # short names that users write in compositions
    registry.compositions["adam"] = "rates+betas"
    registry.compositions["tied"] = "shared+pace"
    # the paper's rule: one rate per weight, the same at every step, any sign
    registry.rules["meta-sgd"] = "sgd"
    # Adam with rates and betas per step, loss parameters, and steps multiplied by learned matrices from both sides
    registry.rules["meta-curvature"] = "adam+loss+curvature"
    # Adam with one rate per weight for all steps, times one per parameter tensor and step, and a learned eps, for
    # recipes that start from General's encoder and train it through the steps
    registry.rules["meta-encoder"] = "tied+betas+loss+eps"
    # meta-encoder with a convolutional network that adds to the steps of parameters on a grid
    registry.rules["meta-lgd"] = "meta-encoder+network"
    # meta-encoder in the eigenbasis of the training tasks' gradients
    registry.rules["meta-axes"] = "meta-encoder+basis"
    # meta-axes with tail averaging, for random samples, which scatter the parameters
    registry.rules["meta-basis"] = "meta-axes+average"
    # ridge regression in the last layer, on learned features
    registry.rules["ridge"] = "solve+loss"
    # Gauss-Newton steps of the maps that several photographs show, and of their flashes
    registry.rules["gauss-newton"] = "newton+loss"

    for name, (table, heading) in TABLES.items():
        registry.tables[name] = Entry(f"metapp.evaluation.tables.{table}", heading)
    registry.measures["SSIM"] = Entry(
        "metapp.appearance.picture_measures:SSIM",
        "Wang et al. 2004, at most 1, more is better",
        ("brdf", "svbrdf_nonstationary", "illumination"),
    )
    for paradigm in PARADIGMS:
        registry.commands[paradigm] = Command(f"metapp.cli.fit_commands:FIT_COMMANDS.{paradigm}", position=30)
    registry.commands["evaluate"] = Command("metapp.cli.evaluate:evaluate_command", position=40)
    registry.commands["export"] = Command("metapp.cli.export:export_command", position=60)
    registry.commands["data"] = Command("metapp.cli.command_tree:data_group", position=100)
    registry.commands["data synth"] = Command("metapp.cli.synth:synth", position=10)
    registry.commands["data cornell"] = Command("metapp.cli.synth:cornell", position=120)
    registry.commands["data join"] = Command("metapp.cli.data:join", position=130)
    registry.commands["data check"] = Command("metapp.cli.data:check", position=140)
