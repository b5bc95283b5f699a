"""Scenes in XML as trees: read, put together with their includes and defaults, and checked.

Mitsuba reads XML by another parser than this module. So nothing that two parsers may read in two ways gets through:
entities, defaults of attributes and unknown names are refused, includes and `$name` are put in here, and the result is
written anew from the tree. Rules of plugins and values are in `metapp.rendering.scenes.rules`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from io import StringIO
from typing import TYPE_CHECKING, NoReturn
from xml.etree.ElementTree import Element, iterparse, tostring
from xml.parsers import expat

from typing_extensions import override

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

# Elements and attributes of Mitsuba's scene format
_OBJECT_TAGS = {"bsdf", "emitter", "film", "integrator", "medium", "phase", "rfilter", "sampler", "sensor", "shape",
            "texture", "volume"}  # fmt: skip
_VALUE_TAGS = {"alias", "boolean", "float", "integer", "lookat", "matrix", "point", "ref", "rgb", "rotate", "scale",
           "spectrum", "string", "transform", "translate", "vector"}  # fmt: skip
_RESOLVED_TAGS = {"default", "include", "path"}  # replaced by what they stand for
_ATTRIBUTES = {"angle", "as", "filename", "id", "name", "origin", "target", "type", "up", "value", "version", "x", "y",
               "z"}  # fmt: skip
_MAX_INCLUDES = 64  # in a scene with all of its includes
_MAX_DEFAULTS = 1_000  # <default> elements
_MAX_SUBSTITUTED_CHARACTERS = 4_096  # of the value of a <default>, and of a value that defaults are put into


def resolve_xml(text: str, places: ScenePlaces, name: str = "") -> str:
    """Check the XML text of a scene, and return it with its includes, defaults and absolute file names put in.

    Args:
        text: the document.
        places: where its data files and includes may lie.
        name: the resolved path of the document's file, if it has one.

    Raises:
        ValueError: the text is no scene in XML, or the scene holds something that it may not.
    """
    resolver = _SceneResolver()
    try:
        root = resolver.resolve_document(text, places, (name,))
    except UnsupportedPluginError as error:
        raise ValueError(explain_version(text, str(error))) from None
    for element in (element for tag in ("ref", "alias") for element in root.iter(tag)):
        if element.get("id") in resolver.media:
            check_plugin(resolver.media[element.attrib["id"]])
    _keep_lines(root)
    return "\n" * (root.line - 1) + tostring(root, encoding="unicode")


def _keep_lines(root: SceneElement) -> None:
    """Put newlines between elements, so that each begins on the line that it has in the user's file.

    Mitsuba's messages then name lines of the user's file. Elements of an include begin on the line of the include.
    """
    line = root.line

    def visit(element: SceneElement) -> None:
        nonlocal line
        previous: SceneElement | None = None
        for child in element:
            newlines = "\n" * max(0, child.line - line)
            line += len(newlines)
            if previous is None:
                element.text = newlines
            else:
                previous.tail = newlines
            visit(child)
            previous = child

    visit(root)


def locate_reason(text: str, reason: str) -> str:
    """Put the line and the element in place of line and column into Mitsuba's reason why it cannot load a scene.

    Args:
        text: the scene as :func:`resolve_xml` returns it.
        reason: Mitsuba's message, which may name a place in the text, such as "string (line 3, col 7): ".

    >>> locate_reason('<scene version="3.0.0"><bsdf type="x"/></scene>', "At string (line 1, col 25): no such plugin")
    'line 1, <bsdf type="x">: no such plugin'
    """
    place = re.search(r"[A-Z][a-z]*(?: \w+){0,2} string \(line (\d+), col (\d+)\): ", reason)
    if place is None:
        return reason
    position = int(place[1]), int(place[2]) - 2  # Mitsuba's column counts from 1, and is the column of the tag's name
    elements = [element for element in parse_xml(text).iter() if (element.line, element.column) <= position]
    location = f"line {position[0]}, {elements[-1]}: " if elements else f"line {position[0]}: "
    return f"{reason[: place.start()]}{location}{reason[place.end() :]}"


def explain_version(text: str, reason: str) -> str:
    """Add the version of a document and the remedy to the reason why Mitsuba 3 cannot take it, if the version is older.

    Args:
        text: the document.
        reason: why it cannot be taken.
    """
    version = next(iterparse(StringIO(text), ("start",)))[1].get("version", "")
    if not re.fullmatch(r"[01](\.[0-9]{1,4}){0,2}", version):
        return reason
    remedy = f"change this scene of version {version} to 3.0.0 by hand: Mitsuba renames parameters alone"
    return f"{reason.rstrip('.')}, or {remedy}."


class SceneElement(Element):
    """An element of a document, which messages name by its tag, type, name and id.

    Attributes:
        line: the line on which the element begins, counted from 1; 0 for an element of no document.
        column: the column at which the element begins, counted from 0.
    """

    line = column = 0

    if TYPE_CHECKING:

        @override
        def __iter__(self) -> Iterator[SceneElement]: ...

        @override
        def iter(self, tag: str | None = None) -> Iterator[SceneElement]: ...  # type: ignore[override]

    @override
    def __str__(self) -> str:
        attributes = "".join(f' {key}="{self.get(key)}"' for key in ("type", "name", "id") if key in self.attrib)
        return f"<{self.tag}{attributes}>"[:80]


class _SceneResolver:
    """A resolver, which puts one scene together from its documents: elements of Mitsuba 3 alone, within bounds.

    Attributes:
        media: types of the participating media that the scene declares, by name. The result goes without them, since
            media do nothing if no shape and no sensor refers to them.
        parts: number of elements and substitutions so far.
        characters: number of characters of all attributes so far.
        read_characters: number of characters of all documents so far.
        includes: number of includes so far.
        defaults: values of <default> elements so far, by name.
        is_old: whether the scene is of a version whose parameters Mitsuba renames.
    """

    def __init__(self) -> None:
        self.media: dict[str, str] = {}
        self.parts, self.characters, self.read_characters, self.includes = 0, 0, 0, 0
        self.defaults: dict[str, str] = {}
        self.is_old = False

    def resolve_document(self, text: str, places: ScenePlaces, chain: tuple[str, ...], depth: int = 0) -> SceneElement:
        """Parse and check a document, and return its root with includes, defaults and file names put in.

        Args:
            text: the document.
            places: where its data files and includes may lie.
            chain: paths of the documents that include each other, the path of this one last.
            depth: number of elements that its root lies within.
        """
        self.read_characters += len(text)
        if self.read_characters > MAX_TEXT_CHARACTERS:
            raise ValueError(f"more than {MAX_TEXT_CHARACTERS:,} characters with all includes, expected fewer.")
        root = parse_xml(text)
        version = root.attrib.pop("version", "")
        if not re.fullmatch(r"\d{1,4}(\.\d{1,4}){0,2}", version):
            raise ValueError(f"a version {version[:20]!r} of <{root.tag[:20]}>, expected one such as 3.0.0; add it.")
        is_old = int(version.partition(".")[0]) < 2  # versions whose parameters Mitsuba renames
        if len(chain) == 1:
            self.is_old = is_old
            if root.tag != "scene":
                raise ValueError("no scene, expected <scene> around all else.")
        if is_old != self.is_old:
            raise ValueError(f"of version {version}, expected the version of the scene that includes it.")
        resolved = self._resolve_element(root, places, chain, depth)
        resolved.set("version", version)
        return resolved

    def _resolve_element(
        self, source: SceneElement, places: ScenePlaces, chain: tuple[str, ...], depth: int
    ) -> SceneElement:
        """Return an element with its children, with includes, defaults and file names put in; see resolve_document."""
        if depth >= MAX_NESTED_LEVELS:
            raise ValueError(f"elements within each other, {MAX_NESTED_LEVELS} deep, expected fewer.")
        resolved = SceneElement(source.tag, self._resolve_attributes(source, places))
        resolved.line = source.line
        for child in source:
            if child.tag == "include":
                resolved.extend(self._resolve_include(child, places, chain, depth))
            elif child.tag == "default":
                self._add_default(child)
            elif child.tag == "path":
                places = places.search_first(self._substitute_defaults(child.get("value", "")))
            elif child.tag == "medium" and source.tag == "scene":
                medium = self._resolve_attributes(child, places)
                self.media[medium.get("id", "")] = medium.get("type", "")
            elif child.tag == "scene":
                raise ValueError("a <scene> within a <scene>, expected one around all else; leave it out.")
            else:
                resolved.append(self._resolve_element(child, places, chain, depth + 1))
        if resolved.tag in _OBJECT_TAGS or (resolved.tag == "spectrum" and "type" in resolved.attrib):
            _check_object(resolved, places)
        return resolved

    def _resolve_attributes(self, source: Element, places: ScenePlaces) -> dict[str, str]:
        """Return the attributes of an element with defaults and absolute file names put in."""
        self.parts += 1
        attributes = {key: self._substitute_defaults(value) for key, value in source.attrib.items()}
        self.characters += sum(map(len, attributes.values()))
        if self.parts > MAX_SCENE_VALUES or self.characters > MAX_TEXT_CHARACTERS:
            raise ValueError(
                f"more than {MAX_SCENE_VALUES:,} elements or {MAX_TEXT_CHARACTERS:,} characters; put meshes in files."
            )
        if source.tag == "string":
            attributes["value"] = check_string(attributes.get("name", ""), attributes.get("value", ""), places)
        elif "filename" in attributes:  # of a spectrum
            attributes["filename"] = check_string("filename", attributes["filename"], places)
        return attributes

    def _substitute_defaults(self, value: str) -> str:
        """Return a value with the values of defaults in place of each `$name`."""
        if "$" not in value:
            return value
        self.parts += value.count("$")
        if self.defaults and len(value) <= _MAX_SUBSTITUTED_CHARACTERS:
            longest_first = sorted(self.defaults, key=len, reverse=True)  # as Mitsuba does
            names = "|".join(map(re.escape, longest_first))
            value = re.sub(rf"\$({names})", lambda match: self.defaults[match[1]], value)
        if len(value) > MAX_VALUE_CHARACTERS or "$" in value:
            raise UnsupportedPluginError(f"{value[:60]!r}, expected a <default> before it for each '$'; add it.")
        return value

    def _add_default(self, element: Element) -> None:
        """Take in a <default>, unless there is one of its name already."""
        name, value = (self._substitute_defaults(element.get(key, "")) for key in ("name", "value"))
        is_short = re.fullmatch(r"[\w.-]{1,256}", name) and len(value) <= _MAX_SUBSTITUTED_CHARACTERS
        if not is_short or len(self.defaults) >= _MAX_DEFAULTS:
            raise ValueError(f"a <default> {name[:40]!r}, expected up to {_MAX_DEFAULTS} short ones; shorten it.")
        self.defaults.setdefault(name, value)

    def _resolve_include(
        self, element: SceneElement, places: ScenePlaces, chain: tuple[str, ...], depth: int
    ) -> list[SceneElement]:
        """Return the elements that an include stands for: the children of a <scene>, or the root of another document.

        Args:
            element: the <include>.
            places: where data files and includes may lie.
            chain: paths of the documents that include each other.
            depth: number of elements that the include lies within.
        """
        name = self._substitute_defaults(element.get("filename", ""))
        self.includes += 1
        if self.includes > _MAX_INCLUDES:
            raise ValueError(f"more than {_MAX_INCLUDES} includes, expected fewer; write their content out.")
        try:
            path, text = places.read_included_text(name)
            if str(path) in chain:
                raise ValueError("it includes itself.")
            root = self.resolve_document(text, places.search_first(path.parent), (*chain, str(path)), depth)
        except ValueError as error:
            if str(error).startswith("includes "):
                raise  # the message names the innermost document, which is at fault
            kind = UnsupportedPluginError if isinstance(error, UnsupportedPluginError) else ValueError
            raise kind(f"includes {name[:60]!r}, which cannot be read: {error}") from None
        del root.attrib["version"]
        for part in root.iter():
            part.line = element.line
        if root.tag == "scene":
            return list(root)
        if "name" in element.attrib:
            root.set("name", self._substitute_defaults(element.attrib["name"]))
        return [root]


def _check_object(element: SceneElement, places: ScenePlaces) -> None:
    """Refuse an element that stands for an object if a scene may not hold its plugin or a parameter."""
    try:
        check_plugin(element.get("type", ""))
    except UnsupportedPluginError as error:
        raise UnsupportedPluginError(f"line {element.line}, {element}: {error}") from None
    parameters = dict(map(_read_parameter, element))
    check_parameters(element.get("type", ""), parameters)
    places.check(element.get("type", ""), parameters)


def _read_parameter(element: Element) -> tuple[str, object]:
    """Return name and value of a parameter of a plugin; objects without a name all have the name ""."""
    name, value = element.get("name", ""), element.get("value", "")
    if element.tag in _OBJECT_TAGS | {"ref"}:
        return name, NESTED_OBJECT
    if element.tag in ("integer", "float"):
        return name, parse_number(value)
    return name, value if element.tag == "string" else None


def parse_xml(text: str) -> SceneElement:
    """Parse a document as a tree, without the text between elements, which Mitsuba ignores.

    Raises:
        ValueError: the text is no XML, or it has a DOCTYPE, elements or attributes that Mitsuba 3 does not know, too
            many elements, or elements nested too deeply.
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
        known_tags = _OBJECT_TAGS | _VALUE_TAGS | _RESOLVED_TAGS | {"scene"}
        if not (tag in known_tags and attributes.keys() <= _ATTRIBUTES):
            head = f"<{tag} {' '.join(attributes)}>"
            raise UnsupportedPluginError(
                f"line {line}: an element {head[:60]!r}, expected those of Mitsuba 3; leave it out."
            )
        element = SceneElement(tag, attributes)
        element.line, element.column = line, parser.CurrentColumnNumber
        stack[-1].append(element)
        stack.append(element)

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
    root: SceneElement = stack[0][0]  # type: ignore[assignment]  # below the element that stands for the document
    return root
