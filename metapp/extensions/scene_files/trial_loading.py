"""A scene from outside is loaded by a process of its own first, whose death is a refusal.

Mitsuba trusts the files of a scene: counts past a file's end ask for gigabytes, indices past the vertices read memory
that is not the mesh's. A loaded scene is checked as it lies in memory, whatever file it came from. The process costs
0.25 s and the time in which Mitsuba loads the scene: it imports no torch, but for BSDFs of metapp.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys

import numpy as np

from metapp.rendering.scenes.rules import SceneValue, instantiate_scene, shorten_mitsuba_message
from metapp.rendering.types import Mitsuba, Scene
from metapp.rendering.variant import LEAST_THREADS, choose_llvm, restrict_plugins

_CPU_SECONDS = 300  # the largest public scenes load in half a minute
_MEMORY_BYTES = 2**35  # of addresses; damaged counts ask for more
_REFUSED, _KILLED = 3, -9  # exit codes


def try_scene(scene: dict[str, SceneValue], variant: str) -> None:
    """Refuse a scene that Mitsuba cannot load, that ends the process, or that never comes to an end.

    Args:
        scene: as `metapp.extensions.scene_files.scene_reader.resolve_scene` gives it.
        variant: of Mitsuba, to load it in.

    Raises:
        ValueError: the process died; Mitsuba's reason; a mesh without faces or with faces that name no vertices, values
            that are not finite.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [
        sys.executable,
        "-P",
        "-m",
        "metapp.extensions.scene_files.trial_loading",
        variant,
    ]  # -P: nothing of this folder
    try:
        done = subprocess.run(
            command,
            input=json.dumps(scene).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            timeout=2 * _CPU_SECONDS,
            check=False,
        )
        code, problem = done.returncode, done.stdout.decode(errors="replace")
    except subprocess.TimeoutExpired:
        code, problem = _KILLED, ""
    if code == _REFUSED:
        raise ValueError(f"no scene that Mitsuba can load: {shorten_mitsuba_message(problem)}")
    if code:
        raise ValueError(
            f"{_ended(code)} while Mitsuba loads it, expected a scene that it can load; leave out meshes, pictures "
            "and other files one by one to find which is damaged."
        )


def _ended(code: int) -> str:
    if code > 0:
        return f"an error (exit code {code})"
    if code == _KILLED or signal.Signals(-code).name == "SIGXCPU":
        return f"no end within {_CPU_SECONDS} s, or no memory left,"
    return f"the process died ({signal.Signals(-code).name})"


def _limit(memory: bool) -> None:
    """Limit the process, if the system can: Windows cannot, and macOS not the memory."""
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_SECONDS, _CPU_SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory:
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))


def _load(variant: str) -> None:
    is_llvm = variant.startswith("llvm")
    _limit(is_llvm)  # CUDA reserves more memory than there is
    if is_llvm:
        choose_llvm()
    import drjit
    import mitsuba

    mitsuba.set_variant(variant)
    restrict_plugins(mitsuba)
    drjit.set_thread_count(LEAST_THREADS)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    try:
        problem = _problem(mitsuba, instantiate_scene(mitsuba, json.loads(sys.stdin.buffer.read())))
    except Exception as error:  # whatever it is, the scene is to blame
        problem = str(error)
    if problem:
        sys.stdout.buffer.write(problem.encode())
        raise SystemExit(_REFUSED)


def _problem(mitsuba: Mitsuba, scene: Scene) -> str:
    """The fault of a scene's meshes, volumes and pictures, which Mitsuba takes as they are; "" for none."""
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
    _load(sys.argv[1])
