"""The command line; torch, mitsuba and colour are imported inside commands, so that --help answers at once."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point of the `metapp` command."""
    from metapp.cli.commands import app
    from metapp.cli.console import run

    sys.exit(run(lambda: app(standalone_mode=False, prog_name="metapp")))
