"""The options that extensions declare: of an application, its formats, merges and outputs.

A `Request` holds what was given of them by name; here they are checked, and each owner gets its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from data_tools.formats import inputs_of
from metapp import door
from metapp.apps import application_of
from metapp.learning.recipe import Recipe
from metapp.runs import BadOption
from metapp.runs.requests.request import Request
from metapp.storage.text import meant, path_of

Owner = door.Application | door.Format | door.Merge | door.Output


class Owned(NamedTuple):
    """An option and the record that declares it."""

    option: door.Option
    owner: Owner


def all_options() -> dict[str, door.Option]:
    """The options of all applications, by name, each as its first owner declares it."""
    names: dict[str, door.Option] = {}
    for application in door.offers(door.Application):
        for option, _ in options_of(application.name):
            names.setdefault(option.name, option)
    return names


def all_shown_options() -> dict[str, door.Option]:
    """The options that are fields of applications, by name."""
    applications = door.offers(door.Application)
    return {option.name: option for offer in applications for option in offer.options if not option.adapt}


def options_of(app: str) -> list[Owned]:
    """The options of an application with their owners."""
    application = application_of(app)
    owned = [Owned(option, form) for form in inputs_of(app) for option in form.options]
    owned += [Owned(merge.option, merge) for merge in door.offers_of(door.Merge, app)]
    owned += [Owned(option, application) for option in application.options]
    return owned + [Owned(output.option, output) for output in door.offers_of(door.Output, app)]


def check_options(request: Request, protocol: str) -> dict[str, object]:
    """The options that were given, without those at their default.

    Args:
        request: its options are values as the command line or a program gives them.
        protocol: that fits are under.

    Raises:
        BadOption: the application has no such option, or not of this value, or not together with others.
    """
    by_name: dict[str, list[Owned]] = {}
    for owned in options_of(request.app):
        by_name.setdefault(owned.option.name, []).append(owned)
    values = {}
    for name, value in request.options.items():
        option = by_name[name][0].option if name in by_name else all_options().get(name)
        if option is None:
            names = sorted({*by_name, *all_options()})
            raise BadOption(f"{name}: no option of a fit, expected one of {', '.join(names)}.{meant(name, names)}")
        value = _typed(option, value)
        if value in (None, option.default) or value == ():
            continue
        if name not in by_name:
            raise BadOption(f"{option.flag}: {request.app} has no such option, only {_apps_with(name)}; leave it out.")
        _check_use(option, request, protocol)
        for each, _ in by_name[name]:
            converted(each, value)
        values[name] = value
    return values


def converted(option: door.Option, value: object) -> object:
    """The value as the owner takes it.

    Raises:
        BadOption: it cannot be converted.
    """
    if option.convert is None:
        return value
    try:
        return option.convert(value)
    except ValueError as error:
        text = " ".join(map(str, value)) if isinstance(value, tuple) else value
        raise BadOption(f"{option.flag} '{text}': {error}.") from None


def adapted(recipe: Recipe, name: str, request: Request, options: Mapping[str, object]) -> Recipe:
    """A recipe as options of the application change it.

    Args:
        recipe: of the request's application.
        name: of the recipe.
        request: what was asked for.
        options: as of `check_options`.

    Raises:
        BadOption: the recipe has no such choice; training has none.
    """
    for option in application_of(request.app).options:
        if option.name not in options or not option.adapt:
            continue
        if request.train:
            raise BadOption(f"{option.flag}: of fits; checkpoints are trained without it, leave --train out.")
        try:
            recipe = door.load(option.adapt)(recipe, converted(option, options[option.name]))
        except ValueError as error:
            raise BadOption(f"{option.flag} {options[option.name]}, by recipe {name}: {error}.") from None
    return recipe


def without_adapted(app: str, options: Mapping[str, object]) -> dict[str, object]:
    """Options but those that change recipes."""
    adapting = {option.name for option in application_of(app).options if option.adapt}
    return {name: value for name, value in options.items() if name not in adapting}


def read_options(form: door.Format, options: Mapping[str, object]) -> dict[str, object]:
    """The values that a format's reader takes, by keyword."""
    given = [option for option in form.options if option.name in options]
    return {door.keyword_of(option): converted(option, options[option.name]) for option in given}


