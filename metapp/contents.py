"""All that the core registers: applications, which register themselves, then rules, tables and commands.

Every command imports this module, so that it imports nothing but texts: the code of an entry is imported at its first
use. Extensions register their entries in modules of their own.
"""

from metapp.apps import brdf, illumination, svbrdf_nonstationary, svbrdf_stationary, texture, transport
from metapp.entries import Lazy
from metapp.paradigms import PARADIGMS
from metapp.registry import Command, Measure, Registry, TableEntry

RULES = (  # constants of metapp.learning.rules.named_rules
    *("meta-sgd", "meta-sgd-loss", "meta-adam", "meta-curvature", "meta-encoder", "meta-lgd", "meta-average"),
    *("meta-axes", "meta-basis", "ridge"),
)
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
    for name in RULES:
        registry.rules[name] = Lazy(f"metapp.learning.rules.named_rules:{name.replace('-', '_').upper()}")
    registry.rules["gauss-newton"] = Lazy("metapp.apps.svbrdf_nonstationary.multi_photo.newton:GAUSS_NEWTON")
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
