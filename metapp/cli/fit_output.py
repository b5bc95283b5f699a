"""The work of `metapp general|overfit|finetune|quickft|meta APP`, and what it prints.

The fits themselves are made and kept by :mod:`metapp.runs.keeping`; here is how a person and a script hear of them.
"""

from __future__ import annotations

import contextlib
import shlex
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.text import Text

from metapp.cli.command_process import Exit, command_seconds, state_what_interruption_keeps
from metapp.cli.console import escape_control_characters, print_json, shorten_to_line, standard_output
from metapp.options import BadOption
from metapp.paradigms import ranks
from metapp.registry import registry
from metapp.runs.checkpoints import describe_checkpoint
from metapp.runs.data_sets.embedded import is_embedded
from metapp.runs.environment import make_folder
from metapp.runs.fit import Fit
from metapp.runs.fit_tables import count_guarded, summarise
from metapp.runs.fitting import Failure, Fitter, make_fitters
from metapp.runs.inputs.finding import DATA_SET_FORMAT, Input, find
from metapp.runs.keeping import fit_and_keep
from metapp.runs.outputs.fit_files import export_path, file_to_open
from metapp.runs.reporter import Reporter, format_number, say, use_reporter
from metapp.runs.resolve import resolve
from metapp.runs.spec import RunOptions, Spec, given_words
from metapp.storage import Document
from metapp.storage.fit_folders import find_fit_folder

if TYPE_CHECKING:
    from rich.table import Table

# degrees; at this mean tilt of normals a relief and its inverse differ by 0.02 of display values under other lights:
# the median over 20 synthetic materials (2.9 over 20 further ones)
VISIBLE_TILT_DEGREES = 3.0
MIN_TABLE_CHARACTERS = 50  # least width of a table, so that its title stays on one line
PHOTO_ERROR_TEXT = "mean |fit - photo| of display values where the photo does not clip"
LEFT_OUT_FIGURE = "left_out_db"  # PSNR of photographs that others predict, which fits state that can be relit
MAX_LISTED_PATHS = 5  # exported files of one format, up to which each is listed
MAX_LISTED_TASKS = 20  # tasks in the table of a run


def fit_and_print(spec: Spec, options: RunOptions, paths: Sequence[Path], *, json: bool) -> None:
    """Fit the inputs of a command and print the results; the exit code is 1 if an input was not fitted.

    Args:
        spec: the specification of the fits, as the user gave it.
        options: the options of the command.
        paths: the inputs; none for the test tasks of a data set.
        json: whether an object is printed in place of tables.

    Raises:
        Exit: an input was not fitted, or a file was not written.
        ValueError: inputs are bad, or nothing could be fitted.
    """
    training = "the same command goes on with training where it stopped, and " if options.train else "the same command "
    state_what_interruption_keeps(f"{training}with --resume fits only the inputs that have no fit yet")
    if not options.train:
        ranks.end_other_ranks()
    silence = use_reporter(Reporter()) if ranks.rank_number() > 0 else contextlib.nullcontext()
    with silence:
        make_folder(options.out)
        inputs = find(spec, paths, options.data, quiet=options.quiet)
        specs, reasons = resolve(spec, inputs, trained=not options.train)
        for line in reasons:
            say(line)
        if options.train:
            specs = _train_checkpoint(specs, inputs, options)
    is_named_data_set = inputs[0].format == DATA_SET_FORMAT and bool(options.data or paths)
    run_folder = options.out / spec.app / given_words(spec, specs[0].data if is_named_data_set else "")
    fitters = make_fitters(specs)
    if not options.quiet:
        say(_introduction(fitters))
    fitted_before = {one.place for one in inputs if find_fit_folder(run_folder, one.name, one.place)}
    begin = time.perf_counter()
    outcomes = list(fit_and_keep(fitters, inputs, run_folder, options))
    seconds = time.perf_counter() - begin
    order = {one.place: number for number, one in enumerate(inputs)}  # fits side by side end in another order
    fits = sorted((one for one in outcomes if isinstance(one, Fit)), key=lambda fit: order.get(fit.source, len(order)))
    failures = [outcome for outcome in outcomes if isinstance(outcome, Failure)]
    if not fits:
        introduction = f"none of {len(inputs)} inputs could be fitted; the first: " if len(inputs) > 1 else ""
        raise ValueError(f"{introduction}{failures[0].reason}")
    new_count = sum(not fit.is_earlier for fit in fits)
    rate = new_count / seconds if new_count else None  # tasks a second, with reading, pictures and exports
    if not options.quiet:
        _print_fits(fits, run_folder, options, rate, table=not json)
        if replaced := sum(not fit.is_earlier and fit.source in fitted_before for fit in fits):
            say(f"{replaced} of {len(fits)} fits and their pictures replace earlier ones; --resume keeps earlier fits")
    for failure in failures:
        prefix = "failed" if failure.fails_run else "warning: skipped"
        say(f"{prefix}: {shorten_to_line(failure.reason)}")
    if json:
        print_json(_make_document(fits, failures, run_folder, rate))
    counted_failures = [failure for failure in failures if failure.fails_run]
    unwritten = sum(failure.is_fit_kept for failure in counted_failures)
    if failed := len(counted_failures) - unwritten:
        say(f"error: {failed} of {failed + len(fits)} inputs were not fitted.")
    if unwritten:
        say(f"error: {unwritten} export{'s were' if unwritten > 1 else ' was'} not written; all fits are kept.")
    if counted_failures:
        raise typer.Exit(Exit.FAILED)


