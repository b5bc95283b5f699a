"""metapp works without the modules and functions that Linux has and Windows or macOS lack."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import os
import pathlib
import signal
import sys

import platformdirs  # and what else reads these names as it is imported
import torch

for module in ("fcntl", "grp", "posix", "pwd", "resource", "termios", "tty"):
    sys.modules[module] = None
for name in ("O_NOFOLLOW", "O_NONBLOCK", "chown", "fork", "geteuid", "getuid", "link", "register_at_fork", "uname"):
    delattr(os, name)
for name in ("SIGALRM", "SIGKILL", "SIGXCPU", "setitimer"):
    delattr(signal, name)
read = pathlib.Path.read_text


def read_text(path, *words, **more):
    if str(path).startswith("/proc"):
        raise FileNotFoundError(path)
    return read(path, *words, **more)


pathlib.Path.read_text = read_text
from metapp.cli import main

for line in (["--help"], ["meta", "brdf", "paint.csv", "--out", "runs"]):
    sys.argv = ["metapp", *line]
    try:
        main()
    except SystemExit as end:
        assert not end.code
import metapp

(folder,) = pathlib.Path("runs/brdf").glob("*/paint")
print(metapp.load(folder).error, metapp.fit("brdf", "paint.csv").error)
"""


def test_help_fit_and_load_need_nothing_that_linux_alone_has(tmp_path: Path) -> None:
    angles = [(theta, 0, other, phi) for theta in (5, 30, 55) for other in (10, 40, 70) for phi in (0, 60, 180)]
    rows = [",".join(map(str, [*row, 0.2, 0.1, 0.05])) for row in angles]
    (tmp_path / "paint.csv").write_text("\n".join(["theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b", *rows]))
    root = str(Path(__file__).parent.parent)
    environment = {**os.environ, "PYTHONPATH": root, "METAPP_CACHE": str(tmp_path / "cache")}
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False, cwd=tmp_path, env=environment
    )
    assert process.returncode == 0, process.stderr
    assert "Usage" in process.stdout
    loaded, again = map(float, process.stdout.splitlines()[-1].split())
    assert loaded == again
