"""Applications as their recipes have them."""

from metapp.apps import app_of, recipes_of
from metapp.learning.app import App


def app_by(name: str, recipe: str = "quick", protocol: str = "") -> App:
    """An application of a name by a recipe, under its default protocol unless another is named."""
    return app_of(name, recipes_of(name, protocol)[recipe], protocol)
