"""The default BRDF set: isotropic materials from reflection models, drawn to be as varied as a measured set.

Every material is reciprocal, non-negative and reflects at most what it receives. Families take turns, so any count
holds a mix of them; within a family, hue, roughness and lightness follow a low-discrepancy sequence, so a small set
still covers the range. Random numbers are PCG64's raw uniforms, the same on every machine.
"""

from __future__ import annotations

import colorsys
import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from metapp.geometry import (
    Cosines,
    MicrofacetKind,
    cosines,
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_schlick,
    gauss_legendre,
    microfacet_lobe,
    rough_reflectance,
    rough_transmittance,
)

Rgb = tuple[float, float, float]
Model = Callable[[Cosines], Tensor]  # cosines [...] -> BRDF [..., 3], wherever both directions are above the horizon


class Material(NamedTuple):
    """One material.

    Attributes:
        name: family, what it is, and a number that is unique within the split ("t" before it: test).
        evaluate: BRDF [..., 3] in 1/sr, linear RGB, >= 0, of angles [..., 3] in rad; 0 below the horizon.
    """

    name: str
    evaluate: Callable[[Tensor], Tensor]


# Complex indices (eta, k) for linear RGB. First what Mitsuba 3.9.1, variant scalar_rgb, makes of the spectra it ships.
# Then metals it does not ship, at 650, 550 and 450 nm, from refractiveindex.info's selection for 3D artists (iron and
# titanium: Johnson and Christy 1974; platinum: Rakic et al. 1998; brass, 70 % copper: Querry 1985).
CONDUCTORS: dict[str, tuple[Rgb, Rgb]] = {
    "gold": ((0.143036, 0.375307, 1.442045), (3.982997, 2.385556, 1.603359)),
    "silver": ((0.155276, 0.116728, 0.138388), (4.828354, 3.122222, 2.146901)),
    "copper": ((0.201005, 0.92375, 1.102215), (3.913262, 2.453045, 2.14209)),
    "aluminium": ((1.657501, 0.880405, 0.521244), (9.223811, 6.269502, 4.837004)),
    "chromium": ((4.369668, 2.916505, 1.654905), (5.206547, 4.231306, 3.754699)),
    "nickel": ((2.367304, 1.663373, 1.467078), (4.498812, 3.050153, 2.345439)),
    "tungsten": ((4.370816, 3.300246, 2.998407), (3.500641, 2.604874, 2.273233)),
    "titanium-nitride": ((1.64845, 1.150516, 1.379824), (3.368328, 1.943498, 1.102068)),
    "vanadium-nitride": ((2.865602, 2.119189, 1.940091), (3.032242, 2.056116, 1.616306)),
    "tantalum": ((2.062721, 2.392939, 2.627929), (2.40836, 1.741486, 1.947028)),
    "copper-oxide": ((3.247541, 2.447805, 2.21022), (0.52109, 0.570031, 0.722179)),
    "amorphous-carbon": ((2.944046, 2.227136, 1.968162), (0.887465, 0.799298, 0.81529)),
    "iron": ((2.9114, 2.9497, 2.5845), (3.0893, 2.9318, 2.7670)),
    "titanium": ((2.7407, 2.5418, 2.2670), (3.8143, 3.4345, 3.0385)),
    "platinum": ((2.3757, 2.0847, 1.8453), (4.2655, 3.7153, 3.1365)),
    "brass": ((0.444, 0.527, 1.094), (3.695, 2.765, 1.829)),
}

_TABLE_SIZE = 64


