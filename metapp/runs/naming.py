"""Names of an application under its protocol, in records, messages, tables and pictures."""

from __future__ import annotations

from metapp.learning.app import App
from metapp.registry import protocols_of


def is_first_protocol(app: App) -> bool:
    """True if the application is under its first protocol, or has no other."""
    return app.protocol in ("", *protocols_of(app.name)[:1])


def observe_of(app: App) -> dict[str, str]:
    """The protocol as records, rows and headers of checkpoints say it: nothing if there is none."""
    return {"observe": app.protocol} if app.protocol else {}


def name_of(app: App) -> str:
    """The application's name and its protocol, if any: illumination photo."""
    return f"{app.name} {app.protocol}".rstrip()


def title_of(app: App) -> str:
    """The application's title in tables and pictures, with its protocol, if any."""
    return f"{app.title} ({app.protocol})" if app.protocol else app.title


def caption_of(app: App, measured: bool = True) -> str:
    """The caption of a table about its errors, or that there are none, as of photos without a reference."""
    protocol = {"fits see": app.protocol} if app.protocol else {}
    conditions = "".join(f"; {key}: {value}" for key, value in (protocol | app.conditions()).items())
    error = f"error: {app.measure}{factor_of(app)}" if measured else "no error: there is no reference"
    return error + conditions


def factor_of(app: App) -> str:
    """The factor that errors are printed with: " x100"; "" if it is 1."""
    return f" x{app.scale:g}" if app.scale != 1 else ""
