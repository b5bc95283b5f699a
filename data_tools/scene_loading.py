"""Mitsuba scenes that paths can be traced in: loaded, and refused where they cannot be.

A scene is what Mitsuba's `load_dict` takes, as far as JSON holds it, with matrices as nested lists; or the text of an
XML file and the folder that its file names start from, {"xml": text, "folder": path}.

Mitsuba would run a library that lies beside a scene and that the scene names as a plugin. So only names of its own
plugins get through, and these are looked for in its own folder first.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import torch
from torch import Tensor

from data_tools.mitsuba_variant import load_mitsuba
from metapp.latlong import luminance

Scene = dict[str, Any]

_BUILT_IN = {"scene", "rgb", "spectrum", "ref"}  # types that no plugin stands for
_MEDIA = {"homogeneous", "heterogeneous"}
_INCLUDES = 32  # files that include each other, at most


class Loaded(NamedTuple):
    """A scene in Mitsuba.

    Attributes:
        mitsuba: the module, in its variant.
        scene: Mitsuba's.
        brightest: the greatest luminance that its lights send out; 0 where they do not tell.
    """

    mitsuba: Any
    scene: Any
    brightest: float


def load_scene(scene: Scene) -> Loaded:
    """Load a scene whose paths can be traced without joining them to the lights.

    Raises:
        ValueError: no Mitsuba that can render here; no scene that it can load; no light, or one that paths cannot meet;
            a sensor other than a perspective one; fog.
    """
    mi = load_mitsuba()
    mi.set_log_level(mi.LogLevel.Error)
    folder = Path(scene.get("folder", "."))
    own = Path(mi.__file__).parent
    plugins = {path.stem for path in (own / "plugins").iterdir()} | _BUILT_IN
    named = _types_in_xml(scene["xml"], folder) if "xml" in scene else _types_in(scene)
    for kind in named:
        if kind not in plugins:
            raise ValueError(f"a plugin '{kind}', expected one of Mitsuba's own; leave it out.")
        if kind in _MEDIA:
            raise ValueError(f"a participating medium, '{kind}', expected surfaces alone; leave it out.")
    before, places = mi.file_resolver(), mi.FileResolver()
    places.clear()
    places.append(str(own))
    places.append(str(folder))
    mi.set_file_resolver(places)
    try:
        loaded = mi.load_string(scene["xml"]) if "xml" in scene else mi.load_dict(_matrices(mi, scene))
    except (RuntimeError, TypeError, ValueError) as error:
        reason = re.sub(r"^\[.*?\] |\s+", lambda part: " " if part[0].isspace() else "", str(error)).strip()
        raise ValueError(f"no scene that Mitsuba can load: {reason}") from None
    finally:
        mi.set_file_resolver(before)
    if not isinstance(loaded, mi.Scene):
        raise ValueError("no scene, expected <scene> around all else, or a dictionary of type 'scene'.")
    _check(mi, loaded)
    return Loaded(mi, loaded, max(_brightest(mi, emitter) for emitter in loaded.emitters()))


def brightness(radiance: Tensor) -> Tensor:
    """Luminance [N] of linear Rec.709 [N, 3]."""
    return luminance(radiance.T[..., None])[:, 0]


def _check(mi: Any, scene: Any) -> None:
    if not scene.emitters():
        raise ValueError("no emitter, expected an area light or an environment; add one.")
    for emitter in scene.emitters():
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta):
            raise ValueError(
                f"an emitter {emitter.class_name()}, which no path meets by chance, expected area lights and "
                "environments; put a small area light in its place."
            )
    if not scene.sensors():
        raise ValueError("no sensor, expected a perspective one; add it.")
    kind = scene.sensors()[0].class_name()
    if kind != "PerspectiveCamera":
        raise ValueError(f"a sensor {kind}, expected a perspective one; change its type to 'perspective'.")


def _brightest(mi: Any, emitter: Any) -> float:
    values = mi.traverse(emitter)
    for name, factor in (("radiance.value", 1.0), ("radiance.data", 1.0), ("data", values.get("scale", 1.0))):
        if name in values:
            radiance = torch.from_numpy(values[name].numpy()).float()
            shape = (1, -1) if name == "radiance.value" else (-1, radiance.shape[-1])
            colours = radiance.reshape(shape)[:, :3].expand(-1, 3)
            return float(brightness(colours * float(factor)).max())
    return 0.0


def _matrices(mi: Any, scene: Any) -> Any:
    """The same with its matrices as Mitsuba wants them."""
    if not isinstance(scene, dict):
        return scene
    return {
        key: mi.ScalarTransform4f(value) if key == "to_world" and isinstance(value, list) else _matrices(mi, value)
        for key, value in scene.items()
    }


def _types_in(scene: Any) -> Iterator[str]:
    """What a dictionary names as plugins."""
    for key, value in scene.items():
        if isinstance(value, dict):
            yield from _types_in(value)
        elif key == "type":
            yield str(value)


def _types_in_xml(text: str, folder: Path, left: int = _INCLUDES) -> Iterator[str]:
    """What a text, and the files it includes, name as plugins."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"not readable as XML ({error}), expected a scene of Mitsuba 3.") from None
    for element in root.iter():
        if element.tag == "path":
            raise ValueError("a <path>, expected file names that start from the scene's folder; write them so.")
        if element.tag == "include":
            name = element.get("filename", "")
            try:
                included = (folder / name).read_text(encoding="utf-8") if left else None
            except (OSError, UnicodeDecodeError):
                included = None
            if included is None:
                raise ValueError(f"includes '{name}', which cannot be read; write its content out.")
            yield from _types_in_xml(included, folder, left - 1)
        elif "type" in element.attrib:
            yield element.attrib["type"]
