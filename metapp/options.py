"""Options as fields of dataclasses: the command line, the Python API and records have the same ones.

A field is annotated by an `Option`, which says all that a command line shows and all that is checked:

    @dataclass(frozen=True)
    class Sizes:
        detail: Annotated[int, Option("Side of the picture.", "PX", low=32, high=4096)] = 256

Nothing here imports torch or typer, so that options are checked before anything large is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from metapp.registry import did_you_mean

PANELS = INPUT, FIT, OUTPUT = "Input", "Fit", "Output"  # of --help
Options = TypeVar("Options")


class BadOption(ValueError):
    """An option that does not exist, or has a value that it cannot have."""


@dataclass(frozen=True)
class Option:
    """Help and limits of an option.

    Attributes:
        help: one or two sentences.
        metavar: placeholder of the value.
        low, high: least and greatest value of a number.
        choices: values of a word; () for any.
        panel: of --help. Of an application's own options it also says what they change: INPUT how files are read, FIT
            the recipe, OUTPUT what is written of a fit.
        protocol: the value of --observe that the option needs; "" for any.
        parse: value -> value of the field; ValueError states the expected form.
        flags: names on the command line; () for the field's name with - for _.
        argument: whether the command line takes it by its place.
    """

    help: str = ""
    metavar: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    panel: str = INPUT
    protocol: str = ""
    parse: Callable[[Any], object] | None = None
    flags: tuple[str, ...] = ()
    argument: bool = False


class Declared(NamedTuple):
    """An option of a dataclass: its name, type, default and `Option`."""

    name: str
    kind: Any
    default: object
    option: Option

    @property
    def flag(self) -> str:
        """Name on the command line."""
        return f"--{self.name.replace('_', '-')}"

    def value(self, given: object) -> object:
        """The field's value of a given one.

        Raises:
            BadOption: another type, or a value that the option cannot have.
        """
        kinds = get_args(self.kind) if isinstance(self.kind, UnionType) else (self.kind,)
        if given is None and NoneType in kinds:
            return None
        if (path_of := self._paths(given, kinds)) is not None:
            given = path_of
        elif not (self.option.parse and get_origin(kinds[0]) is tuple) and not _is_one_of(given, kinds):
            names = " or ".join(getattr(kind, "__name__", str(kind)).replace("NoneType", "None") for kind in kinds)
            raise BadOption(f"{self.flag} {given!r}: expected {names}.")
        option = self.option
        low, high = (given if end is None else end for end in (option.low, option.high))
        if isinstance(given, int | float) and not low <= given <= high:  # type: ignore[operator]
            least, most = (f"{end:,}" if end is not None else "" for end in (option.low, option.high))
            expected = f"{least} to {most}" if least and most else f"{least} or more" if least else f"{most} or less"
            raise BadOption(f"{self.flag} {given}: expected {expected}.")
        if option.choices and given not in option.choices:
            expected = f"{', '.join(option.choices)}.{did_you_mean(str(given), option.choices)}"
            raise BadOption(f"{self.flag} '{given}': expected one of {expected}")
        try:
            return option.parse(given) if option.parse else given
        except (ValueError, TypeError, AttributeError) as error:
            raise BadOption(f"{self.flag} '{_text(given)}': {error}.") from None

    def _paths(self, given: object, kinds: tuple[Any, ...]) -> object:
        """Paths of text, where the option takes them; None where it does not."""
        if Path in kinds and isinstance(given, str | Path):
            return Path(given)
        if any(get_origin(kind) is tuple and get_args(kind)[0] is Path for kind in kinds):
            some = [given] if isinstance(given, str | Path) else given
            return tuple(Path(path) for path in some)  # type: ignore[attr-defined]
        return None


def _is_one_of(value: object, kinds: tuple[Any, ...]) -> bool:
    plain = tuple(kind for kind in kinds if isinstance(kind, type))
    plain += (int,) * (float in plain)
    return isinstance(value, plain) and (bool in plain or not isinstance(value, bool))


def _text(value: object) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def declared(options: type) -> tuple[Declared, ...]:
    """The options of a dataclass, in the order of its fields."""
    hints = get_type_hints(options, include_extras=True)
    found = []
    for field in fields(options):
        kind = hints[field.name]
        if get_origin(kind) is Annotated:
            about = next((note for note in kind.__metadata__ if isinstance(note, Option)), None)
            found += [Declared(field.name, get_args(kind)[0], _default(field), about)] if about else []
    return tuple(found)


def _default(field: Field[Any]) -> object:
    return field.default if field.default_factory is MISSING else field.default_factory()


def parse(options: type[Options], values: Mapping[str, object], **checked: object) -> Options:
    """An instance of a dataclass of options.

    Args:
        options: the dataclass.
        values: by name, as a command line or a program gives them; those of None are left out.
        checked: further fields, taken as they are.

    Raises:
        BadOption: an option that the class does not have, or a value that it cannot have.
    """
    by_name = {one.name: one for one in declared(options)}
    for name in values:
        if name not in by_name:
            names = ", ".join(sorted(by_name))
            raise BadOption(f"{name}: not an option, expected one of {names}.{did_you_mean(name, by_name)}")
    given = {name: by_name[name].value(value) for name, value in values.items() if value is not None}
    return options(**given, **checked)


@dataclass(frozen=True)
class AppOptions:
    """The options of an application beside those of all; each application extends it by its own."""

    def given(self, *panels: str) -> dict[str, Any]:
        """The options of these panels, of all where none is named, that are not at their default."""
        return {
            one.name: getattr(self, one.name)
            for one in declared(type(self))
            if (not panels or one.option.panel in panels) and getattr(self, one.name) != one.default
        }

    def defaults(self, *panels: str) -> dict[str, Any]:
        """The defaults of the options of these panels."""
        return {one.name: one.default for one in declared(type(self)) if one.option.panel in panels}

    def reading(self) -> dict[str, Any]:
        """Keywords of readers; a reader takes those that its format names."""
        return self.given(INPUT)

    def adapt(self, recipe: Any) -> Any:
        """The recipe, a `metapp.learning.recipe.Recipe`, as these options change it.

        Raises:
            ValueError: the recipe has no such choice; the message states the expected one.
        """
        return recipe

    def recorded(self) -> dict[str, object]:
        """The options that errors of fits depend on, as JSON holds them."""
        return {name: _as_json(value) for name, value in sorted(self.given(INPUT, FIT).items())}


def _as_json(value: object) -> object:
    if isinstance(value, tuple):
        return [_as_json(each) for each in value]
    return str(value.absolute()) if isinstance(value, Path) else value
