"""The command line: arguments, help, messages, and what commands print.

Read in this order: `command_tree` (the commands and their order), `console` (output, errors and exit codes),
`arguments` (dataclasses of options become options of commands), then a module for each command. torch, Mitsuba and
colour-science are imported inside commands, so that --help answers at once.
"""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command `metapp` and end the process with its exit code."""
    if "_METAPP_COMPLETE" in os.environ:  # a shell asks for words that complete a line
        from metapp.cli.command_tree import app

        app(prog_name="metapp")
    from metapp.cli.console import run_command

    def command() -> object:
        from metapp.cli.command_tree import app  # here: run_command makes Ctrl-C during imports one line, too

        return app(standalone_mode=False, prog_name="metapp")

    sys.exit(run_command(command))
