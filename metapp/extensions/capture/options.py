"""An option that commands for mirror balls and marker sheets have alike."""

from __future__ import annotations

import typer

from metapp.networks import options


def field_of_view(unsaid: str) -> object:
    """The option for a camera's field of view in degrees; its help ends with what 0 means."""
    words = f"Field of view along the photos' shorter side; 0: {unsaid}."
    return typer.Option(min=0, max=150, metavar="DEGREES", help=words, callback=_checked_view)


def _checked_view(degrees: float) -> float:
    try:
        options.field_of_view(degrees)
    except ValueError as error:
        raise typer.BadParameter(f"{degrees:g} degrees, {error}.") from None
    return degrees
