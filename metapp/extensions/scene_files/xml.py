"""Scenes in XML as trees: read, put together with their includes and defaults, and checked.

Mitsuba reads XML by another parser than ours. So nothing that two parsers may read in two ways gets through: entities,
defaults of attributes and names from elsewhere are refused, includes and `$name` are put in here, and the result
is written anew from the tree.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from io import StringIO
from typing import TYPE_CHECKING, NoReturn
from xml.etree.ElementTree import Element, iterparse, tostring
from xml.parsers import expat

from metapp.extensions.scene_files.scene_places import MAX_TEXT_CHARACTERS, ScenePlaces
from metapp.rendering.scenes.rules import (
    MAX_NESTED_LEVELS,
    MAX_SCENE_VALUES,
    MAX_VALUE_CHARACTERS,
    NESTED_OBJECT,
    UnsupportedPluginError,
    check_parameters,
    check_plugin,
    check_string,
    parse_number,
)

_OBJECTS = {"bsdf", "emitter", "film", "integrator", "medium", "phase", "rfilter", "sampler", "sensor", "shape",
            "texture", "volume"}  # fmt: skip
_VALUES = {"alias", "boolean", "float", "integer", "lookat", "matrix", "point", "ref", "rgb", "rotate", "scale",
           "spectrum", "string", "transform", "translate", "vector"}  # fmt: skip
_OURS = {"default", "include", "path"}
_ATTRIBUTES = {"angle", "as", "filename", "id", "name", "origin", "target", "type", "up", "value", "version", "x", "y",
               "z"}  # fmt: skip
_INCLUDES = 64  # in all
_DEFAULTS, _SHORT = 1_000, 4_096  # <default>s, and characters of their values and of what they are put into


def resolve_xml(text: str, places: ScenePlaces, name: str = "") -> str:
    """The XML text of a scene with all includes, defaults and absolute file names in it.

    Args:
        text: a document.
        places: of its files.
        name: resolved path of its file, if it has one.

    Raises:
        ValueError: no scene in XML, or something that a scene may not hold.
    """
    reader = _Reader()
    try:
        root = reader.document(text, places, (name,))
    except UnsupportedPluginError as error:
        raise ValueError(explain_version(text, str(error))) from None
    for element in (element for tag in ("ref", "alias") for element in root.iter(tag)):
        if element.get("id") in reader.media:
            check_plugin(reader.media[element.attrib["id"]])
    _keep_lines(root)
    return "\n" * (root.line - 1) + tostring(root, encoding="unicode")


def _keep_lines(root: SceneElement) -> None:
    """Put newlines between elements, so that each begins on its line of the user's file, or on that of its include."""
    line = root.line

    def visit(element: SceneElement) -> None:
        nonlocal line
        before: SceneElement | None = None
        for child in element:
            space = "\n" * max(0, child.line - line)
            line += len(space)
            if before is None:
                element.text = space
            else:
                before.tail = space
            visit(child)
            before = child

    visit(root)


def locate_reason(text: str, reason: str) -> str:
    """Mitsuba's reason why it cannot load a scene, with the line and the element in place of columns of the text.

    Args:
        text: the scene as `resolve_xml` writes it.
        reason: may name a place in it, "string (line 3, col 7): ".

    >>> located('<scene version="3.0.0"><bsdf type="x"/></scene>', "At string (line 1, col 25): no such plugin")
    'line 1, <bsdf type="x">: no such plugin'
    """
    place = re.search(r"[A-Z][a-z]*(?: \w+){0,2} string \(line (\d+), col (\d+)\): ", reason)
    if place is None:
        return reason
    at = int(place[1]), int(place[2]) - 2  # Mitsuba's column is of the name, from 1
    before = [element for element in parse_xml(text).iter() if (element.line, element.column) <= at]
    shown = f"line {at[0]}, {before[-1]}: " if before else f"line {at[0]}: "
    return f"{reason[: place.start()]}{shown}{reason[place.end() :]}"