class _Draws:
    """Uniform numbers of one material: the first three spread evenly over its family, the others independent."""

    def __init__(self, split: str, seed: int, family: int, member: int) -> None:
        key = [seed, ("train", "test").index(split), family]
        shift = np.random.Generator(np.random.PCG64(np.random.SeedSequence(key))).random(3)
        # Kronecker sequences: the golden ratio for the hue, for the others its kin in the plane (Roberts 2018).
        spread = (shift + member * np.array([0.6180339887498949, 0.7548776662466927, 0.5698402909980532])) % 1
        self.hue, self.roughness, self.lightness = (float(value) for value in spread)
        self._rest = np.random.Generator(np.random.PCG64(np.random.SeedSequence([*key, member])))

    def between(self, low: float, high: float) -> float:
        return low + (high - low) * float(self._rest.random())

    def chance(self, probability: float) -> bool:
        return float(self._rest.random()) < probability

    def alpha(self, low: float, high: float) -> float:
        """Roughness, evenly spread over its logarithm."""
        return low * (high / low) ** self.roughness

    def kind(self) -> MicrofacetKind:
        return "ggx" if self.chance(0.65) else "beckmann"

    def colour(self, darkest: float = 0.03, brightest: float = 0.9, saturation: tuple[float, float] = (0.1, 1)) -> Rgb:
        """A linear RGB albedo: this material's hue, its brightest channel between the two given."""
        srgb_value = (darkest ** (1 / 2.2)) + (brightest ** (1 / 2.2) - darkest ** (1 / 2.2)) * self.lightness
        depth = self.between(*saturation) * (0.15 if self.chance(0.15) else 1.0)  # some are all but neutral
        red, green, blue = (channel**2.2 for channel in colorsys.hsv_to_rgb(self.hue, depth, srgb_value))
        return red, green, blue


def colour_name(linear_rgb: Rgb) -> str:
    """What to call a colour: a hue, or black, grey or white."""
    hue, saturation, value = colorsys.rgb_to_hsv(*(channel ** (1 / 2.2) for channel in linear_rgb))
    if value < 0.22:
        return "black"
    if saturation < 0.2:
        return "white" if value > 0.85 else "grey"
    names = ("red", "orange", "yellow", "lime", "green", "teal", "cyan", "azure", "blue", "violet", "magenta", "rose")
    name = names[round(hue * 12) % 12]
    return "brown" if name in ("red", "orange") and value < 0.6 and saturation > 0.3 else name


def roughness_name(alpha: float) -> str:
    """What to call a roughness."""
    return "polished" if alpha < 0.07 else "satin" if alpha < 0.16 else "brushed" if alpha < 0.32 else "rough"


def _interpolate(table: Tensor, cos: Tensor) -> Tensor:
    place = cos.clamp(0, 1) * (len(table) - 1)
    below = place.detach().long().clamp_max(len(table) - 2)
    table = table.to(cos)
    lower = table[below]
    return lower + (place - below) * (table[below + 1] - lower)


def _grid() -> Tensor:
    # Not 0 itself, where a direction sees no facet from the front.
    return torch.linspace(0, 1, _TABLE_SIZE, dtype=torch.float64).clamp_min(1e-6)


def directional_albedo(model: Model, cos: Tensor, points: int = 48) -> Tensor:
    """Share of the light from one direction that a BRDF without sharp lobes reflects, by quadrature.

    Args:
        model: the BRDF.
        cos: cosines of the direction, [N], float64.
        points: nodes per axis over the outgoing hemisphere.

    Returns:
        [N, 3].
    """
    nodes, weights = gauss_legendre(points)
    azimuth = (torch.arange(points, dtype=torch.float64) + 0.5) * (math.pi / points)
    incident, outgoing, phi = torch.broadcast_tensors(cos[:, None, None], nodes[:, None], azimuth)
    sines = ((1 - incident**2) * (1 - outgoing**2)).sqrt()
    difference = ((1 + incident * outgoing + sines * phi.cos()) / 2).clamp_min(1e-12).sqrt()
    half = (incident + outgoing) / (2 * difference)
    values = model(Cosines(incident, outgoing, half, difference))
    return (values * (outgoing * weights[:, None])[..., None]).sum((1, 2)) * (2 * math.pi / points)


def diffuse(albedo: Rgb) -> Model:
    """Lambert's law."""

    def model(at: Cosines) -> Tensor:
        return at.half.new_tensor(albedo).div(math.pi).expand(*at.half.shape, 3)

    return model


