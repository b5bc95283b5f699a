"""Runs that have ended: their fits, and exports of these.

Anybody may have written a record that is read here: its specification is checked before anything is made of it.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from metapp.entries import did_you_mean
from metapp.learning.task import Task
from metapp.options import BadOption
from metapp.runs.fit import Fit, find_tasks, read_fit
from metapp.runs.inputs.refusals import path_refusal
from metapp.runs.outputs.fit_files import export_path, file_to_open
from metapp.runs.reporter import progress, say
from metapp.runs.resolve import app_of, presenter_of
from metapp.runs.spec import Spec, application_named, check_export, parse_fit_options
from metapp.storage.fit_folders import PARAMS, RECORD, fit_folders
from metapp.storage.folders import FolderKind, find_record_files, path_kind


class RunFits(NamedTuple):
    """Fits that were kept, and the folder that they were read from.

    Attributes:
        folder: the folder of a run, or of one of its fits.
        fits: the fits.
    """

    folder: Path
    fits: list[Fit]


def read_run(place: Path, task: str = "", *, by_paradigm: bool = True) -> RunFits:
    """Read the fits of a run.

    Args:
        place: the folder of a run or of one of its fits, or a folder of runs, whose newest run is taken.
        task: the name of the one fit that is wanted; "" for all.
        by_paradigm: whether to read fits by paradigms alone, which have parameters of a network; else results of
            methods without a network are read, too.

    Raises:
        ValueError: there is no fit or none of that name, or the one of a fit's folder has another specification than
            metapp writes; in the folder of a run such fits are passed over with a warning.
    """
    folder = place
    if (place / RECORD).is_file():
        fit = read_known_fit(place)
        fits = [fit] if fit.spec.paradigm or not by_paradigm else []
    else:
        folder, fits = _read_newest_run(place, by_paradigm=by_paradigm)
    if not fits:
        expected = "a run's folder, such as runs/brdf/meta"
        if (kind := path_kind(place)) in (FolderKind.DATA_SET, FolderKind.RESULTS):
            raise ValueError(path_refusal(place, kind, expected))
        state = "no folders of fits" if folder.is_dir() else "a file" if folder.is_file() else "no such folder"
        raise ValueError(f"{place}: {state}, expected {expected}.")
    names = [fit.name for fit in fits]
    if task and task not in names:
        first_names = f"{', '.join(names[:5])}{' and so on' if len(names) > 5 else ''}"
        raise ValueError(
            f"{place}: no record of task '{task}', expected one of {first_names}.{did_you_mean(task, names)}"
        )
    return RunFits(folder, [fits[names.index(task)]] if task else fits)


def read_known_fit(place: Path) -> Fit:
    """Read a fit from its folder, from one of the files in it, or from a file of `Fit.save`.

    Raises:
        ValueError: there is no fit, or its record states what this version does not know; the message names the file.
    """
    folder = place.parent if place.name in (RECORD, PARAMS) and (place.parent / RECORD).is_file() else place
    fit = read_fit(folder)
    _require_known_spec(fit)
    return fit


def _require_known_spec(fit: Fit) -> None:
    """Refuse a fit by whose specification nothing can be shown, as of another program or another version.

    Raises:
        ValueError: an entry is missing or not known; the message names the file.
    """
    spec, place = fit.spec, fit.folder
    missing = [name for name in ("app", "data", "recipe") if not getattr(spec, name)]
    reason = f"'{missing[0]}' is missing, expected text" if missing else ""
    if spec.paradigm and fit.seconds is None:
        reason = "without seconds"
    try:
        if not reason:
            application_named(spec.app)
            if spec.paradigm:
                parse_fit_options(spec.app, spec.paradigm)
            presenter_of(spec, app_of(spec))
    except BadOption as error:
        reason = f"a fit of other settings than are known ({str(error).rstrip('.')})"
    if reason:
        file = place if place.is_file() else place / RECORD
        raise ValueError(f"{file}: {fit.name}: {reason}; fit again.")


def holds_fits(path: Path) -> bool:
    """Test whether a path is the folder of a fit, of a run or of runs, which :func:`read_run` reads."""
    return path_kind(path) in (FolderKind.FIT, FolderKind.RUN) or bool(find_record_files(path))


def read_fits(run_folder: Path, *, by_paradigm: bool = True) -> list[Fit]:
    """Read the fits in the folder of a run, in the order of their folders' names.

    A single warning names the first file that should be a record and is not.

    Args:
        run_folder: the folder of the run.
        by_paradigm: whether to read fits by paradigms alone; see :func:`read_run`.
    """
    fits, problems = list[Fit](), list[str]()
    for folder in fit_folders(run_folder):
        try:
            fit = read_fit(folder)
            if fit.spec.paradigm or not by_paradigm:
                _require_known_spec(fit)
                fits.append(fit)
        except (ValueError, FileNotFoundError) as error:
            problems.append(f"{str(error).removesuffix('; fit again.')}; passed over, as if not there.")
    if problems:
        more = f" {len(problems) - 1} more in {run_folder} alike." if len(problems) > 1 else ""
        warnings.warn(f"{problems[0]}{more}", stacklevel=2)
    return fits


def read_fits_of_spec(run_folder: Path, spec: Spec) -> dict[str, Fit]:
    """Read the fits in the folder of a run that have a specification, by the places of their inputs.

    Fits that were made side by side are left out, since their seconds are shares of a batch's time.
    """
    fits, document = {}, spec.document()
    for folder in fit_folders(run_folder):
        with contextlib.suppress(ValueError, FileNotFoundError):
            fit = read_fit(folder)
            if fit.batch == 1 and fit.spec.document() == document:
                fits[fit.source] = fit
    return fits


def _read_newest_run(folder: Path, *, by_paradigm: bool) -> tuple[Path, list[Fit]]:
    """Read the fits of the run with the latest record in a folder of runs, such as `runs` or `runs/brdf`.

    Records that are none of a fit are passed over, and so are runs without others.

    Args:
        folder: the folder of runs; of any other one the fits right in it are read.
        by_paradigm: whether fits must be by paradigms; see :func:`read_run`.

    Returns:
        The folder of the run and its fits; the folder as it is and [] if there are none.
    """
    record_files = sorted(find_record_files(folder), key=lambda file: file.stat().st_mtime_ns, reverse=True)
    for run_folder in dict.fromkeys(file.parent.parent for file in record_files):
        if fits := read_fits(run_folder, by_paradigm=by_paradigm):
            say(f"{folder}: the newest run is {run_folder}")
            return run_folder, fits
    return folder, read_fits(folder, by_paradigm=by_paradigm)


def provide_tasks(fits: Sequence[Fit], inputs: Sequence[Path] = (), data: Path | None = None) -> int:
    """Give fits the tasks that were fitted, read once for all of them, and return the number of those not found.

    Args:
        fits: the fits.
        inputs: files and folders that were fitted; () to look for them where records say.
        data: the data set that was fitted; None if it is not given.
    """
    tasks = find_tasks(fits, inputs, data)
    for fit in fits:
        fit.task = tasks.get(fit.name, Task(fit.name, {}))
    return sum(fit.name not in tasks for fit in fits)


def with_options(fit: Fit, options: Mapping[str, object]) -> Fit:
    """Set further options of a fit by which it is shown and written, such as another size, and return it.

    Args:
        fit: a fit in its folder, which is changed.
        options: the options by name, which are set beside those of the fit.

    Raises:
        BadOption: an option is wrong.
    """
    if not options:
        return fit
    parsed, _ = parse_fit_options(fit.spec.app, fit.spec.paradigm, **dict(options))
    theta, app = fit.parameters, fit.app
    others = {name: value for name, value in fit.spec.options.items() if name not in options}
    fit.spec = replace(fit.spec, options=others | parsed.options)
    fit.forget()
    fit.parameters, fit.app = theta, app
    return fit


def export_fits(
    place: Path,
    form: str,
    inputs: Sequence[Path],
    *,
    data: Path | None,
    out: Path | None,
    options: Mapping[str, object],
    quiet: bool,
) -> tuple[Path, list[str], list[Path]]:
    """Write every fit of a run in another file format.

    Args:
        place: the folder of a run, or of one of its fits.
        form: the name of the format, one value of --export.
        inputs: the fitted files, for formats that hold something of the input, too.
        data: the data set whose test tasks were fitted, for such formats.
        out: the folder to write to; None for a folder of the format's name in the folder of each fit.
        options: the application's own options by name, which are set beside those of the fits.
        quiet: whether no progress is shown.

    Returns:
        The folder that holds all exports, the names of the fits, and for each the file that a user opens.

    Raises:
        BadOption: fits of the application cannot be written in this format, or not with these options.
        ValueError: there is no run, records or parameters are damaged, or a format needs inputs that are not given.
    """
    folder, fits = read_run(place)
    apps = sorted({fit.spec.app for fit in fits})
    if len(apps) > 1:
        raise ValueError(f"{place}: fits of {', '.join(apps)}, expected one application; take one run's folder.")
    check_export(form, fits[0].spec.application)
    fits = [with_options(fit, options) for fit in fits]
    are_tasks_read = bool(inputs or data)  # some formats do without the input, but have more detail with it
    if are_tasks_read:
        provide_tasks(fits, inputs, data)
    else:
        for fit in fits:
            fit.task = Task(fit.name, {})
    files = []
    with progress(form, len(fits), quiet=quiet) as bar:
        for fit in fits:
            path = export_path(fit.folder, form, out)
            try:
                fit.write_export(form, path)
            except KeyError as missing:  # the format holds something of the input, too, which takes time to read
                if not are_tasks_read:
                    provide_tasks(fits)
                    are_tasks_read = True
                if not fit.task.data:
                    raise ValueError(
                        f"{fit.name}: {form} is made of the fit and its input ({missing}), expected both; "
                        "give what was fitted after the form, or --data."
                    ) from None
                fit.write_export(form, path)
            files.append(file_to_open(path))
            bar.advance(fit.name)
    target = out or (folder if len(fits) > 1 else export_path(fits[0].folder, form).parent)
    return target, [fit.name for fit in fits], files
