"""Runs that are over: their records, and the options that these were made by."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.paradigms import paradigms
from metapp.runs import BadOption
from metapp.runs.embedded import embedded_exists
from metapp.runs.inputs import Reading, data_folder, data_label, tasks_to_fit
from metapp.runs.session import Options, options_of
from metapp.runs.sources import SOURCED, source_of, sources_of
from metapp.storage.records import FIT, holds, read_records

FORM = {**FIT, "settings": {"app": str, "paradigm": str, "rule": str, "recipe": str, "data": str}}  # of a fit's record


class Recorded(NamedTuple):
    """A run's folder, and its records of fits."""

    folder: Path
    records: list[dict[str, Any]]


def read_run(run: Path, form: dict[str, Any] = FORM, task: str = "") -> Recorded:
    """The records of a run.

    Args:
        run: its folder, or the record file in it.
        form: what records must hold.
        task: the one to take; "" for all.

    Raises:
        ValueError: there are none, or none of that task.
    """
    folder = run.parent if run.name == "record.jsonl" else run
    records = read_records(folder / "record.jsonl", form)
    if not records:
        found = "no record.jsonl" if folder.is_dir() else "no such folder"
        raise ValueError(f"{run}: {found} with fits, expected a run's folder, such as runs/brdf/meta/...")
    if not task:
        return Recorded(folder, records)
    names = [record["name"] for record in records]
    if task not in names:
        known = f"{', '.join(names[:5])}{' and so on' if len(names) > 5 else ''}"
        raise ValueError(f"{run}: no record of task '{task}', expected one of {known}.")
    return Recorded(folder, [records[names.index(task)]])


def options_as(settings: dict[str, Any], **more: Any) -> Options:
    """The options that a fit was made by, as far as its settings say them; `more` are of `options_of`.

    Raises:
        ValueError: settings that are not known here.
    """
    rule = settings["rule"] if settings.get("paradigm") == "meta" else ""
    try:
        return options_of(
            settings["app"],
            observe=settings.get("observe", ""),
            rule=rule,
            recipe=settings["recipe"],
            quiet=True,
            **more,
        )
    except BadOption as error:
        raise ValueError(f"{settings['app']}: a fit of other settings than are known ({error})") from None


def app_as(settings: dict[str, Any]) -> App:
    """The application as it was at the fit.

    Raises:
        ValueError: settings that are not known here.
    """
    options = options_as(settings)
    if settings["paradigm"] not in paradigms():
        raise ValueError(f"paradigm '{settings['paradigm']}': not known, expected {', '.join(paradigms())}; fit again.")
    return options.by(paradigms()[settings["paradigm"]]).app


def tasks_as(records: list[dict[str, Any]], app: App, inputs: list[Path], data: Path | None) -> dict[str, Task]:
    """What was fitted in a run, by name: of what is given, else from where its records say, else embedded.

    Returns:
        Without those that are not there, or not as they were fitted.
    """
    label, origin = records[-1]["settings"]["data"], records[-1].get("origin", {})
    sourced = [record for record in records if holds(record, SOURCED) and record["stamp"]]
    if not (inputs or data):
        inputs = _existing(origin.get("inputs", [])) or _existing(record["source"] for record in sourced)
        data = Path(origin["data"]) if "data" in origin and Path(origin["data"]).is_dir() else None
    reading = Reading([Path(path) for path in origin.get("roots", [])], origin.get("fov_rad", 0.0))
    if sourced:
        return _of_sources(sourced, app, inputs, reading)
    embedded = embedded_exists(app.name) and data_label(data_folder(app, None, quiet=True)) == label
    if not (inputs or data or embedded):
        return {}
    tasks, found = tasks_to_fit(app, inputs, data, True, reading)
    return {task.name: task for task in tasks} if found == label else {}


def _existing(places: Iterable[str]) -> list[Path]:
    """The paths, where all of them are there; else none."""
    paths = [Path(place) for place in places]
    return paths if all(path.exists() for path in paths) else []


def _of_sources(records: list[dict[str, Any]], app: App, inputs: list[Path], reading: Reading) -> dict[str, Task]:
    """Tasks of a run of many inputs, each of which its record knows: the run's name says nothing of their content."""
    sources = sources_of(app, inputs, None, True, reading)[0] if inputs else []
    found = {record["name"]: source_of(record, sources) for record in records}
    return {name: source.task()._replace(name=name) for name, source in found.items() if source}
