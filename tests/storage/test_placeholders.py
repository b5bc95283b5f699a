"""Files that cannot be read, such as Git LFS pointers, are refused by every reader; texts have several encodings."""

import bz2
import codecs
import gzip
import lzma
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from data_tools.readers import environment_maps, merl, square_photos
from metapp.storage.files import check_readable, open_text, placeholder_line, read_text
from tests.pictures import noise_image, write_image

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 34992012\n"
PAGE = b"<!DOCTYPE html>\n<html><head><title>Not found</title></head></html>"
PLACEHOLDERS = {
    "a Git LFS pointer, expected the file itself; fetch it by git lfs pull.": POINTER,
    "an HTML page, expected the file itself; download it again": PAGE,
    "an HTML page": b"\n\n<html lang=en>",
    "packed, as archives and spreadsheets (.xlsx) are, expected the file itself; unpack it": gzip.compress(b"a"),
    "packed, as archives": b"PK\x03\x04\x14\0",
    "packed": bz2.compress(b"a"),
    "packed,": lzma.compress(b"a"),
    "a PDF document, expected the file itself; export": b"%PDF-1.7\n1 0 obj",
}


@pytest.mark.parametrize(("line", "content"), PLACEHOLDERS.items(), ids=range(len(PLACEHOLDERS)))
def test_a_placeholder_is_refused_by_every_reader(tmp_path: Path, line: str, content: bytes) -> None:
    readers: dict[str, Callable[[Path], object]] = {
        "gold.binary": merl.find, "sky.hdr": environment_maps.read_task, "rock.jpg": square_photos.read_task,
        "camera.txt": read_text,
    }  # fmt: skip
    for name, read in readers.items():
        (file := tmp_path / name).write_bytes(content)
        for refuse in (check_readable, read):
            with pytest.raises(ValueError, match=f"^{re.escape(f'{file}: {line}')}"):
                refuse(file)


def test_a_name_that_is_not_utf_8_is_refused(tmp_path: Path) -> None:
    """As old archives from other systems leave it."""
    (file := tmp_path / os.fsdecode(b"caf\xe9.jpg")).write_bytes(b"")
    for refuse in (check_readable, square_photos.read_task, read_text):
        with pytest.raises(ValueError, match=r"caf\\udce9.jpg': a name that is not UTF-8, .*; rename it"):
            refuse(file)


@pytest.mark.parametrize("content", [b"", b"x", b"#?RADIANCE\n", b"<scene version='3.0.0'/>", b"theta_i,phi_i\n"])
def test_a_file_that_is_itself_is_no_placeholder(tmp_path: Path, content: bytes) -> None:
    (file := tmp_path / "a").write_bytes(content)
    check_readable(file)
    assert placeholder_line(file) == ""


def test_every_kind_of_image_is_itself(tmp_path: Path) -> None:
    for suffix in (".png", ".jpg", ".tif", ".exr", ".hdr", ".bmp", ".tga", ".webp", ".jp2"):
        values = noise_image(40, 40).astype("float32") / 255 if suffix in (".exr", ".hdr") else noise_image(40, 40)
        check_readable(write_image(tmp_path / f"a{suffix}", values))


def test_a_folder_of_pointers_names_the_first(tmp_path: Path) -> None:
    for name in ("a.binary", "b.binary"):
        (tmp_path / name).write_bytes(POINTER)
    with pytest.raises(ValueError, match=r"a\.binary: a Git LFS pointer"):
        merl.find(tmp_path)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("big", [False, True])
def test_texts_have_neither_byte_order_marks_nor_foreign_line_ends(
    tmp_path: Path, end: str, encoding: str, big: bool
) -> None:
    content = f"10,ä{end}20{end}".encode(encoding)
    if big and encoding == "utf-16":
        content = codecs.BOM_UTF16_BE + f"10,ä{end}20{end}".encode("utf-16-be")
    (file := tmp_path / "a.txt").write_bytes(content)
    assert read_text(file) == "10,ä\n20\n"
    with open_text(file) as lines:
        assert list(lines) == ["10,ä\n", "20\n"]


def test_a_text_in_no_known_encoding_is_no_text(tmp_path: Path) -> None:
    (file := tmp_path / "a.txt").write_bytes(b"10,\xe4\n")
    with pytest.raises(UnicodeDecodeError):
        read_text(file)
