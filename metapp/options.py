"""Options as fields of dataclasses, which the command line, the Python API and records have in common.

A field is annotated by an :class:`Option`, which says all that a command line shows and all that is checked:

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

from metapp.entries import did_you_mean

PANELS = INPUT, FIT, OUTPUT = "Input", "Fit", "Output"  # sections of --help
Options = TypeVar("Options")


class BadOption(ValueError):
    """An error of an option that does not exist, or of a value that an option cannot have."""


@dataclass(frozen=True)
class Option:
    """An option: its help and limits, and the name, types and default of the field that it annotates.

    Attributes:
        help: one or two sentences.
        metavar: the placeholder of the value in help.
        low, high: the least and the greatest value of a number; None for no limit.
        choices: the words that a value may be; () for any.
        panel: the section of --help. For an application's own options it also says what they influence: INPUT the
            reading of files, FIT the recipe, OUTPUT the files of a fit.
        observes: the value of --observe that the option needs; "" for any.
        parse: a function from a given value to the field's value; its ValueError states the expected form. None if the
            given value is the field's value.
        short: the letter of a short name on the command line; "" for none.
        name: the name of the field.
        kinds: the types that the field's value may have.
        default: the default of the field.
        flag: the name on the command line, with two hyphens.
    """

    help: str = ""
    metavar: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    panel: str = INPUT
    observes: str = ""
    parse: Callable[[Any], object] | None = None
    short: str = ""
    name: str = ""
    kinds: tuple[Any, ...] = ()
    default: object = None
    flag: str = ""

    def parse_value(self, given: object) -> object:
        """Check a given value, and convert it to the field's value.

        Raises:
            BadOption: the value has another type, or the option cannot have it.
        """
        kinds = self.kinds
        if given is None and NoneType in kinds:
            return None
        if Path in kinds and isinstance(given, str):
            given = Path(given)
        elif any(get_origin(kind) is tuple and get_args(kind)[0] is Path for kind in kinds):
            paths = [given] if isinstance(given, str | Path) else given
            given = tuple(Path(path) for path in paths)  # type: ignore[attr-defined]
        elif not (self.parse and get_origin(kinds[0]) is tuple) and not _has_type(given, kinds):
            names = " or ".join(getattr(kind, "__name__", str(kind)).replace("NoneType", "None") for kind in kinds)
            raise BadOption(f"{self.flag} {given!r}: expected {names}.")
        low, high = (given if limit is None else limit for limit in (self.low, self.high))
        if isinstance(given, int | float) and not low <= given <= high:  # type: ignore[operator]
            least, most = (f"{limit:,}" if limit is not None else "" for limit in (self.low, self.high))
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
            text = " ".join(map(str, given)) if isinstance(given, tuple | list) else given
            raise BadOption(f"{self.flag} '{text}': {error}.") from None


def _has_type(value: object, kinds: tuple[Any, ...]) -> bool:
    """Return whether a value has one of the types; an integer is also a float, and a bool is no number."""
    types = tuple(kind for kind in kinds if isinstance(kind, type))
    types += (int,) * (float in types)
    return isinstance(value, types) and (bool in types or not isinstance(value, bool))


def options_by_name(options: type) -> Mapping[str, Option]:
    """Return the options of a dataclass by name, in the order of its fields."""
    return _collect_options(options)


@functools.cache
def _collect_options(options: type) -> Mapping[str, Option]:
    """Collect the options of a dataclass from the annotations of its fields."""
    hints, options_found = get_type_hints(options, include_extras=True), {}
    for field in fields(options):
        kind, *notes = get_args(hints[field.name]) if get_origin(hints[field.name]) is Annotated else (None,)
        if option := next((note for note in notes if isinstance(note, Option)), None):
            kinds, flag = get_args(kind) if isinstance(kind, UnionType) else (kind,), field.name.replace("_", "-")
            options_found[field.name] = replace(
                option, name=field.name, kinds=kinds, default=field.default, flag=f"--{flag}"
            )
    return options_found


def parse_options(options: type[Options], values: Mapping[str, object], /, **checked: object) -> Options:
    """Make an instance of a dataclass of options from given values.

    Args:
        options: the dataclass.
        values: values by the names of options, from a command line or a program; options whose value is None have their
            default.
        checked: values of further fields, which are not checked.

    Raises:
        BadOption: an option cannot have its value.
    """
    known = options_by_name(options)
    parsed = {name: known[name].parse_value(value) for name, value in values.items() if value is not None}
    return options(**parsed, **checked)


@dataclass(frozen=True)
class AppOptions:
    """The options that an application has in addition to the options of all fits.

    An application's subclass is a frozen dataclass, each field of which is annotated by an :class:`Option`. The
    option's panel says what the option influences: INPUT the reading of inputs, FIT the recipe, by
    :meth:`adapt_recipe`, and OUTPUT the files of a fit, by :meth:`adapt_asset`. An option `size` about OUTPUT is the
    height and width of files.
    """

    def non_default_values(self, *panels: str) -> dict[str, Any]:
        """Return the values that differ from their default, by name, of options in these panels or in all panels."""
        return {
            name: getattr(self, name)
            for name, option in options_by_name(type(self)).items()
            if (not panels or option.panel in panels) and getattr(self, name) != option.default
        }

    def reader_keywords(self) -> dict[str, Any]:
        """Return keyword arguments for readers, each of which is given those that its function has."""
        return self.non_default_values(INPUT)

    def adapt_asset(self, asset: Any) -> Any:
        """Change an asset as the options about OUTPUT ask, such as its relief; its size is not changed here.

        Args:
            asset: a `metapp.appearance.assets.Asset`.
        """
        return asset

    def adapt_recipe(self, recipe: Any) -> Any:
        """Change a recipe as the options ask.

        Args:
            recipe: a `metapp.learning.recipe.Recipe`.

        Raises:
            ValueError: the recipe does not have this choice; the message states what is expected.
        """
        return recipe


def to_json_options(values: Mapping[str, object]) -> dict[str, Any]:
    """Return values of options, by name, as JSON holds them: tuples as lists, and paths as absolute text."""
    return {name: _to_json(value) for name, value in sorted(values.items())}


def _to_json(value: object) -> object:
    """Return a value as JSON holds it: tuples as lists, and paths as absolute text."""
    if isinstance(value, tuple):
        return [_to_json(item) for item in value]
    return str(value.absolute()) if isinstance(value, Path) else value


def split_option(auto: str) -> Option:
    """Return the option --split of commands that write data sets.

    Args:
        auto: how names or files tell the split of a task, for the help on the value "auto".
    """
    splits = ("train", "test", "auto")
    return Option(f"The split that tasks are put in. auto: {auto}", "|".join(splits), choices=splits)


@dataclass(frozen=True)
class Converter:
    """The command `metapp data NAME`, which converts files of the format NAME to a data set.

    A subclass declares the command. Its fields are the options, which the format's `read_task` gets as keyword
    arguments, and its docstring is the help. If names or files tell more about the split than their order, it declares
    `split` again, by :func:`split_option`.
    """

    split: Annotated[str, split_option("every fifth of the sorted names is a test task (80 give 64 + 16).")] = "auto"

    def arguments(self) -> dict[str, object]:
        """Return the options as keyword arguments of the format's `read_task`."""
        return {name: value for name, value in vars(self).items() if name != "split"}
