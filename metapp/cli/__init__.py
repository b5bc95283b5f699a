"""The command line: arguments, help, messages, and what commands print.

Read in this order: `command_tree` (the commands and their order), `console` (output), `progress` with `live_bar`
(messages and progress), `command_process` (errors, signals and exit codes) with `watchdog` (signals that Python cannot
see), `arguments` (dataclasses of options become options of commands), `help` with `help_page` (what --help prints).
Then read the commands: `fit_commands` with `fit_output` (fits), `evaluate` with `evaluation_options` and
`evaluation_output` (tables), `export`, `data` (conversion of files), and `synth` with `synthesis_options` and
`synthesis` (synthetic data). torch, Mitsuba and colour-science are imported inside commands, so that --help answers at
once.
"""

from __future__ import annotations

import os
import sys

# torch's threads sleep soon after they begin to wait for each other. By OpenMP's default they spin, and take from other
# programs, and from the thread that they wait for, three times the CPU time of a fit. Sleeping at once costs 15 % of
# the time on an idle machine; GNU's OpenMP, which counts turns, lets threads spin for some microseconds first.
WAITING_VARIABLES = {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "1000"}


def main() -> None:
    """Run the command `metapp` and end the process with its exit code."""
    if not WAITING_VARIABLES.keys() & os.environ.keys():
        os.environ.update(WAITING_VARIABLES)  # here: OpenMP reads them once, when torch is imported
    if "_METAPP_COMPLETE" in os.environ:  # a shell asks for words that complete a line
        from metapp.cli.command_tree import app

        app(prog_name="metapp")
    from metapp.cli.command_process import Exit, run_command
    from metapp.cli.watchdog import start_watchdog

    def command() -> object:
        start_watchdog()
        from metapp.cli.command_tree import app  # here: run_command makes Ctrl-C during imports one line, too

        return app(standalone_mode=False, prog_name="metapp")

    code = run_command(command)
    if code == Exit.INTERRUPTED:  # at once: to take torch down takes longer on a busy machine than the watchdog waits
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)
