"""A BRDF as source code of a neutral shading language, which `languages` writes in others.

Its statements are those of HLSL, but that declarations say `let` (a name for a value) or `var` (a variable), functions
`fn`. `real` is the number type of the network's layers, `@` stands before a number of that type. No arrays and no
loops: every language takes sums of products, and compilers make of them what the hardware has.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from torch import Tensor

from metapp.appearance.lobes import LAST, NODES, Lobes
from metapp.apps.brdf.network import Folded

COMMON = """\
fn float NAME_expm1(float x) {
    if (x < 0.01) {
        return x * (1.0 + x * (0.5 + x / 6.0));
    }
    return exp(x) - 1.0;
}

// Reflectance in 1/sr, linear RGB, without the cosine; wi and wo point away from the surface, whose normal is z.
fn float3 NAME_eval(float3 wi, float3 wo) {
    if (min(wi.z, wo.z) <= 0.0) {
        return float3(0.0, 0.0, 0.0);
    }
    let float3 total = wi + wo;
    let float len = length(total);
    let float3 h = total / len;
    let float square = h.x * h.x + h.y * h.y;
    var float sine = 0.0;
    var float cos_phi = 1.0;
    var float sin_phi = 0.0;
    if (square > 0.0) {
        sine = sqrt(square);
        cos_phi = h.x / sine;
        sin_phi = h.y / sine;
    }
    let float x = cos_phi * wi.x + sin_phi * wi.y;
    let real half_x = real(sine);
    let real half_z = real(h.z);
    let real d_x = real(h.z * x - sine * wi.z);
    let real d_y = real(cos_phi * wi.y - sin_phi * wi.x);
    let real d_z = real(0.5 * len);
LAYERS
}

// Shares of three densities, the cosine's first, for the angle of wo.
fn float3 NAME_shares(float cosine) {
    let float place = min(acos(min(cosine, 1.0)) * SCALE, FINAL);
    var float3 shares = float3(0.0, 0.0, 0.0);
SHARES
    return shares;
}

// Density of a mirror at those facets of GGX roughness alpha that are visible from wo; wi may be below the surface.
fn float NAME_facets(float3 wi, float3 wo, float alpha) {
    let float3 total = wi + wo;
    if (total.z <= 0.0) {
        return 0.0;
    }
    let float3 h = normalize(total);
    let float spread = (h.x * h.x + h.y * h.y) / (alpha * alpha) + h.z * h.z;
    let float slope = alpha * alpha * (wo.x * wo.x + wo.y * wo.y) + wo.z * wo.z;
    return 1.0 / (2.0 * PI * alpha * alpha * spread * spread * (wo.z + sqrt(slope)));
}

// The same with what goes below the surface mirrored up: it integrates to 1 over the directions above.
fn float NAME_lobe(float3 wi, float3 wo, float alpha) {
    return NAME_facets(wi, wo, alpha) + NAME_facets(float3(wi.x, wi.y, -wi.z), wo, alpha);
}

// Density of NAME_sample per solid angle.
fn float NAME_pdf(float3 wi, float3 wo) {
    if (min(wi.z, wo.z) <= 0.0) {
        return 0.0;
    }
    let float3 shares = NAME_shares(wo.z);
    return shares.x * wi.z / PI + shares.y * NAME_lobe(wi, wo, FIRST) + shares.z * NAME_lobe(wi, wo, SECOND);
}

// A direction above the surface, of three numbers in [0, 1).
fn float3 NAME_sample(float3 wo, float3 u) {
    let float3 shares = NAME_shares(wo.z);
    let float phi = 2.0 * PI * u.y;
    if (u.z < shares.x) {
        let float radius = sqrt(u.x);
        return float3(radius * cos(phi), radius * sin(phi), sqrt(max(0.0, 1.0 - u.x)));
    }
    var float alpha = SECOND;
    if (u.z < shares.x + shares.y) {
        alpha = FIRST;
    }
    let float3 stretched = normalize(float3(alpha * wo.x, alpha * wo.y, wo.z));
    let float z = (1.0 - u.x) * (1.0 + stretched.z) - stretched.z;
    let float sine = sqrt(max(0.0, 1.0 - z * z));
    let float3 cap = float3(sine * cos(phi), sine * sin(phi), z) + stretched;
    let float3 h = normalize(float3(alpha * cap.x, alpha * cap.y, cap.z));
    let float3 wi = h * (2.0 * dot(wo, h)) - wo;
    return float3(wi.x, wi.y, max(abs(wi.z), 1e-6));
}
"""
INPUTS = ("half_x", "", "half_z", "d_x", "d_y", "d_z")  # of an NBRDF; half_y is 0


def source_of(name: str, folded: Folded, lobes: Lobes) -> str:
    """The functions <name>_eval, <name>_sample and <name>_pdf of an NBRDF network and its sampling density."""
    parts = {
        "NAME": name,
        "LAYERS": "\n".join(f"    {line}" for line in _layers(name, folded.layers)),
        "SHARES": "\n".join(f"    {line}" for line in _shares(lobes)),
        "SCALE": number((NODES - 1) / LAST),
        "FINAL": number(NODES - 1),
        "FIRST": number(lobes.alphas[0][0]),
        "SECOND": number(lobes.alphas[1][0]),
        "PI": number(math.pi),
    }
    return re.sub("|".join(parts), lambda match: parts[match[0]], COMMON)


def number(value: float) -> str:
    """A number of 32 bits as all languages read it."""
    text = f"{value:.9g}"
    return text if set(text) & set(".e") else f"{text}.0"


def _layers(name: str, layers: Sequence[tuple[Tensor, Tensor]]) -> list[str]:
    inputs: tuple[str, ...] = INPUTS
    lines: list[str] = []
    for i, (weights, bias) in enumerate(layers):
        last, outputs = i == len(layers) - 1, []
        for row, (factors, shift) in enumerate(zip(weights.tolist(), bias.tolist(), strict=True)):
            terms = [f"@{number(factor)} * {of}" for factor, of in zip(factors, inputs, strict=True) if of]
            total = " + ".join([f"@{number(shift)}", *terms])
            outputs.append(f"{'abc'[i]}{row}")
            if last:
                lines.append(f"let float {outputs[-1]} = {name}_expm1(max(0.0, float({total})));")
            else:
                lines.append(f"let real {outputs[-1]} = max(@0.0, {total});")
        inputs = tuple(outputs)
    return [*lines, f"return float3({', '.join(inputs)});"]


def _shares(lobes: Lobes) -> list[str]:
    """Linear between nodes: a hat function each."""
    lines = []
    for node, shares in enumerate(lobes.shares.tolist()):
        vector = ", ".join(map(number, shares))
        lines.append(f"shares = shares + float3({vector}) * max(0.0, 1.0 - abs(place - {number(node)}));")
    return lines