def oren_nayar(albedo: Rgb, sigma: float) -> Model:
    """Rough diffuse facets: Oren and Nayar (1994) in Fujii's form, which keeps energy; `sigma` in [0, 1]."""
    norm = 1 / (math.pi + (math.pi / 2 - 2 / 3) * sigma)

    def model(at: Cosines) -> Tensor:
        s = 2 * at.difference**2 - 1 - at.incident * at.outgoing
        # The quotient has a pole where both directions graze; the floor moves it under the horizon.
        t = torch.where(s > 0, torch.maximum(at.incident, at.outgoing).clamp_min(0.02), 1.0)
        return (norm * (1 + sigma * s / t)).clamp_min(0)[..., None] * at.half.new_tensor(albedo)

    return model


def conductor(eta: Rgb, k: Rgb, alpha: float, kind: MicrofacetKind) -> Model:
    """Bare rough metal; the same model as Mitsuba's `roughconductor`."""

    def fresnel(cos: Tensor) -> Tensor:
        return fresnel_conductor(cos, cos.new_tensor(eta), cos.new_tensor(k))

    return lambda at: microfacet_lobe(at, alpha, fresnel, kind)


def coated(base: Model, alpha: float, kind: MicrofacetKind, eta: float = 1.5) -> Model:
    """A rough dielectric interface over another model, which gets what the interface lets through, twice.

    Args:
        base: what is under the coat, in terms of the directions outside it.
        alpha: roughness of the coat.
        kind: its facets.
        eta: its index of refraction.

    Returns:
        The coated model. It keeps energy: base <= 1 gives reflected + transmitted <= 1.
    """

    def interface(cos: Tensor) -> Tensor:
        return fresnel_dielectric(cos, eta)

    through = rough_transmittance(_grid(), alpha, eta, kind)

    def model(at: Cosines) -> Tensor:
        both_ways = _interpolate(through, at.incident) * _interpolate(through, at.outgoing)
        return microfacet_lobe(at, alpha, interface, kind) + both_ways[..., None] * base(at)

    return model


def internal_reflectance(alpha: float, kind: MicrofacetKind, eta: float) -> float:
    """Share of diffuse light from within that a rough dielectric interface of index `eta` > 1 keeps inside."""
    nodes, weights = gauss_legendre(_TABLE_SIZE)
    kept = rough_reflectance(nodes, alpha, lambda cos: fresnel_dielectric(cos, 1 / eta), kind)[:, 0]
    return float((2 * weights * nodes * kept).sum())


def plastic(albedo: Rgb, alpha: float, kind: MicrofacetKind, eta: float = 1.49) -> Model:
    """A rough coat on a diffuse body, light bouncing between the two; Mitsuba's `roughplastic` with `nonlinear`.

    The bounces deepen the colour: the body's albedo a becomes a / (1 - a R), R the coat's reflectance from within.
    """
    kept = internal_reflectance(alpha, kind, eta)
    red, green, blue = (a / ((1 - a * kept) * eta * eta) for a in albedo)
    return coated(diffuse((red, green, blue)), alpha, kind, eta)


def absorbing_layer(base: Model, tint: Rgb, eta: float = 1.5) -> Model:
    """A clear coloured layer over a model: `tint` is what passes on a straight way in and out, in (0, 1]."""

    def model(at: Cosines) -> Tensor:
        ways = [(1 - (1 - cos * cos) / eta**2).rsqrt() for cos in (at.incident, at.outgoing)]
        return at.half.new_tensor(tint) ** ((ways[0] + ways[1]) / 2)[..., None] * base(at)

    return model


def flakes(colour: Rgb, alpha: float) -> Model:
    """Metal flakes scattered about the surface's plane: a wide lobe of the given colour."""

    def fresnel(cos: Tensor) -> Tensor:
        return fresnel_schlick(cos, cos.new_tensor(colour))

    return lambda at: microfacet_lobe(at, alpha, fresnel, "ggx")


