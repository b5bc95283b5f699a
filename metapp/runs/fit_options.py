"""The options of a fit in one dataclass: options of the command line, keywords of `metapp.fit`, entries of records.

Options are checked here, before anything large is imported. What their names stand for is looked up in
`metapp.runs.choice`.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from metapp.application import Application
from metapp.entries import did_you_mean
from metapp.options import (
    FIT,
    INPUT,
    OUTPUT,
    AppOptions,
    BadOption,
    Option,
    options_by_name,
    parse_options,
)
from metapp.registry import registry
from metapp.storage.files import content_digest, file_name
from metapp.storage.folders import is_data_set

MAX_GRADIENT_STEPS, MAX_SEED = 10**9, 2**63 - 1
DEFAULT_TASKS_HELP = "default: test tasks of --data"  # a clause of help texts about INPUT


@dataclass(frozen=True)
class FitOptions:
    """The options of a fit, with the application's own options as a field.

    Attributes:
        application: the application.
        paradigm: general, overfit, finetune, quickft or meta.
        inputs: files and folders, or objects in memory; () stands for the test tasks of the data set.
        app_options: the options that only this application has.
    """

    application: Application
    paradigm: str = "meta"
    inputs: Sequence[object] = ()
    app_options: AppOptions = field(default_factory=AppOptions)
    data: Annotated[Path | None, Option("Folder of a data set; default: the embedded data set.")] = None
    observe: Annotated[str, Option("Protocol, what fits see: reference or photo; default: what INPUT holds.")] = ""
    recipe: Annotated[str, Option("Recipe; default: the one that suits the inputs, else full.", panel=FIT)] = ""
    rule: Annotated[str, Option("Name of a learned rule; default: the recipe's.", panel=FIT)] = ""
    steps: Annotated[
        int | None,
        Option("Number of gradient steps; default: the recipe's.", low=0, high=MAX_GRADIENT_STEPS, panel=FIT),
    ] = None
    checkpoint: Annotated[
        Path | None,
        Option("Checkpoint, or folder of checkpoints; default: the one that ships.", "FILE", panel=FIT),
    ] = None
    train: Annotated[bool, Option("Train first, on the training tasks of --data.", panel=FIT)] = False
    train_steps: Annotated[
        int | None,
        Option("Number of outer training steps; default: the recipe's.", low=1, high=MAX_GRADIENT_STEPS, panel=FIT),
    ] = None
    seed: Annotated[int, Option("Random seed; default: 0.", low=0, high=MAX_SEED, panel=FIT)] = 0
    device: Annotated[str, Option("auto, cpu, cuda; default: auto.", choices=("auto", "cpu", "cuda"), panel=FIT)] = (
        "auto"
    )
    batch: Annotated[int | None, Option("Fit N inputs in parallel.", low=1, panel=FIT)] = None
    resume: Annotated[bool, Option("Skip inputs that have a fit of the same settings.", panel=FIT)] = False
    export: Annotated[
        str, Option("Also write each fit in these file formats, separated by commas.", "KIND", panel=OUTPUT)
    ] = ""
    out: Annotated[Path, Option("Folder for runs and checkpoints; default: runs.", panel=OUTPUT)] = Path("runs")
    quiet: Annotated[bool, Option("Show no progress bar and no table.", short="q", panel=OUTPUT)] = False

    @property
    def exports(self) -> tuple[str, ...]:
        """The names of file formats to write fits in, each once."""
        return tuple(dict.fromkeys(name for name in self.export.split(",") if name))

    @property
    def paths(self) -> list[Path]:
        """The inputs that are paths."""
        return [path for path in self.inputs if isinstance(path, Path)]

    @property
    def objects(self) -> list[object]:
        """The inputs that are objects in memory."""
        return [item for item in self.inputs if not isinstance(item, Path)]


def fit_options(
    app: str | Application, paradigm: str = "meta", inputs: Sequence[object] = (), **values: Any
) -> FitOptions:
    """Check the options of a fit and return them as one object; nothing large is imported.

    Args:
        app: the application, or its name.
        paradigm: the name of the paradigm.
        inputs: paths, or objects in memory.
        values: options of all fits and the application's own, by name, as a command line or a program gives them.

    Raises:
        BadOption: there is no such application, option, recipe or export, fits cannot observe what an option names, an
            option has a wrong value, or options exclude each other.
    """
    if not isinstance(paradigm, str):
        raise BadOption(f"paradigm: {paradigm!r}, expected str.")
    application = application_named(app) if isinstance(app, str) else app
    given_paths, given_data = [path for path in inputs if isinstance(path, Path)], values.get("data")
    paths, data = extract_data_set(given_paths, Path(given_data) if isinstance(given_data, str | Path) else None)
    if len(paths) < len(given_paths):
        inputs, values["data"] = (), data
    options_class = application.options.load()
    app_values = {name: values.pop(name) for name in options_by_name(options_class) if name in values}
    for name in values:
        if name not in options_by_name(FitOptions):
            raise BadOption(_describe_unknown_option(name, application))
    options = parse_options(
        FitOptions,
        values,
        application=application,
        paradigm=paradigm,
        inputs=tuple(inputs),
        app_options=parse_options(options_class, app_values),
    )
    _check(options, options.app_options.non_default_values())
    return options


def extract_data_set(paths: Sequence[Path], data: Path | None) -> tuple[Sequence[Path], Path | None]:
    """Take a data set that is given as INPUT as the data set whose test tasks are fitted.

    Args:
        paths: the inputs that are paths.
        data: the data set of --data, None if it is not set.

    Returns:
        The inputs and the data set; no inputs if one of them is a data set.

    Raises:
        BadOption: a data set is given beside other inputs, or --data names another one.
    """
    data_set = next(filter(is_data_set, paths), None)
    if data_set is None:
        return paths, data
    if len(paths) > 1:
        raise BadOption(
            f"{data_set}: a data set beside {len(paths) - 1} more INPUT, expected it alone; fit others by another "
            "command, or join data sets by metapp data join."
        )
    if data and data.resolve() != data_set.resolve():
        raise BadOption(f"{data_set}: a data set, and another by --data {data}, expected one; leave one out.")
    return (), data_set


def application_named(name: str) -> Application:
    """Return the application that a user names.

    Raises:
        BadOption: there is no such application; the message lists all.
    """
    try:
        return registry().application(name)
    except ValueError as error:
        message = str(error)
    raise BadOption(message)  # outside of the handler, so that a traceback shows one error


def check_observation(observation: str, application: Application) -> None:
    """Refuse a value of --observe that an application does not have.

    Args:
        observation: the value of --observe, "" if it is not set.
        application: the application.

    Raises:
        BadOption: fits of the application cannot observe this.
    """
    names = application.observations
    if observation and observation not in names:
        expected = f"expects one of {', '.join(names)}" if names else "has one protocol; leave it out"
        raise BadOption(f"--observe '{observation}': {application.name} {expected}.{did_you_mean(observation, names)}")


def check_new_files(paths: Iterable[Path]) -> None:
    """Refuse to overwrite files: one that is there already may be a measurement.

    Raises:
        BadOption: one of the files is there already.
    """
    for path in paths:
        if os.path.lexists(path):
            raise BadOption(f"{path}: is there already, expected a new file; choose another --out, or remove it.")


def check_export(name: str, application: Application) -> None:
    """Refuse a file format that fits of an application cannot be written in.

    Args:
        name: the name of the format, one value of --export.
        application: the application.

    Raises:
        BadOption: the application has no such format, or a library for it is missing.
    """
    forms = sorted(application.exports)
    if name not in forms:
        expected = f"expects one of {', '.join(forms)}" if forms else "has none; leave it out"
        raise BadOption(f"--export '{name}': {application.name} {expected}.{did_you_mean(name, forms)}")
    needs = application.exports[name].needs
    if needs and not importlib.util.find_spec(needs[0]):
        raise BadOption(f'--export {name} needs {needs[1]}: pip install "metapp[export]"')


def _describe_unknown_option(name: str, application: Application) -> str:
    """Return the error message about an option that an application does not have."""
    apps_with_option = [
        other.name for other in registry().applications.values() if name in options_by_name(other.options.load())
    ]
    if apps_with_option:
        flag = f"--{name.replace('_', '-')}"
        return (
            f"{flag}: {application.name} has no such option, only {', '.join(sorted(apps_with_option))}; leave it out."
        )
    names = {**options_by_name(FitOptions), **options_by_name(application.options.load())}
    return f"{name}: no option of a fit, expected one of {', '.join(sorted(names))}.{did_you_mean(name, names)}"


def _check(options: FitOptions, app_values: Mapping[str, object]) -> None:
    """Refuse names that the application does not have and options that exclude each other.

    Args:
        options: the options.
        app_values: the application's own options that are not at their default, by name.

    Raises:
        BadOption: there is such a name, or there are such options.
    """
    for form in options.exports:
        check_export(form, options.application)
    check_observation(options.observe, options.application)
    if options.train_steps and not options.train:
        raise BadOption("--train-steps: only with --train.")
    for name in app_values:
        option = options_by_name(type(options.app_options))[name]
        if option.panel == INPUT and not options.inputs:
            remedy = f"not about the data set {options.data}; leave it out" if options.data else "name what to fit"
            raise BadOption(f"{option.flag}: about INPUT alone; {remedy}.")
        if option.panel == FIT and options.train:
            raise BadOption(f"{option.flag}: of fits; checkpoints are trained without it, leave --train out.")


def app_options_of_record(
    application: Application, recorded: Mapping[str, object], *, inputs: bool
) -> dict[str, object]:
    """Return an application's own options as a record states them.

    Args:
        application: the application.
        recorded: the options in the record; one that the application does not have is left out.
        inputs: whether to return options about INPUT, too.
    """
    known_options = options_by_name(application.options.load())
    return {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in recorded.items()
        if name in known_options and (inputs or known_options[name].panel != INPUT)
    }


def folder_name_parts(app_options: AppOptions) -> list[str]:
    """Return the parts of a run folder's name that state options of the application, such as conserve, relief2.0.

    Options about inputs are one part, a digest: the same files, read otherwise, are other data.
    """
    recorded, options = app_options.recorded_values(), options_by_name(type(app_options))
    about_inputs = {name: value for name, value in recorded.items() if options[name].panel == INPUT}
    others = {name: value for name, value in recorded.items() if name not in about_inputs}
    parts = [file_name(name if value is True else f"{name}{value}") for name, value in others.items()]
    return [*parts, f"inputs-{content_digest(about_inputs)[:6]}"] if about_inputs else parts