def _train_checkpoint(specs: Sequence[Spec], inputs: Sequence[Input], options: RunOptions) -> list[Spec]:
    """Train the checkpoint that the fits of all inputs need, and return their specifications with it.

    Raises:
        BadOption: inputs need different checkpoints.
    """
    from metapp.runs.checkpoint_training import train  # imported here, since most runs train nothing

    different = {(spec.recipe, spec.observe): spec for spec in specs}
    if len(different) > 1:
        needs = ", ".join(" ".join(filter(None, words)) for words in different)
        raise BadOption(f"--train: inputs need checkpoints of {needs}, expected one; name --recipe, or give less.")
    folders = [Path(one.path) for one in inputs if one.format == DATA_SET_FORMAT]
    data = options.data or next((folder for folder in folders if not is_embedded(folder)), None)
    path = train(specs[0], replace(options, data=data)).absolute()
    trained, _ = resolve(replace(specs[0], checkpoint=path), inputs)
    return trained


def _introduction(fitters: Sequence[Fitter]) -> str:
    """Return the line that says what is fitted, in how many steps, and where fits begin."""
    names = " and ".join(dict.fromkeys(fitter.app.full_name for fitter in fitters))
    steps = " or ".join(dict.fromkeys(str(fitter.method.steps) for fitter in fitters))
    different = {id(fitter): fitter for fitter in fitters}.values()
    begins = " or ".join(dict.fromkeys(describe_checkpoint(fitter.spec) for fitter in different))
    size = fitters[0].presenter.size
    files = "; files of {:,} rows, {:,} columns".format(*size) if size else ""
    count = f"{len(fitters)} input{'s' * (len(fitters) != 1)}"
    return f"{names} {fitters[0].spec.paradigm}: {count}; {steps} steps, from {begins}{files}"


