"""What the contract of applications and paradigms is tested on: each application, small."""

import functools

import pytest

from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Task, Tasks
from metapp.paradigms.paradigm import Paradigm
from tests.paradigms.small import KINDS, SMALL, fits_of, small_app, small_recipe


@pytest.fixture(autouse=True)
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling takes longer than these tests."""
    monkeypatch.setenv("TORCH_COMPILE_DISABLE", "1")


@pytest.fixture(scope="session", params=KINDS)
def app(request: pytest.FixtureRequest) -> App:
    app = small_app(request.param)
    assert app.name in SMALL, f"{app.name}: no small tasks for its contract; add a line to SMALL."
    return app


@functools.cache  # a fixture is made anew for every test that names its application
def sources_of(name: str) -> list[Task]:
    return SMALL[name].tasks()


@functools.cache
def tasks_of(name: str) -> Tasks:
    return stack_tasks(small_app(name), sources_of(name))


@pytest.fixture(scope="session")
def sources(app: App) -> list[Task]:
    """What tasks are before an application prepares them."""
    return sources_of(app.name)


@pytest.fixture(scope="session")
def tasks(request: pytest.FixtureRequest, app: App) -> Tasks:
    if app.name == "illumination":
        request.getfixturevalue("shared_scene")
    return tasks_of(app.name)


@pytest.fixture(autouse=True)
def judged(request: pytest.FixtureRequest) -> None:
    """What errors of an application need beside its tasks."""
    if "app" in request.fixturenames and request.getfixturevalue("app").name == "illumination":
        request.getfixturevalue("scene")


@pytest.fixture
def fits(app: App) -> dict[str, Paradigm]:
    """The five paradigms of the application, by name."""
    return fits_of(app, small_recipe(app))
