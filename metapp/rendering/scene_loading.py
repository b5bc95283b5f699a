"""Mitsuba scenes that paths can be traced in: checked, loaded, and refused where they cannot be.

A scene is what Mitsuba's `load_dict` takes, as far as JSON holds it, with matrices as nested lists; or the text of an
XML document, {"xml": text}.

Mitsuba gets nothing but what was checked here, and no folder of a scene: it would run a library that lies there and
that the scene names as a plugin. All file names are absolute, and the files lie in folders that the user named. Mitsuba
reads XML by another parser than ours. So nothing that two parsers may read in two ways gets through: entities, defaults
of attributes and names from elsewhere are refused, includes and `$name` are put in here, and what is handed on is
written anew from the tree.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple, NoReturn
from xml.etree.ElementTree import Element, tostring
from xml.parsers import expat

import numpy as np
import torch
from torch import Tensor

from metapp.appearance.latlong import luminance
from metapp.rendering.scene_plugins import PLUGIN, check_parameters, check_plugin, number_of
from metapp.rendering.scene_rules import (
    DEPTH,
    PARTS,
    TEXT,
    TEXT_BYTES,
    CheckedDict,
    Places,
    SceneDict,
    checked_string,
)
from metapp.rendering.scene_trial import instantiate
from metapp.rendering.types import Emitter, Mitsuba, Scene
from metapp.rendering.variant import load_mitsuba

_LONGEST = 200  # characters of Mitsuba's messages
_OBJECTS = {"bsdf", "emitter", "film", "integrator", "medium", "phase", "rfilter", "sampler", "sensor", "shape",
            "texture", "volume"}  # fmt: skip
_VALUES = {"alias", "boolean", "float", "integer", "lookat", "matrix", "point", "ref", "rgb", "rotate", "scale",
           "spectrum", "string", "transform", "translate", "vector"}  # fmt: skip
_OURS = {"default", "include", "path"}
_ATTRIBUTES = {"angle", "as", "filename", "id", "name", "origin", "target", "type", "up", "value", "version", "x", "y",
               "z"}  # fmt: skip
_INCLUDES = 64  # in all
_DEFAULTS, _SHORT = 1_000, 4_096  # <default>s, and characters of their values and of what they are put into


class Loaded(NamedTuple):
    """A scene in Mitsuba.

    Attributes:
        mitsuba: the module, in its variant.
        scene: Mitsuba's.
        brightest: the greatest luminance that its lights send out; 0 where they do not tell.
    """

    mitsuba: Mitsuba
    scene: Scene
    brightest: float


def checked(scene: SceneDict, places: Places, name: str = "") -> SceneDict:
    """The same scene, of the same form, with absolute file names, includes and defaults in it.

    Args:
        scene: a dictionary, or {"xml": text}.
        places: where its files may lie; none for a stored scene, whose files must have been read in this process.
        name: resolved path of its file, if it has one.

    Raises:
        ValueError: something that a scene may not hold.
    """
    if not isinstance(scene, dict):
        raise ValueError("no scene, expected an object of type 'scene'.")
    if "xml" in scene:
        if not isinstance(scene["xml"], str):
            raise ValueError("an 'xml' that is no text, expected a document; change it.")
        return {"xml": checked_xml(scene["xml"], places, name)}
    return CheckedDict(places).object(scene)


def load_scene(scene: SceneDict) -> Loaded:
    """Load a scene whose paths can be traced without next-event estimation.

    Raises:
        ValueError: no Mitsuba that can render here; no scene that it can load; no light, or one that paths cannot meet;
            a sensor other than a perspective one; fog; a file that `checked` did not let through before.
    """
    mi = load_mitsuba()
    mi.set_log_level(mi.LogLevel.Error)
    scene = checked(scene, Places())
    try:
        loaded = instantiate(mi, scene)
    except Exception as error:  # whatever it is, the scene is to blame
        raise ValueError(f"no scene that Mitsuba can load: {reason_of(error)}") from None
    _check(mi, loaded)
    brightest = max(_brightest(mi, emitter) for emitter in loaded.emitters())
    if not 0 <= brightest < math.inf:
        raise ValueError(f"a light of luminance {brightest}, expected a finite one of 0 or more; change its radiance.")
    return Loaded(mi, loaded, brightest)


def reason_of(error: BaseException) -> str:
    """What Mitsuba says of an error, in one line."""
    error = error.__cause__ or error  # an error within a loop
    reason = re.sub(r"\[\w+\.(?:cpp|h):\d+\] |\s+", lambda part: " " if part[0].isspace() else "", str(error)).strip()
    return reason if len(reason) <= _LONGEST else f"{reason[: _LONGEST // 2]} ... {reason[5 - _LONGEST // 2 :]}"


def brightness(radiance: Tensor) -> Tensor:
    """Luminance [N] of linear Rec.709 [N, 3]."""
    return luminance(radiance.T[..., None])[:, 0]


def _check(mi: Mitsuba, scene: Scene) -> None:
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
    width, height = scene.sensors()[0].film().crop_size()
    if not width or not height:
        raise ValueError(f"a film of {width} x {height} px, expected 1 or more of both; change its crop.")


def _brightest(mi: Mitsuba, emitter: Emitter) -> float:
    values = mi.traverse(emitter)
    for name in ("radiance.value", "radiance.data", "data"):
        if name in values:
            radiance = torch.from_numpy(np.array(values[name]))
            if not radiance.is_floating_point():  # 8-bit sRGB: linear values are no greater
                radiance = radiance / torch.iinfo(radiance.dtype).max
            shape = (1, -1) if name == "radiance.value" else (-1, radiance.shape[-1])
            colours = radiance.float().reshape(shape)[:, :3].expand(-1, 3)
            factor = np.array(values.get("scale", 1.0)).item() if name == "data" else 1.0  # a Dr.Jit array in envmaps
            return float(brightness(colours * factor).max())
    return 0.0


def checked_xml(text: str, places: Places, name: str = "") -> str:
    """The XML text of a scene with all includes, defaults and absolute file names in it.

    Args:
        text: a document.
        places: where its files may lie.
        name: resolved path of its file, if it has one.

    Raises:
        ValueError: no scene in XML, or something that a scene may not hold.
    """
    return tostring(_Reader().document(text, places, (name,)), encoding="unicode")


class _Reader:
    """Puts one document together, within bounds on all of it."""

    def __init__(self) -> None:
        self.parts, self.characters, self.read, self.includes = 0, 0, 0, 0
        self.defaults: dict[str, str] = {}
        self.old = False

    def document(self, text: str, places: Places, chain: tuple[str, ...], depth: int = 0) -> Element:
        """The root of a document, checked; `chain` names the files that include each other, this one last."""
        self.read += len(text)
        if self.read > TEXT_BYTES:
            raise ValueError(f"more than {TEXT_BYTES:,} characters with all includes, expected fewer.")
        root = parse(text)
        version = root.attrib.pop("version", "")
        if not re.fullmatch(r"\d{1,4}(\.\d{1,4}){0,2}", version):
            raise ValueError(f"a version {version[:20]!r} of <{root.tag[:20]}>, expected one such as 3.0.0; add it.")
        old = int(version.partition(".")[0]) < 2  # Mitsuba renames parameters of these
        if len(chain) == 1:
            self.old = old
            if root.tag != "scene":
                raise ValueError("no scene, expected <scene> around all else.")
        if old != self.old:
            raise ValueError(f"of version {version}, expected that of the scene that includes it.")
        made = self._element(root, places, chain, depth)
        made.set("version", version)
        return made

    def _element(self, source: Element, places: Places, chain: tuple[str, ...], depth: int) -> Element:
        if depth >= DEPTH:
            raise ValueError(f"elements within each other, {DEPTH} deep, expected fewer.")
        made = Element(source.tag, self._attributes(source, places))
        for child in source:
            if child.tag == "include":
                made.extend(self._included(child, places, chain, depth))
            elif child.tag == "default":
                self._default(child)
            elif child.tag == "path":
                places = places.first(places.folder(self._substituted(child.get("value", ""))))
            elif child.tag == "scene":
                raise ValueError("a <scene> within a <scene>, expected one around all else; leave it out.")
            else:
                made.append(self._element(child, places, chain, depth + 1))
        if made.tag in _OBJECTS or (made.tag == "spectrum" and "type" in made.attrib):
            check_plugin(made.get("type", ""))
            check_parameters(made.get("type", ""), dict(map(_parameter, made)))
        return made

    def _attributes(self, source: Element, places: Places) -> dict[str, str]:
        self.parts += 1
        made = {key: self._substituted(value) for key, value in source.attrib.items()}
        self.characters += sum(map(len, made.values()))
        if self.parts > PARTS or self.characters > TEXT_BYTES:
            raise ValueError(f"more than {PARTS:,} elements or {TEXT_BYTES:,} characters; put meshes in files.")
        if source.tag == "string":
            made["value"] = checked_string(made.get("name", ""), made.get("value", ""), places)
        elif "filename" in made:  # of a spectrum
            made["filename"] = checked_string("filename", made["filename"], places)
        return made

    def _substituted(self, value: str) -> str:
        if "$" not in value:
            return value
        self.parts += value.count("$")
        if self.defaults and len(value) <= _SHORT:
            longest_first = sorted(self.defaults, key=len, reverse=True)  # as Mitsuba does
            names = "|".join(map(re.escape, longest_first))
            value = re.sub(rf"\$({names})", lambda found: self.defaults[found[1]], value)
        if "$" in value or len(value) > TEXT:
            raise ValueError(f"{value[:60]!r}, expected a <default> before it for each '$'; add it.")
        return value

    def _default(self, element: Element) -> None:
        name, value = (self._substituted(element.get(key, "")) for key in ("name", "value"))
        if not re.fullmatch(r"[\w.-]{1,256}", name) or len(value) > _SHORT or len(self.defaults) >= _DEFAULTS:
            raise ValueError(f"a <default> {name[:40]!r}, expected up to {_DEFAULTS} short ones; shorten it.")
        self.defaults.setdefault(name, value)

    def _included(self, element: Element, places: Places, chain: tuple[str, ...], depth: int) -> list[Element]:
        """What a document holds, or, of one without <scene>, the document's element."""
        name = self._substituted(element.get("filename", ""))
        self.includes += 1
        if self.includes > _INCLUDES:
            raise ValueError(f"more than {_INCLUDES} includes, expected fewer; write their content out.")
        try:
            path, text = places.text(name)
            if str(path) in chain:
                raise ValueError("it includes itself.")
            root = self.document(text, places.first(path.parent), (*chain, str(path)), depth)
        except ValueError as error:
            if str(error).startswith("includes "):
                raise  # one file is named, the one that is to blame
            raise ValueError(f"includes {name[:60]!r}, which cannot be read: {error}") from None
        del root.attrib["version"]
        if root.tag == "scene":
            return list(root)
        if "name" in element.attrib:
            root.set("name", self._substituted(element.attrib["name"]))
        return [root]


