"""The specification of a fit: everything that its result depends on, as one frozen value.

The command line makes a :class:`Spec` of its options, `metapp.fit` of its keywords. :func:`metapp.runs.resolve.resolve`
fills in what they leave open, for each input. The whole Spec is written into the record of the fit and read back with
it, compared by --resume, and is what tables tell methods apart by. Nothing here imports torch, so that help and a wrong
option answer at once.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec

from metapp.application import Application
from metapp.entries import did_you_mean
from metapp.options import FIT, OUTPUT, AppOptions, BadOption, Option, options_by_name, parse_options, to_json_options
from metapp.paradigms import paradigm_of
from metapp.registry import registry
from metapp.storage import Document
from metapp.storage.files import content_digest, to_json_value

MAX_GRADIENT_STEPS, MAX_SEED = 10**9, 2**63 - 1
MAX_FOLDER_NAME_LETTERS = 80  # of a run's folder; a longer name becomes a digest
DEFAULT_TASKS_HELP = "default: test tasks of --data"  # a clause of help texts about INPUT


@dataclass(frozen=True, kw_only=True)
class Spec:
    """Everything that the result of a fit depends on.

    A field that is annotated by an :class:`metapp.options.Option` is an option of the command line and a keyword of
    `metapp.fit`. The fields after `options` are only ever filled in by :func:`metapp.runs.resolve.resolve`.

    Attributes:
        app: the name of the application.
        paradigm: general, overfit, finetune, quickft or meta; "" for a method without a network.
        options: the application's own options that differ from their default, by name, as JSON holds them.
        digest: 12 hexadecimal digits of the checkpoint's content; "" if the paradigm reads none.
        data: the label of the data set that the task is of; "files" for files, "memory" for objects.
        conditions: what else errors depend on, by name, such as the features of a perceptual loss.
        versions: the versions of metapp, torch and Python, by name.

    >>> Spec(app="brdf", steps=20).paradigm
    'meta'
    """

    app: str
    paradigm: str = "meta"
    observe: Annotated[str, Option("Protocol, what fits see: reference or photo; default: what INPUT holds.")] = ""
    recipe: Annotated[str, Option("Recipe; default: the one that suits each input, else full.", panel=FIT)] = ""
    rule: Annotated[str, Option("Name of a learned rule; default: the recipe's.", panel=FIT)] = ""
    steps: Annotated[
        int | None,
        Option("Number of gradient steps; default: the recipe's.", low=0, high=MAX_GRADIENT_STEPS, panel=FIT),
    ] = None
    checkpoint: Annotated[
        Path | None,
        Option("File of checkpoints, for all paradigms; default: those that ship.", "FILE", panel=FIT),
    ] = None
    seed: Annotated[int, Option("Random seed; default: 0.", low=0, high=MAX_SEED, panel=FIT)] = 0
    device: Annotated[str, Option("auto, cpu, cuda; default: auto.", choices=("auto", "cpu", "cuda"), panel=FIT)] = (
        "auto"
    )
    options: dict[str, Any] = field(default_factory=dict)
    digest: str = ""
    data: str = ""
    conditions: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)

    @functools.cached_property
    def application(self) -> Application:
        """The application, with its recipes, formats and exports."""
        return registry().applications[self.app]

    @functools.cached_property
    def app_options(self) -> AppOptions:
        """The application's own options.

        Raises:
            BadOption: the application does not have an option, or not with this value.
        """
        kind = self.application.options.load()
        if unknown := self.options.keys() - options_by_name(kind).keys():
            raise BadOption(f"--{min(unknown)}: {self.app} has no such option; leave it out.")
        values = {name: tuple(value) if isinstance(value, list) else value for name, value in self.options.items()}
        return parse_options(kind, values)

    @property
    def key(self) -> str:
        """12 hexadecimal digits that equal specifications have in common, for dictionaries and groups of fits."""
        return hashlib.sha256(msgspec.json.encode(self.document(), order="deterministic")).hexdigest()[:12]

    def document(self) -> Document:
        """Return the specification as JSON holds it, without what is not set.

        >>> Spec(app="brdf", steps=20).document()
        {'app': 'brdf', 'paradigm': 'meta', 'steps': 20, 'seed': 0, 'device': 'auto'}
        """
        document: Document = to_json_value(msgspec.to_builtins(self, enc_hook=str))
        return {name: value for name, value in document.items() if name == "paradigm" or value not in (None, "", {})}

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Spec:
        """Return the specification that :meth:`document` made a document of.

        Raises:
            msgspec.ValidationError: an entry has another type, or there is an unknown one.
        """
        return msgspec.convert(dict(document), cls, dec_hook=lambda kind, value: kind(value))


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """The options that say what a command does with its fits, on which no result depends."""

    data: Annotated[Path | None, Option("Folder of a data set; default: the embedded data set.")] = None
    train: Annotated[bool, Option("Train first, on the training tasks of --data.", panel=FIT)] = False
    train_steps: Annotated[
        int | None,
        Option("Number of outer training steps; default: the recipe's.", low=1, high=MAX_GRADIENT_STEPS, panel=FIT),
    ] = None
    batch: Annotated[int, Option("Fit N inputs in parallel.", low=1, panel=FIT)] = 1
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


def parse_fit_options(app: str, paradigm: str = "meta", **values: object) -> tuple[Spec, RunOptions]:
    """Make a specification, and the options of the command, of values by name; nothing large is imported.

    Args:
        app: the name of the application.
        paradigm: the name of the paradigm.
        values: options of all fits, of commands, and the application's own, as a command line or a program gives them;
            None stands for an option that is not given.

    Raises:
        BadOption: there is no such application, paradigm, option, observation or export, an option has a wrong value,
            or options exclude each other.
    """
    application = application_named(app)
    if not isinstance(paradigm, str):
        raise BadOption(f"paradigm: {paradigm!r}, expected str.")
    try:
        paradigm_of(paradigm)
    except ValueError as error:
        raise BadOption(str(error)) from None
    own, kinds = application.options.load(), (Spec, RunOptions, application.options.load())
    known = {name: kind for kind in kinds for name in options_by_name(kind)}
    for name in values:
        if name not in known:
            raise BadOption(_describe_unknown_option(name, application))
    given = [{name: value for name, value in values.items() if known[name] is kind} for kind in kinds]
    run_options = parse_options(RunOptions, given[1])
    spec = parse_options(
        Spec,
        given[0],
        app=app,
        paradigm=paradigm,
        options=to_json_options(parse_options(own, given[2]).non_default_values()),
    )
    for form in run_options.exports:
        check_export(form, application)
    check_observation(spec.observe, application)
    if run_options.train_steps and not run_options.train:
        raise BadOption("--train-steps: only with --train.")
    if run_options.train:
        for name in spec.app_options.non_default_values(FIT):
            flag = options_by_name(own)[name].flag
            raise BadOption(f"{flag}: of fits; checkpoints are trained without it, leave --train out.")
    return spec, run_options


def given_words(spec: Spec, label: str = "") -> str:
    """Return the words by which a user asked for fits, as the name of their folder; a digest if they are long.

    Args:
        spec: the specification as the user gave it, before it was resolved.
        label: the label of the data set that the user named; "" for none.

    >>> given_words(Spec(app="brdf", steps=20, options={"conserve": True}), "merl-1a2b3c")
    'meta-merl-1a2b3c-20steps-conserve'
    """
    words = [spec.paradigm, label, spec.recipe, spec.rule, "" if spec.steps is None else f"{spec.steps}steps"]
    checkpoint = f"{spec.checkpoint.stem}-{content_digest(str(spec.checkpoint))[:6]}" if spec.checkpoint else ""
    words += [spec.observe, checkpoint]
    words.append(f"seed{spec.seed}" if spec.seed else "")
    for name, value in spec.options.items():
        text = "x".join(map(str, value)) if isinstance(value, list) else value
        words.append(name if value is True else f"{name}{text}")
    text = "-".join(filter(None, words))
    if len(text) <= MAX_FOLDER_NAME_LETTERS and re.fullmatch(r"[\w.-]+", text):
        return text
    return f"{spec.paradigm}-{hashlib.sha256(text.encode(errors='surrogatepass')).hexdigest()[:8]}"


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
    """Refuse a value of --observe that an application does not have; "" stands for the default.

    Raises:
        BadOption: fits of the application cannot observe this.
    """
    names = application.observations
    if observation and observation not in names:
        expected = f"expects one of {', '.join(names)}" if names else "has one protocol; leave it out"
        raise BadOption(f"--observe '{observation}': {application.name} {expected}.{did_you_mean(observation, names)}")


def check_export(name: str, application: Application) -> None:
    """Refuse a file format that fits of an application cannot be written in.

    Args:
        name: the name of the format, one value of --export.
        application: the application.

    Raises:
        BadOption: the application has no such format, or a library for it is missing.
    """
    forms = registry().exports_of(application)
    if name not in forms:
        expected = f"expects one of {', '.join(forms)}" if forms else "has none; leave it out"
        raise BadOption(f"--export '{name}': {application.name} {expected}.{did_you_mean(name, forms)}")
    needs = forms[name][1].needs
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
    names = [*options_by_name(Spec), *options_by_name(RunOptions), *options_by_name(application.options.load())]
    return f"{name}: no option of a fit, expected one of {', '.join(sorted(names))}.{did_you_mean(name, names)}"
