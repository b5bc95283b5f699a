"""Applications as recipes configure them, for tests that need the networks of real fits."""

from metapp.apps import app_of, recipes_of
from metapp.learning.app import App


def app_by_recipe(name: str, recipe: str = "quick", protocol: str = "") -> App:
    """Return an application with the network of a recipe, under its default protocol unless another is named."""
    return app_of(name, recipes_of(name, protocol)[recipe], protocol)
