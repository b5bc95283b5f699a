"""Public scenes for Mitsuba 3: what a file needs, the repaired document, and whether Mitsuba loads it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import indent, tostring

from metapp.extensions.scene_files.places import Places, read_text
from metapp.extensions.scene_files.trial import try_scene
from metapp.extensions.scene_files.upgrade.repairs import Repair, repair
from metapp.extensions.scene_files.xml import SceneElement, checked_xml, merged, parse
from metapp.rendering.scenes.loading import check_traced, load_any
from metapp.rendering.scenes.plugins import snake_case
from metapp.rendering.variant import load_mitsuba
from metapp.storage.files import write_atomically


class Upgraded(NamedTuple):
    """A repaired scene.

    Attributes:
        root: of its document; file names are absolute.
        repairs: in the order of the file.
        left: elements that Mitsuba 3 lacks and that no repair replaces.
    """

    root: SceneElement
    repairs: list[Repair]
    left: list[Repair]


class Verdict(NamedTuple):
    """Mitsuba 3's answer to a scene.

    Attributes:
        problem: why it cannot load it; empty if it can.
        limit: why metapp cannot trace its paths, though Mitsuba loads it; empty if it can.
    """

    problem: str = ""
    limit: str = ""


def upgraded(path: Path, roots: Iterable[Path] = ()) -> Upgraded:
    """Repair a scene file, which stays as it is; nothing of it is loaded or run.

    Args:
        path: of the file, XML.
        roots: folders that its files may come from, beside its own.

    Raises:
        ValueError: no scene in XML, or files and includes that are missing or elsewhere, with the path.
    """
    try:
        if path.suffix.lower() != ".xml":
            raise ValueError("no .xml file, expected a scene in XML; dictionaries as JSON are of version 3 already.")
        root = merged(read_text(path), Places.beside(path, roots), str(path.resolve()))
        done, left = repair(root)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Upgraded(root, sorted(done, key=lambda one: one.line), left)


def document(root: SceneElement, folder: Path) -> str:
    """The text of a document whose file names hold from a folder: relative ones where the files lie in it."""
    copy = parse(tostring(root, encoding="unicode"), strict=False)
    own = folder.resolve()
    for element in copy.iter():
        key = "value" if element.tag == "string" and snake_case(element.get("name", "")).endswith("filename") else ""
        key = key or ("filename" if "filename" in element.attrib else "")
        name = Path(element.get(key, "")) if key else Path()
        if name.is_relative_to(own):
            element.set(key, name.relative_to(own).as_posix())
    indent(copy, " " * 4)
    return tostring(copy, encoding="unicode") + "\n"


def write(root: SceneElement, path: Path) -> None:
    """Write a document to a file, whose folder is made if missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = document(root, path.parent)
    write_atomically(path, lambda part: part.write_text(text, encoding="utf-8"))


def verdict(path: Path, roots: Iterable[Path] = ()) -> Verdict:
    """Test if Mitsuba 3 loads a scene file, and metapp traces its paths.

    Args:
        path: of the file, XML.
        roots: folders that its files may come from, beside its own.
    """
    variant = load_mitsuba().variant()
    wrong = ""
    try:
        text = read_text(path)
        tree = parse(checked_xml(text, Places.beside(path, roots), str(path.resolve())))
        indent(tree, " " * 4)
        scene = {"xml": tostring(tree, encoding="unicode")}
        if scene["xml"].count("\n") != text.rstrip().count("\n"):  # written by another hand, lines are not the file's
            wrong = r" \(line \d+, col \d+\)"
        try_scene(scene, variant)
        mi, loaded = load_any(scene)
    except ValueError as error:
        return Verdict(problem=re.sub(wrong, "", str(error)))
    try:
        check_traced(mi, loaded)
    except ValueError as error:
        return Verdict(limit=str(error))
    return Verdict()


def lines(repairs: Iterable[Repair]) -> list[str]:
    """One line for each repair; the same one of several elements is one, with their number."""
    same: dict[tuple[str, str], list[int]] = {}
    for line, element, done in repairs:
        same.setdefault((element, done), []).append(line)
    return [
        f"line {found[0]}{f' and {len(found) - 1} more' if found[1:] else ''}: {element}: {done}"
        for (element, done), found in same.items()
    ]