def _print_fits(fits: Sequence[Fit], run_folder: Path, options: RunOptions, rate: float | None, *, table: bool) -> None:
    """Print the table of a run or the line of its only fit, and where its files are.

    Args:
        fits: the fits, in the order of the inputs.
        run_folder: the folder of the run.
        options: the options of the command.
        rate: tasks that were fitted per second; None if all fits were there before.
        table: whether the figures of fits are printed.
    """
    if table and len(fits) > 1:
        standard_output().print(fits_table(fits, rate=rate, most=MAX_LISTED_TASKS))
    elif table:
        standard_output().print(fit_line(fits[0]), soft_wrap=True)
        for remark in _describe_guard(fits):
            say(remark)
    for line in relief_lines(fits, changed="relief" in fits[0].spec.options):
        say(line)
    if skipped := sum(fit.is_earlier for fit in fits):
        line = f"{skipped} of {len(fits)} inputs are skipped, since they have a fit by equal settings"
        say(f"{line}; metapp export writes other files of these fits" if options.exports else line)
    for line in describe_exports(fits, options.exports):
        say(line)
    place = fits[0].folder if len(fits) == 1 else run_folder
    say(f"fits: {place}")
    if "view" in registry().commands:
        say(f"to look at: metapp view {shlex.quote(str(place))}")


def _make_document(fits: Sequence[Fit], failures: Sequence[Failure], run_folder: Path, rate: float | None) -> Document:
    """Make the object that --json prints; see :func:`_print_fits` for the arguments."""
    spec = fits[0].spec
    common = {name: getattr(spec, name) for name in ("app", "observe", "paradigm", "steps", "device", "data")}
    return {
        **{name: value for name, value in common.items() if value != ""},
        **{"rule": fits[0].rule},
        **spec.conditions,
        **summarise(fits),
        "scale": fits[0].scale,
        "guarded": count_guarded(fits),
        "tasks": [_task_document(fit) for fit in fits],
        "tasks_per_second": rate,
        "failures": [{"source": failure.place, "reason": failure.reason} for failure in failures],
        "out": str(run_folder),
    }


def _task_document(fit: Fit) -> Document:
    """Return what --json prints of a fit."""
    figures = {key: fit.figures[key] for key in ("mean_tilt_degrees", LEFT_OUT_FIGURE) if key in fit.figures}
    shown = {"photo_error": fit.photo_error, **figures, "seconds": fit.seconds, "counts": fit.counts}
    shown |= {"note": fit.note, "warning": fit.warning}
    set_entries = {key: value for key, value in shown.items() if value not in (None, "", {})}
    return {"name": fit.name, "error": fit.error, **set_entries, "folder": str(fit.folder)}


def relief_lines(fits: Sequence[Fit], *, changed: bool = False) -> list[str]:
    """Return a line about normals that fits found in photographs; [] if they found none.

    If steep normals were found in one photograph, it says that dents may be bumps: both look alike under one flash.

    Args:
        fits: the fits.
        changed: whether --relief gives exported slopes another factor.
    """
    tilts = [fit.figures["mean_tilt_degrees"] for fit in fits if "mean_tilt_degrees" in fit.figures]
    if not tilts:
        return []
    mean = f"mean tilt {statistics.median(tilts):.1f} degrees"
    mean += f", median of {len(tilts)}, up to {max(tilts):.1f}" if len(tilts) > 1 else ""
    mean += ", without --relief" if changed else ""
    of_one_photo = [fit.figures for fit in fits if fit.counts.get("photos", 1) == 1]
    if max((figures.get("mean_tilt_degrees", 0.0) for figures in of_one_photo), default=0.0) >= VISIBLE_TILT_DEGREES:
        mean += "; one photo cannot tell dents from bumps, several photos of one place do: metapp data rectify PHOTOS"
    return [f"relief: {mean}"]


def fit_line(fit: Fit) -> str:
    """Return a sentence on a fit: the number of pictures, its error, and the seconds of the whole command."""
    app, count = fit.app, len([*fit.folder.glob("*.png")])
    if fit.error is not None:
        error = f"error{app.error_measure.factor} {fit.error:.3f} ({app.error_measure.text})"
    elif LEFT_OUT_FIGURE in fit.figures and fit.photo_error is not None:
        psnr_db = fit.figures[LEFT_OUT_FIGURE]
        error = f"photos that were left out are predicted to {psnr_db:.1f} dB, {fit.photo_error:.2f} %"
    elif fit.photo_error is not None:
        error = f"photo error {fit.photo_error:.2f} % ({PHOTO_ERROR_TEXT})"
    else:
        error = fit.presenter.caption(measured=False)
    pictures = [f"{count} picture{'s' * (count != 1)}"] if count else []
    name, seconds = escape_control_characters(fit.name), f"{command_seconds():.1f} s in all"
    return f"{name}: {', '.join([*pictures, error, seconds])}"


