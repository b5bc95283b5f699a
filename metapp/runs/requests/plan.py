"""From a request to a plan: the application, its recipe, rule and steps, the paradigm, the device, the run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import torch

from metapp.apps import app_of, protocols_of, recipes_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.paradigms import Job, Paradigm, paradigms
from metapp.runs import BadOption
from metapp.runs.requests.checks import check_export, check_name, check_numbers, check_protocol, check_rule
from metapp.runs.requests.choosing import chosen_recipe
from metapp.runs.requests.naming import observe_of
from metapp.runs.requests.options import (
    adapted,
    check_options,
    merge_of,
    name_parts,
    recorded_options,
    shown_options,
    without_adapted,
)
from metapp.runs.requests.request import Request
from metapp.runs.surroundings import find_device, precision_of, versions
from metapp.storage import Document
from metapp.storage.text import meant


class Checkpoint(NamedTuple):
    """A checkpoint, where it came from and a digest of its file ("" where nothing is needed)."""

    prepared: MetaParameters
    source: str
    digest: str


@dataclass(frozen=True)
class Plan:
    """A request with all that it names looked up.

    Attributes:
        request: as it was made, with recipe and rule by their names; steps None where they are the recipe's.
        paradigm: what fits.
        job: application, recipe, rule and steps that it works on.
        device: what it works with.
        options: what was given of the options that extensions declare, but for what is their default.
        checkpoint: what fits begin at; None until `checkpoints.find_checkpoint` has found it.
    """

    request: Request
    paradigm: Paradigm
    job: Job
    device: torch.device
    options: Mapping[str, object] = field(default_factory=dict)
    checkpoint: Checkpoint | None = None

    @property
    def app(self) -> App:
        """The application under its protocol, with the network of the recipe and of the rule."""
        return self.job.app

    @property
    def steps(self) -> int:
        """Gradient steps of a fit."""
        return self.paradigm.count(self.job)

    @property
    def prepared(self) -> MetaParameters:
        """The parameters of the checkpoint, which must have been found."""
        assert self.checkpoint is not None
        return self.checkpoint.prepared

    def by(self, paradigm: str, rule: str = "") -> Plan:
        """The same for another paradigm and rule ("" for the same one), of the recipe's steps, without a checkpoint."""
        rule = rule or self.job.rule
        request = replace(self.request, paradigm=paradigm, rule=rule, steps=None)
        app = app_of(self.app.name, self.job.recipe, self.app.protocol, rule=rule if paradigm == "meta" else "")
        job = Job(replace(app, size=self.app.size), self.job.recipe, rule, None)
        return replace(self, request=request, paradigm=paradigms()[paradigm], job=job, checkpoint=None)

    def settings(self, label: str) -> Document:
        """Everything that figures of a run on data of this name depend on: what its records carry, and their key."""
        job, recipe, app = self.job, self.job.recipe, self.app
        options = recorded_options(app.name, self.options)
        adam, guard = self.paradigm.adam(job, self.prepared), self.paradigm.guard(job)
        assert self.checkpoint is not None
        return {
            "app": app.name,
            **observe_of(app),
            "paradigm": self.paradigm.name,
            "rule": job.rule if self.paradigm.name == "meta" else ("adam" if adam else "none"),
            "steps": self.steps,
            "batch": recipe.batch,
            "adam": adam and asdict(adam),
            **({"guard": asdict(guard)} if guard else {}),
            "checkpoint": self.checkpoint.digest,
            "data": label,
            "recipe": self.request.recipe,
            **({"options": options} if options else {}),
            "seed": self.request.seed,
            "device": str(self.device),
            "versions": versions(),
            **app.conditions(),
            **precision_of(app, self.device, self.steps),
        }

    def path(self, label: str) -> Path:
        """runs/<app>/<paradigm>/<data>-<recipe>-seed<seed>, with rule, protocol, and what is not the recipe's."""
        request = self.request
        name = f"{label}-{request.recipe}-seed{request.seed}"
        if self.paradigm.name == "meta":
            name += f"-{self.job.rule}"
        name += "".join(f"-{part}" for part in name_parts(self.app.name, self.options))
        if request.steps is not None:
            name += f"-{request.steps}steps"
        if self.app.protocol:
            name += f"-{self.app.protocol}"
        return request.out / self.app.name / self.paradigm.name / name

    def origin(self) -> Document:
        """Where inputs and data set are, by which they are found again: absolute paths, as far as given."""
        request = self.request
        places: Document = {
            "inputs": [str(path.absolute()) for path in request.inputs],
            "data": request.data and str(request.data.absolute()),
        }
        return {key: value for key, value in places.items() if value}


def plan(request: Request) -> Plan:
    """Check what was asked for and look up what it names; no task is read and nothing is written.

    Raises:
        BadOption: something that the application does not have, or options or inputs that exclude each other.
        ValueError: no such device, paradigm or data set.
    """
    by_name = paradigms()
    if request.paradigm not in by_name:
        raise ValueError(
            f"paradigm '{request.paradigm}': expected one of {', '.join(by_name)}.{meant(request.paradigm, by_name)}"
        )
    paradigm = by_name[request.paradigm]
    check_name(request.app)
    check_numbers(request)
    check_protocol(request.observe, request.app)
    recipes = recipes_of(request.app, request.observe)
    options = check_options(request, request.observe or next(iter(protocols_of(request.app)), ""))
    name = request.recipe or chosen_recipe(request)
    if name not in recipes:
        raise BadOption(f"--recipe '{name}': expected one of {', '.join(recipes)}.{meant(name, recipes)}")
    recipe = adapted(recipes[name], name, request, options)
    if recipe == recipes[name]:  # by options that say what it does anyway
        options = without_adapted(request.app, options)
    rule = check_rule(request, recipe)
    app = app_of(request.app, recipe, request.observe, rule=rule if paradigm.name == "meta" else "")
    device = find_device(request.device, app)
    steps = None if paradigm.steps(recipe) in (request.steps, 0) else request.steps
    request = replace(request, recipe=name, rule=rule, steps=steps)
    _check(request, options)
    try:
        app = replace(app, **shown_options(request.app, options))
    except ValueError as error:
        raise BadOption(str(error)) from None
    return Plan(request, paradigm, Job(app, recipe, rule, steps), device, options)


def _check(request: Request, options: Mapping[str, object]) -> None:
    """Refuse options that exclude each other, and forms that the application is not written in.

    Raises:
        BadOption: there is such a one.
    """
    if request.train_steps and not request.train:
        raise BadOption("--train-steps: only with --train.")
    for form in request.exports:
        check_export(form, request.app)
    if (merging := merge_of(request.app, options)) and request.resumes:
        raise BadOption(f"{merging[0].option.flag} makes one input of all; leave out --batch.")
