"""Write fits in another format."""

from __future__ import annotations

from data_tools.formats import exports_of
from metapp.experiments import BadOption
from metapp.experiments.reporter import say
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.storage.records import RunFolder, file_name


def check_export(name: str, app: App) -> None:
    """Refuse a format that fits of an application cannot be written in.

    Raises:
        BadOption: it cannot.
    """
    known = exports_of(app.name)
    if name and name not in known:
        expected = f"expects one of {', '.join(known)}" if known else "has none; leave it out"
        raise BadOption(f"--export '{name}': {app.name} {expected}.")


def export_all(app: App, tasks: list[Task], folder: RunFolder, name: str) -> None:
    """Write every fit of a run in a format, under <run>/<format>/."""
    writer = exports_of(app.name)[name]()
    for task in tasks:
        writer.export(app, folder.theta(task.name), folder.path / name / file_name(task.name))
    say(f"{len(tasks)} fits written as {name}: {folder.path / name}")
