"""Scenes of Mitsuba 3 as tasks of light transport: files in XML, files of a dictionary in JSON, and both in memory.

A scene in memory is trusted no more than a file: it may hold the same plugins, values and file names. This module reads
and checks scenes; paths are traced elsewhere.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from data_tools.readers.input_source import Sources, sources_of_files
from data_tools.readers.listing import files_below
from data_tools.synthetic.transport_task import BESIDE, HELD_OUT, SAMPLES, UNITS, make_transport_task
from metapp.extensions.scene_files.scene_places import ScenePlaces, read_scene_text
from metapp.extensions.scene_files.trial_loading import try_scene
from metapp.extensions.scene_files.xml import ParsedScene, parse_xml
from metapp.learning.task import Task
from metapp.rendering.scenes.rules import MAX_NESTED_LEVELS, SceneChecker, SceneDict, SceneValue
from metapp.rendering.variant import load_mitsuba
from metapp.storage.shards import MANIFEST

__all__ = ["BESIDE", "UNITS", "find", "read_scene", "read_task", "recognises", "task_of_object"]

SCENE_FILE_SUFFIXES = (".xml", ".json")

_ARRAY_PACKAGES = ("numpy", "mitsuba", "drjit", "torch")  # whose arrays of numbers a scene in memory may hold
_ARRAY_SHAPES = ((), (3,), (3, 3), (4, 4))  # of numbers, vectors and transforms


def recognises(path: Path) -> bool:
    """Return whether a path is a scene file, or a folder with scene files in it, by their suffixes."""
    return bool(_find_scene_files(path)) if path.is_dir() else path.suffix.lower() in SCENE_FILE_SUFFIXES


def find(path: Path) -> Sources:
    """Find scene files: in a folder by their suffixes, at any depth; a file that is named counts whatever its suffix.

    Returns:
        The files, sorted; no lines about skipped files, since meshes and textures belong to scenes.

    Raises:
        ValueError: the path does not exist, or the folder has no scene in it.
    """
    if not path.exists():
        raise ValueError(f"{path}: no such file or folder; give existing scene files.")
    scenes = _find_scene_files(path) if path.is_dir() else [path]
    if not scenes:
        raise ValueError(f"{path}: no scene in this folder, expected .xml or .json files of Mitsuba 3.")
    return sources_of_files((scenes, []))


def read_task(path: Path, samples: int = SAMPLES, held_out: int = HELD_OUT, roots: Iterable[Path] = ()) -> Task:
    """Read a scene file and trace its paths, as a task that is named by the file's stem.

    Random numbers are drawn by the name: two files of one name give the same draws.

    Args:
        path: the scene file.
        samples: number of samples that fits see.
        held_out: number of samples that tests alone see.
        roots: folders that its data files may come from, beside its own folder.

    Returns:
        The task, see :func:`data_tools.synthetic.transport_task.make_transport_task`.

    Raises:
        ValueError: the scene may not be read, cannot be loaded, or has no paths to sample; the message names the file.
    """
    load_mitsuba()  # before the scene is read: an error of Mitsuba itself is no fault of the scene
    return _trace_task(path.stem, _parse_file(path, roots), str(path), samples=samples, held_out=held_out)


def task_of_object(source: object, name: str, *, roots: Iterable[Path] = (), **_: object) -> Task:
    """Trace the paths of a scene in memory, as a task; data files that it names lie in the current folder.

    Args:
        source: a dictionary of type "scene", as `mi.load_dict` takes it, of numbers, texts, transforms and
            dictionaries; or the text of an XML document.
        name: the name of the task, by which random numbers are drawn.
        roots: further folders that its data files may come from.

    Raises:
        ValueError: the source is neither; it holds something that JSON cannot, such as a material that Mitsuba has
            loaded; it may not be read, cannot be loaded, or has no paths to sample.
    """
    load_mitsuba()
    return _trace_task(name, _parse_object(source, name, roots), name)


def _trace_task(name: str, parsed: ParsedScene, subject: str, **counts: int) -> Task:
    """Trace the paths of a scene, as a task.

    Args:
        name: the name of the task, by which random numbers are drawn.
        parsed: the scene, see :func:`_check_scene`.
        subject: what messages begin with: the file or the name.
        counts: numbers of samples, arguments of `make_transport_task`.

    Raises:
        ValueError: the scene cannot be loaded, or has no paths to sample.
    """
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "big")
    try:
        try_scene(parsed.scene, load_mitsuba().variant())
        return make_transport_task(name, parsed.scene, seed, **counts)
    except ValueError as error:
        reason = str(error)
        if "that Mitsuba can load: " in reason and "; " not in reason:
            reason = f"{reason.rstrip('.')}; change it, or leave it out."
        reason = parsed.explain(ValueError(reason))
    # raised outside of `except`: the frames of an error would keep the scene alive, and Dr.Jit traces the materials of
    # all scenes that are alive
    raise ValueError(f"{subject}: {reason}")


def read_scene(path: Path, roots: Iterable[Path] = ()) -> SceneDict:
    """Read a scene file as `metapp.rendering.scenes.loading.load_scene` takes it, with absolute file names.

    Args:
        path: the scene file.
        roots: folders that its data files may come from, beside its own folder.

    Raises:
        ValueError: the file is no text; a .json file is no JSON or no object; the scene holds what it may not.
    """
    return _parse_file(path, roots).scene


def _parse_file(path: Path, roots: Iterable[Path]) -> ParsedScene:
    """Read a scene file; see :func:`read_scene`."""
    try:
        text = read_scene_text(path)
        scene = {"xml": text} if path.suffix.lower() == ".xml" else _parse_json(text)
        return _check_scene(scene, ScenePlaces.from_scene_file(path, roots), str(path.resolve()))
    except ValueError as error:
        # metapp's own exports of BRDFs have such a scene beside the one that needs metapp's plugin
        reason, builtin = str(error), path.with_name(f"{path.stem}_builtin.xml")
        if builtin.is_file():
            reason = f"{reason.rstrip('.')}; or take {builtin.name} beside it, which needs no plugin of metapp."
        raise ValueError(f"{path}: {reason}") from None


def resolve_scene_in_memory(source: object, name: str, roots: Iterable[Path] = ()) -> SceneDict:
    """Return a scene in memory as `metapp.rendering.scenes.loading.load_scene` takes it, with absolute file names.

    Args:
        source: a dictionary of type "scene", or the text of an XML document; see :func:`task_of_object`.
        name: the name of the scene in messages.
        roots: folders that its data files may come from, beside the current folder.

    Raises:
        ValueError: the source is neither; it holds something that JSON cannot, or that a scene may not hold.
    """
    return _parse_object(source, name, roots).scene


def _parse_object(source: object, name: str, roots: Iterable[Path]) -> ParsedScene:
    """Check a scene in memory; see :func:`resolve_scene_in_memory`."""
    try:
        if isinstance(source, str):
            scene: SceneDict = {"xml": source}
        elif isinstance(source, Mapping):
            scene = _check_type(_to_json_value("scene", source))
        else:
            expected = "a path, a scene as Mitsuba's load_dict takes it, or XML text"
            raise ValueError(f"{type(source).__name__}, expected {expected}.")
        return _check_scene(scene, ScenePlaces.from_scene_file(Path.cwd() / name, roots))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def check_stored_scene(scene: SceneDict) -> SceneDict:
    """Check a scene of a data set, and return its dictionary; files that it names must have been read in this process.

    Raises:
        ValueError: the scene holds something that it may not.
    """
    return _check_scene(scene, ScenePlaces()).scene


def _check_scene(scene: SceneDict, places: ScenePlaces, name: str = "") -> ParsedScene:
    """Check a scene, and return it as a dictionary with absolute file names.

    Args:
        scene: a dictionary of plugins, or {"xml": text}.
        places: where its data files may lie.
        name: the resolved path of the scene's file, if it has one.

    Raises:
        ValueError: the scene holds something that it may not.
    """
    if not isinstance(scene, dict):
        raise ValueError("no scene, expected an object of type 'scene'.")
    if "xml" not in scene:
        parsed = ParsedScene(scene)
    elif isinstance(scene["xml"], str):
        parsed = parse_xml(scene["xml"], places, name)
    else:
        raise ValueError("an 'xml' that is no text, expected a document; change it.")
    try:
        return parsed._replace(scene=SceneChecker(places).check_object(parsed.scene))
    except ValueError as error:
        raise ValueError(parsed.explain(error)) from None


def _parse_json(text: str) -> SceneDict:
    try:
        scene = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not readable as JSON ({error}), expected a scene dictionary of Mitsuba 3.") from None
    return _check_type(scene)


def _check_type(scene: object) -> SceneDict:
    """Refuse an object that is no dictionary of type "scene" and holds no XML."""
    if not isinstance(scene, dict) or not (scene.get("type") == "scene" or isinstance(scene.get("xml"), str)):
        raise ValueError("no scene, expected an object of type 'scene'; write one with metapp data cornell.")
    return scene


def _find_scene_files(folder: Path) -> list[Path]:
    return [path for path in files_below(folder, SCENE_FILE_SUFFIXES) if path.name != MANIFEST]


def _to_json_value(key: str, value: object, depth: int = 0) -> SceneValue:
    """Return a value of a scene in memory as JSON can hold it; `key` is its name in messages."""
    if depth > MAX_NESTED_LEVELS:
        raise ValueError(f"objects within each other, more than {MAX_NESTED_LEVELS} deep, expected fewer.")
    if isinstance(value, Mapping):
        return {str(name): _to_json_value(str(name), part, depth + 1) for name, part in value.items()}
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, list | tuple):
        return [_to_json_value(key, part, depth + 1) for part in value]
    numbers = _to_array(value)
    if numbers is None:
        raise ValueError(
            f"{type(value).__name__} as {key[:40]!r}, expected numbers, text, a transform or a dictionary; "
            "give the dictionary that the object was loaded from, or the name of a file."
        )
    return numbers.tolist()


def _to_array(value: object) -> np.ndarray | None:
    """Return numbers of another package as an array, a transform as its matrix; None for other objects."""
    if type(value).__module__.partition(".")[0] not in _ARRAY_PACKAGES:
        return None
    try:
        numbers = np.array(value)
        numbers = np.array(value.matrix) if numbers.dtype == object and hasattr(value, "matrix") else numbers
    except Exception:  # whatever an object of another library raises
        return None
    if numbers.shape[-1:] == (1,):  # variants of Mitsuba that work on arrays add an axis
        numbers = numbers[..., 0]
    return numbers if numbers.dtype.kind in "uifb" and numbers.shape in _ARRAY_SHAPES else None
