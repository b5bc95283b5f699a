"""Seeded mutations of files: bytes of any, values and structure of JSON, elements and attributes of XML."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable, Sequence
from typing import Any
from xml.etree import ElementTree

_INTEGERS = (0, 1, 2, 3, 7, 31, 32, 127, 128, 255, 256, 1000, 16383, 16384, 32767, 32768, 65535, 65536, 2**24,
             2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)  # fmt: skip
_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-45, 1e30, 3.4e38, float("inf"), float("-inf"), float("nan"))
_HEADER = 512  # bytes where most formats keep sizes
_TEXTS = ("", " ", "\0", "\n", "\x1b[31m", "../../x", "/dev/zero", "x" * 5000, "é\ud800", "nan", "-1", "1e999", "{}",
          "$a", "&a;", "C:\\x", "null", "9" * 400)  # fmt: skip


def mutate_bytes(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    """One to four mutations; `others` are valid files to splice with."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = rng.choice(_BYTES)(rng, content, others)
    return content


def mutate_json(rng: random.Random, document: Any) -> str:
    """The text of a document after one to four mutations of its values or structure, and sometimes of its text."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        document = _mutate_value(rng, document, rng.random() < 0.05)
    text, kind = json.dumps(document), rng.random()
    if kind < 0.1:
        return _of_text(rng, text)
    depth = rng.choice((200, 2000, 100_000)) if kind < 0.12 else 0
    return text.replace("0", "[" * depth + "]" * depth, 1) if depth else text


def mutate_xml(rng: random.Random, text: str) -> str:
    """The text of a document after one to four mutations of elements and attributes, and sometimes of its text."""
    root = ElementTree.fromstring(text)
    for _ in range(rng.choice((1, 1, 2, 4))):
        _mutate_element(rng, root)
    text, kind = _xml_text(root), rng.random()
    if kind < 0.1:
        return _of_text(rng, text)
    if kind < 0.12:
        depth = rng.choice((100, 2000, 50_000))
        return text.replace("<shape", "<shape>" * depth + "</shape>" * depth + "<shape", 1)
    if kind < 0.14:
        entity = f'<!DOCTYPE scene [<!ENTITY a "{rng.choice(("diffuse", "x" * 1000))}">]>'
        return entity + text.replace("diffuse", "&a;")
    return text


def _of_text(rng: random.Random, text: str) -> str:
    content = text.encode("utf-8", "surrogatepass")
    return mutate_bytes(rng, content, [content]).decode("utf-8", "replace")


def _place(rng: random.Random, content: bytes) -> int:
    """A position, half of the time in the header."""
    limit = min(_HEADER, len(content)) if rng.random() < 0.5 else len(content)
    return rng.randrange(limit) if limit else 0


def _flip(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 8, 64)) if changed else 0):
        changed[_place(rng, content)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _overwrite(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 4, 32)) if changed else 0):
        changed[_place(rng, content)] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
    return bytes(changed)


def _number(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    order = rng.choice("<>")
    if rng.random() < 0.3:
        new = struct.pack(order + rng.choice("fd"), rng.choice(_FLOATS[:-4] if rng.random() < 0.3 else _FLOATS[-3:]))
    else:
        size = rng.choice((1, 2, 4, 8))
        new = (rng.choice(_INTEGERS) % 256**size).to_bytes(size, "little" if order == "<" else "big")
    at = _place(rng, content)
    return content[:at] + new + content[at + len(new) :]


def _truncate(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    return content[: _place(rng, content)]


def _copy(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    """A block again, elsewhere, over what is there or between."""
    start, at = _place(rng, content), _place(rng, content)
    block = content[start : start + rng.choice((1, 4, 16, 256))]
    return content[:at] + block + content[at + (len(block) if rng.random() < 0.5 else 0) :]


def _remove(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    at = _place(rng, content)
    return content[:at] + content[at + rng.choice((1, 2, 4, 64)) :]


def _insert(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    at = _place(rng, content)
    return content[:at] + rng.randbytes(rng.choice((1, 2, 16, 256))) + content[at:]


def _splice(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others)
    at = _place(rng, content)
    return content[:at] + other[at if rng.random() < 0.5 else _place(rng, other) :]


def _append(rng: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    return content + (rng.randbytes(rng.choice((1, 100, 5000))) if rng.random() < 0.5 else content)


_BYTES: tuple[Callable[[random.Random, bytes, Sequence[bytes]], bytes], ...] = (
    _flip, _flip, _overwrite, _number, _number, _truncate, _copy, _remove, _insert, _splice, _append,
)  # fmt: skip


def odd_value(rng: random.Random) -> Any:
    """A value that a JSON document may have anywhere."""
    kinds: tuple[Callable[[], Any], ...] = (
        lambda: rng.choice((None, True, False)),
        lambda: rng.choice((1, -1)) * rng.choice((*_INTEGERS, 10**40)),
        lambda: rng.choice(_FLOATS),
        lambda: rng.choice(_TEXTS),
        lambda: [odd_value(rng) for _ in range(rng.randrange(3))],
        lambda: {rng.choice(_TEXTS): odd_value(rng) for _ in range(rng.randrange(3))},
        lambda: {"type": rng.choice(("scene", "diffuse", "bitmap", 3)), "value": [1, 2]},
    )
    return rng.choice(kinds)()


def _mutate_value(rng: random.Random, value: Any, here: bool) -> Any:
    """The same with one thing changed, somewhere below or here."""
    if here or not isinstance(value, dict | list) or not value:
        return odd_value(rng)
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    key = rng.choice(keys)
    changed = dict(value) if isinstance(value, dict) else list(value)
    kind = rng.random()
    if kind < 0.1:
        del changed[key]
    elif kind < 0.15 and isinstance(changed, dict):
        changed[rng.choice(_TEXTS)] = changed.pop(key)
    elif kind < 0.2 and isinstance(changed, dict):
        changed[rng.choice(_TEXTS)] = odd_value(rng)
    elif kind < 0.25 and isinstance(changed, list):
        changed.insert(key, changed[rng.choice(keys)])
    elif kind < 0.3:
        changed[key] = changed[rng.choice(keys)]
    else:
        changed[key] = _mutate_value(rng, changed[key], rng.random() < 0.3)
    return changed


def _mutate_element(rng: random.Random, root: ElementTree.Element) -> None:
    elements = list(root.iter())
    element = rng.choice(elements)
    kind = rng.randrange(7)
    if kind == 0 and element.attrib:
        del element.attrib[rng.choice(list(element.attrib))]
    elif kind <= 2 and element.attrib:
        name = rng.choice(list(element.attrib))
        other = [each.get(name, "") for each in elements if name in each.attrib]
        odd = rng.choice((rng.choice(_TEXTS), str(rng.choice(_INTEGERS)), str(rng.choice(_FLOATS))))
        element.set(name, rng.choice((odd, odd, rng.choice(other))))
    elif kind == 3:
        element.tag = rng.choice([each.tag for each in elements] + ["ref", "include", "path", "default", "x", "null"])
    elif kind == 4 and len(element):
        element.remove(rng.choice(list(element)))
    elif kind == 5:
        element.append(rng.choice(elements[1:]) if len(elements) > 1 and rng.random() < 0.7 else root.__copy__())
        if any(each is root for each in list(element)) or _holds_itself(element):
            element.remove(element[-1])
    else:
        element.set(rng.choice(("id", "name", "type", "value", "filename", "version")), rng.choice(_TEXTS))


def _holds_itself(element: ElementTree.Element) -> bool:
    below, seen = list(element), 0
    while below and seen < 5000:
        each = below.pop()
        if each is element:
            return True
        seen += 1
        below += list(each)
    return seen >= 5000


def _xml_text(element: ElementTree.Element) -> str:
    """As ElementTree writes it, but whatever characters there are."""
    attributes = "".join(f' {name}="{_escaped(value)}"' for name, value in element.attrib.items())
    inside = "".join(_xml_text(child) for child in element)
    return f"<{element.tag}{attributes}>{inside}</{element.tag}>"


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
