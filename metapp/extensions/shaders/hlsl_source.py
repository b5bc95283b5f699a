"""A BRDF as HLSL, which `languages` translates into other languages.

The code has neither arrays nor loops, and assigns each variable once: every language takes sums of products, and
compilers map them to the hardware. This module knows NBRDF networks and sampling lobes, but no other language.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from importlib import resources

from torch import Tensor

from metapp.appearance.lobes import LAST_VIEWER_RAD, VIEWER_NODES, LobeMixture
from metapp.apps.brdf.brdf_network import PlainLayers

COMMON_SOURCE = """\
// Reflectance in 1/sr, linear RGB, without the cosine; wi and wo point away from the surface, whose normal is z.
float3 NAME_eval(float3 wi, float3 wo) {
    if (min(wi.z, wo.z) <= 0.0) {
        return float3(0.0, 0.0, 0.0);
    }
    float3 total = wi + wo;
    float len = length(total);
    float3 h = total / len;
    float3 angle = NAME_azimuth(h);
    float3 d = NAME_difference(wi, h, len);
    LAYERS
}

// Shares of three densities, the cosine's first, for the angle of wo.
float3 NAME_shares(float cosine) {
    float place = min(acos(min(cosine, 1.0)) * SCALE, FINAL);
    return SHARES;
}

// The GGX roughness of the lobe that a number in [0, 1), at least shares.x, chooses.
float3 NAME_alpha(float3 shares, float number) {
    if (number < shares.x + shares.y) {
        return FIRST;
    }
    return SECOND;
}

// NAME_facets with what goes below the surface mirrored up: it integrates to 1 over the directions above.
float NAME_lobe(float3 wi, float3 wo, float3 alpha) {
    return NAME_facets(wi, wo, alpha) + NAME_facets(float3(wi.x, wi.y, -wi.z), wo, alpha);
}

// Density of NAME_sample per solid angle.
float NAME_pdf(float3 wi, float3 wo) {
    if (min(wi.z, wo.z) <= 0.0) {
        return 0.0;
    }
    float3 shares = NAME_shares(wo.z);
    return shares.x * wi.z / PI + shares.y * NAME_lobe(wi, wo, FIRST) + shares.z * NAME_lobe(wi, wo, SECOND);
}

// A direction above the surface, of three numbers in [0, 1).
float3 NAME_sample(float3 wo, float3 u) {
    float3 shares = NAME_shares(wo.z);
    if (u.z < shares.x) {
        float phi = 2.0 * PI * u.y;
        float radius = sqrt(u.x);
        return float3(radius * cos(phi), radius * sin(phi), sqrt(max(0.0, 1.0 - u.x)));
    }
    float3 h = NAME_facet(wo, NAME_alpha(shares, u.z), u.x, u.y);
    float3 wi = h * (2.0 * dot(wo, h)) - wo;
    return float3(wi.x, wi.y, max(abs(wi.z), 1e-6));
}
"""
# inputs of an NBRDF, in order: half vector and difference vector; the y of the half vector is always 0
NETWORK_INPUT_EXPRESSIONS = ("angle.x", "", "h.z", "d.x", "d.y", "d.z")


def hlsl_source(name: str, folded: PlainLayers, lobes: LobeMixture) -> str:
    """Write the functions <name>_eval, <name>_sample and <name>_pdf of an NBRDF network in HLSL.

    Args:
        name: the name that the names of functions begin with.
        folded: the network.
        lobes: the lobes that directions are sampled from.
    """
    replacements = {
        "NAME": name,
        "LAYERS": "\n    ".join(_layer_lines(name, folded.layers)),
        "SHARES": "\n        + ".join(_share_terms(lobes)),
        "SCALE": float_literal((VIEWER_NODES - 1) / LAST_VIEWER_RAD),
        "FINAL": float_literal(VIEWER_NODES - 1),
        "FIRST": f"float3({float_literal(lobes.alphas[0][0])}, {float_literal(lobes.alphas[0][1])}, 1.0)",
        "SECOND": f"float3({float_literal(lobes.alphas[1][0])}, {float_literal(lobes.alphas[1][1])}, 1.0)",
        "PI": float_literal(math.pi),
    }
    facets_source = (
        (resources.files("metapp.appearance") / "facets.hlsl").read_text(encoding="utf-8").split("\n\n", 1)[1]
    )
    return re.sub("|".join(replacements), lambda match: replacements[match[0]], f"{facets_source}\n{COMMON_SOURCE}")


def float_literal(value: float) -> str:
    """Write a number of 32 bits so that all languages read it as a float."""
    text = f"{value:.9g}"
    return text if set(text) & set(".e") else f"{text}.0"


def _layer_lines(name: str, layers: Sequence[tuple[Tensor, Tensor]]) -> list[str]:
    """Write the lines that evaluate the layers of a network and return the reflectance."""
    inputs: tuple[str, ...] = NETWORK_INPUT_EXPRESSIONS
    lines: list[str] = []
    for i, (weights, bias) in enumerate(layers):
        is_last, outputs = i == len(layers) - 1, []
        for row, (factors, shift) in enumerate(zip(weights.tolist(), bias.tolist(), strict=True)):
            products = zip(factors, inputs, strict=True)
            terms = [f"{float_literal(factor)} * {expression}" for factor, expression in products if expression]
            total = " + ".join([float_literal(shift), *terms])
            outputs.append(f"{'abc'[i]}{row}")
            if is_last:
                lines.append(f"float {outputs[-1]} = {name}_expm1(max(0.0, {total}));")
            else:
                lines.append(f"float {outputs[-1]} = max(0.0, {total});")
        inputs = tuple(outputs)
    return [*lines, f"return float3({', '.join(inputs)});"]


def _share_terms(lobes: LobeMixture) -> list[str]:
    """Write the terms whose sum is the shares of lobes, interpolated linearly between nodes by hat functions."""
    return [
        f"float3({', '.join(map(float_literal, shares))}) * max(0.0, 1.0 - abs(place - {float_literal(node)}))"
        for node, shares in enumerate(lobes.shares.tolist())
    ]
