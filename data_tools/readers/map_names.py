"""Names of files of materials' maps: the words that tell a map's role, and marks of variants, tiles and resolutions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

NORMAL_ROLES = ("normal (OpenGL)", "normal", "normal (DirectX)")  # green points up, is not said, points down
PLAIN_COLOUR_ROLE = "plain"  # the role of a colour that only its place beside other maps tells
COLOUR_ROLES = ("base colour", "diffuse", PLAIN_COLOUR_ROLE)
# the roles of red, green, blue and alpha of files that pack them; "" for a channel that is not read
PACKED_CHANNEL_ROLES = {
    "occlusion, roughness, metallic": ("", "roughness", "metallic"),
    "roughness, metallic": ("roughness", "metallic"),
    "metallic, roughness": ("metallic", "roughness"),
    "metallic, gloss": ("metallic", "", "", "gloss"),
}

# The words of each role, in small letters; all of two letters or more may end in "map".
_WORDS = {
    "diffuse": "diffuse diff d",
    "base colour": "albedo alb basecolor basecolour color colour col bc c albedotransparency",
    "normal": "normal normals norm nrm nor nml nrm16 n",
    "roughness": "roughness rough rgh r",
    "gloss": "gloss glossiness smoothness g",
    "specular": "specular spec f0 refl reflection s",
    "metallic": "metallic metalness metal met mtl m",
    # maps that are of no use here, but no base colour either
    "": "ambientocclusion ao occlusion height disp displacement disp16 bump bump16 opacity alpha alphamasked mask "
    "emissive emission glow reflect cavity curvature preview thumb thumbnail render translucency transmission sheen "
    "fuzz anisotropy thickness h e o",
    "occlusion, roughness, metallic": "arm orm occlusionroughnessmetallic aoroughnessmetallic metallicroughness "
    "roughnessmetallic",
    "roughness, metallic": "rma",
    "metallic, roughness": "mra",
    "metallic, gloss": "metallicsmoothness metallicgloss maskmap",
}
# What follows a word of normals.
_GREEN = {"normal (OpenGL)": ("gl", "ogl", "opengl"), "normal (DirectX)": ("dx", "directx")}
_MOST_WORDS = 4  # that a role is made of, such as NormalMapOpenGL's

_WORD = re.compile(r"\d+[kK](?![a-z])|[A-Z]+(?![a-z])\d*|[A-Z]?[a-z]+\d*|\d+")
_RESOLUTION = re.compile(r"\d{1,2}k|128|256|512|1024|2048|4096|8192|x\d{3,4}|jpe?g|png|tiff?|exr", re.IGNORECASE)
_MARK = re.compile(r"VAR\d+|1\d{3}", re.IGNORECASE)  # of variants, and of tiles (UDIM)
_WORKFLOWS = ("METALNESS", "SPECULAR")  # behind roles in capitals, COL_2K_METALNESS: marks, too


class MapName(NamedTuple):
    """The parts of a file's stem.

    Attributes:
        material: the material's name as written; "" if the stem is a role alone.
        mark: the mark of a variant or tile; "" for none.
        role: the map's role; "" for a map that is of no use here, None for a file that is called after no role.
    """

    material: str
    mark: str
    role: str | None


def _role_of_words() -> dict[str, str]:
    """Return the role of each word that files' names end in."""
    plain = {word: role for role, words in _WORDS.items() for word in words.split()}
    mapped = {f"{word}map": role for word, role in plain.items() if len(word) > 1} | plain
    normals = [word for word, role in mapped.items() if role == "normal" and len(word) > 1]
    return mapped | {f"{word}{end}": role for word in normals for role, ends in _GREEN.items() for end in ends}


_ROLES = _role_of_words()


def parse_map_name(stem: str) -> MapName:
    """Split the stem of a file into the material's name, a mark, and the role that its last words tell.

    >>> map_name("RockNormalGL_4k")
    MapName(material='Rock', mark='', role='normal (OpenGL)')
    >>> map_name("ROCK_COL_VAR1")
    MapName(material='ROCK', mark='VAR1', role='base colour')
    >>> map_name("rock")
    MapName(material='rock', mark='', role=None)
    """
    words = [*_WORD.finditer(stem)]
    marks = []
    while len(words) > 1 and (_RESOLUTION.fullmatch(word := words[-1].group()) or _MARK.fullmatch(word)):
        marks += [word] * (not _RESOLUTION.fullmatch(word))
        words.pop()
    if words and words[-1].group() in _WORKFLOWS:
        name, mark, role = parse_map_name(before := stem[: words[-1].start()].rstrip("_-. "))
        if role is not None and name and before.removeprefix(name).isupper():
            return MapName(name, "_".join(filter(None, (mark, words[-1].group()))), role)
    for count in range(min(_MOST_WORDS, len(words)), 0, -1):
        tail = "".join(word.group() for word in words[-count:]).lower()
        if tail in _ROLES:
            start = words[-count].start()
            if len(tail) > 1 or stem[max(start - 1, 0)] in "_-. ":  # a letter alone may be the end of a name
                return MapName(stem[:start].rstrip("_-. "), "_".join(reversed(marks)), _ROLES[tail])
    return MapName(stem, "", None)


def is_unused_map(file: Path) -> bool:
    """Tell whether a file is a map that is of no use alone, by its name, such as heights and packed channels."""
    return parse_map_name(file.stem).role in ("", *PACKED_CHANNEL_ROLES)
