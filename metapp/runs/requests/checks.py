"""Checks whether an application has what was asked for; if not, a usage error lists what it has."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import UnionType
from typing import get_args, get_type_hints

import torch

from data_tools.formats import exports_of
from metapp.apps import app_names, app_of, protocols_of
from metapp.learning.names import composition_names, rule_names
from metapp.learning.recipe import Recipe
from metapp.learning.rules import rule_of
from metapp.runs import BadOption
from metapp.runs.requests.request import Request
from metapp.storage.text import meant


def check_name(app: str) -> None:
    """A usage error that lists the applications where there is none of that name."""
    if app not in app_names():
        names = app_names()
        raise BadOption(f"'{app}' is not an application; expected one of {', '.join(names)}.{meant(app, names)}")


def check_types(options: Mapping[str, object]) -> None:
    """A usage error where general options that a program gives are of another type."""
    hints = get_type_hints(Request)
    for name, value in options.items():
        kinds = get_args(hints[name]) if isinstance(hints[name], UnionType) else (hints[name],)
        names = " or ".join(kind.__name__.replace("NoneType", "None") for kind in kinds)
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise BadOption(f"{name}: {value!r}, expected {names}.")


def check_numbers(request: Request) -> None:
    """A usage error where a number is negative or so large that nothing of that size can be held."""
    for name, most in {"steps": 10**9, "train_steps": 10**9, "seed": 2**63 - 1}.items():
        if not 0 <= (getattr(request, name) or 0) <= most:
            raise BadOption(f"{name}: {getattr(request, name)}, expected 0 to {most:,}.")


def check_protocol(protocol: str, app: str) -> None:
    """A usage error where the application of a name has no such protocol."""
    protocols = protocols_of(app)
    if protocol and protocol not in protocols:
        expected = f"expects one of {', '.join(protocols)}" if protocols else "has one protocol; leave it out"
        raise BadOption(f"--observe '{protocol}': {app} {expected}.{meant(protocol, protocols)}")


def check_rule(request: Request, recipe: Recipe) -> str:
    """The one name of a rule or composition, the recipe's default where none is asked for, or a usage error."""
    if not request.rule:
        return recipe.rule
    try:
        rule = rule_of(request.rule)
        app = app_of(request.app, recipe, request.observe, rule=rule.name)
        theta = {key: value[0] for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}
        rule.require(app, theta)
    except ValueError as error:
        words = [*rule_names(), *composition_names()]
        unknown = [word for word in request.rule.split("+") if word not in words]
        raise BadOption(f"--rule: {error}{meant(unknown[0], words) if unknown else ''}") from None
    return rule.name


def check_export(name: str, app: str) -> None:
    """Refuse a form that fits of an application cannot be written in.

    Raises:
        BadOption: it cannot, or a library for it is missing.
    """
    forms = exports_of(app)
    if name not in forms:
        expected = f"expects one of {', '.join(forms)}" if forms else "has none; leave it out"
        raise BadOption(f"--export '{name}': {app} {expected}.{meant(name, forms)}")
    if missing := forms[name].missing():
        raise BadOption(missing)


def check_new_files(paths: Iterable[Path]) -> None:
    """A usage error where a file that is to be written is there already: it may be what was measured."""
    for path in paths:
        if os.path.lexists(path):
            raise BadOption(f"{path}: is there already, expected a new file; choose another --out, or remove it.")
