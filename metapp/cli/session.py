"""From options to objects: which tasks, which start, which device, which folder; shared by fitting and evaluation."""

from __future__ import annotations

import importlib
import platform
import warnings
from dataclasses import asdict
from importlib import metadata, resources
from pathlib import Path
from typing import Any, NamedTuple

import torch
import typer
from torch import Generator

from metapp.apps import app_names, load_app
from metapp.cli.console import follow, progress, say
from metapp.cli.embedded import embedded_data, embedded_exists
from metapp.learning import MetaParameters
from metapp.paradigms import Job, Paradigm, paradigms
from metapp.paradigms.prepare import Interrupted, describe, prepare
from metapp.records import digest, load_start, save_start
from metapp.shards import fingerprint, read_shard
from metapp.task import App, Task, stack


class Options(NamedTuple):
    """The options that all paradigms share; what each means stands in its --help."""

    app: App
    recipe: str
    rule: str
    steps: int | None
    data: Path | None
    out: Path
    checkpoint: Path | None
    seed: int
    device: torch.device
    quiet: bool

    @property
    def job(self) -> Job:
        """What the paradigms work on."""
        return Job(self.app, self.app.recipes[self.recipe], self.rule, self.steps)


class Start(NamedTuple):
    """A prepared start, where it came from and a digest of its file ("" where nothing is needed)."""

    prepared: MetaParameters
    source: str
    digest: str


def find_app(name: str) -> App:
    """The application, or a usage error that lists those that exist."""
    if name not in app_names():
        raise typer.BadParameter(f"'{name}' is not an application; expected one of {', '.join(app_names())}.")
    return load_app(name)


def check_rule(name: str, app: App, recipe: str) -> str:
    """The rule, the recipe's default where it is empty, or a usage error; of the recipe as well."""
    if recipe not in app.recipes:
        raise typer.BadParameter(f"--recipe '{recipe}': expected one of {', '.join(app.recipes)}.")
    known = app.recipes[recipe].meta
    if name and name not in known:
        raise typer.BadParameter(f"--rule '{name}': {app.name}, recipe {recipe}, expects one of {', '.join(known)}.")
    return name or app.recipes[recipe].rule


def find_device(name: str, app: App) -> torch.device:
    """The device; auto is CUDA where there is one, but the CPU where the application's kernels are too small for it."""
    if name not in ("auto", "cpu", "cuda"):
        raise typer.BadParameter(f"--device '{name}': expected auto, cpu or cuda.")
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device cuda: PyTorch finds no CUDA device; use --device cpu or install a CUDA build.")
    if app.small_kernels:
        torch.set_num_threads(1)  # threads that share such small kernels wait for each other
    automatic = "cuda" if torch.cuda.is_available() and not app.small_kernels else "cpu"
    return torch.device(automatic if name == "auto" else name)


def data_folder(options: Options) -> Path:
    """The folder of task shards: --data, or the embedded set, made on first use."""
    return options.data or embedded_data(options.app.name, quiet=options.quiet)


def data_label(folder: Path) -> str:
    """A data set's name in run folders: its folder's name and a digest of its content."""
    return f"{folder.name}-{fingerprint(folder)[:6]}"


def test_tasks(options: Options, inputs: list[Path]) -> tuple[list[Task], str]:
    """What to fit, the user's files or the data set's test tasks, and its name."""
    if inputs:
        tasks = read_inputs(options.app, inputs)
        names = digest([(task.name, float(sum(v.double().sum() for v in task.data.values()))) for task in tasks])
        return tasks, f"files-{names[:6]}"
    folder = data_folder(options)
    tasks = read_shard(folder, "test", options.app.name)
    if not tasks:
        raise ValueError(f"{folder}: 0 test tasks, expected some; convert the data again with --split auto or test.")
    return tasks, data_label(folder)


def read_inputs(app: App, inputs: list[Path]) -> list[Task]:
    """Tasks of a user's files, by the first reader of the application that takes them."""
    missing = [path for path in inputs if not path.exists()]
    if missing:
        raise ValueError(f"{missing[0]}: no such file or folder; give existing input files.")
    tasks: list[Task] = []
    for path in inputs:
        reader = importlib.import_module(f"data_tools.{_reader(app, path)}")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            tasks += reader.read_tasks([path])
        for warning in caught:
            say(f"warning: {warning.message}")
    names = [task.name for task in tasks]
    return [
        task if names.count(task.name) == 1 else task._replace(name=f"{task.name}-{i + 1}")
        for i, task in enumerate(tasks)
    ]


def _reader(app: App, path: Path) -> str:
    """The data tool that reads a path."""
    for name in app.readers:
        if importlib.import_module(f"data_tools.{name}").recognises(path):
            return name
    raise ValueError(f"{path}: not an input of {app.name}, expected {app.inputs}.")


def find_start(options: Options, paradigm: Paradigm) -> Start:
    """The best start there is: --checkpoint, else one trained on this data earlier, else the one that ships.

    Raises:
        ValueError: there is none.
    """
    needed = paradigm.needs(options.job)
    if needed is None:
        return Start(MetaParameters(), "random", "")
    path = _start_path(options, needed)
    prepared, info = load_start(path, options.device)
    if info["app"] != options.app.name or info["start"] != needed:
        raise ValueError(f"{path}: a start of {info['app']} {info['start']}, expected {options.app.name} {needed}.")
    start = Start(prepared, _describe_path(path, options), digest(path))
    if paradigm.name == "quickft":
        return _with_tuning(options, start)
    return start


