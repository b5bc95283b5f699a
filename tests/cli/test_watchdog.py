"""Signals end a command within a second, also while native code keeps Python from seeing them."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")

ROOT = Path(__file__).parents[2]
LINES = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # commands in the background of a shell begin without it
from metapp.cli.command_process import run_command
from metapp.cli.watchdog import start_watchdog
def command():
    start_watchdog()
    print("begun", flush=True)
    {}
    print("done", flush=True)
sys.exit(run_command(command))
"""
# sum() sees no signal and lets no thread run until it ends, as Mitsuba while it compiles
NATIVE, PYTHON = "sum(range(2 * 10**9))", "time.sleep(30)"
SHORT = "time.sleep(0.01)"


def start(body: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", LINES.format(body)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip
    assert process.stdout
    assert process.stdout.readline() == "begun\n"
    return process


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(("body", "code"), [(NATIVE, -signal.SIGKILL), (PYTHON, 130)])
@pytest.mark.parametrize("whole_group", [False, True])
def test_a_signal_ends_a_command(number: signal.Signals, body: str, code: int, whole_group: bool) -> None:
    process = start(body)
    time.sleep(0.5)  # the line before it is printed already: native code has begun by now
    (os.killpg if whole_group else os.kill)(process.pid, number)
    _, errors = process.communicate(timeout=10)  # ends when the watchdog has ended, too
    assert process.returncode == code
    assert len(errors.splitlines()) == 1
    assert errors.startswith("interrupted")


@pytest.mark.parametrize(("body", "end"), [(SHORT, None), (PYTHON, signal.SIGKILL), (NATIVE, signal.SIGKILL)])
def test_the_watchdog_ends_with_the_command(body: str, end: signal.Signals | None) -> None:
    process = start(body)
    if end:
        process.send_signal(end)
    process.communicate(timeout=10)
    assert process.returncode == (-end if end else 0)
    for _ in range(500):
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.01)
    raise AssertionError("a process of the command is left")
