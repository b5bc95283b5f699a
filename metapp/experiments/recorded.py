"""Runs that are over: their records, and the options that these were made by."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from metapp.experiments import BadOption
from metapp.experiments.session import Options, options_of
from metapp.learning.app import App
from metapp.paradigms import paradigms
from metapp.storage.records import FIT, read_records

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
