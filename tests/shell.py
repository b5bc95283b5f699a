"""Bash in which `metapp` and `python` run as forks of a process that has imported torch, for tests of many commands.

`metapp` and `python` are small programs in a folder of PATH, which pass their arguments, folder, environment and
streams to this process. Bash treats pipes, patterns and variables as it does for a user.
"""

import contextlib
import json
import os
import runpy
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tests.forks import FORKS

SOCKET_VARIABLE = "METAPP_TESTS_SOCKET"
# without the modules that Python imports by default, the program starts in 20 ms
CLIENT_PROGRAM = f"""#!{sys.executable} -IS
import json, os, socket, sys
call = socket.socket(socket.AF_UNIX)
call.connect(os.environ["{SOCKET_VARIABLE}"])
socket.send_fds(call, [b"."], [0, 1, 2])
call.sendall(json.dumps([sys.argv, os.getcwd(), dict(os.environ)]).encode("utf-8", "surrogateescape"))
call.shutdown(socket.SHUT_WR)
sys.exit(int(call.recv(8)))
"""
SCRIPT_TIMEOUT_S = 600
COMMANDS_PROGRAM = """
import json, sys
from metapp.cli.command_tree import app
from metapp.cli.command_process import run_command
from metapp.evaluation.style import FIGURE_STYLE
FIGURE_STYLE["savefig.dpi"] = 40  # nobody looks at these figures
for line in sys.stdin:
    code = run_command(lambda: app(json.loads(line), standalone_mode=False, prog_name="metapp"))
    print(f"\\n== {code}", flush=True)
"""


def run_commands(
    *lines: Sequence[object], folder: Path, python: str | Path = sys.executable, **environment: str
) -> list[str]:
    """Run `metapp` commands in one new process and return what each prints; all must succeed.

    Args:
        lines: the arguments of each command.
        folder: the folder to run in.
        python: the interpreter.
        environment: variables beside those of the test.
    """
    process = subprocess.run(
        [python, "-c", COMMANDS_PROGRAM],
        input="\n".join(json.dumps(list(map(str, line))) for line in lines),
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "COLUMNS": "200", "OMP_NUM_THREADS": "1", **environment},
    )
    assert "Traceback" not in process.stderr
    *parts, _ = process.stdout.split("\n== ")
    codes = [part.partition("\n")[0] for part in process.stdout.split("\n== ")[1:]]
    assert codes == ["0"] * len(lines), process.stderr
    return [parts[0], *(part.partition("\n")[2] for part in parts[1:])]


@contextlib.contextmanager
def forked_commands(folder: Path) -> Iterator[Mapping[str, str]]:
    """Serve the programs `metapp` and `python`, and yield the environment variables by which bash finds them.

    Args:
        folder: a new folder for the two programs; seconds.txt in it lists all calls with their CPU seconds.
    """
    folder.mkdir()
    for name in ("metapp", "python"):
        (folder / name).write_text(CLIENT_PROGRAM, encoding="utf-8")
        (folder / name).chmod(0o755)
    socket_path = folder / "socket"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(socket_path))  # the path of a socket has at most 107 characters
        server.listen()
        threading.Thread(target=_accept, args=(server,), daemon=True).start()
        yield {SOCKET_VARIABLE: str(socket_path), "PATH": f"{folder}:{os.environ['PATH']}"}
        server.shutdown(socket.SHUT_RDWR)


def run_bash(script: str, folder: Path, environment: Mapping[str, str]) -> tuple[int, str]:
    """Run a script by bash up to its first error; return the exit code and all that it printed."""
    process = subprocess.run(
        ["bash", "-eu", "-o", "pipefail", "-c", script],
        cwd=folder,
        env={**os.environ, **environment},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=SCRIPT_TIMEOUT_S,
        check=False,
    )
    return process.returncode, process.stdout.decode(errors="replace")


def _accept(server: socket.socket) -> None:
    with contextlib.suppress(OSError):  # the socket is closed at the end
        while True:
            call, _ = server.accept()
            threading.Thread(target=_answer, args=(call,), daemon=True).start()


def _answer(call: socket.socket) -> None:
    process = FORKS.Process(target=_run_request, args=(call,))
    process.start()
    process.join()
    code = process.exitcode or 0
    with call, contextlib.suppress(BrokenPipeError):
        call.sendall(str(code if code >= 0 else 128 - code).encode())


def _run_request(call: socket.socket) -> None:
    """Run the command that a client asks for, with its streams, folder and environment, in this fork."""
    _, streams, *_ = socket.recv_fds(call, 1, 3)
    request = b"".join(iter(lambda: call.recv(1 << 16), b""))
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    words, folder, environment = json.loads(request)
    sys.stdin, sys.stdout, sys.stderr = map(os.fdopen, range(3), "rww")
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    try:
        _run_program(Path(words[0]).name, words[1:])
    finally:
        used = os.times()
        with (Path(words[0]).parent / "seconds.txt").open("a", encoding="utf-8") as file:
            file.write(f"{sum(used[:4]):.1f} {' '.join([Path(words[0]).name, *words[1:]])}\n")


def _run_program(name: str, words: list[str]) -> None:
    """Run `metapp`, or `python` with a file or `-m`, in this process."""
    if name == "metapp":
        from metapp.cli import main

        sys.argv = ["metapp", *words]
        main()
    elif words[0] == "-m":
        sys.argv, sys.path[0] = words[1:], ""
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv = words
        sys.path.insert(0, str(Path(words[0]).parent))
        runpy.run_path(words[0], run_name="__main__")
