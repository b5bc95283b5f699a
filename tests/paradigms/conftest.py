"""What the contract of applications and paradigms is tested on: each application, small."""

from __future__ import annotations

import pytest

from metapp.apps import app_names, load_app
from metapp.learning.app import App, stack
from metapp.learning.task import Task, Tasks
from metapp.paradigms import Job
from metapp.paradigms import training as prepare
from tests.paradigms.small import SMALL, small_recipe


@pytest.fixture(autouse=True)
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling takes longer than these tests."""
    monkeypatch.setattr(prepare, "can_compile", lambda: False)


@pytest.fixture(scope="session", params=app_names())
def app(request: pytest.FixtureRequest) -> App:
    app = load_app(request.param)
    assert app.name in SMALL, f"{app.name}: no small tasks for its contract; add a line to SMALL."
    return app.at(small_recipe(app))


@pytest.fixture(scope="session")
def sources(app: App) -> list[Task]:
    """What tasks are before an application prepares them."""
    return SMALL[app.name].tasks()


@pytest.fixture(scope="session")
def tasks(request: pytest.FixtureRequest, app: App, sources: list[Task]) -> Tasks:
    if app.name == "illumination":
        request.getfixturevalue("shared_scene")
    return stack(app, sources)


@pytest.fixture(autouse=True)
def judged(request: pytest.FixtureRequest) -> None:
    """What errors of an application need beside its tasks."""
    if "app" in request.fixturenames and request.getfixturevalue("app").name == "illumination":
        request.getfixturevalue("scene")


@pytest.fixture
def job(app: App) -> Job:
    recipe = small_recipe(app)
    return Job(app, recipe, recipe.rule)