def shown_options(app: str, options: Mapping[str, object]) -> dict[str, Any]:
    """The values of the application's fields, by name."""
    own = [option for option in application_of(app).options if option.name in options and not option.adapt]
    return {door.keyword_of(option): converted(option, options[option.name]) for option in own}


def merge_of(app: str, options: Mapping[str, object]) -> tuple[door.Merge, object] | None:
    """The merge that makes one task of all inputs, and its value; None where inputs are apart."""
    for merge in door.offers_of(door.Merge, app):
        if merge.option.name in options:
            return merge, converted(merge.option, options[merge.option.name])
    return None


def outputs_of(app: str, options: Mapping[str, object]) -> list[tuple[door.Output, object]]:
    """The outputs of a run beside files of its fits, and their values."""
    own = [output for output in door.offers_of(door.Output, app) if output.option.name in options]
    return [(output, converted(output.option, options[output.option.name])) for output in own]


def recorded_options(app: str, options: Mapping[str, object]) -> dict[str, object]:
    """Options that errors of fits depend on, as records state them: of reading, merging and recipes."""
    names = {
        option.name
        for option, owner in options_of(app)
        if isinstance(owner, door.Format | door.Merge) or (isinstance(owner, door.Application) and option.adapt)
    }
    return {name: _as_recorded(value) for name, value in sorted(options.items()) if name in names}


def options_from_record(app: str, recorded: Mapping[str, object], *, inputs: bool) -> dict[str, object]:
    """Options as a record states them, for a `Request`, those about INPUT only with `inputs`.

    Those that the application does not have are left out.
    """
    kinds = {option.name: option for option, _ in options_of(app)}
    return {
        name: [path_of(str(path)) for path in value] if kinds[name].several and isinstance(value, list) else value
        for name, value in recorded.items()
        if name in kinds and (inputs or not kinds[name].of_inputs)
    }


def name_parts(app: str, options: Mapping[str, object]) -> list[str]:
    """The parts of a run folder's name that state options: detail512."""
    return [
        f"{option.name}{options[option.name]}"
        for option in application_of(app).options
        if option.adapt and option.name in options
    ]


def _as_recorded(value: object) -> object:
    return [str(path.absolute()) for path in value] if isinstance(value, tuple) else value


def _typed(option: door.Option, value: Any) -> object:
    """A value of the option's type; of paths a tuple.

    Raises:
        BadOption: it is of another type, or out of range.
    """
    if option.default is None:
        some = [value] if isinstance(value, str | Path) else value or ()
        if not option.several and len(some) > 1:
            raise BadOption(f"{option.name}: {len(some)} paths, expected one.")
        return tuple(Path(path) for path in some)
    kind = type(option.default)
    fits = isinstance(value, (int, float) if kind is float else kind) and isinstance(value, bool) == (kind is bool)
    if not fits:
        raise BadOption(f"{option.name}: {value!r}, expected {kind.__name__}.")
    if (option.low is not None and value < option.low) or (option.high is not None and value > option.high):
        least, most = (f"{end:g}" if end is not None else "" for end in (option.low, option.high))
        expected = f"{least} to {most}" if least and most else f"{least} or more" if least else f"{most} or less"
        raise BadOption(f"{option.name}: {value}, expected {expected}.")
    if option.choices and value not in option.choices:
        raise BadOption(f"{option.name}: {value!r}, expected one of {', '.join(option.choices)}.")
    return value


def _check_use(option: door.Option, request: Request, protocol: str) -> None:
    if option.protocol and option.protocol != protocol:
        raise BadOption(f"{option.flag}: only with --observe {option.protocol}; add that.")
    if option.of_inputs and not (request.inputs or request.objects):
        raise BadOption(f"{option.flag}: about INPUT alone; name what to fit.")


def _apps_with(name: str) -> str:
    apps = [offer.name for offer in door.offers(door.Application)]
    return ", ".join(app for app in sorted(apps) if any(option.name == name for option, _ in options_of(app)))