def sheen(base: Model, colour: Rgb, roughness: float) -> Model:
    """Fibres standing on a base: Estevez and Kulla's "Charlie" (2017) with Neubelt and Pettineo's visibility.

    Args:
        base: what is under the fibres; it gets what they let through, both ways.
        colour: of the fibres; where they would reflect more than 0.7 of the light they are dimmed.
        roughness: in (0, 1]; lower draws the sheen to the rim.

    Returns:
        The model. Unlike the published one it is energy conserving by its albedo's complement, hence reciprocal.
    """
    power = 1 / roughness

    def fibres(at: Cosines) -> Tensor:
        sine = (1 - at.half * at.half).clamp_min(1e-12) ** (power / 2)
        around = 4 * (at.incident + at.outgoing - at.incident * at.outgoing).clamp_min(1e-3)
        return ((2 + power) / (2 * math.pi) * sine / around)[..., None] * at.half.new_tensor([1.0, 1.0, 1.0])

    albedo = directional_albedo(fibres, _grid())[:, 0]
    dim = min(1.0, 0.7 / float(albedo.max() * max(colour)))
    through = 1 - albedo * (dim * max(colour))

    def model(at: Cosines) -> Tensor:
        both_ways = _interpolate(through, at.incident) * _interpolate(through, at.outgoing)
        return fibres(at) * at.half.new_tensor(colour) * dim + both_ways[..., None] * base(at)

    return model


def mixture(first: Model, second: Model, share: float) -> Model:
    """Two materials side by side, finer than the eye: `share` of the first, the rest of the second."""
    return lambda at: share * first(at) + (1 - share) * second(at)


def _draw_conductor(draw: _Draws) -> tuple[str, Model]:
    metal = list(CONDUCTORS)[int(draw.hue * len(CONDUCTORS))]
    alpha = draw.alpha(0.03, 0.5)
    return f"{metal}-{roughness_name(alpha)}", conductor(*CONDUCTORS[metal], alpha, draw.kind())


def _draw_plastic(draw: _Draws) -> tuple[str, Model]:
    colour, alpha = draw.colour(), draw.alpha(0.12, 0.6)
    return f"{colour_name(colour)}-{roughness_name(alpha)}", plastic(colour, alpha, draw.kind(), draw.between(1.4, 1.7))


def _draw_glossy(draw: _Draws) -> tuple[str, Model]:
    colour, alpha = draw.colour(0.01), draw.alpha(0.03, 0.12)
    return f"{colour_name(colour)}-{roughness_name(alpha)}", plastic(colour, alpha, draw.kind(), draw.between(1.4, 1.7))


def _draw_coated_metal(draw: _Draws) -> tuple[str, Model]:
    metal = ("aluminium", "chromium", "silver", "titanium", "iron", "brass")[int(draw.between(0, 6))]
    tint, alpha = draw.colour(0.5, 0.98, (0.1, 0.75)), draw.alpha(0.08, 0.45)
    body = absorbing_layer(conductor(*CONDUCTORS[metal], alpha, draw.kind()), tint)
    return f"{colour_name(tint)}-{metal}-{roughness_name(alpha)}", coated(body, draw.between(0.03, 0.12), "ggx")


def _draw_paint(draw: _Draws) -> tuple[str, Model]:
    colour, alpha = draw.colour(0.15, 0.85, (0.2, 0.9)), draw.alpha(0.2, 0.55)
    ground = diffuse(draw.colour(0.02, 0.35, (0.3, 1)))
    body = mixture(flakes(colour, alpha), ground, draw.between(0.35, 0.85))
    return f"{colour_name(colour)}-{roughness_name(alpha)}", coated(body, draw.between(0.03, 0.08), draw.kind())


