"""The translation of HLSL into other shading languages and C++.

The HLSL of a BRDF, see `hlsl_source`, is so simple that a table of substitutions translates it.

Slang's compiler (2026.14) cannot take the table's place. It has no OSL, and writes GLSL and HLSL only as whole programs
with an entry point, not as functions to include. It renames brdf_gold_eval to brdf_gold_eval_0 and most variables to
_S1, _S2 and so on, drops all comments, and puts 4,300 lines before 170 of C++.
"""

from __future__ import annotations

import re
from typing import NamedTuple


class Language(NamedTuple):
    """How a language differs from HLSL.

    Attributes:
        suffix: the suffix of its files.
        substitutions: regular expressions and their replacements, in the order in which they are applied to lines.
        head: the beginning of a file.
        tail: the end of a file, in which NAME is replaced by the name of the material.
    """

    suffix: str
    substitutions: tuple[tuple[str, str], ...] = ()
    head: str = ""
    tail: str = ""


_CPP = """\
#pragma once
#include <algorithm>
#include <cmath>

#ifndef METAPP_FLOAT3
#define METAPP_FLOAT3
struct float3 {
    float x, y, z;
    float3(float x, float y, float z) : x(x), y(y), z(z) {}
};
inline float3 operator+(float3 a, float3 b) { return float3(a.x + b.x, a.y + b.y, a.z + b.z); }
inline float3 operator-(float3 a, float3 b) { return float3(a.x - b.x, a.y - b.y, a.z - b.z); }
inline float3 operator*(float3 a, float b) { return float3(a.x * b, a.y * b, a.z * b); }
inline float3 operator/(float3 a, float b) { return float3(a.x / b, a.y / b, a.z / b); }
inline float dot(float3 a, float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline float length(float3 a) { return std::sqrt(dot(a, a)); }
inline float3 normalize(float3 a) { return a / length(a); }
#endif

namespace metapp {
using std::abs, std::acos, std::cos, std::exp, std::max, std::min, std::sin, std::sqrt;

"""
_OSL = """
shader NAME(vector wi = vector(0, 0, 1), vector wo = vector(0, 0, 1), output color reflectance = 0) {
    vector value = NAME_eval(wi, wo);
    reflectance = color(value[0], value[1], value[2]);
}
"""
LANGUAGES = {
    "cpp": Language(
        "h",
        (
            (r"^(float3?) ", r"inline \1 "),
            (r"(?<![\w.])(\d+(?:\.\d*)?e[-+]?\d+|\d+\.\d*)", r"\1f"),
        ),
        head=_CPP,
        tail="}\n",
    ),
    "glsl": Language("glsl", ((r"\bfloat3\b", "vec3"),)),
    "hlsl": Language("hlsl"),
    "osl": Language(
        "osl",
        ((r"\bfloat3\b", "vector"), (r"\.x\b", "[0]"), (r"\.y\b", "[1]"), (r"\.z\b", "[2]")),
        tail=_OSL,
    ),
    "wgsl": Language(
        "wgsl",
        (
            (r"^(float3?) (\w+)\((.*)\) \{$", r"fn \2(\3) -> \1 {"),
            (r"\b(float3?) (\w+)(?=[,)])", r"\2: \1"),  # an argument
            (r"\b(float3?) (\w+) =", r"let \2: \1 ="),
            (r"\bfloat3\b", "vec3f"),
            (r"\bfloat\b", "f32"),
        ),
    ),
}


def translate_source(source: str, name: str, language: Language) -> str:
    """Translate the HLSL of a material into a language.

    Args:
        source: the HLSL, see :func:`metapp.extensions.shaders.hlsl_source.hlsl_source`.
        name: the name of the material, by which the names of its functions begin.
        language: the language, one of LANGUAGES.

    Returns:
        The content of a file.
    """
    for pattern, replacement in language.substitutions:
        source = re.sub(pattern, replacement, source, flags=re.MULTILINE)
    return f"{language.head}{source}{language.tail.replace('NAME', name)}"
