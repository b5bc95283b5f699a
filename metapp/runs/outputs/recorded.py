"""Runs that are over: their records, and the plans that these were made by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.options import BadOption
from metapp.paradigms import PARADIGMS
from metapp.runs.inputs.embedded import embedded_exists
from metapp.runs.inputs.sources import Source, data_folder, data_label, source_of, sources_to_fit, tasks_to_fit
from metapp.runs.options import fit_options, own_of_record
from metapp.runs.plan import Plan, plan
from metapp.runs.reporter import say
from metapp.storage import Document
from metapp.storage.records import FIT, read_records
from metapp.storage.text import entry_of, meant, path_of

RECORD = "record.jsonl"
# settings that plans are made of, and what they are where records lack them
TEXTS = {"app": None, "data": None, "recipe": None, "paradigm": "", "rule": "", "observe": ""}


class Recorded(NamedTuple):
    """A run's folder, and its records of fits."""

    folder: Path
    records: list[Document]


def read_run(run: Path, task: str = "", *, by_paradigm: bool = True) -> Recorded:
    """The records of a run.

    Args:
        run: its folder, the record file in it, or a folder of runs, whose newest run is taken.
        task: the one to take; "" for all.
        by_paradigm: fits alone, to which a network's parameters belong; else those of methods without one, too.

    Raises:
        ValueError: there are none, none of that task, or one of other settings than metapp writes.
    """
    folder = run.parent if run.name == RECORD else _newest_run(run)
    records = read_records(folder / RECORD, ("settings", *(FIT if by_paradigm else ("error",))))
    if by_paradigm:
        records = [record for record in records if record["settings"].keys() >= {"paradigm", "rule"}]
    if not records:
        state = "no record.jsonl with fits" if folder.is_dir() else "a file" if folder.is_file() else "no such folder"
        raise ValueError(f"{run}: {state}, expected a run's folder, such as runs/brdf/meta/...")
    names = [record["name"] for record in records]
    if task and task not in names:
        some = f"{', '.join(names[:5])}{' and so on' if len(names) > 5 else ''}"
        raise ValueError(f"{run}: no record of task '{task}', expected one of {some}.{meant(task, names)}")
    chosen = [records[names.index(task)]] if task else records
    for record in chosen:
        _check_settings(record, folder / RECORD)
    return Recorded(folder, chosen)


def _check_settings(record: Document, file: Path) -> None:
    """Refuse settings and an origin, which anybody may have written, that no plan can be made of.

    Raises:
        ValueError: one is missing or of another type.
    """
    settings, origin, where = record["settings"], record.get("origin", {}), f"{file}: {record['name']}: "
    for key, absent in TEXTS.items():
        entry_of(settings, key, str, where, "fit again", absent)
    entry_of(settings, "options", dict, where, "fit again", {})
    entry_of(origin, "data", str, where, "fit again", "")
    if not all(isinstance(place, str) for place in entry_of(origin, "inputs", list, where, "fit again", [])):
        raise ValueError(f"{where}'inputs' hold more than text, expected paths; fit again.")


def holds_runs(path: Path) -> bool:
    """True of what `read_run` may take for a run or a folder of runs."""
    return path.name == RECORD or (path / RECORD).is_file() or bool(_records_below(path))


def _records_below(folder: Path) -> list[Path]:
    """The record files of a folder of runs, such as `runs` or `runs/brdf/meta`."""
    found = [file for places in ("*/", "*/*/", "*/*/*/") for file in folder.glob(f"{places}{RECORD}")]
    return [file for file in found if file.resolve() == folder.resolve() / file.relative_to(folder)]  # through no link


def _newest_run(folder: Path) -> Path:
    """The run of the latest record in a folder of runs; else the folder itself."""
    found = [] if (folder / RECORD).is_file() else _records_below(folder)
    newest = max(found, key=lambda file: file.stat().st_mtime_ns).parent if found else folder
    if found:
        say(f"{folder}: the newest run is {newest}")
    return newest


def plan_as(settings: Document, options: Mapping[str, object] | None = None, **more: Any) -> Plan:
    """The plan that a fit was made by, as far as its record says it.

    Args:
        settings: of the record.
        options: of extensions, beside those that the record states.
        more: further options, as of `FitOptions`.

    Raises:
        BadOption: one of `options`.
        ValueError: settings that are not known here.
    """
    app, inputs = settings["app"], more.pop("inputs", ())
    own = own_of_record(app, settings.get("options", {}), inputs=bool(inputs)) | dict(options or {})
    paradigm = settings.get("paradigm", "meta")
    if paradigm not in PARADIGMS:
        raise ValueError(f"paradigm '{paradigm}': not known, expected {', '.join(PARADIGMS)}; fit again.")
    given = {"rule": settings.get("rule", "") if paradigm == "meta" else "", "recipe": settings["recipe"]}
    given |= {"observe": settings.get("observe", ""), "quiet": True, **more}
    try:
        return plan(fit_options(app, paradigm, inputs, **own, **given))
    except BadOption as error:
        if options:
            raise
        raise ValueError(f"{app}: a fit of other settings than are known ({error})") from None


def tasks_as(records: list[Document], app: App, inputs: list[Path], data: Path | None) -> dict[str, Task]:
    """The tasks that were fitted in a run, by name: of what is given, else from where its records say, else embedded.

    Returns:
        Without those that are not there, or not as they were fitted.
    """
    settings, origin = records[-1]["settings"], records[-1].get("origin", {})
    sourced = [record for record in records if record.get("stamp")]
    moved = bool(inputs)
    if not (inputs or data):
        inputs = _existing(origin.get("inputs", [])) or _existing(record["source"] for record in sourced)
        data = path_of(origin["data"]) if "data" in origin and path_of(origin["data"]).is_dir() else None
    if not inputs and any("source" in record for record in records):
        return {}
    label = settings["data"]
    embedded = embedded_exists(app.name) and data_label(data_folder(app, None, quiet=True)) == label
    if not (inputs or data or embedded):
        return {}
    planned = plan_as(settings, inputs=inputs, data=data)
    if inputs:
        return _of_sources(sourced, sources_to_fit(planned)[0], moved)
    tasks, now = tasks_to_fit(planned)
    return {task.name: task for task in tasks} if now == label else {}


def _existing(places: Iterable[str]) -> list[Path]:
    """The paths that are there."""
    return [path for path in map(path_of, places) if path.exists()]


def _of_sources(records: list[Document], sources: list[Source], moved: bool) -> dict[str, Task]:
    """Tasks of files that have not changed since, or in size where they have moved; no other is read."""
    by_name = {record["name"]: source_of(record, sources, moved) for record in records}
    return {name: source.task()._replace(name=name) for name, source in by_name.items() if source}
