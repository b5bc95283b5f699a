"""The trial of a scene from outside: a process of its own loads it first, and the scene is refused if the process dies.

Mitsuba trusts the files of a scene: counts past a file's end ask for gigabytes, indices past the vertices read memory
that is not the mesh's. So the loaded scene is checked in memory, whatever file it came from. The trial costs 0.25 s and
the time in which Mitsuba loads the scene: the process imports torch only if the scene has BSDFs of metapp.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import subprocess
import sys

import numpy as np

from metapp.rendering.scenes.rules import SceneValue, instantiate_scene, shorten_mitsuba_message
from metapp.rendering.types import Mitsuba, Scene
from metapp.rendering.variant import LEAST_THREADS, choose_llvm, restrict_plugins

_MAX_CPU_SECONDS = 300  # of a trial; the largest public scenes load in half a minute
_MAX_ADDRESS_BYTES = 2**32  # of a trial: half a GiB for Mitsuba, and what the files of a scene may take
_SET_PARENT_DEATH_SIGNAL = 1  # an option of prctl
_REFUSED, _KILLED = 3, -9  # exit codes of a trial that refused the scene, and of a process that was killed


def try_scene(scene: dict[str, SceneValue], variant: str) -> None:
    """Refuse a scene that Mitsuba cannot load, that ends the process, or whose loading does not end.

    Args:
        scene: the scene, see :func:`metapp.extensions.scene_files.scene_reader.read_scene`.
        variant: the variant of Mitsuba that loads it.

    Raises:
        ValueError: the process died; Mitsuba refuses the scene, with its reason; a mesh has no faces, or faces at
            vertices that do not exist; values are not finite.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    # -P: a module in the current folder, which may be the scene's, must not be imported in place of another one
    command = [sys.executable, "-P", "-m", "metapp.extensions.scene_files.trial_loading", variant]
    try:
        process = subprocess.run(
            command,
            input=json.dumps(scene).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            timeout=2 * _MAX_CPU_SECONDS,
            check=False,
        )
        code, problem = process.returncode, process.stdout.decode(errors="replace")
    except subprocess.TimeoutExpired:
        code, problem = _KILLED, ""
    if code == _REFUSED:
        raise ValueError(f"no scene that Mitsuba can load: {shorten_mitsuba_message(problem)}")
    if code:
        raise ValueError(
            f"{_describe_end(code)} while Mitsuba loads it, expected a scene that it can load; leave out meshes, "
            "pictures and other files one by one to find which is damaged."
        )


def _describe_end(code: int) -> str:
    """Say how a trial ended, by the exit code of its process."""
    if code > 0:
        return f"an error (exit code {code})"
    if code == _KILLED or signal.Signals(-code).name == "SIGXCPU":
        return f"no end within {_MAX_CPU_SECONDS} s, or no memory left,"
    return f"the process died ({signal.Signals(-code).name})"


def _end_with_parent() -> None:
    """Have Linux kill this process when the process that started it ends, whichever way that ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)


def _limit_process(memory: bool) -> None:
    """Limit the time and the memory of this process where the system can: Windows can limit neither, macOS no memory.

    Args:
        memory: whether to limit the memory.
    """
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_CPU, (_MAX_CPU_SECONDS, _MAX_CPU_SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory:
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_AS, (_MAX_ADDRESS_BYTES, _MAX_ADDRESS_BYTES))


def _load_scene(variant: str) -> None:
    """Load the scene that standard input holds as JSON, and write the reason to standard output if it is refused."""
    _end_with_parent()
    is_llvm = variant.startswith("llvm")
    _limit_process(is_llvm)  # CUDA reserves more addresses than the limit
    if is_llvm:
        choose_llvm()
    import drjit
    import mitsuba

    mitsuba.set_variant(variant)
    restrict_plugins(mitsuba)
    drjit.set_thread_count(LEAST_THREADS)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    try:
        problem = _find_fault(mitsuba, instantiate_scene(mitsuba, json.loads(sys.stdin.buffer.read())))
    except Exception as error:  # whatever Mitsuba raises, the scene is to blame
        problem = str(error)
    if problem:
        sys.stdout.buffer.write(problem.encode())
        raise SystemExit(_REFUSED)


def _find_fault(mitsuba: Mitsuba, scene: Scene) -> str:
    """Return the first fault of a scene's meshes, volumes and pictures, which Mitsuba does not check; "" for none."""
    parameters = mitsuba.traverse(scene)
    for key, value in parameters.items():
        name, _, kind = key.rpartition(".")
        numbers = np.array(value)
        if kind == "faces":
            vertices = len(parameters[f"{name}.vertex_positions"]) // 3
            if not numbers.size:
                return f"the mesh {name!r} has no faces, expected some; leave the shape out."
            if numbers.max() >= vertices:
                return f"the mesh {name!r} has a face at vertex {numbers.max():,}, expected 0 to {vertices - 1:,}."
        if numbers.dtype.kind == "f" and not np.isfinite(numbers).all():
            return f"{key!r} holds NaN or infinite values, expected finite ones; export it again."
    return ""


if __name__ == "__main__":
    _load_scene(sys.argv[1])
