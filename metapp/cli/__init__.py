"""The command line; torch, mitsuba and colour are imported inside commands, so that --help answers at once."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point of the `metapp` command."""
    from metapp.cli.console import run

    def command() -> object:
        from metapp.cli.commands import app  # here, as Ctrl-C is one line from now on

        return app(standalone_mode=False, prog_name="metapp")

    sys.exit(run(command))
