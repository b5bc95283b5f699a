"""The command line; torch, mitsuba and colour are imported inside commands, so that --help answers at once."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Entry point of the `metapp` command."""
    if "_METAPP_COMPLETE" in os.environ:  # a shell waits for words that complete a line
        from metapp.cli.command_tree import app

        app(prog_name="metapp")
    from metapp.cli.console import run_command

    def command() -> object:
        from metapp.cli.command_tree import app  # here, as Ctrl-C is one line from now on

        return app(standalone_mode=False, prog_name="metapp")

    sys.exit(run_command(command))
