"""Scenes in XML as dictionaries, by Mitsuba's own parser, of a text that is put together here first.

Mitsuba's parser loads no plugin. But while it parses, it opens files of includes and spectra wherever they lie, waits
for a FIFO, ends the process at deeply nested elements, takes gigabytes for defaults that name each other, and ignores
a DOCTYPE. So it gets one text of bounded size, without includes, defaults and folders. The text is written anew:
nothing gets through that two parsers may read in two ways.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple, NoReturn
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from metapp.extensions.scene_files.scene_places import MAX_TEXT_CHARACTERS, ScenePlaces
from metapp.rendering.scenes.rules import (
    MAX_NESTED_LEVELS,
    MAX_SCENE_VALUES,
    MAX_VALUE_CHARACTERS,
    SceneDict,
    SceneValue,
    UnsupportedPluginError,
    is_file_name,
    shorten_mitsuba_message,
)
from metapp.rendering.variant import load_mitsuba

_MAX_INCLUDES = 64  # in a scene with all of its includes
_MAX_DEFAULTS = 1_000  # <default> elements
_MAX_SUBSTITUTED_CHARACTERS = 4_096  # of the value of a <default>, and of a value that defaults are put into

ParserState = Any  # a class of Mitsuba, which holds the nodes of a document


class ParsedScene(NamedTuple):
    """A scene's dictionary, and the document that it was parsed from, by which errors are explained.

    Attributes:
        scene: the dictionary.
        text: the document as Mitsuba parsed it; "" for a scene that was a dictionary from the start.
        version: the version of Mitsuba that the document states.
        state: Mitsuba's nodes of the document.
        node_indices: the index of each object's node, by the object's path in the dictionary.
    """

    scene: SceneDict
    text: str = ""
    version: str = "3.0.0"
    state: ParserState = None
    node_indices: Mapping[str, int] = {}

    def explain(self, error: ValueError) -> str:
        """Return the reason why a scene is refused, with line and element of the document.

        If something is unknown to Mitsuba 3 in a scene of an older version, the reason states that version.

        >>> parsed = ParsedScene({}, '<scene version="3.0.0"><bsdf type="x">')
        >>> parsed.explain(ValueError("Error while loading string (line 1, col 25): no such plugin"))
        'line 1, <bsdf type="x">: no such plugin'
        """
        reason = str(error)
        if not self.text:
            return reason
        node = re.search(r'dictionary node "([^"]*)"', reason)
        if node and node[1] in self.node_indices:
            node_state = self.state.nodes[self.node_indices[node[1]]]
            reason = reason.replace(node[0], load_mitsuba().parser.file_location(self.state, node_state), 1)
        lines = self.text.encode().split(b"\n")
        place = re.search(r"(?:[A-Z][a-z]*(?: \w+){0,2} )?string \(line (\d{1,9}), col (\d{1,9})\): ", reason)
        if place and 0 < int(place[1]) <= len(lines):  # else a name in the scene has this form
            line = lines[int(place[1]) - 1]
            begin = int(place[2]) - 2  # Mitsuba's column counts bytes from 1, and is the column of the tag's name
            element = line[begin : line.find(b">", begin) + 1].decode(errors="replace")
            element = "".join(character if character.isprintable() else "?" for character in element)
            reason = f"{reason[: place.start()]}line {place[1]}, {element:.80}: {reason[place.end() :]}"
        unknown = isinstance(error, UnsupportedPluginError) or "that Mitsuba can load: " in reason
        if unknown and _is_old(self.version):
            remedy = f"change this scene of version {self.version} to 3.0.0 by hand: Mitsuba renames parameters alone"
            reason = f"{reason.rstrip('.')}, or {remedy}."
        return reason


def parse_xml(text: str, places: ScenePlaces, name: str = "") -> ParsedScene:
    """Parse the XML text of a scene, with absolute names of files; plugins and values are not checked.

    Args:
        text: the document.
        places: where its data files and includes may lie.
        name: the resolved path of the document's file, if it has one.

    Raises:
        ValueError: the text is no XML, or Mitsuba cannot parse it; a file that it names may not be read.
    """
    builder = _DocumentBuilder(places)
    try:
        builder.add_document(text, (name,))
        document = builder.text
        state = _parse_document(document)  # Mitsuba's nodes refer to the text, which must live as long as they do
    except UnsupportedPluginError as error:
        raise ValueError(ParsedScene({}, builder.text, builder.version).explain(error)) from None
    reader = _NodeReader(state)
    scene = reader.read_object(0, ())
    return ParsedScene(scene, document, builder.version, state, reader.node_indices)


def _parse_document(text: str) -> ParserState:
    """Return Mitsuba's nodes of a document, with parameters named as in version 3.

    Raises:
        UnsupportedPluginError: Mitsuba cannot parse it.
    """
    mi = load_mitsuba()
    config = mi.parser.ParserConfig(mi.variant())
    try:
        state = mi.parser.parse_string(config, text)
        mi.parser.transform_upgrade(config, state)
    except Exception as error:  # whatever Mitsuba raises, the scene is to blame
        reason = shorten_mitsuba_message(str(error)).rstrip(".")
        raise UnsupportedPluginError(f"no scene that Mitsuba can load: {reason}; change it, or leave it out.") from None
    return state


def _is_old(version: str) -> bool:
    """Return whether a version is one whose parameters Mitsuba renames."""
    return int(version.partition(".")[0]) < 2


class _NodeReader:
    """A reader of Mitsuba's nodes as dictionaries.

    Attributes:
        nodes: the nodes.
        indices_by_id: the index of the node that an id names.
        node_indices: see :class:`ParsedScene`.
        counts: greatest number in a key so far, by kind of object.
    """

    def __init__(self, state: ParserState) -> None:
        self.nodes, self.indices_by_id = state.nodes, state.id_to_index
        self.node_indices: dict[str, int] = {}
        self.counts: Counter[str] = Counter()

    def read_object(self, index: int, path: tuple[str, ...]) -> SceneDict:
        """Return the dictionary of the object whose node has an index, and which lies at a path of keys."""
        self.node_indices[".".join(path)] = index
        parameters = self.nodes[index].props
        result: SceneDict = {"type": parameters.plugin_name()}
        if parameters.id():
            result["id"] = parameters.id()
        for name, value in parameters.items():
            if name in ("type", "id"):
                raise ValueError(f"a parameter named {name!r}, expected another name; leave it out.")
            if parameters.type(name).name != "ResolvedReference":
                if path:  # a scene has no parameters
                    result[name] = self._read_value(value, parameters.type(name).name)
                continue
            # names at the root mean nothing, and may be the ids of other objects; keys have no points
            has_key = path and "." not in name
            key = name if has_key else self._number_object(self.nodes[value.index()].type.name.lower())
            result[key] = self.read_object(value.index(), (*path, key))
        return result

    def _number_object(self, kind: str) -> str:
        """Return a key for the next object of a kind, such as "shape 2", which is no id of another object."""
        self.counts[kind] += 1
        while (key := f"{kind} {self.counts[kind]}") in self.indices_by_id:
            self.counts[kind] += 1
        return key

    def _read_value(self, value: Any, kind: str) -> SceneValue:
        """Return a parameter as a dictionary holds it; `kind` is the name of Mitsuba's type."""
        if kind == "Reference":
            index = self.indices_by_id.get(value.id())  # an <alias> is another id of a node
            return {"type": "ref", "id": value.id() if index is None else self.nodes[index].props.id()}
        if kind == "Color":
            return {"type": "rgb", "value": list(value)}
        if kind == "Spectrum":
            pairs = [list(pair) for pair in zip(value.wavelengths, value.values, strict=False)]
            return {"type": "spectrum", "value": value.values[0] if value.is_uniform() else pairs}
        if kind == "Transform":
            matrix: list[list[float]] = np.array(value.matrix).tolist()
            return matrix
        return list(value) if kind == "Vector" else value


