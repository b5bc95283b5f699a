"""The writing of XML documents with indentation, whole or not at all. What a document means is not known here."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, indent, tostring

from metapp.storage.files import write_bytes


def write_xml(path: Path, root: Element) -> None:
    """Write an XML document with indentation, so that the file is there whole or not at all."""
    indent(root)
    content: bytes = tostring(root, encoding="utf-8", xml_declaration=True)
    write_bytes(path, content + b"\n")