def explain_version(text: str, reason: str) -> str:
    """The reason why Mitsuba 3 cannot take a document, with its version and the remedy if that is an older one."""
    version = next(iterparse(StringIO(text), ("start",)))[1].get("version", "")
    if not re.fullmatch(r"[01](\.[0-9]{1,4}){0,2}", version):
        return reason
    remedy = f"change this scene of version {version} to 3.0.0 by hand: Mitsuba renames parameters alone"
    return f"{reason.rstrip('.')}, or {remedy}."


class SceneElement(Element):
    """An element of a document.

    Attributes:
        line: on which it begins, from 1; 0 of one that no document holds.
        column: at which it begins, from 0.
    """

    line = column = 0

    if TYPE_CHECKING:

        def __iter__(self) -> Iterator[SceneElement]: ...

        def iter(self, tag: str | None = None) -> Iterator[SceneElement]: ...  # type: ignore[override]  # noqa: D102

    def __str__(self) -> str:
        """As messages name it."""
        shown = "".join(f' {key}="{self.get(key)}"' for key in ("type", "name", "id") if key in self.attrib)
        return f"<{self.tag}{shown}>"[:80]


class _Reader:
    """Puts one document together, within bounds on all of it, out of elements of Mitsuba 3 alone.

    Attributes:
        media: types of the participating media that the scene declares, by name; the document goes without them, since
            they do nothing if no shape and no sensor refers to them.
    """

    def __init__(self) -> None:
        self.media: dict[str, str] = {}
        self.parts, self.characters, self.read, self.includes = 0, 0, 0, 0
        self.defaults: dict[str, str] = {}
        self.old = False

    def document(self, text: str, places: ScenePlaces, chain: tuple[str, ...], depth: int = 0) -> SceneElement:
        """The root of a document, checked; `chain` names the files that include each other, this one last."""
        self.read += len(text)
        if self.read > MAX_TEXT_CHARACTERS:
            raise ValueError(f"more than {MAX_TEXT_CHARACTERS:,} characters with all includes, expected fewer.")
        root = parse_xml(text)
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

    def _element(self, source: SceneElement, places: ScenePlaces, chain: tuple[str, ...], depth: int) -> SceneElement:
        if depth >= MAX_NESTED_LEVELS:
            raise ValueError(f"elements within each other, {MAX_NESTED_LEVELS} deep, expected fewer.")
        made = SceneElement(source.tag, self._attributes(source, places))
        made.line = source.line
        for child in source:
            if child.tag == "include":
                made.extend(self._included(child, places, chain, depth))
            elif child.tag == "default":
                self._default(child)
            elif child.tag == "path":
                places = places.first(self._substituted(child.get("value", "")))
            elif child.tag == "medium" and source.tag == "scene":
                declared = self._attributes(child, places)
                self.media[declared.get("id", "")] = declared.get("type", "")
            elif child.tag == "scene":
                raise ValueError("a <scene> within a <scene>, expected one around all else; leave it out.")
            else:
                made.append(self._element(child, places, chain, depth + 1))
        if made.tag in _OBJECTS or (made.tag == "spectrum" and "type" in made.attrib):
            _check_object(made, places)
        return made

    def _attributes(self, source: Element, places: ScenePlaces) -> dict[str, str]:
        self.parts += 1
        made = {key: self._substituted(value) for key, value in source.attrib.items()}
        self.characters += sum(map(len, made.values()))
        if self.parts > MAX_SCENE_VALUES or self.characters > MAX_TEXT_CHARACTERS:
            raise ValueError(
                f"more than {MAX_SCENE_VALUES:,} elements or {MAX_TEXT_CHARACTERS:,} characters; put meshes in files."
            )
        if source.tag == "string":
            made["value"] = check_string(made.get("name", ""), made.get("value", ""), places)
        elif "filename" in made:  # of a spectrum
            made["filename"] = check_string("filename", made["filename"], places)
        return made

    def _substituted(self, value: str) -> str:
        if "$" not in value:
            return value
        self.parts += value.count("$")
        if self.defaults and len(value) <= _SHORT:
            longest_first = sorted(self.defaults, key=len, reverse=True)  # as Mitsuba does
            names = "|".join(map(re.escape, longest_first))
            value = re.sub(rf"\$({names})", lambda found: self.defaults[found[1]], value)
        if len(value) > MAX_VALUE_CHARACTERS or "$" in value:
            raise UnsupportedPluginError(f"{value[:60]!r}, expected a <default> before it for each '$'; add it.")
        return value

    def _default(self, element: Element) -> None:
        name, value = (self._substituted(element.get(key, "")) for key in ("name", "value"))
        if not re.fullmatch(r"[\w.-]{1,256}", name) or len(value) > _SHORT or len(self.defaults) >= _DEFAULTS:
            raise ValueError(f"a <default> {name[:40]!r}, expected up to {_DEFAULTS} short ones; shorten it.")
        self.defaults.setdefault(name, value)

    def _included(
        self, element: SceneElement, places: ScenePlaces, chain: tuple[str, ...], depth: int
    ) -> list[SceneElement]:
        """The content of a document, or, of one without <scene>, the document's element."""
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
            kind = UnsupportedPluginError if isinstance(error, UnsupportedPluginError) else ValueError
            raise kind(f"includes {name[:60]!r}, which cannot be read: {error}") from None
        del root.attrib["version"]
        for part in root.iter():
            part.line = element.line
        if root.tag == "scene":
            return list(root)
        if "name" in element.attrib:
            root.set("name", self._substituted(element.attrib["name"]))
        return [root]


