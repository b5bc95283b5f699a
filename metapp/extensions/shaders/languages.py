"""The neutral source of `source` in shading languages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

_FUNCTION = re.compile(r"^fn (\w+) (\w+)\((.*)\) \{$", re.MULTILINE)
_DECLARED = re.compile(r"\b(let|var) (\w+) (\w+) =")
_PLAIN = re.compile(r"(?<![\w.])(\d+(?:\.\d*)?e[-+]?\d+|\d+\.\d*)")
_TYPES = re.compile(r"\b(float3|float)\b")
_COMPONENT = re.compile(r"\.([xyz])\b")


class Language(NamedTuple):
    """How a language writes things.

    Attributes:
        suffix: of files.
        types: its names of `float` and `float3`.
        function: a function's head, of its type, name and arguments.
        argument: of a type and a name.
        declared: a declaration, of `let` or `var`, type and name.
        plain: a suffix of all other numbers.
        head, tail: the beginning and end of a file.
        indexed: whether components are written as [0].
    """

    suffix: str
    types: Mapping[str, str]
    function: str = "{type} {name}({arguments}) {{"
    argument: str = "{type} {name}"
    declared: Mapping[str, str] = {"let": "{type} {name} =", "var": "{type} {name} ="}
    plain: str = ""
    head: str = ""
    tail: str = ""
    indexed: bool = False


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
    "cpp": Language("h", _HLSL, function="inline {type} {name}({arguments}) {{", plain="f", head=_CPP, tail="}\n"),
    "glsl": Language("glsl", {"float": "float", "float3": "vec3"}),
    "hlsl": Language("hlsl", _HLSL),
    "osl": Language("osl", {"float": "float", "float3": "vector"}, tail=_OSL, indexed=True),
    "wgsl": Language(
        "wgsl",
        {"float": "f32", "float3": "vec3f"},
        function="fn {name}({arguments}) -> {type} {{",
        argument="{name}: {type}",
        declared={"let": "let {name}: {type} =", "var": "var {name}: {type} ="},
    ),
}


def translate_source(source: str, name: str, language: Language) -> str:
    """The neutral source of a material in a language.

    Args:
        source: of `source_of`.
        name: the material's, which its functions begin with.
        language: one of LANGUAGES.
    """
    types = language.types

    def function(match: re.Match[str]) -> str:
        pairs = (argument.split() for argument in match[3].split(", "))
        arguments = ", ".join(language.argument.format(type=types[of], name=each) for of, each in pairs)
        return language.function.format(type=types[match[1]], name=match[2], arguments=arguments)

    def declared(match: re.Match[str]) -> str:
        return language.declared[match[1]].format(type=types[match[2]], name=match[3])

    text = _FUNCTION.sub(function, source)
    text = _DECLARED.sub(declared, text)
    text = _TYPES.sub(lambda match: types[match[1]], text)
    if language.plain:
        text = _PLAIN.sub(rf"\1{language.plain}", text)
    if language.indexed:
        text = _COMPONENT.sub(lambda match: f"[{'xyz'.index(match[1])}]", text)
    return f"{language.head}{text}{language.tail.replace('NAME', name)}"
