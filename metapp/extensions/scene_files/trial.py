"""A scene from outside is loaded by a process of its own first, whose death is a refusal.

Files of meshes, volumes and pictures are checked, but Mitsuba reads others too (measured materials, spectra, curves),
and decodes pictures by libraries of its own. The process costs 0.25 s and what Mitsuba needs to load the scene: it
imports no torch.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import Any

from metapp.rendering.scenes.instances import instantiate
from metapp.rendering.variant import THREADS, choose_llvm, own_plugins_only

Json = Any  # a value of a scene

_CPU_SECONDS = 300  # the largest public scenes load in half a minute


def try_scene(scene: dict[str, Json], variant: str) -> None:
    """Refuse a scene that ends the process that loads it, or that never comes to an end.

    Args:
        scene: as `metapp.extensions.scene_files.checking.checked` gives it.
        variant: of Mitsuba, to load it in.

    Raises:
        ValueError: the process died.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-P", "-m", "metapp.extensions.scene_files.trial", variant]  # -P: nothing of this folder
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment
    )
    try:
        process.communicate(json.dumps(scene).encode(), timeout=2 * _CPU_SECONDS)
    except subprocess.TimeoutExpired:
        pass
    finally:
        process.kill()
        code = process.wait()
    if code < 0:
        raise ValueError(
            f"{_ended(-code)} while Mitsuba loads it, expected a scene that it can load; leave out meshes, pictures "
            "and other files one by one to find which is damaged."
        )


def _ended(number: int) -> str:
    if number in (signal.SIGXCPU, signal.SIGKILL):
        return f"no end within {_CPU_SECONDS} s, or no memory left,"
    return f"the process died ({signal.Signals(number).name})"


def _load(variant: str) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_SECONDS, _CPU_SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if variant.startswith("llvm"):
        choose_llvm()
    import drjit
    import mitsuba

    mitsuba.set_variant(variant)
    own_plugins_only(mitsuba)
    drjit.set_thread_count(THREADS)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    instantiate(mitsuba, json.loads(sys.stdin.buffer.read()))


if __name__ == "__main__":
    _load(sys.argv[1])
