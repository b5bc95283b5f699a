"""Names of files of materials' maps: the words that tell a map's role, and marks of variants, tiles and resolutions.

Names alone are looked at, never a file.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

NORMAL_ROLES = ("normal (OpenGL)", "normal", "normal (DirectX)")  # green points up, is not stated, points down
PLAIN_COLOUR_ROLE = "plain"  # the role of a colour that only its place beside other maps tells
COLOUR_ROLES = ("base colour", "diffuse", PLAIN_COLOUR_ROLE)
# The roles of red, green, blue and alpha in files that pack several maps; "" for a channel that is not read.
PACKED_CHANNEL_ROLES = {
    "occlusion, roughness, metallic": ("", "roughness", "metallic"),
    "roughness, metallic": ("roughness", "metallic"),
    "metallic, roughness": ("metallic", "roughness"),
    "metallic, gloss": ("metallic", "", "", "gloss"),
}

# The words of each role, in small letters; all of two letters or more may end in "map".
_ROLE_WORDS = {
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
# The endings that say, behind a word for normals, where green points.
_NORMAL_ENDINGS = {"normal (OpenGL)": ("gl", "ogl", "opengl"), "normal (DirectX)": ("dx", "directx")}
_MAX_ROLE_WORDS = 4  # words that one role may consist of, such as NormalMapOpenGL's

_WORD = re.compile(r"\d+[kK](?![a-z])|[A-Z]+(?![a-z])\d*|[A-Z]?[a-z]+\d*|\d+")
_RESOLUTION = re.compile(r"\d{1,2}k|128|256|512|1024|2048|4096|8192|x\d{3,4}|jpe?g|png|tiff?|exr", re.IGNORECASE)
_MARK = re.compile(r"VAR\d+|1\d{3}", re.IGNORECASE)  # marks of variants, and of tiles (UDIM)
_WORKFLOWS = ("METALNESS", "SPECULAR")  # marks that follow roles in capitals, as in COL_2K_METALNESS


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


def _list_word_roles() -> dict[str, str]:
    """Return the role of each word that files' names may end in."""
    word_roles = {word: role for role, words in _ROLE_WORDS.items() for word in words.split()}
    all_roles = {f"{word}map": role for word, role in word_roles.items() if len(word) > 1} | word_roles
    normal_words = [word for word, role in all_roles.items() if role == "normal" and len(word) > 1]
    return all_roles | {
        f"{word}{ending}": role
        for word in normal_words
        for role, endings in _NORMAL_ENDINGS.items()
        for ending in endings
    }


_ROLES = _list_word_roles()


def parse_map_name(stem: str) -> MapName:
    """Split the stem of a file into the material's name, a mark, and the role that its last words tell.

    >>> parse_map_name("RockNormalGL_4k")
    MapName(material='Rock', mark='', role='normal (OpenGL)')
    >>> parse_map_name("ROCK_COL_VAR1")
    MapName(material='ROCK', mark='VAR1', role='base colour')
    >>> parse_map_name("rock")
    MapName(material='rock', mark='', role=None)
    """
    words = [*_WORD.finditer(stem)]
    marks = []
    while len(words) > 1 and (_RESOLUTION.fullmatch(word := words[-1].group()) or _MARK.fullmatch(word)):
        marks += [word] * (not _RESOLUTION.fullmatch(word))
        words.pop()
    if words and words[-1].group() in _WORKFLOWS:
        name, mark, role = parse_map_name(stem_before := stem[: words[-1].start()].rstrip("_-. "))
        if role is not None and name and stem_before.removeprefix(name).isupper():
            return MapName(name, "_".join(filter(None, (mark, words[-1].group()))), role)
    for count in range(min(_MAX_ROLE_WORDS, len(words)), 0, -1):
        tail = "".join(word.group() for word in words[-count:]).lower()
        if tail in _ROLES:
            start = words[-count].start()
            if len(tail) > 1 or stem[max(start - 1, 0)] in "_-. ":  # a letter alone may be the end of a name
                return MapName(stem[:start].rstrip("_-. "), "_".join(reversed(marks)), _ROLES[tail])
    return MapName(stem, "", None)


def is_unused_map(file: Path) -> bool:
    """Tell by its name whether a file is a map that is of no use alone, such as heights and packed channels."""
    return parse_map_name(file.stem).role in ("", *PACKED_CHANNEL_ROLES)
