"""Repeat rows of tables from their records, and say whether the figures agree."""

from __future__ import annotations

import functools
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.appearance.precision import FLOAT32
from metapp.evaluation.cell import Cell
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables import load_table, table_names
from metapp.learning.task import Params
from metapp.paradigms import paradigms
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.fits.fitter import fit_tasks
from metapp.runs.inputs.sources import tasks_to_fit
from metapp.runs.outputs.recorded import ORIGIN, SETTINGS, plan_as, read_run, tasks_as
from metapp.runs.reporter import progress
from metapp.runs.requests.plan import Plan
from metapp.runs.surroundings import machine, threads_of
from metapp.runs.torch_state import threads
from metapp.storage import Document
from metapp.storage.forms import NUMBER, OPTIONAL, misfits
from metapp.storage.records import RunFolder, finite, read_theta
from metapp.storage.text import path_of

FORM = {"key": str, "settings": {"app": str}}
FIT = {
    **{"error": OPTIONAL, "seconds?": NUMBER, "threads?": range(1, 1025)},
    **{"settings": {**SETTINGS, "seed": SETTINGS["seed?"]}, "origin?": ORIGIN},
}
OF_FIT = {"data", "recipe", "seed"}  # settings
ROUNDING = 1e-6  # relative: what the same machine, versions and threads may differ by
ELSEWHERE = 0.01
AROUND = ("versions", "device", "precision")  # settings that figures depend on by rounding, or by a device's draws
FOUND_BY = {"data": "give what was fitted after RECORD, or --data", "checkpoint": "give that file by --checkpoint"}
_ALONE = "{}: a record of {}, expected one of a fit; metapp evaluate with another --out makes its table anew."


class Instead(NamedTuple):
    """Replacements of what records say: inputs, a data set, a checkpoint, a tolerance."""

    inputs: Sequence[Path] = ()
    data: Path | None = None
    checkpoint: Path | None = None
    tolerance: float | None = None


class Repeated(NamedTuple):
    """A row that was repeated.

    Attributes:
        name: of the task.
        recorded: the error then; None where there is no reference.
        found: the error now.
        difference: of the two, relative; of the parameters where there is no error.
        tolerance: up to which they agree.
        differs: what is not as it was then, (then, now) by name: versions, device, machine, threads.
        seconds: of inference, (then, now), where they were measured.
    """

    name: str
    recorded: float | None
    found: float | None
    difference: float
    tolerance: float
    differs: dict[str, tuple[object, object]]
    seconds: tuple[float, float] | None

    @property
    def agrees(self) -> bool:
        """True if the figure is the recorded one."""
        return self.difference <= self.tolerance


def rerun(record: Path, task: str, instead: Instead, *, quiet: bool) -> list[Repeated]:
    """Repeat the records of a file; what is measured now is kept nowhere.

    Args:
        record: the file, or a run's folder.
        task: the one to repeat; "" for all.
        instead: what to use in place of what records say.
        quiet: no progress.

    Raises:
        ValueError: no such record, or its data, checkpoint or settings are not to be had as they were.
    """
    folder, records = read_run(record, FORM, task)
    runs: dict[str, list[Document]] = {}
    for line in records:
        runs.setdefault(line["key"], []).append(line)
    done = []
    with progress("rerun", len(records), quiet=quiet) as bar:
        for of_run in runs.values():
            for row in _repeated(folder, of_run, instead):
                done.append(row)
                bar.advance(row.name)
    return done


def _repeated(folder: Path, records: list[Document], instead: Instead) -> Iterator[Repeated]:
    """The rows of one run, which share their settings."""
    first = records[0]
    if "error" not in first or not first["settings"].keys() >= OF_FIT:
        raise ValueError(_ALONE.format(first["name"], "no fit"))
    for record in records:
        place = next(misfits(record, FIT), None if record["settings"] == first["settings"] else ".settings")
        if place is not None:
            raise ValueError(
                f"{folder / 'record.jsonl'}: record of {record['name']}: {place[1:]} is missing or not as metapp "
                "writes it; take the run's folder from where it was made, or fit again."
            )
    plan = _plan_of(folder, first, instead)
    # more threads than processors wait for each other, by minutes where a record says a thousand
    count = min(first["threads"], os.cpu_count() or 1) if "threads" in first else threads_of(plan.app)
    with threads(count), _as_precise(first["settings"]):
        cell = _cell_of(plan, records, instead)
        assert cell.folder is not None
        around = _changed(first, cell.folder.settings)
        around |= _differing({"machine": first.get("origin", {}).get("machine")}, {"machine": machine(plan.device)})
        by_name = {task.name: task for task in cell.tasks}
        recorded = {record["name"]: record for record in records}
        missing = [name for name in recorded if name not in by_name]
        if missing:
            raise ValueError(f"{missing[0]}: no such task in {cell.folder.settings['data']}; {FOUND_BY['data']}.")
        for now, theta in cell.measure([by_name[name] for name in recorded]):
            yield _compared(folder, recorded.pop(now["name"]), now, theta, around, instead.tolerance)
    if recorded:
        raise ValueError(
            f"{next(iter(recorded))}: could not be fitted again, expected a figure; see what is said above."
        )


