"""Damage to files, drawn by hypothesis: any bytes, or a valid file with a few changes."""

import re
import struct
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

from tests.fuzz.files import Files

HEADER = 512  # bytes, where most formats keep sizes
INTEGERS = (0, 1, 2, 3, 7, 32, 127, 128, 255, 256, 16384, 32767, 65535, 2**24, 2**31 - 1, 2**32 - 1, 2**63 - 1)
FLOATS = (0.0, -0.0, -1.0, 1e-45, 1e30, 3.4e38, float("inf"), float("nan"))
WORDS = (b"0", b"-1", b"1e999", b"nan", b"-1e-40", b"9" * 400, b"9223372036854775808", b"", b'""', b"null", b"true",
         b"[]", b"{}", b"[[1, 2]]", b'{"type": "scene"}', b'"../../x"', b'"$a"', b'"\x00"', b'"\xff"', b'"\\ud800"',
         b'"' + b"x" * 5000 + b'"', b"[" * 3000, b"&a;", b"<shape>" * 3000)  # fmt: skip
WORD = re.compile(rb'"[^"<>]{0,200}"|-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?')  # of JSON, XML and tables


def _place(draw: Callable[..., Any], content: bytes) -> int:
    """A position, half of the time in the header."""
    return int(draw(st.integers(0, min(len(content), draw(st.sampled_from((HEADER, len(content))))))))


NUMBERS = st.builds(
    lambda number, size, order: (number % 256**size).to_bytes(size, order),
    st.sampled_from(INTEGERS), st.sampled_from((1, 2, 4, 8)), st.sampled_from(("little", "big")),
) | st.builds(struct.pack, st.sampled_from(("<f", ">f", "<d", ">d")), st.sampled_from(FLOATS))  # fmt: skip


@st.composite
def changed(draw: Callable[..., Any], content: bytes) -> bytes:
    """The same with one change."""
    at = _place(draw, content)
    kind = draw(st.sampled_from(("truncate", "bytes", "number", "copy", "word", "word")))
    if kind == "truncate":
        return content[:at]
    if kind == "word":
        words = list(WORD.finditer(content[: 40 * HEADER]))
        start, end = words[draw(st.integers(0, len(words) - 1))].span() if words else (at, at)
        return content[:start] + draw(st.sampled_from(WORDS)) + content[end:]
    start = _place(draw, content)
    new = {"bytes": st.binary(max_size=64), "number": NUMBERS, "copy": st.just(content[start : start + 64])}[kind]
    put = draw(new)
    return content[:at] + put + content[at + draw(st.sampled_from((0, len(put), 1, 64))) :]


@st.composite
def damaged(draw: Callable[..., Any], valid: list[Files]) -> tuple[Files, str]:
    """Files of a reader, of which one is damaged, and that one's name."""
    files = draw(st.sampled_from(valid))
    file = draw(st.sampled_from(sorted(files)))
    content = files[file]
    if draw(st.integers(0, 9)) == 0:
        return {**files, file: draw(st.binary(max_size=1000))}, file
    # the header of safetensors, whose length is put right
    head = content[8 : 8 + int.from_bytes(content[:8], "little")] if file.endswith(".safetensors") else b""
    part = head if head and draw(st.booleans()) else content
    for _ in range(draw(st.sampled_from((1, 1, 2, 4)))):
        part = draw(changed(part))
    if head and part is not content and not part.startswith(content[:8]):
        part = len(part).to_bytes(8, "little") + part + content[8 + len(head) :]
    return {**files, file: part}, file
