"""All that the core registers: applications, which register themselves, then rules, tables and commands.

Every command imports this module, so that it imports nothing but texts: the code of an entry is imported at its first
use. Extensions register their entries in modules of their own.
"""

from metapp.apps import brdf, illumination, svbrdf_nonstationary, svbrdf_stationary, texture, transport
from metapp.entries import Lazy
from metapp.paradigms import PARADIGMS
from metapp.registry import Command, Measure, Registry, TableEntry

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
    """Add the core's applications, rules, tables and commands."""
    for application in (brdf, texture, svbrdf_stationary, svbrdf_nonstationary, illumination, transport):
        application.register(registry)
    for name, part in RULE_PARTS.items():
        registry.parts[name] = Lazy(f"metapp.learning.rules.{part}")
    registry.parts["newton"] = Lazy("metapp.apps.svbrdf_nonstationary.several.newton:Newton")
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
        registry.tables[name] = TableEntry(f"metapp.evaluation.tables.{table}", heading)
    registry.measures["SSIM"] = Measure(
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
