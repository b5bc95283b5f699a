"""Runs that are over: their records, and the plans that these were made by."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.paradigms import paradigms
from metapp.runs import BadOption
from metapp.runs.embedded import embedded_exists
from metapp.runs.inputs import SOURCED, data_folder, data_label, source_of, sources_to_fit, tasks_to_fit
from metapp.runs.plan import Plan, plan
from metapp.runs.request import Request
from metapp.storage import Document
from metapp.storage.records import FIT, NUMBER, holds, read_records
from metapp.storage.text import meant, path_of

# what settings and origins of records hold: plans are made of them, and anybody may have written them
SETTINGS = {
    **{"app": str, "data": str, "recipe": str},
    **{f"{name}?": str for name in ("paradigm", "rule", "observe", "checkpoint", "device", "precision", "peer")},
    **{"seed?": range(1 << 63), "steps?": range(1 + 10**7), "detail?": range(1 + 10**4), "versions?": {...: str}},
}
ORIGIN = {
    **{f"{name}?": str for name in ("machine", "data", "checkpoint")},
    **{"inputs?": [str], "roots?": [str], "fov_rad?": NUMBER, "exposure?": NUMBER, "exposures?": str},
}
FORM = {**FIT, "settings": {**SETTINGS, "paradigm": str, "rule": str}, "origin?": ORIGIN}  # of a fit's record


class Recorded(NamedTuple):
    """A run's folder, and its records of fits."""

    folder: Path
    records: list[Document]


def read_run(run: Path, form: Document = FORM, task: str = "") -> Recorded:
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
        found = "no record.jsonl with fits" if folder.is_dir() else "a file" if folder.is_file() else "no such folder"
        raise ValueError(f"{run}: {found}, expected a run's folder, such as runs/brdf/meta/...")
    if not task:
        return Recorded(folder, records)
    names = [record["name"] for record in records]
    if task not in names:
        known = f"{', '.join(names[:5])}{' and so on' if len(names) > 5 else ''}"
        raise ValueError(f"{run}: no record of task '{task}', expected one of {known}.{meant(task, names)}")
    return Recorded(folder, [records[names.index(task)]])


def plan_as(settings: Document, origin: Document | None = None, **more: Any) -> Plan:
    """The plan that a fit was made by, as far as its record says it.

    Args:
        settings: of the record.
        origin: of the record, for how files were read.
        more: further options, as of `Request`.

    Raises:
        ValueError: settings that are not known here.
    """
    request = Request(
        settings["app"],
        settings.get("paradigm", "meta"),
        rule=settings.get("rule", "") if settings.get("paradigm") == "meta" else "",
        recipe=settings["recipe"],
        observe=settings.get("observe", ""),
        detail=settings.get("detail", 0),
        quiet=True,
        **reading_of(origin or {}),
        **more,
    )
    if request.paradigm not in paradigms():
        raise ValueError(f"paradigm '{request.paradigm}': not known, expected {', '.join(paradigms())}; fit again.")
    try:
        return plan(request)
    except BadOption as error:
        raise ValueError(f"{settings['app']}: a fit of other settings than are known ({error})") from None


def app_as(settings: Document) -> App:
    """The application as it was at the fit.

    Raises:
        ValueError: settings that are not known here.
    """
    return plan_as(settings).app


def tasks_as(records: list[Document], app: App, inputs: list[Path], data: Path | None) -> dict[str, Task]:
    """What was fitted in a run, by name: of what is given, else from where its records say, else embedded.

    Returns:
        Without those that are not there, or not as they were fitted.
    """
    settings, origin = records[-1]["settings"], records[-1].get("origin", {})
    sourced = [record for record in records if holds(record, SOURCED) and record["stamp"]]
    if not (inputs or data):
        inputs = _existing(origin.get("inputs", [])) or _existing(record["source"] for record in sourced)
        data = path_of(origin["data"]) if "data" in origin and path_of(origin["data"]).is_dir() else None
    request = Request(app.name, inputs=inputs, data=data, quiet=True, **reading_of(origin))
    known = _of_sources(sourced, app, request)
    if known or settings.get("batched"):
        return known
    label = settings["data"]
    embedded = embedded_exists(app.name) and data_label(data_folder(app, None, quiet=True)) == label
    if not (inputs or data or embedded):
        return {}
    tasks, now = tasks_to_fit(app, request)
    return {task.name: task for task in tasks} if now == label else {}


def _existing(places: Iterable[str]) -> list[Path]:
    """The paths that are there."""
    return [path for path in map(path_of, places) if path.exists()]


def reading_of(origin: Document) -> Document:
    """The options of a record's origin that say how files were read."""
    fov = round(math.degrees(origin.get("fov_rad", 0.0)), 9)  # as it was given, so that radians are the same bits
    roots = [path_of(path) for path in origin.get("roots", [])]
    photos = {"exposure": origin.get("exposure", 0.0), "exposures": origin.get("exposures", "")}
    return {"fov": fov, "scene_root": roots} | photos


def _of_sources(records: list[Document], app: App, request: Request) -> dict[str, Task]:
    """Tasks of files that have not changed since, each of which its record knows; no other is read."""
    sources = sources_to_fit(app, request)[0] if records and request.inputs else []
    by_name = {record["name"]: source_of(record, sources) for record in records}
    return {name: source.task()._replace(name=name) for name, source in by_name.items() if source}
