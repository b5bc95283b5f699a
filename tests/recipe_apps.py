"""Applications as recipes configure them, by their names, for tests that need the networks of real fits."""

from collections.abc import Mapping
from types import MappingProxyType

from metapp.appearance.presenter import Presenter
from metapp.application import Application, Export, Format
from metapp.learning.app import App
from metapp.learning.recipe import Recipe
from metapp.registry import registry


def app_names() -> list[str]:
    """Return the names of all applications, sorted."""
    return sorted(registry().applications)


def application(name: str) -> Application:
    """Return the application of a name."""
    return registry().applications[name]


def observations_of(name: str) -> tuple[str, ...]:
    """Return what fits of an application may see, the values of --observe; "" for the only thing."""
    return registry().applications[name].observations or ("",)


def recipes_of(name: str, observes: str = "") -> dict[str, Recipe]:
    """Return the recipes of an application whose fits see something, by name; "" stands for the default."""
    return {recipe: entry.load() for recipe, entry in registry().applications[name].recipes_observing(observes).items()}


def app_by_recipe(name: str, recipe: str = "quick", observes: str = "") -> App:
    """Return an application with the network of a recipe, whose fits see the default unless something is named."""
    return recipes_of(name, observes)[recipe].app


def presenter_of(app: App, values: Mapping[str, object] = MappingProxyType({})) -> Presenter:
    """Return the presenter of an application's fits."""
    presenter: Presenter = registry().applications[app.name].make_presenter(app, values)
    return presenter


def exports_of(name: str) -> dict[str, Export]:
    """Return the forms in which fits of an application are written, by name, sorted."""
    return dict(sorted(registry().applications[name].exports.items()))


def input_formats(name: str) -> dict[str, Format]:
    """Return the formats that fits of an application accept, by name, sorted."""
    return registry().applications[name].input_formats
