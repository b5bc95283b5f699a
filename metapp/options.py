"""Options as fields of dataclasses: the command line, the Python API and records have the same ones.

A field is annotated by an `Option`, which says all that a command line shows and all that is checked:

    @dataclass(frozen=True)
    class Sizes:
        detail: Annotated[int, Option("Side of the picture.", "PX", low=32, high=4096)] = 256

Nothing here imports torch or typer, so that options are checked before anything large is imported.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from metapp.names import application_of, did_you_mean
from metapp.registry import load_reference

PANELS = INPUT, FIT, OUTPUT = "Input", "Fit", "Output"  # of --help
Options = TypeVar("Options")


class BadOption(ValueError):
    """An option that does not exist, or has a value that it cannot have."""


@dataclass(frozen=True)
class Option:
    """An option: help and limits, and, of the field that it annotates, name, type and default.

    Attributes:
        help: one or two sentences.
        metavar: placeholder of the value.
        low, high: least and greatest value of a number.
        choices: values of a word; () for any.
        panel: of --help. Of an application's own options it also says their effect: INPUT on reading files, FIT on
            the recipe, OUTPUT on the files of a fit.
        protocol: the value of --observe that the option needs; "" for any.
        parse: value -> value of the field; ValueError states the expected form.
        short: the letter of a further name on the command line; "" for none.
        name, kinds, default: of the field; a value has one of the types `kinds`.
        flag: the name on the command line.
    """

    help: str = ""
    metavar: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    panel: str = INPUT
    protocol: str = ""
    parse: Callable[[Any], object] | None = None
    short: str = ""
    name: str = ""
    kinds: tuple[Any, ...] = ()
    default: object = None
    flag: str = ""

    def parse_value(self, given: object) -> object:
        """The field's value of a given one.

        Raises:
            BadOption: another type, or a value that the option cannot have.
        """
        kinds = self.kinds
        if given is None and NoneType in kinds:
            return None
        if Path in kinds and isinstance(given, str):
            given = Path(given)
        elif any(get_origin(kind) is tuple and get_args(kind)[0] is Path for kind in kinds):
            some = [given] if isinstance(given, str | Path) else given
            given = tuple(Path(path) for path in some)  # type: ignore[attr-defined]
        elif not (self.parse and get_origin(kinds[0]) is tuple) and not _is_one_of(given, kinds):
            names = " or ".join(getattr(kind, "__name__", str(kind)).replace("NoneType", "None") for kind in kinds)
            raise BadOption(f"{self.flag} {given!r}: expected {names}.")
        low, high = (given if end is None else end for end in (self.low, self.high))
        if isinstance(given, int | float) and not low <= given <= high:  # type: ignore[operator]
            least, most = (f"{end:,}" if end is not None else "" for end in (self.low, self.high))
            expected = f"{least} to {most}" if least and most else f"{least} or more" if least else f"{most} or less"
            raise BadOption(f"{self.flag} {given}: expected {expected}.")
        if self.choices and given not in self.choices:
            expected = ", ".join(self.choices)
            raise BadOption(
                f"{self.flag} '{given}': expected one of {expected}.{did_you_mean(str(given), self.choices)}"
            )
        try:
            return self.parse(given) if self.parse else given
        except (ValueError, TypeError, AttributeError) as error:
            text = " ".join(map(str, given)) if isinstance(given, tuple) else given
            raise BadOption(f"{self.flag} '{text}': {error}.") from None


def _is_one_of(value: object, kinds: tuple[Any, ...]) -> bool:
    plain = tuple(kind for kind in kinds if isinstance(kind, type))
    plain += (int,) * (float in plain)
    return isinstance(value, plain) and (bool in plain or not isinstance(value, bool))


def options_by_name(options: type) -> Mapping[str, Option]:
    """The options of a dataclass by name, in the order of its fields."""
    return _declared(options)


@functools.cache
def _declared(options: type) -> Mapping[str, Option]:
    hints, found = get_type_hints(options, include_extras=True), {}
    for field in fields(options):
        kind, *notes = get_args(hints[field.name]) if get_origin(hints[field.name]) is Annotated else (None,)
        if about := next((note for note in notes if isinstance(note, Option)), None):
            kinds, flag = get_args(kind) if isinstance(kind, UnionType) else (kind,), field.name.replace("_", "-")
            found[field.name] = replace(about, name=field.name, kinds=kinds, default=field.default, flag=f"--{flag}")
    return found


def parse_options(options: type[Options], values: Mapping[str, object], **checked: object) -> Options:
    """An instance of a dataclass of options.

    Args:
        options: the dataclass.
        values: by name of its options, as a command line or a program gives them; those of None are left out.
        checked: further fields, taken as they are.

    Raises:
        BadOption: a value that an option cannot have.
    """
    known = options_by_name(options)
    given = {name: known[name].parse_value(value) for name, value in values.items() if value is not None}
    return options(**given, **checked)


@dataclass(frozen=True)
class AppOptions:
    """The options of an application beside those of all; each application extends it by its own."""

    def non_default_values(self, *panels: str) -> dict[str, Any]:
        """The options of these panels (of all if none is named) that are not at their default."""
        return {
            name: getattr(self, name)
            for name, option in options_by_name(type(self)).items()
            if (not panels or option.panel in panels) and getattr(self, name) != option.default
        }

    def reader_keywords(self) -> dict[str, Any]:
        """Keywords of readers; a reader takes those that it has."""
        return self.non_default_values(INPUT)

    def adapt_recipe(self, recipe: Any) -> Any:
        """The recipe, a `metapp.learning.recipe.Recipe`, as these options change it.

        Raises:
            ValueError: the recipe has no such choice; the message states the expected one.
        """
        return recipe

    def recorded_values(self) -> dict[str, object]:
        """The options that errors of fits depend on, or that later exports follow, as JSON holds them."""
        return {name: _as_json(value) for name, value in sorted(self.non_default_values(INPUT, FIT).items())}


def app_options_class(app: str) -> type[AppOptions]:
    """The dataclass of an application's own options."""
    result: type[AppOptions] = load_reference(application_of(app).options)
    return result


def _as_json(value: object) -> object:
    if isinstance(value, tuple):
        return [_as_json(each) for each in value]
    return str(value.absolute()) if isinstance(value, Path) else value


def split_option(auto: str) -> Option:
    """The option --split of commands that write data sets; `auto` says how names and files tell the split of a task."""
    splits = ("train", "test", "auto")
    return Option(f"Where the tasks belong. auto: {auto}", "|".join(splits), choices=splits)


@dataclass(frozen=True)
class Converter:
    """The command `metapp data NAME` that converts files of the format NAME: its options are fields, its help the text.

    A subclass whose files or names tell more of the split has `split` anew.
    """

    split: Annotated[str, split_option("of the sorted names, every fifth is a test task (80 give 64 + 16).")] = "auto"

    def arguments(self) -> dict[str, object]:
        """The options as keywords of the format's `read_task`."""
        return {name: value for name, value in vars(self).items() if name != "split"}