def describe_exports(fits: Sequence[Fit], forms: Sequence[str]) -> Iterator[str]:
    """Yield a line for each exported file of new fits; many files of one format share a line."""
    for form in forms:
        paths = [export_path(fit.folder, form) for fit in fits if not fit.is_earlier]
        files = [file_to_open(path) for path in paths if path.parent.is_dir()]
        if len(files) > MAX_LISTED_PATHS:
            yield f"{form}: {len(files)} files, the first is {files[0]}"
        else:
            yield from (f"{form}: {file}" for file in files)


def _describe_guard(fits: Sequence[Fit]) -> list[str]:
    """Return a line about the guard of a learned rule, if it acted; else []."""
    count = count_guarded(fits)
    if not count:
        return []
    from metapp.evaluation.rows import fit_remarks  # imported here, since it imports more than a table of fits needs

    return fit_remarks([{"paradigm": fits[0].spec.paradigm, "tasks": len(fits), "guarded": count}])


def fits_table(fits: Sequence[Fit], *, rate: float | None = None, most: int | None = None) -> Table:
    """Make a table with a line for each fit, or for the fits of the largest errors, and with means in its last line.

    If fits have no error, as those of photographs have none, the table says how many pictures were made instead.

    Args:
        fits: the fits.
        rate: tasks that were fitted per second; None if it is not to be said.
        most: the most fits to list; None for all.
    """
    from rich.table import Table  # imported here, as it takes 10 ms, and a single fit has no table

    presenter, paradigm = fits[0].presenter, fits[0].spec.paradigm or fits[0].spec.conditions.get("method", "")
    remarks = _describe_guard(fits)
    listed = fits
    if most is not None and len(fits) > most:
        listed = sorted(fits, key=lambda fit: -(fit.error or 0.0))[:most]
        remarks.insert(0, f"{most} of {len(fits)} tasks are listed, those of the largest errors")
    if rate is not None:
        remarks.insert(0, f"{rate:.4g} tasks/s, with reading and pictures included")
    totals = summarise(fits)
    has_errors = totals["error"] is not None
    if "photo_error" in totals:
        remarks.insert(0, f"photo error: {PHOTO_ERROR_TEXT}")
    caption = "\n".join([presenter.caption(measured=has_errors), *remarks])
    table = Table(
        title=f"{presenter.title}: {paradigm}", show_footer=True, caption=caption, min_width=MIN_TABLE_CHARACTERS
    )
    has_means = has_errors or "photo_error" in totals
    table.add_column("task", "mean error; other columns: median" if has_means else "median")
    if has_errors:
        table.add_column(
            f"error{presenter.app.error_measure.factor}", format_number(totals["error"], ".3f"), justify="right"
        )
    if "photo_error" in totals:
        table.add_column("photo error %", format_number(totals["photo_error"], ".2f"), justify="right")
    table.add_column("seconds", format_number(totals["seconds"], ".4f"), justify="right")
    picture_counts = {} if has_errors else {fit.name: len([*fit.folder.glob("*.png")]) for fit in listed}
    if any(picture_counts.values()):
        table.add_column("pictures", justify="right")
    for fit in listed:
        cells = [format_number(fit.error, ".3f")] if has_errors else []
        cells += [format_number(fit.photo_error, ".2f")] if "photo_error" in totals else []
        cells.append(format_number(fit.seconds, ".4f"))
        cells += [f"{picture_counts[fit.name]}"] if any(picture_counts.values()) else []
        table.add_row(Text(escape_control_characters(fit.name)), *cells)
    return table