def _parameter(element: Element) -> tuple[str, object]:
    """Name and value of an element within a plugin; shapes, which have no names, are all one."""
    name, value = element.get("name", ""), element.get("value", "")
    if element.tag in _OBJECTS | {"ref"}:
        return name, PLUGIN
    if element.tag in ("integer", "float"):
        return name, number_of(value)
    return name, value if element.tag == "string" else None


def parse(text: str) -> Element:
    """The tree of a document; text between elements is left out, as it says nothing to Mitsuba.

    Raises:
        ValueError: no XML, or XML with a DOCTYPE, names of other languages, too many elements or too deep.
    """
    parser = expat.ParserCreate()
    holder = Element("document")
    stack, count = [holder], 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(stack) > DEPTH or count > PARTS:
            raise ValueError(f"more than {PARTS:,} elements, or {DEPTH} within each other, expected fewer.")
        if tag not in _OBJECTS | _VALUES | _OURS | {"scene"} or not attributes.keys() <= _ATTRIBUTES:
            shown = f"<{tag} {' '.join(attributes)}>"
            raise ValueError(f"an element {shown[:60]!r}, expected those of Mitsuba 3; leave it out.")
        stack[-1].append(Element(tag, attributes))
        stack.append(stack[-1][-1])

    def refuse(*_: object) -> NoReturn:
        raise ValueError("a DOCTYPE, expected a scene without one; leave it out.")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(f"not readable as XML ({error}), expected a scene of Mitsuba 3.") from None
    return holder[0]
