"""The translation of neutral source code into shading languages and C++.

The neutral language, see `neutral_source`, is so simple that a few replacements by regular expressions translate it.
This module does not know what the code computes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

_FUNCTION_HEAD = re.compile(r"^fn (\w+) (\w+)\((.*)\) \{$", re.MULTILINE)
_DECLARATION = re.compile(r"\b(let|var) (\w+) (\w+) =")
_FLOAT_LITERAL = re.compile(r"(?<![\w.])(\d+(?:\.\d*)?e[-+]?\d+|\d+\.\d*)")
_TYPE = re.compile(r"\b(float3|float)\b")
_COMPONENT = re.compile(r"\.([xyz])\b")


class Language(NamedTuple):
    """The syntax of a language.

    Attributes:
        suffix: the suffix of its files.
        types: its names of `float` and `float3`.
        function: the head of a function, a template with {type}, {name} and {arguments}.
        argument: an argument of a function, a template with {type} and {name}.
        declarations: the declarations by `let` and by `var`, templates with {type} and {name}.
        float_suffix: the suffix of literals of numbers.
        head: the beginning of a file.
        tail: the end of a file, in which NAME is replaced by the name of the material.
        is_indexed: whether components of vectors are written as [0], [1], [2] in place of .x, .y, .z.
    """

    suffix: str
    types: Mapping[str, str]
    function: str = "{type} {name}({arguments}) {{"
    argument: str = "{type} {name}"
    declarations: Mapping[str, str] = {"let": "{type} {name} =", "var": "{type} {name} ="}
    float_suffix: str = ""
    head: str = ""
    tail: str = ""
    is_indexed: bool = False


_HLSL = {"float": "float", "float3": "float3"}
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
        "h", _HLSL, function="inline {type} {name}({arguments}) {{", float_suffix="f", head=_CPP, tail="}\n"
    ),
    "glsl": Language("glsl", {"float": "float", "float3": "vec3"}),
    "hlsl": Language("hlsl", _HLSL),
    "osl": Language("osl", {"float": "float", "float3": "vector"}, tail=_OSL, is_indexed=True),
    "wgsl": Language(
        "wgsl",
        {"float": "f32", "float3": "vec3f"},
        function="fn {name}({arguments}) -> {type} {{",
        argument="{name}: {type}",
        declarations={"let": "let {name}: {type} =", "var": "var {name}: {type} ="},
    ),
}


def translate_source(source: str, name: str, language: Language) -> str:
    """Translate the neutral source of a material into a language.

    Args:
        source: the neutral source, see :func:`metapp.extensions.shaders.neutral_source.brdf_source`.
        name: the name of the material, by which the names of its functions begin.
        language: the language, one of LANGUAGES.

    Returns:
        The content of a file.
    """
    types = language.types

    def write_function(match: re.Match[str]) -> str:
        pairs = (argument.split() for argument in match[3].split(", "))
        arguments = ", ".join(
            language.argument.format(type=types[type_name], name=argument) for type_name, argument in pairs
        )
        return language.function.format(type=types[match[1]], name=match[2], arguments=arguments)

    def write_declaration(match: re.Match[str]) -> str:
        return language.declarations[match[1]].format(type=types[match[2]], name=match[3])

    text = _FUNCTION_HEAD.sub(write_function, source)
    text = _DECLARATION.sub(write_declaration, text)
    text = _TYPE.sub(lambda match: types[match[1]], text)
    if language.float_suffix:
        text = _FLOAT_LITERAL.sub(rf"\1{language.float_suffix}", text)
    if language.is_indexed:
        text = _COMPONENT.sub(lambda match: f"[{'xyz'.index(match[1])}]", text)
    return f"{language.head}{text}{language.tail.replace('NAME', name)}"