class _DocumentBuilder:
    """A builder of the text that Mitsuba parses, from the documents of a scene.

    Attributes:
        places: where files may lie that the element at hand names.
        version: the version that the scene's own document states.
        pieces: pieces of the text so far.
        line: the line on which the text so far ends.
        ends: texts that end the elements which are open; "" for an element that stands for something else.
        defaults: values of <default> elements so far, by name.
        parts: number of elements and substitutions so far.
        characters: number of characters of all attributes so far.
        read_characters: number of characters of all documents so far.
        includes: number of includes so far.
    """

    def __init__(self, places: ScenePlaces) -> None:
        self.places, self.version = places, "3.0.0"
        self.pieces: list[str] = []
        self.ends: list[str] = []
        self.defaults: dict[str, str] = {}
        self.line, self.parts, self.characters, self.read_characters, self.includes = 1, 0, 0, 0, 0

    @property
    def text(self) -> str:
        """The text so far."""
        return "".join(self.pieces)

    def add_document(self, text: str, chain: tuple[str, ...], include_name: str = "") -> None:
        """Add a document.

        Args:
            text: the document.
            chain: paths of the documents that include each other, the path of this one last.
            include_name: name of the parameter that the root of an included document is.

        Raises:
            ValueError: it is no XML, has a DOCTYPE, is too large, or names a file that may not be read.
        """
        self.read_characters += len(text)
        if self.read_characters > MAX_TEXT_CHARACTERS:
            raise ValueError(f"more than {MAX_TEXT_CHARACTERS:,} characters with all includes, expected fewer.")
        parser, root_depth, is_included = expat.ParserCreate(), len(self.ends), len(chain) > 1

        def start(tag: str, attributes: dict[str, str]) -> None:
            if not is_included:  # elements of an include are on the include's line
                new_lines = parser.CurrentLineNumber - self.line
                self.pieces.append("\n" * new_lines)
                self.line += new_lines
            attributes = self._substitute_in_attributes(attributes)
            if len(self.ends) == root_depth:
                version = attributes.pop("version", "")
                self._check_version(tag, version, is_included)
                if not is_included:
                    attributes["version"] = version + ".0" * (2 - version.count("."))  # Mitsuba's have three numbers
                elif tag == "scene":
                    self.ends.append("")
                    return
                elif include_name:
                    attributes["name"] = include_name
            self._start_element(tag, attributes, chain)

        def refuse(*_: object) -> NoReturn:
            raise ValueError("a DOCTYPE, expected a scene without one; leave it out.")

        parser.StartElementHandler = start
        parser.EndElementHandler = lambda _: self.pieces.append(self.ends.pop())
        parser.StartDoctypeDeclHandler = refuse
        parser.EntityDeclHandler = refuse
        try:
            parser.Parse(text, True)
        except expat.ExpatError as error:
            raise ValueError(f"not readable as XML ({error}), expected a scene of Mitsuba 3.") from None

    def _check_version(self, tag: str, version: str, is_included: bool) -> None:
        """Check the version that the root of a document states, and keep the version of the scene's own document."""
        if tag != "scene" and not is_included:
            raise ValueError(f"an XML document of <{tag[:40]}>, expected a scene of Mitsuba, <scene>; give one.")
        if not re.fullmatch(r"\d{1,4}(\.\d{1,4}){0,2}", version):
            raise ValueError(f"a version {version[:20]!r} of <{tag[:20]}>, expected one such as 3.0.0; add it.")
        if not is_included:
            self.version = version
        elif _is_old(version) != _is_old(self.version):
            raise ValueError(f"of version {version}, expected the version of the scene that includes it.")

    def _start_element(self, tag: str, attributes: dict[str, str], chain: tuple[str, ...]) -> None:
        """Add the start of an element, or what it stands for."""
        content = end = ""
        if tag == "include":
            self._add_include(attributes, chain)
        elif tag == "default":
            self._add_default(attributes)
        elif tag == "path":
            self.places = self.places.search_first(attributes.get("value", ""))
        else:
            end = f"</{tag}>"
            if tag == "string" and is_file_name(attributes.get("name", "")):
                attributes["value"] = self._resolve_file(attributes.get("value", ""))
            elif tag == "spectrum" and "filename" in attributes:
                # Mitsuba reads the file of a spectrum while it parses, but not that of an object
                file = quoteattr(self._resolve_file(attributes.pop("filename")))
                attributes["type"] = "spectrum"
                content = f'<string name="filename" value={file}></string>'
            written = "".join(f" {name}={quoteattr(value)}" for name, value in attributes.items())
            self.pieces.append(f"<{tag}{written}>{content}")
        self.ends.append(end)

    def _resolve_file(self, name: str) -> str:
        """Return the absolute name of a data file; a medium's is kept, since media are left out or refused."""
        return name if "</medium>" in self.ends else str(self.places.resolve_file(name))

    def _substitute_in_attributes(self, attributes: dict[str, str]) -> dict[str, str]:
        """Return the attributes of an element with defaults put in."""
        self.parts += 1
        attributes = {name: self._substitute_defaults(value) for name, value in attributes.items()}
        self.characters += sum(map(len, attributes.values()))
        is_deep = len(self.ends) >= MAX_NESTED_LEVELS
        if is_deep or self.parts > MAX_SCENE_VALUES or self.characters > MAX_TEXT_CHARACTERS:
            raise ValueError(
                f"more than {MAX_SCENE_VALUES:,} elements, {MAX_NESTED_LEVELS} within each other or "
                f"{MAX_TEXT_CHARACTERS:,} characters, expected fewer; put meshes in files."
            )
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

    def _add_default(self, attributes: Mapping[str, str]) -> None:
        """Take in a <default>, unless there is one of its name already."""
        name, value = attributes.get("name", ""), attributes.get("value", "")
        is_short = re.fullmatch(r"[\w.-]{1,256}", name) and len(value) <= _MAX_SUBSTITUTED_CHARACTERS
        if not is_short or len(self.defaults) >= _MAX_DEFAULTS:
            raise ValueError(f"a <default> {name[:40]!r}, expected up to {_MAX_DEFAULTS} short ones; shorten it.")
        self.defaults.setdefault(name, value)

    def _add_include(self, attributes: Mapping[str, str], chain: tuple[str, ...]) -> None:
        """Add the content of an included <scene>, or the root of another document.

        Args:
            attributes: the attributes of the <include>.
            chain: paths of the documents that include each other.
        """
        name, places = attributes.get("filename", ""), self.places
        self.includes += 1
        if self.includes > _MAX_INCLUDES:
            raise ValueError(f"more than {_MAX_INCLUDES} includes, expected fewer; write their content out.")
        try:
            path, text = places.read_included_text(name)
            if str(path) in chain:
                raise ValueError("it includes itself.")
            self.places = places.search_first(path.parent)
            self.add_document(text, (*chain, str(path)), attributes.get("name", ""))
        except ValueError as error:
            if str(error).startswith("includes "):
                raise  # the message names the innermost document, which is at fault
            kind = UnsupportedPluginError if isinstance(error, UnsupportedPluginError) else ValueError
            raise kind(f"includes {name[:60]!r}, which cannot be read: {error}") from None
        self.places = places
