"""Files that only stand for another one: pointers of Git, pages of a server, archives with the name of their content.

They are told by their first bytes, so that a user reads what happened instead of an error of a format's reader.
"""

from __future__ import annotations

import re

START_BYTES = 1024  # of a file, by which it is told

# A page in HTML, or a server's error message in XML, after blanks, comments and declarations
_PAGE = re.compile(
    rb"(?:\s|<!--.*?-->|<\?xml[^>]*>)*(?:<!doctype\s+html|<html|<head|<body|<(?P<error>error)>\s*<code>)",
    re.IGNORECASE | re.DOTALL,
)
# Marks in text, the noun for the message, and the command that fetches the file itself
_POINTERS = (
    (re.compile(rb"version https?://(?:git-lfs|hawser|git-media)\b"), "a Git LFS pointer", "git lfs pull"),
    (re.compile(rb"/annex/objects/"), "a git-annex pointer", "git annex get"),
)
# The noun for the message, the place of the mark in the file, and the mark
_ARCHIVES = (
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
    """Describe a file that only stands for another one.

    Args:
        start: the first START_BYTES bytes of the file, or all bytes of a shorter one.

    Returns:
        What the file is, what is expected and the remedy; "" for any other file.

    >>> placeholder_of(b"version https://git-lfs.github.com/spec/v1")
    'a Git LFS pointer, expected the file itself; fetch it by git lfs pull.'
    >>> placeholder_of(b"#?RADIANCE")
    ''
    """
    for noun, place, mark in _ARCHIVES:
        if mark.match(start, place):
            return f"{noun}, expected what it holds; unpack it."
    text = start.removeprefix(b"\xef\xbb\xbf")
    if text[:2] in (b"\xff\xfe", b"\xfe\xff"):  # in UTF-16 every second byte of ASCII letters is 0
        text = text[2:].replace(b"\0", b"")
    for mark, noun, command in _POINTERS:
        if mark.match(text):
            return f"{noun}, expected the file itself; fetch it by {command}."
    if page := _PAGE.match(text):
        noun = "an error message of a server" if page["error"] else "an HTML page"
        return f"{noun}, expected the file itself; download it again, by the link of the file."
    return ""
