"""Fixtures for the contract of applications and paradigms: each application with a small network and small tasks."""

import functools

import pytest

from metapp.learning.app import App, stack_tasks
from metapp.learning.recipe import Recipe
from metapp.learning.task import Task, Tasks
from tests.paradigms.small import NETWORK_KINDS, SMALL_APPLICATIONS, small_app, small_recipe


@pytest.fixture(autouse=True)
def disable_compilation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep torch from compiling, which takes longer than these tests."""
    monkeypatch.setenv("TORCH_COMPILE_DISABLE", "1")


@pytest.fixture(scope="session", params=NETWORK_KINDS)
def app(request: pytest.FixtureRequest) -> App:
    """Each application, and the second network of BRDFs, small."""
    app = small_app(request.param)
    assert app.name in SMALL_APPLICATIONS, f"{app.name}: no small tasks; add a line to SMALL_APPLICATIONS."
    return app


@functools.cache  # fixtures are made again for every test that names its application
def small_sources(name: str) -> list[Task]:
    """Return an application's small tasks before it prepares them."""
    return SMALL_APPLICATIONS[name].tasks()


@functools.cache
def small_tasks(app: App) -> Tasks:
    """Return an application's small tasks, prepared and stacked."""
    return stack_tasks(app, small_sources(app.name))


@pytest.fixture(scope="session")
def sources(app: App) -> list[Task]:
    """The application's small tasks before it prepares them."""
    return small_sources(app.name)


@pytest.fixture(scope="session")
def tasks(request: pytest.FixtureRequest, app: App) -> Tasks:
    """The application's small tasks, prepared and stacked."""
    if app.name == "illumination":
        request.getfixturevalue("shared_second_scene")
    return small_tasks(app)


@pytest.fixture(autouse=True)
def _second_scene_where_needed(request: pytest.FixtureRequest) -> None:
    """Link the second scene's matrix into the cache of tests of illumination, whose errors need it."""
    if "app" in request.fixturenames and request.getfixturevalue("app").name == "illumination":
        request.getfixturevalue("second_scene")


@pytest.fixture
def recipe(app: App) -> Recipe:
    """The small recipe of the application."""
    return small_recipe(app)
