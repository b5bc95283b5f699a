"""Bash whose `metapp` and `python` are forks of a process that has imported torch: for tests of many commands.

They are small programs in a folder of PATH, which pass their arguments, folder, environment and streams to this
process. Whatever bash makes of a line, such as pipes, patterns and variables, is as it is for a user.
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

PLACE = "METAPP_TESTS_SOCKET"
# without what Python imports at the start, it takes 20 ms
PROGRAM = f"""#!{sys.executable} -IS
import json, os, socket, sys
call = socket.socket(socket.AF_UNIX)
call.connect(os.environ["{PLACE}"])
socket.send_fds(call, [b"."], [0, 1, 2])
call.sendall(json.dumps([sys.argv, os.getcwd(), dict(os.environ)]).encode("utf-8", "surrogateescape"))
call.shutdown(socket.SHUT_WR)
sys.exit(int(call.recv(8)))
"""
SECONDS = 600  # of a script, at most
MANY = """
import json, sys
from metapp.cli.command_tree import app
from metapp.cli.console import run_command
from metapp.evaluation.style import FIGURE_STYLE
FIGURE_STYLE["savefig.dpi"] = 40  # nobody looks at these figures
for line in sys.stdin:
    code = run_command(lambda: app(json.loads(line), standalone_mode=False, prog_name="metapp"))
    print(f"\\n== {code}", flush=True)
"""


def many_commands(
    *lines: Sequence[object], folder: Path, python: str | Path = sys.executable, **more: str
) -> list[str]:
    """What commands print, each of which ends well, in one process of its own; `more` of its environment."""
    done = subprocess.run(
        [python, "-c", MANY],
        input="\n".join(json.dumps(list(map(str, line))) for line in lines),
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "COLUMNS": "200", "OMP_NUM_THREADS": "1", **more},
    )
    assert "Traceback" not in done.stderr
    *said, _ = done.stdout.split("\n== ")
    codes = [part.partition("\n")[0] for part in done.stdout.split("\n== ")[1:]]
    assert codes == ["0"] * len(lines), done.stderr
    return [said[0], *(part.partition("\n")[2] for part in said[1:])]


@contextlib.contextmanager
def forked_commands(folder: Path) -> Iterator[Mapping[str, str]]:
    """Serve `metapp` and `python`; what the environment of `bash` needs for that.

    Args:
        folder: for the two programs; seconds.txt in it lists all calls, with the CPU seconds of each.
    """
    folder.mkdir()
    for name in ("metapp", "python"):
        (folder / name).write_text(PROGRAM, encoding="utf-8")
        (folder / name).chmod(0o755)
    place = folder / "socket"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(place))  # of a socket the path has 107 characters at most
        server.listen()
        threading.Thread(target=_accept, args=(server,), daemon=True).start()
        yield {PLACE: str(place), "PATH": f"{folder}:{os.environ['PATH']}"}
        server.shutdown(socket.SHUT_RDWR)


def bash(script: str, folder: Path, environment: Mapping[str, str]) -> tuple[int, str]:
    """Run a script by bash up to its first error: exit code, and all that it printed."""
    done = subprocess.run(
        ["bash", "-eu", "-o", "pipefail", "-c", script],
        cwd=folder,
        env={**os.environ, **environment},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=SECONDS,
        check=False,
    )
    return done.returncode, done.stdout.decode(errors="replace")


def _accept(server: socket.socket) -> None:
    with contextlib.suppress(OSError):  # it is closed
        while True:
            call, _ = server.accept()
            threading.Thread(target=_answer, args=(call,), daemon=True).start()


def _answer(call: socket.socket) -> None:
    process = FORKS.Process(target=_be, args=(call,))
    process.start()
    process.join()
    code = process.exitcode or 0
    with call, contextlib.suppress(BrokenPipeError):
        call.sendall(str(code if code >= 0 else 128 - code).encode())


def _be(call: socket.socket) -> None:
    """Be the command that a call asks for."""
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
        _run(Path(words[0]).name, words[1:])
    finally:
        used = os.times()
        with (Path(words[0]).parent / "seconds.txt").open("a", encoding="utf-8") as file:
            file.write(f"{sum(used[:4]):.1f} {' '.join([Path(words[0]).name, *words[1:]])}\n")


def _run(name: str, words: list[str]) -> None:
    """Be `metapp`, or `python` with a file, `-m` or `-c`."""
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
