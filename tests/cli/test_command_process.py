"""The process of a command: streams, interruption and exit codes."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from metapp.cli.command_process import run_command, state_what_interruption_keeps


def test_an_interruption_says_what_the_command_keeps(capsys: pytest.CaptureFixture[str]) -> None:
    def fit() -> None:
        state_what_interruption_keeps("fits that are done are kept")
        raise KeyboardInterrupt

    def compare() -> None:
        raise KeyboardInterrupt

    assert [run_command(fit), run_command(compare)] == [130, 130]
    assert capsys.readouterr().err == "interrupted; fits that are done are kept.\ninterrupted.\n"


def test_a_reader_that_goes_away_ends_a_command_quietly(capsys: pytest.CaptureFixture[str]) -> None:
    """An example is `metapp ... | head`."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as pipe, contextlib.redirect_stdout(pipe):
        assert run_command(lambda: print("a line")) == 141
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize("flush", [False, True])
def test_a_full_standard_output_is_named(flush: bool, capsys: pytest.CaptureFixture[str]) -> None:
    with open("/dev/full", "w") as full, contextlib.redirect_stdout(full):
        assert run_command(lambda: print("a line", flush=flush)) == 1
    assert capsys.readouterr().err == "error: standard output: No space left on device; print to another file.\n"


@pytest.mark.parametrize("streams", ["1>&-", "0<&- 1>&-", "0<&- 1>&- 2>&-", "2>&-"])
def test_closed_streams_are_one_line_and_no_file_gets_their_numbers(streams: str, tmp_path: Path) -> None:
    lines = "from metapp.cli.command_process import run_command\nimport sys\n"
    lines += "def command():\n    file = open('made', 'w')\n    print('printed')\n    print(file.fileno(), file=file)\n"
    lines += "    file.close()\nsys.exit(run_command(command))"
    process = subprocess.run(
        ["bash", "-c", f'"$0" -c "$1" {streams}', sys.executable, lines], capture_output=True, text=True, cwd=tmp_path
    )
    output = "error: standard output: closed, expected an open one; print to a file or to /dev/null, or add --quiet.\n"
    is_closed = "1>" in streams
    assert process.stderr == (output if is_closed and "2>" not in streams else "")
    assert (process.returncode, process.stdout) == ((1, "") if is_closed else (0, "printed\n"))
    assert int((tmp_path / "made").read_text()) > 2


def test_a_program_that_ends_itself_keeps_its_exit_code() -> None:
    """--show-completion ends so; only a broken pipe counts as output that nobody read."""
    with pytest.raises(SystemExit) as ended:
        run_command(lambda: sys.exit(0))
    assert ended.value.code == 0
