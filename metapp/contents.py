"""All that the core has, by name: one page of entries, each imported at first use."""

from metapp.registry import Application, Entry, Export, Format, Recipe, Registry

EITHER = ("reference", "photo")  # values of --observe

# names of recipes by application, and the protocols under which they are
USUAL = ("quick", "full", "paper")
SMALLER = ("paper-64", "paper-128")
RECIPES = (
    ("brdf", ("",), USUAL),
    ("texture", ("",), (*USUAL, *SMALLER)),
    ("svbrdf_stationary", ("",), (*USUAL, *SMALLER)),
    ("svbrdf_nonstationary", EITHER, USUAL),
    ("svbrdf_nonstationary", ("reference",), SMALLER),
    ("illumination", EITHER, USUAL),
    ("transport", ("",), USUAL),
)


def register(registry: Registry) -> None:
    """Add the core's applications and all that belongs to them, rules, tables and commands."""
    for app, protocols, names in RECIPES:
        for protocol in protocols:
            for name in names:
                place = ".".join(filter(None, ("RECIPES", protocol, name)))
                registry.recipes[app, protocol, name] = Recipe(f"metapp.apps.{app}.recipes:{place}")

    app, recipes, readers = "metapp.apps.brdf", "metapp.apps.brdf.recipes:RECIPES", "data_tools.readers"
    registry.applications["brdf"] = Application(
        f"{app}.app:Brdf",
        help="BRDFs: reflectance of a material over pairs of directions.",
        options=f"{app}.options:BrdfOptions",
        kinds=("phi_h",),
    )
    registry.recipes["brdf", "", "anisotropic"] = Recipe(
        f"{recipes}.anisotropic",
        help="reflectance that depends on phi_h",
        kind="phi_h",
        paradigms=("meta", "overfit"),
    )
    registry.networks["brdf", "nbrdf"] = Entry(f"{app}.nbrdf:NBRDF")
    registry.networks["brdf", "featured"] = Entry(f"{app}.featured:FEATURED")
    registry.networks["brdf", "anisotropic"] = Entry(f"{app}.featured:ANISOTROPIC")
    registry.formats["merl"] = Format(f"{readers}.merl", app="brdf", inputs="MERL .binary files")
    registry.formats["nbrdf"] = Format(f"{readers}.nbrdf", app="brdf", inputs="folders with an NBRDF network")
    registry.objects["brdf"] = Entry(f"{readers}.brdf_objects:from_object")
    registry.exports["brdf", "merl"] = Export(f"{readers}.merl:export")
    registry.exports["brdf", "nbrdf"] = Export(f"{readers}.nbrdf:export", holds=("w1", "w2", "w3", "b1", "b2", "b3"))
    registry.synthetic["brdf"] = Entry(
        "data_tools.synthetic.brdf", "metals, plastics, paints, fabrics; 1.6 MB, as MERL 35 MB (80 + 20)"
    )

    # textures, and stationary svBRDFs, whose maps come of noise as well
    registry.applications["texture"] = Application(
        "metapp.apps.texture.app:Texture",
        help="Textures that look like the photograph of an exemplar.",
        options="metapp.networks.options:ExemplarOptions",
    )
    registry.applications["svbrdf_stationary"] = Application(
        "metapp.apps.svbrdf_stationary.app:SvbrdfStationary",
        help="Tiling maps of a flat material from one flash photograph.",
        options="metapp.networks.options:FlashExemplarOptions",
    )
    registry.formats["images"] = Format("data_tools.readers.photos", app="texture", inputs="images")
    registry.formats["flash"] = Format("data_tools.readers.flash", app="svbrdf_stationary", inputs="flash photos")
    registry.objects["texture"] = Entry("data_tools.readers.photos:task_of_object")
    registry.objects["svbrdf_stationary"] = Entry("data_tools.readers.flash:task_of_object")
    registry.synthetic["texture"] = Entry(
        "data_tools.synthetic.texture", "photos of 20 kinds of flat materials; 0.2 MB (240 + 20)"
    )
    registry.synthetic["svbrdf_stationary"] = Entry(
        "data_tools.synthetic.svbrdf_stationary", "flash photos of 16 of these kinds; 0.2 MB (120 + 16)"
    )

    name, readers = "svbrdf_nonstationary", "data_tools.readers"
    registry.applications[name] = Application(
        "metapp.apps.svbrdf_nonstationary.app:SvbrdfNonstationary",
        help="Maps of a flat material from one or several flash photographs.",
        options="metapp.networks.options:FlashOptions",
        kinds=("places", "photo"),
        protocols=EITHER,
    )
    registry.formats["maps"] = Format(f"{readers}.material_maps", app=name)
    registry.formats["strips"] = Format(f"{readers}.strips", app=name)
    registry.formats["svbrdf"] = Format(  # of fits: photos, strips and maps
        f"{readers}.svbrdf_inputs",
        app=name,
        inputs="flash photos, strips, a material's maps",
        kinds=(("photo", ""),),
    )
    registry.objects[name] = Entry(f"{readers}.svbrdf_inputs:task_of_object")
    registry.synthetic[name] = Entry(
        "data_tools.synthetic.svbrdf_nonstationary", "maps and flash photos of 19 kinds; 0.4 MB (1,200 + 16)"
    )

    registry.applications["illumination"] = Application(
        "metapp.apps.illumination.app:Illumination",
        help="HDR environment maps, from themselves or from the photograph of a mirror ball.",
        options="metapp.apps.illumination.options:IlluminationOptions",
        protocols=EITHER,
    )
    registry.applications["transport"] = Application(
        "metapp.apps.transport.app:Transport",
        help="Light transport of a scene: densities that guide its paths.",
        options="metapp.apps.transport.options:TransportOptions",
    )
    registry.formats["laval"] = Format("data_tools.readers.latlong", app="illumination", inputs="HDR maps (.exr, .hdr)")
    registry.objects["illumination"] = Entry("data_tools.readers.latlong:task_of_object")
    registry.synthetic["illumination"] = Entry(
        "data_tools.synthetic.illumination", "HDR maps of 16 kinds, photos of spheres; 0.15 MB (900 + 16)"
    )
    registry.synthetic["transport"] = Entry(
        "data_tools.synthetic.transport", "light paths of Cornell boxes; 0.7 MB and 2 s each (40 + 8)"
    )

    parts = "metapp.learning.rules.parts"
    # in the order in which they act on a step
    registry.parts["sgd"] = Entry(f"{parts}:SignedRates")
    registry.parts["rates"] = Entry(f"{parts}:Rates")
    registry.parts["shared"] = Entry(f"{parts}:SharedRates")
    registry.parts["solve"] = Entry("metapp.learning.rules.solve:Solve")
    registry.parts["betas"] = Entry(f"{parts}:Betas")
    registry.parts["loss"] = Entry(f"{parts}:LossParameters")
    registry.parts["pace"] = Entry(f"{parts}:Paces")
    registry.parts["eps"] = Entry(f"{parts}:Eps")
    registry.parts["curvature"] = Entry(f"{parts}:Curvature")
    registry.parts["network"] = Entry("metapp.learning.rules.network:Network")
    registry.parts["average"] = Entry(f"{parts}:Average")
    registry.parts["basis"] = Entry(f"{parts}:Basis")
    # names for compositions
    registry.compositions["adam"] = "rates+betas"
    registry.compositions["tied"] = "shared+pace"
    # the paper's rule: one rate per weight, the same at every step, any sign
    registry.rules["meta-sgd"] = "sgd"
    # Adam with rates and betas per step, loss parameters, and steps multiplied by learned matrices from both sides
    registry.rules["meta-curvature"] = "adam+loss+curvature"
    # Adam with one rate per weight for all steps, times one per parameter tensor and step, and a learned eps, for
    # recipes that start from General's encoder and train it through the steps
    registry.rules["meta-encoder"] = "tied+betas+loss+eps"
    # the same, and a convolutional network that adds to the steps of parameters on a grid
    registry.rules["meta-lgd"] = "meta-encoder+network"
    # meta-encoder in the eigenbasis of the training tasks' gradients
    registry.rules["meta-axes"] = "meta-encoder+basis"
    # the same with tail averaging, where samples are random, which lets the parameters scatter
    registry.rules["meta-basis"] = "meta-axes+average"
    # ridge regression in the last layer, on learned features
    registry.rules["ridge"] = "solve+loss"

    tables = "metapp.evaluation.tables"
    registry.tables["results"] = Entry(f"{tables}.results:results")
    registry.tables["quickft"] = Entry(f"{tables}.results:quickft")
    registry.tables["image"] = Entry(f"{tables}.image:image")
    registry.tables["ablation"] = Entry(f"{tables}.ablation:ablation")
    registry.tables["storage"] = Entry(f"{tables}.storage:storage")
    registry.tables["samples"] = Entry(f"{tables}.storage:samples")
    registry.tables["convergence"] = Entry(f"{tables}.convergence:convergence")
    registry.measures["SSIM"] = Entry(
        "metapp.appearance.picture_measures:SSIM",
        "Wang et al. 2004, at most 1, more is better",
        ("brdf", "svbrdf_nonstationary", "illumination"),
    )
    for paradigm in ("general", "overfit", "finetune", "quickft", "meta"):
        registry.commands[paradigm] = Entry(f"metapp.cli.fit:COMMANDS.{paradigm}")
    registry.commands["evaluate"] = Entry("metapp.cli.evaluate:command")
    registry.commands["export"] = Entry("metapp.cli.export:command")
    registry.commands["data"] = Entry("metapp.cli.commands:data")
    registry.commands["data synth"] = Entry("metapp.cli.synth:synth")
    registry.commands["data cornell"] = Entry("metapp.cli.synth:cornell")
    registry.commands["data join"] = Entry("metapp.cli.data:join")
    registry.commands["data check"] = Entry("metapp.cli.data:check")
    for converter in ("merl", "nbrdf", "images", "flash", "maps", "strips", "laval"):
        registry.commands[f"data {converter}"] = Entry(f"data_tools.converters:{converter.capitalize()}")