def _plan_of(folder: Path, record: Document, instead: Instead) -> Plan:
    """The plan of a record, with what is used instead; of a row that a table alone makes, that of General."""
    settings, origin = record["settings"], record.get("origin", {})
    a_fit = settings.get("paradigm") in paradigms()
    places = {key: path_of(origin[key]) for key in ("data", "checkpoint") if key in origin}
    inputs = list(instead.inputs) or ([] if instead.data else [path_of(path) for path in origin.get("inputs", [])])
    above = (parent.parent for parent in folder.resolve().parents if parent.name == settings["app"])
    device = str(settings.get("device", "cpu")).split(":")[0]
    return plan_as(
        settings if a_fit else settings | {"paradigm": "general"},
        inputs=inputs,
        steps=settings.get("steps") or None if a_fit else None,
        data=instead.data or (None if inputs and a_fit else places.get("data")),
        checkpoint=instead.checkpoint or places.get("checkpoint"),
        out=next(above, Path("runs")),
        seed=settings["seed"],
        device=device if device != "cuda" or torch.cuda.is_available() else "cpu",
    )


def _cell_of(plan: Plan, records: list[Document], instead: Instead) -> Cell:
    """The cell that makes such records: fits by a paradigm, or that of a table; nothing is added to its folder."""
    settings = records[0]["settings"]
    if settings.get("paradigm") in paradigms():
        if plan.request.inputs:
            label = settings["data"]
            tasks = list(tasks_as(records, plan.app, list(instead.inputs), instead.data).values())
        else:
            tasks, label = tasks_to_fit(plan)
        plan = find_checkpoint(plan)
        folder = RunFolder(plan.path(label), plan.settings(label))
        return Cell(label, tasks, folder, functools.partial(fit_tasks, plan), plan.steps)
    subject = Subject(plan, run=True, strict=False)
    cells = (load_table(name).repeat(subject, settings) for name in table_names())
    cell = next(filter(None, cells), None)
    if cell is None or cell.folder is None:
        raise ValueError(_ALONE.format(settings["app"], settings.get("paradigm") or settings.get("method")))
    return cell


def _differing(then: Document, now: Document) -> dict[str, tuple[object, object]]:
    """Entries of a record that are not so now."""
    return {key: (value, now.get(key)) for key, value in then.items() if value is not None and value != now.get(key)}


def _read_back(settings: Document) -> Document:
    """Settings as a record's line holds them."""
    result: Document = json.loads(json.dumps(finite(settings)))
    return result


def _changed(record: Document, now: Document) -> dict[str, tuple[object, object]]:
    """Versions and devices that differ.

    Raises:
        ValueError: anything else does, such as the data or the checkpoint; names it, what was expected and found.
    """
    then = record["settings"]
    both = [{key: value for key, value in each.items() if key not in AROUND} for each in (then, _read_back(now))]
    differing = _differing(*both) | {key: (None, now[key]) for key in both[1].keys() - both[0].keys()}
    for key in sorted(differing, key=lambda key: (key not in FOUND_BY, key)):
        expected, actual = differing[key]
        remedy = FOUND_BY.get(key, "repeat it by the version of metapp that made it")
        difference = f"{key} {actual}, expected {expected} as recorded"
        raise ValueError(f"{record['name']}: {difference}; {remedy}.")
    rest = [{"device": then.get("device"), "precision": "float32"} | each for each in (then, now)]
    around = [{key: each[key] for key in ("device", "precision")} for each in rest]
    return _differing(then.get("versions", {}), now["versions"]) | _differing(*around)


@contextmanager
def _as_precise(settings: Document) -> Iterator[None]:
    """Fit in float32 alone where the recorded fits did; other arithmetic depends on the CPU."""
    before = os.environ.get(FLOAT32)
    if "precision" not in settings:
        os.environ[FLOAT32] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(FLOAT32, None)
        else:
            os.environ[FLOAT32] = before


def _compared(
    folder: Path, then: Document, now: Document, theta: Params | None, around: Document, tolerance: float | None
) -> Repeated:
    recorded, found = then["error"], now["error"]
    differs = around | _differing({"threads": then.get("threads")}, now)
    if recorded is not None and found is not None:
        difference = abs(found - recorded) / max(abs(recorded), 1e-12)
    else:
        difference = _distance(read_theta(folder, then["name"]), theta) if recorded is found is None else math.inf
    allowed = tolerance if tolerance is not None else ELSEWHERE if differs else ROUNDING
    seconds = (then["seconds"], now["seconds"]) if "seconds" in then and "seconds" in now else None
    return Repeated(then["name"], recorded, found, difference, allowed, differs, seconds)


def _distance(then: Params, now: Params | None) -> float:
    """The relative difference of parameters; infinite where they are not of one network."""
    if now is None or {key: value.shape for key, value in then.items()} != {k: v.shape for k, v in now.items()}:
        return math.inf
    square = sum(float((now[key].cpu() - then[key]).double().square().sum()) for key in then)
    whole = sum(float(value.double().square().sum()) for value in then.values())
    return math.sqrt(square / max(whole, 1e-30))