def _check_object(made: SceneElement, places: ScenePlaces) -> None:
    try:
        check_plugin(made.get("type", ""))
    except UnsupportedPluginError as error:
        raise UnsupportedPluginError(f"line {made.line}, {made}: {error}") from None
    parameters = dict(map(_parameter, made))
    check_parameters(made.get("type", ""), parameters)
    places.check(made.get("type", ""), parameters)


def _parameter(element: Element) -> tuple[str, object]:
    """Name and value of an element within a plugin; shapes, which have no names, are all one."""
    name, value = element.get("name", ""), element.get("value", "")
    if element.tag in _OBJECTS | {"ref"}:
        return name, NESTED_OBJECT
    if element.tag in ("integer", "float"):
        return name, parse_number(value)
    return name, value if element.tag == "string" else None


def parse_xml(text: str) -> SceneElement:
    """The tree of a document; text between elements is left out, as it says nothing to Mitsuba.

    Raises:
        ValueError: no XML, or XML with a DOCTYPE, elements or attributes that Mitsuba 3 has not, too many or too deep.
    """
    parser = expat.ParserCreate()
    stack, count = [SceneElement("document")], 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(stack) > MAX_NESTED_LEVELS or count > MAX_SCENE_VALUES:
            raise ValueError(
                f"more than {MAX_SCENE_VALUES:,} elements, or {MAX_NESTED_LEVELS} within each other, expected fewer."
            )
        line = parser.CurrentLineNumber
        known = tag in _OBJECTS | _VALUES | _OURS | {"scene"} and attributes.keys() <= _ATTRIBUTES
        if not known:
            shown = f"<{tag} {' '.join(attributes)}>"
            raise UnsupportedPluginError(
                f"line {line}: an element {shown[:60]!r}, expected those of Mitsuba 3; leave it out."
            )
        made = SceneElement(tag, attributes)
        made.line, made.column = line, parser.CurrentColumnNumber
        stack[-1].append(made)
        stack.append(made)

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
    root: SceneElement = stack[0][0]  # type: ignore[assignment]  # the document's
    return root
