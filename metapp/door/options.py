"""The options that extensions declare."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Option(NamedTuple):
    """An option of what has it: an application, a format, an output, a conversion.

    Attributes:
        name: on the command line, with _ for -.
        default: a number, a word or False for a flag, whose type is the option's; None for a path.
        help: one or two sentences.
        metavar: what stands for the value.
        low, high: least and greatest value of a number.
        choices: the values of a word; () for any.
        several: whether it may be given several times.
        panel: of --help.
        convert: what was given -> what the owner takes; ValueError states what is expected.
        adapt: of an application, `adapt(recipe, value) -> recipe`, ValueError where the recipe has no such choice; ""
            for an option that is a field of its class. What adapts is in the name of a run's folder, and
            checkpoints are never trained with it.
        passed_as: the keyword that the owner takes it by; "" for the option's name.
        protocol: the value of --observe that it needs; "" for any.
        of_inputs: whether it is about INPUT alone.
    """

    name: str
    default: int | float | str | bool | None
    help: str
    metavar: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    several: bool = False
    panel: str = "Input"
    convert: Callable[..., object] | None = None
    adapt: str = ""
    passed_as: str = ""
    protocol: str = ""
    of_inputs: bool = False

    @property
    def flag(self) -> str:
        """Its name on the command line."""
        return "--" + self.name.replace("_", "-")


def keyword_of(option: Option) -> str:
    """The keyword that an option's owner takes it by."""
    return option.passed_as or option.name
