"""Scenes of Mitsuba 3 as tasks of light transport: files, XML or a dictionary as JSON, and the same in memory.

Nothing in memory is trusted more than in a file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from data_tools.readers.input_source import Sources, sources_of_files
from data_tools.readers.listing import files_below
from data_tools.synthetic.transport_task import BESIDE, HELD, SAMPLES, UNITS, make_transport_task
from metapp.extensions.scene_files.scene_places import ScenePlaces, read_scene_text
from metapp.extensions.scene_files.trial_loading import try_scene
from metapp.extensions.scene_files.xml import explain_version, locate_reason, resolve_xml
from metapp.learning.task import Task
from metapp.rendering.scenes.rules import MAX_NESTED_LEVELS, SceneChecker, SceneDict, SceneValue
from metapp.rendering.variant import load_mitsuba
from metapp.storage.shards import MANIFEST

__all__ = ["BESIDE", "UNITS", "find", "read_scene", "read_task", "recognises", "task_of_object"]

SCENE_FILE_SUFFIXES = (".xml", ".json")

_NUMBERS = ("numpy", "mitsuba", "drjit", "torch")  # whose arrays of numbers a scene in memory may hold
_SHAPES = ((), (3,), (3, 3), (4, 4))


def recognises(path: Path) -> bool:
    """True if a path is a scene file, or a folder with one in it, known by its suffix."""
    return bool(_below(path)) if path.is_dir() else path.suffix.lower() in SCENE_FILE_SUFFIXES


def find(path: Path) -> Sources:
    """Find scene files: in a folder by their suffix, at any depth; a named file as it is.

    Returns:
        The files, sorted; and no line about others, since meshes and textures belong to scenes.

    Raises:
        ValueError: a path that does not exist, a folder without any scene.
    """
    if not path.exists():
        raise ValueError(f"{path}: no such file or folder; give existing scene files.")
    scenes = _below(path) if path.is_dir() else [path]
    if not scenes:
        raise ValueError(f"{path}: no scene in this folder, expected .xml or .json files of Mitsuba 3.")
    return sources_of_files((scenes, []))


def read_task(path: Path, samples: int = SAMPLES, held: int = HELD, roots: Iterable[Path] = ()) -> Task:
    """Trace the paths of a scene file, as the task that is named by the file's stem.

    The same file name gives the same draws.

    Args:
        path: of the file.
        samples: N, for fits to see.
        held: M, for tests alone.
        roots: folders that its files may come from, beside its own.

    Returns:
        As `make_transport_task`.

    Raises:
        ValueError: as `read_scene`, `load_scene` and `draw_samples`, with the path.
    """
    load_mitsuba()  # what keeps it from rendering is no fault of the scene
    scene = read_scene(path, roots)
    return _traced(path.stem, scene, str(path), samples=samples, held=held)


def task_of_object(source: object, name: str, *, roots: Iterable[Path] = (), **_: object) -> Task:
    """Make the task of a scene in memory; files that it names lie in the current folder.

    Args:
        source: a dictionary of type "scene", as `mi.load_dict` takes it, of numbers, texts, transforms and
            dictionaries; or the text of an XML document.
        name: of the task.
        roots: further folders that its files may come from.

    Raises:
        ValueError: neither; it holds something that JSON does not, such as a material that Mitsuba has loaded; as
            `read_task`.
    """
    load_mitsuba()
    return _traced(name, resolve_scene_in_memory(source, name, roots), name)


def _traced(name: str, scene: SceneDict, subject: str, **counts: int) -> Task:
    """The task of a scene, drawn by its name; `subject` begins errors."""
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "big")
    try:
        try_scene(scene, load_mitsuba().variant())
        return make_transport_task(name, scene, seed, **counts)
    except ValueError as error:
        reason = str(error)
        if "that Mitsuba can load: " in reason and "; " not in reason:
            reason = f"{reason.rstrip('.')}; change it, or leave it out."
        if "xml" in scene and "that Mitsuba can load: " in reason:
            reason = explain_version(scene["xml"], locate_reason(scene["xml"], reason))
    # without the error, which would keep the scene alive: Dr.Jit traces the materials of all scenes that are
    raise ValueError(f"{subject}: {reason}")


def read_scene(path: Path, roots: Iterable[Path] = ()) -> SceneDict:
    """The content of a scene file, as `load_scene` takes it, with file names that hold from everywhere.

    Args:
        path: of the file.
        roots: folders that its files may come from, beside its own.

    Raises:
        ValueError: no text; of a .json file, no JSON or no object; something that a scene may not hold.
    """
    try:
        text = read_scene_text(path)
        scene = {"xml": text} if path.suffix.lower() == ".xml" else _from_json(text)
        return resolve_scene(scene, ScenePlaces.beside(path, roots), str(path.resolve()))
    except ValueError as error:
        reason, builtin = str(error), path.with_name(f"{path.stem}_builtin.xml")  # as our exports have
        if builtin.is_file():
            reason = f"{reason.rstrip('.')}; or take {builtin.name} beside it, which needs no plugin of metapp."
        raise ValueError(f"{path}: {reason}") from None


def resolve_scene_in_memory(source: object, name: str, roots: Iterable[Path] = ()) -> SceneDict:
    """The content of a scene in memory, as `read_scene` has that of a file.

    Args:
        source, name: as of `task_of_object`.
        roots: folders that its files may come from, beside the current one.

    Raises:
        ValueError: as `task_of_object`.
    """
    try:
        if isinstance(source, str):
            scene: SceneDict = {"xml": source}
        elif isinstance(source, Mapping):
            scene = _scene(_plain("scene", source))
        else:
            expected = "a path, a scene as Mitsuba's load_dict takes it, or XML text"
            raise ValueError(f"{type(source).__name__}, expected {expected}.")
        return resolve_scene(scene, ScenePlaces.beside(Path.cwd() / name, roots))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def resolve_scene(scene: SceneDict, places: ScenePlaces, name: str = "") -> SceneDict:
    """The same scene, of the same form, with absolute file names, includes and defaults in it.

    Args:
        scene: a dictionary, or {"xml": text}.
        places: of its files.
        name: resolved path of its file, if it has one.

    Raises:
        ValueError: something that a scene may not hold.
    """
    if not isinstance(scene, dict):
        raise ValueError("no scene, expected an object of type 'scene'.")
    if "xml" in scene:
        if not isinstance(scene["xml"], str):
            raise ValueError("an 'xml' that is no text, expected a document; change it.")
        return {"xml": resolve_xml(scene["xml"], places, name)}
    return SceneChecker(places).object(scene)


def check_stored_scene(scene: SceneDict) -> SceneDict:
    """The same scene of a data set, whose files must have been read in this process.

    Raises:
        ValueError: as `resolve_scene`.
    """
    return resolve_scene(scene, ScenePlaces())


def _from_json(text: str) -> SceneDict:
    try:
        scene = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not readable as JSON ({error}), expected a scene dictionary of Mitsuba 3.") from None
    return _scene(scene)


def _scene(scene: object) -> SceneDict:
    if not isinstance(scene, dict) or not (scene.get("type") == "scene" or isinstance(scene.get("xml"), str)):
        raise ValueError("no scene, expected an object of type 'scene'; write one with metapp data cornell.")
    return scene


def _below(folder: Path) -> list[Path]:
    return [path for path in files_below(folder, SCENE_FILE_SUFFIXES) if path.name != MANIFEST]


def _plain(key: str, value: object, depth: int = 0) -> SceneValue:
    """A value of a scene in memory as JSON holds it."""
    if depth > MAX_NESTED_LEVELS:
        raise ValueError(f"objects within each other, more than {MAX_NESTED_LEVELS} deep, expected fewer.")
    if isinstance(value, Mapping):
        return {str(below): _plain(str(below), part, depth + 1) for below, part in value.items()}
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, list | tuple):
        return [_plain(key, part, depth + 1) for part in value]
    numbers = _numbers(value)
    if numbers is None:
        raise ValueError(
            f"{type(value).__name__} as {key[:40]!r}, expected numbers, text, a transform or a dictionary; "
            "give what it was made of, or the name of a file."
        )
    return numbers.tolist()


def _numbers(value: object) -> np.ndarray | None:
    """Numbers of numpy, Mitsuba or Dr.Jit, a transform as its matrix; None of all else."""
    if type(value).__module__.partition(".")[0] not in _NUMBERS:
        return None
    try:
        numbers = np.array(value)
        numbers = np.array(value.matrix) if numbers.dtype == object and hasattr(value, "matrix") else numbers
    except Exception:  # whatever an object of another library raises
        return None
    if numbers.shape[-1:] == (1,):  # of a variant that works on arrays
        numbers = numbers[..., 0]
    return numbers if numbers.dtype.kind in "uifb" and numbers.shape in _SHAPES else None