def _draw_fabric(draw: _Draws) -> tuple[str, Model]:
    colour, pile = draw.colour(0.02, 0.7), draw.between(0, 0.6)
    red, green, blue = (pile + (1 - pile) * channel for channel in colour)
    body = oren_nayar(colour, draw.between(0.3, 0.9))
    if draw.chance(0.4):  # satin weaves have a broad highlight as well
        body = coated(body, draw.between(0.3, 0.5), "beckmann", 1.46)
        return f"{colour_name(colour)}-satin", sheen(body, (red, green, blue), 0.15 + 0.35 * draw.roughness)
    return f"{colour_name(colour)}-velvet", sheen(body, (red, green, blue), 0.2 + 0.6 * draw.roughness)


def _draw_diffuse(draw: _Draws) -> tuple[str, Model]:
    colour = draw.colour(0.02, 0.95)
    if draw.chance(0.4):
        return f"{colour_name(colour)}-lambert", diffuse(colour)
    return f"{colour_name(colour)}-oren-nayar", oren_nayar(colour, 0.2 + 0.8 * draw.roughness)


def _draw_mixture(draw: _Draws) -> tuple[str, Model]:
    families = [_draw_conductor, _draw_plastic, _draw_glossy, _draw_paint, _draw_diffuse]
    first = int(draw.between(0, 5))
    second = (first + int(draw.between(1, 5))) % 5
    one, model = families[first](draw)
    draw.hue, draw.lightness = (draw.hue + draw.between(0.2, 0.8)) % 1, 1 - draw.lightness
    other, body = families[second](draw)
    return f"{one}-on-{other}", mixture(model, body, draw.between(0.25, 0.75))


_FAMILIES: dict[str, Callable[[_Draws], tuple[str, Model]]] = {
    "conductor": _draw_conductor,
    "plastic": _draw_plastic,
    "glossy": _draw_glossy,
    "coated": _draw_coated_metal,
    "paint": _draw_paint,
    "fabric": _draw_fabric,
    "diffuse": _draw_diffuse,
    "mixture": _draw_mixture,
}
# Twenty turns, in about the shares of the MERL set: metals and glossy coats first, fabrics and chalk fewer.
_TURNS = """
    conductor plastic glossy paint conductor fabric coated plastic diffuse glossy
    conductor paint mixture plastic conductor glossy coated fabric diffuse mixture
"""


def _evaluator(model: Model) -> Callable[[Tensor], Tensor]:
    def evaluate(angles: Tensor) -> Tensor:
        at = cosines(angles)
        above = (at.incident > 0) & (at.outgoing > 0)
        # Below the horizon a model may be anything; a harmless place keeps values and gradients finite.
        safe = Cosines(at.incident.clamp_min(1e-6), at.outgoing.clamp_min(1e-6), at.half, at.difference)
        return torch.where(above[..., None], model(safe), 0.0)

    return evaluate


def synthetic_materials(split: Literal["train", "test"], count: int | None = None, seed: int = 0) -> list[Material]:
    """The materials of one split.

    Args:
        split: "train" or "test"; the same families, other draws.
        count: how many; by default 80 for training, 20 for the test. A larger set begins with the smaller one.
        seed: of all draws, >= 0.

    Returns:
        Materials with unique names such as "conductor-gold-rough-07" ("-t07" in the test split).

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    if split not in ("train", "test"):
        raise ValueError(f"split of the synthetic BRDFs: {split!r}, expected 'train' or 'test'")
    count = (80 if split == "train" else 20) if count is None else count
    if count < 0 or seed < 0:
        raise ValueError(f"synthetic BRDFs: count {count} and seed {seed}, expected both to be 0 or more")
    turns, drawn = _TURNS.split(), dict.fromkeys(_FAMILIES, 0)
    materials = []
    for index in range(count):
        family = turns[index % len(turns)]
        draw = _Draws(split, seed, list(_FAMILIES).index(family), drawn[family])
        drawn[family] += 1
        kind, model = _FAMILIES[family](draw)
        number = f"{'t' if split == 'test' else ''}{index:02d}"
        materials.append(Material(f"{family}-{kind}-{number}", _evaluator(model)))
    return materials
