"""Transport: the light of a scene as a density over primary sample space, to guide paths by (paper section 4.1.6)."""

from __future__ import annotations

from metapp.apps.transport.options import TransportOptions
from metapp.registry import Application, Registry

_HERE = "metapp.apps.transport"
RECIPES = f"{_HERE}.recipes:RECIPES"


def register(registry: Registry) -> None:
    """Add the application and its recipes."""
    registry.applications["transport"] = Application(
        f"{_HERE}.app:Transport",
        help="Light transport of a scene: densities that guide its paths.",
        options=TransportOptions,
        examples=(
            (
                "general transport {}/box.xml",
                "the light paths of a scene as a density, by one forward pass; renders by it",
            ),
            ("meta transport {}/box.xml", "the density fitted in a few learned steps"),
            ("quickft transport {}/box.xml", "the density fitted by a tuned Adam of as many steps, to compare"),
            ("data cornell --count 2 --out {}/boxes", "two random Cornell boxes, traced, as a data set"),
        ),
        files="data_tools.synthetic.examples:write_example",
    )
    registry.add_recipes("transport", RECIPES, "quick", "full", "paper")
