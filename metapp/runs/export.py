"""Write fits in another format."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Generator

from data_tools.formats import Export, exports_of
from metapp.appearance.presentation import Presentation
from metapp.learning.app import App, Distilled, stack
from metapp.learning.task import Params, Task
from metapp.paradigms import paradigms
from metapp.runs import BadOption
from metapp.runs.checkpoints import find_checkpoint
from metapp.runs.reporter import number, say
from metapp.runs.session import options_of


def check_export(name: str, app: str) -> None:
    """Refuse a form that fits of an application cannot be written in.

    Raises:
        BadOption: it cannot, or a library for it is missing.
    """
    known = exports_of(app)
    if name and name not in known:
        expected = f"expects one of {', '.join(known)}" if known else "has none; leave it out"
        raise BadOption(f"--export '{name}': {app} {expected}.")
    form = known.get(name)
    if isinstance(form, Export) and form.missing():
        raise BadOption(form.missing())


def export_fit(
    shown: Presentation[Any], task: Task, theta: Params, path: Path, name: str, settings: Mapping[str, Any]
) -> None:
    """Write one fit in a form; where that holds another network, the fit is distilled into it first.

    Args:
        shown: the presentation of the fit's application, at the size of surfaces.
        task: what was fitted.
        theta: parameters, without a task axis.
        path: where to, without suffix; its last part names an asset.
        name: of the form.
        settings: what the fit was made by, as records have it: an asset's provenance.
    """
    app = shown.app
    form = exports_of(app.name)[name]
    if isinstance(form, Export):
        surface = shown.surface(theta, task)
        assert surface is not None, f"{app.name} has no surface"
        form.write(surface, path, {"task": task.name, **settings})
        return
    if form.holds and set(theta) != set(form.holds):
        theta = distilled(app, task, theta)
    form.writer().export(app, theta, path)


def distilled(app: App, task: Task, theta: Params) -> Params:
    """The application's usual network, fitted by Finetune to what another one evaluates to.

    It sees as many values of the fit as the task has samples, and none of the task's own; what it lost is said.

    Args:
        app: with the network that the fit is of.
        task: what was fitted.
        theta: parameters of one task, without a task axis.
    """
    options, finetune = options_of(app.name, quiet=True), paradigms()["finetune"]
    usual, rng = options.app, Generator().manual_seed(options.seed)
    assert isinstance(app, Distilled), f"{app.name} has one network"
    taught = stack(usual, [app.evaluated(theta, task)])
    found = finetune.fit(options.job, find_checkpoint(options, finetune).prepared, taught, rng)
    fits = (app, {key: value[None] for key, value in theta.items()}), (usual, found)
    errors = [app.traits.scale * float(of.errors(each, stack(of, [task]))["error"][0]) for of, each in fits]
    before, after = (number(error, ".3f") for error in errors)
    say(f"{task.name}: distilled into the network of the format; error {after}, of the fit {before}")
    return {key: value[0] for key, value in found.items()}
