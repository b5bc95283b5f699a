"""Damage to files for fuzzing, drawn by hypothesis: random bytes, or a valid file with a few changes."""

import re
import struct
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

from tests.fuzz.files import Files

HEADER_BYTES = 512  # the beginning of a file, where most formats state sizes
HOSTILE_INTEGERS = (0, 1, 2, 3, 7, 32, 127, 128, 255, 256, 16384, 32767, 65535, 2**24, 2**31 - 1, 2**32 - 1, 2**63 - 1)
HOSTILE_FLOATS = (0.0, -0.0, -1.0, 1e-45, 1e30, 3.4e38, float("inf"), float("nan"))
HOSTILE_WORDS = (b"0", b"-1", b"1e999", b"nan", b"-1e-40", b"9" * 400, b"9223372036854775808", b"", b'""', b"null",
                 b"true", b"[]", b"{}", b"[[1, 2]]", b'{"type": "scene"}', b'"../../x"', b'"$a"', b'"\x00"', b'"\xff"',
                 b'"\\ud800"', b'"' + b"x" * 5000 + b'"', b"[" * 3000, b"&a;", b"<shape>" * 3000)  # fmt: skip
TEXT_TOKEN = re.compile(rb'"[^"<>]{0,200}"|-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?')  # a string or a number


def _draw_position(draw: Callable[..., Any], content: bytes) -> int:
    """Draw a position in a file's content, half of the time in its header."""
    return int(draw(st.integers(0, min(len(content), draw(st.sampled_from((HEADER_BYTES, len(content))))))))


ENCODED_NUMBERS = st.builds(
    lambda number, size, order: (number % 256**size).to_bytes(size, order),
    st.sampled_from(HOSTILE_INTEGERS), st.sampled_from((1, 2, 4, 8)), st.sampled_from(("little", "big")),
) | st.builds(struct.pack, st.sampled_from(("<f", ">f", "<d", ">d")), st.sampled_from(HOSTILE_FLOATS))  # fmt: skip


@st.composite
def change_content(draw: Callable[..., Any], content: bytes) -> bytes:
    """Draw a copy of a file's content with one change: it is cut off, or bytes, numbers or words are replaced."""
    position = _draw_position(draw, content)
    kind = draw(st.sampled_from(("truncate", "bytes", "number", "copy", "word", "word")))
    if kind == "truncate":
        return content[:position]
    if kind == "word":
        words = list(TEXT_TOKEN.finditer(content[: 40 * HEADER_BYTES]))
        start, end = words[draw(st.integers(0, len(words) - 1))].span() if words else (position, position)
        return content[:start] + draw(st.sampled_from(HOSTILE_WORDS)) + content[end:]
    start = _draw_position(draw, content)
    new = {"bytes": st.binary(max_size=64), "number": ENCODED_NUMBERS, "copy": st.just(content[start : start + 64])}[
        kind
    ]
    inserted = draw(new)
    return content[:position] + inserted + content[position + draw(st.sampled_from((0, len(inserted), 1, 64))) :]


@st.composite
def damage_one_file(draw: Callable[..., Any], valid: list[Files]) -> tuple[Files, str]:
    """Draw files of a reader, one of them damaged, and the name of the damaged one."""
    files = draw(st.sampled_from(valid))
    file = draw(st.sampled_from(sorted(files)))
    content = files[file]
    if draw(st.integers(0, 9)) == 0:
        return {**files, file: draw(st.binary(max_size=1000))}, file
    # a safetensors file: half of the time only its header is changed, and the length before it is corrected
    head = content[8 : 8 + int.from_bytes(content[:8], "little")] if file.endswith(".safetensors") else b""
    part = head if head and draw(st.booleans()) else content
    for _ in range(draw(st.sampled_from((1, 1, 2, 4)))):
        part = draw(change_content(part))
    if head and part is not content and not part.startswith(content[:8]):
        part = len(part).to_bytes(8, "little") + part + content[8 + len(head) :]
    return {**files, file: part}, file
