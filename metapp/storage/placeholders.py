"""Files that stand for another one: pointers of Git, pages of a server, archives under another name."""

from __future__ import annotations

import re

START_BYTES = 1024  # of a file, which tell

_PAGE = re.compile(
    rb"(?:\s|<!--.*?-->|<\?xml[^>]*>)*(?:<!doctype\s+html|<html|<head|<body|<(?P<error>error)>\s*<code>)",
    re.IGNORECASE | re.DOTALL,
)
_POINTERS = (
    (re.compile(rb"version https?://(?:git-lfs|hawser|git-media)\b"), "a Git LFS pointer", "git lfs pull"),
    (re.compile(rb"/annex/objects/"), "a git-annex pointer", "git annex get"),
)
_ARCHIVES = (  # place and bytes of their marks
    ("a ZIP archive", 0, re.compile(rb"PK(?:\x03\x04|\x05\x06|\x07\x08)")),
    ("a gzip archive", 0, re.compile(rb"\x1f\x8b\x08")),
    ("a bzip2 archive", 0, re.compile(rb"BZh[1-9](?:1AY&SY|\x17rE8P\x90)")),
    ("an xz archive", 0, re.compile(rb"\xfd7zXZ\x00")),
    ("a Zstandard archive", 0, re.compile(rb"\x28\xb5\x2f\xfd")),
    ("a 7z archive", 0, re.compile(rb"7z\xbc\xaf\x27\x1c")),
    ("a RAR archive", 0, re.compile(rb"Rar!\x1a\x07")),
    ("a tar archive", 257, re.compile(rb"ustar[ \0]")),
)


def placeholder_of(start: bytes) -> str:
    """Return what a file stands for another one as, what is expected and the remedy; "" for a file that is itself.

    Args:
        start: the first `START_BYTES` of the file, or all of a shorter one.

    >>> placeholder_of(b"version https://git-lfs.github.com/spec/v1")
    'a Git LFS pointer, expected the file itself; fetch it by git lfs pull.'
    >>> placeholder_of(b"#?RADIANCE")
    ''
    """
    for noun, place, mark in _ARCHIVES:
        if mark.match(start, place):
            return f"{noun}, expected what it holds; unpack it."
    text = start.removeprefix(b"\xef\xbb\xbf")
    if text[:2] in (b"\xff\xfe", b"\xfe\xff"):  # UTF-16: of the letters of ASCII every second byte is 0
        text = text[2:].replace(b"\0", b"")
    for mark, noun, command in _POINTERS:
        if mark.match(text):
            return f"{noun}, expected the file itself; fetch it by {command}."
    if page := _PAGE.match(text):
        noun = "an error message of a server" if page["error"] else "an HTML page"
        return f"{noun}, expected the file itself; download it again, by the link of the file."
    return ""