def _with_tuning(options: Options, start: Start) -> Start:
    """Put the Adam that was tuned for this very encoder into its start."""
    try:
        path = _start_path(options._replace(checkpoint=None), "quickft")
    except ValueError:
        return start
    tuned, info = load_start(path, options.device)
    if info["encoder"] != start.digest:
        return start
    return Start(start.prepared._replace(alpha=tuned.alpha), f"{start.source}, tuned Adam", digest(path))


def _start_path(options: Options, name: str) -> Path:
    if options.checkpoint:
        return options.checkpoint
    if options.data or embedded_exists(options.app.name):
        path = trained_path(options, name)
        if path.is_file():
            return path
    path = shipped_path(options.app.name, name)
    # the starts that ship were trained by the quick recipe
    if path.is_file() and options.recipe == "quick":
        return path
    raise ValueError(
        f"{options.app.name} {name}, recipe {options.recipe}: no start, neither trained on this data nor shipped; "
        "train one with --train."
    )


def trained_path(options: Options, name: str) -> Path:
    """Where a start that is trained on this data is kept."""
    run = f"{data_label(data_folder(options))}-{options.recipe}-seed{options.seed}"
    return options.out / options.app.name / "starts" / run / f"{name}.safetensors"


def shipped_path(app: str, name: str) -> Path:
    """Where a start that ships with metapp is."""
    return Path(str(resources.files("metapp.checkpoints"))) / app / f"{name}.safetensors"


def _describe_path(path: Path, options: Options) -> str:
    shipped = path == shipped_path(options.app.name, path.stem)
    return "the one that ships" if shipped and not options.checkpoint else str(path)


def train_start(options: Options, paradigm: Paradigm, steps: int | None) -> Path:
    """Train what a paradigm needs on the training tasks and keep it for later runs on this data.

    Returns:
        The file of the start.
    """
    needed = paradigm.needs(options.job)
    if needed is None:
        raise typer.BadParameter(f"--train: {paradigm.name} needs no preparation; leave the option out.")
    if options.checkpoint:
        raise typer.BadParameter("--train makes a start of its own; leave --checkpoint out.")
    folder = data_folder(options)
    tasks = stack(options.app, read_shard(folder, "train", options.app.name), options.device)
    general = paradigms()["general"]
    if needed != "general" or paradigm.name == "quickft":
        try:
            encoder = find_start(options, general)
        except ValueError:
            say("no General start yet: training it first.")
            train_start(options, general, steps)
            encoder = find_start(options, general)
    name = "quickft" if paradigm.name == "quickft" else needed
    generator = Generator(options.device).manual_seed(options.seed)
    say(f"training {options.app.name} {name} on {len(tasks)} tasks of {folder.name}, every eighth for validation")
    path = trained_path(options, name)
    with progress(options.quiet) as bar:
        row = bar.add_task(f"train {name}", total=None, note="")
        try:
            prepared = prepare(
                name,
                options.job._replace(steps=None),
                tasks,
                generator,
                encoder=None if name == "general" else encoder.prepared,
                steps=steps,
                report=None if options.quiet else lambda i, n, note: follow(bar, row, i, n, note),
            )
        except Interrupted as error:
            kept = path.with_suffix(".interrupted.safetensors")
            save_start(kept, error.prepared.start, describe(options.job, name, error.prepared))
            say(f"interrupted at validation error {error.prepared.validation:.3f}; best state so far: {kept}")
            raise
    info = describe(options.job, name, prepared) | {
        "data": data_label(folder),
        "recipe": options.recipe,
        "seed": options.seed,
        "versions": versions(),
        "curve": prepared.curve,
    }
    if name != "general":
        info["encoder"] = encoder.digest
    save_start(path, prepared.start, info)
    say(f"{name}: validation error {prepared.validation:.3f} at step {prepared.step}; kept as {path}")
    return path


def versions() -> dict[str, str]:
    """The versions that a figure depends on."""
    return {
        "metapp": metadata.version("metapp"),
        "torch": str(torch.__version__),
        "python": platform.python_version(),
    }


def settings_of(options: Options, paradigm: Paradigm, start: Start, label: str) -> dict[str, Any]:
    """Everything that a run's figures depend on: what its records carry, and their key."""
    recipe = options.job.recipe
    return {
        "app": options.app.name,
        "paradigm": paradigm.name,
        "rule": options.rule if paradigm.name == "meta" else ("adam" if paradigm.count(options.job) else "none"),
        "steps": paradigm.count(options.job),
        "batch": recipe.batch,
        "adam": asdict(getattr(recipe, paradigm.name)) if paradigm.name in ("overfit", "finetune", "quickft") else None,
        "start": start.digest,
        "data": label,
        "recipe": options.recipe,
        "seed": options.seed,
        "device": str(options.device),
        "versions": versions(),
    }
