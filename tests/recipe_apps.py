"""Applications as recipes configure them, by their names, for tests that need the networks of real fits."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from metapp.appearance.presenter import Presenter
from metapp.application import Application, Export, Format
from metapp.learning.app import App
from metapp.learning.recipe import Recipe
from metapp.learning.task import Params, Task
from metapp.registry import registry
from metapp.runs.fit import Fit
from metapp.runs.spec import Spec


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
    """Return the presenter of an application's fits, by its own options."""
    application = registry().applications[app.name]
    presenter: Presenter = application.presenter.load()(app, application, application.options.load()(**values))
    return presenter


def fit_of(app: App, theta: Params, task: Task, values: Mapping[str, object] = MappingProxyType({})) -> Fit:
    """Return a fit of given parameters, without a task axis, by an application's own options."""
    fit = Fit(name=task.name, spec=Spec(app=app.name, paradigm="meta", options=dict(values)))
    fit.app, fit.parameters, fit.task = app, theta, task
    return fit


def asset_of(app: App, theta: Params, task: Task, values: Mapping[str, object] = MappingProxyType({})) -> Any:
    """Return what a fit of given parameters is for, at the size of files."""
    return fit_of(app, theta, task, values).asset


def exports_of(name: str) -> dict[str, Export]:
    """Return the forms in which fits of an application are written, by name, sorted."""
    return {form: entry for form, (_, entry) in registry().exports_of(registry().applications[name]).items()}


def input_formats(name: str) -> dict[str, Format]:
    """Return the formats that fits of an application accept, by name, sorted."""
    return registry().applications[name].input_formats
