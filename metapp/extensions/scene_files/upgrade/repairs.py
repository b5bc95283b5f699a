"""Repairs of scenes of Mitsuba 0.6, and of other people's integrators, so that Mitsuba 3 loads them.

Mitsuba itself renames parameters of version 0.6 and puts scales and offsets of textures into transforms. A repair edits
an element in place and logs it; what it cannot repair it leaves. Names and defaults are those of the documentation of
Mitsuba 0.6 and of Mitsuba 3.9.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from metapp.extensions.scene_files.upgrade.values import child, linear_rgb, made, name_of, numbers, shown
from metapp.extensions.scene_files.xml import SceneElement
from metapp.rendering.scenes.plugins import plugins

Log = Callable[[SceneElement, str], None]


class Repair(NamedTuple):
    """A repair of an element.

    Attributes:
        line: of the document that holds it.
        element: as it was.
        done: what was done, or, of an element that stays, what a user can do.
    """

    line: int
    element: str
    done: str


_TAGS = {"lookAt": "lookat", "camera": "sensor", "luminaire": "emitter"}
_TYPES = {
    ("bsdf", "lambertian"): "diffuse",
    ("bsdf", "bump"): "bumpmap",
    ("bsdf", "roughdiffuse"): "diffuse",
    ("integrator", "volpath_simple"): "volpath",
    ("texture", "ldrtexture"): "bitmap",
    ("texture", "exrtexture"): "bitmap",
}
_PATHS = {"max_depth", "rr_depth", "hide_emitters"}
_SAMPLER = {"sample_count", "seed"}
_KEPT = {  # of each plugin all parameters that Mitsuba 3 takes; of others nothing depends on any
    "path": _PATHS,
    "volpath": _PATHS,
    "volpathmis": _PATHS,
    "direct": {"emitter_samples", "bsdf_samples", "shading_samples", "hide_emitters"},
    "hdrfilm": {"width", "height", "crop_offset_x", "crop_offset_y", "crop_width", "crop_height", "file_format",
                "pixel_format", "component_format", "sample_border", "compensate"},
    "independent": _SAMPLER,
    "ldsampler": _SAMPLER,
    "multijitter": _SAMPLER,
    "orthogonal": _SAMPLER,
    "stratified": _SAMPLER,
}  # fmt: skip
_GONE = "left out"
_FALLBACKS = {"integrator": "path", "film": "hdrfilm", "sampler": "independent"}
_MESH = {"collapse", "max_smooth_angle", "srgb"}
_DROPPED = {
    "bitmap": {"max_anisotropy", "cache", "wrap_mode_v", "gamma"},
    "diffuse": {"alpha", "use_fast_approx"},
    "envmap": {"gamma", "cache"},
    "obj": _MESH,
    "ply": _MESH,
    "serialized": _MESH,
}
_FORMATS = ("luminance", "luminance_alpha", "rgb", "rgba", "xyz", "xyza")
_MICROFACETS = dict.fromkeys(("phong", "as"), "beckmann")
_VALUES = {
    ("bitmap", "filter_type"): dict.fromkeys(("trilinear", "ewa", "isotropic", "anisotropic"), "bilinear"),
    ("bitmap", "wrap_mode"): dict.fromkeys(("zero", "one", "black", "white"), "clamp"),
    ("roughconductor", "distribution"): _MICROFACETS,
    ("roughdielectric", "distribution"): _MICROFACETS,
    ("roughplastic", "distribution"): _MICROFACETS,
    ("hdrfilm", "file_format"): dict.fromkeys(("png", "jpg", "jpeg", "numpy", "matlab", "mathematica"), "openexr"),
}
_CONDUCTORS = {"conductor", "roughconductor"}  # whose default material version 3 changed
_NO_LAYERS = "version 3 has no layers; give a 'principled' BSDF with clearcoat"
_NO_LOBES = (
    "version 3 has no such lobe; give 'blendbsdf' of 'diffuse' and 'roughconductor' with the material 'none', or "
)
_LEFT = {
    "phong": f"{_NO_LOBES}'principled'; exponent n is alpha sqrt(1 / (2 (n + 2))), 2/3 of the specular reflectance",
    "ward": f"{_NO_LOBES}'principled'; its alphas are those of 'beckmann'",
    "mixturebsdf": "version 3 mixes two BSDFs; give one 'blendbsdf' within another",
    "blackbody": "version 3 has none for RGB; give a <spectrum> of 'wavelength:value' pairs or an <rgb>",
    "vertexcolors": "give 'mesh_attribute' of the name 'vertex_color'",
    "coating": _NO_LAYERS,
    "roughcoating": _NO_LAYERS,
    "difftrans": "version 3 has no diffuse transmission of this kind; give 'principledthin' with diff_trans",
    "hk": "version 3 has no layer of a scattering medium; give 'diffuse' or 'principledthin'",
    "irawan": "version 3 has no woven cloth; give 'principled' with sheen",
    **dict.fromkeys(("sky", "sun", "sunsky"), "axes and units differ in version 3; give 'sunsky', or an 'envmap' that "
                                              "was rendered of it"),
}  # fmt: skip


def repair(root: SceneElement) -> tuple[list[Repair], list[Repair]]:
    """Repair a scene in place.

    Args:
        root: of the document, as `metapp.extensions.scene_files.xml.merged` gives it.

    Returns:
        What was done, and the elements that stay as they are though Mitsuba 3 lacks them.
    """
    done: dict[SceneElement, Repair] = {}
    left: list[Repair] = []
    old = root.get("version", "").startswith(("0.", "1."))

    def log(element: SceneElement, what: str) -> None:
        before = done.get(element, Repair(element.line, str(element), ""))
        gone = not before.done or what.startswith(_GONE)  # whatever was done to it before
        done[element] = before._replace(done=what if gone else f"{before.done}; {what}")

    for element in _all(root):
        for rule in (*_RULES, *(_OLD_RULES if old else ())):
            rule(element, log)
        kind = element.get("type", element.tag)
        if kind in _LEFT and (old or kind not in plugins()):
            left.append(Repair(element.line, str(element), _LEFT[kind]))
    return list(done.values()), left


def _all(element: SceneElement) -> Iterator[SceneElement]:
    """An element, then what is within it once it was repaired."""
    yield element
    for part in list(element):
        yield from _all(part)


def _names(element: SceneElement, log: Log) -> None:
    if element.tag in _TAGS:
        log(element, f"<{_TAGS[element.tag]}>")
        element.tag = _TAGS[element.tag]
    kind = _TYPES.get((element.tag, element.get("type", "")))
    if kind:
        log(element, f"'{kind}'")
        element.set("type", kind)


def _parameters(element: SceneElement, log: Log) -> None:
    kind = element.get("type", "")
    for part in list(element):
        name = name_of(part)
        if kind == "bitmap" and name == "wrap_mode_u":
            log(part, "wrap_mode")
            part.set("name", name := "wrap_mode")
        if name in _DROPPED.get(kind, ()):
            _remove(element, part, log)
        if kind == "bitmap" and name == "gamma" and numbers(part.get("value", "")) == (1.0,):
            log(part, "left out, raw: no conversion")
            element.append(made("boolean", name="raw", value="true"))
        value = _VALUES.get((kind, name), {}).get(part.get("value", "").lower())
        if value:
            log(part, f"{part.get('value')} is {value}")
            part.set("value", value)


def _plugin(element: SceneElement, log: Log) -> None:
    """An integrator, film or sampler: one of version 3 with the parameters that this takes."""
    if element.tag not in _FALLBACKS:
        return
    kind = element.get("type", "")
    if kind not in plugins():
        new = _FALLBACKS[element.tag]
        depth = next((part for part in element.iter() if name_of(part) == "max_depth"), None)
        of_depth = f" of max_depth {depth.get('value')}" if depth is not None else ""
        log(element, f"'{new}'{of_depth}{', as it has no default' if '$' in kind else ''}")
        element.set("type", new)
        if depth is not None:
            own = child(element, "max_depth")
            if own is not None:
                element.remove(own)
            element.append(made("integer", name="max_depth", value=depth.get("value", "")))
        _parameters(element, log)
    kept = _KEPT.get(element.get("type", ""), set())
    for part in list(element) if kept else ():
        if part.tag == "rfilter":
            continue
        unset = "$" in part.get("value", "")
        if name_of(part) not in kept or unset or _wrong_format(part):
            _remove(element, part, log, "as it has no default" if unset else _UNKNOWN)


_UNKNOWN = "version 3 has no such parameter"


def _remove(element: SceneElement, part: SceneElement, log: Log, why: str = _UNKNOWN) -> None:
    log(part, f"{_GONE}, {why}")
    element.remove(part)


def _wrong_format(part: SceneElement) -> bool:
    return name_of(part) == "pixel_format" and part.get("value", "").lower() not in _FORMATS


def _colour(element: SceneElement, log: Log) -> None:
    """Colours as linear RGB: those in sRGB, and the three numbers of a spectrum, of builds for RGB."""
    if element.tag not in ("rgb", "srgb", "spectrum") or "type" in element.attrib:
        return
    value = element.get("value", "")
    is_srgb = element.tag == "srgb" or value.startswith("#")
    values = linear_rgb(value) if is_srgb else numbers(value)
    if len(values) == 3 and (is_srgb or element.tag == "spectrum"):
        log(element, f"rgb {shown(values)}, linear")
        element.tag = "rgb"
        element.set("value", shown(values))
    if "intent" in element.attrib:
        log(element, "without 'intent', version 3 takes it from the place")
        del element.attrib["intent"]


def _conductor(element: SceneElement, log: Log) -> None:
    """The default material of version 0.6; the medium outside is air or is left."""
    if element.tag != "bsdf" or element.get("type") not in _CONDUCTORS:
        return
    if all(child(element, name) is None for name in ("eta", "k", "material")):
        log(element, 'no material: "Cu", the default of version 0.6')
        element.append(made("string", name="material", value="Cu"))
    outside = child(element, "ext_eta")
    if outside is not None and (outside.get("value") in ("air", "vacuum") or numbers(outside.get("value", "")) == (1,)):
        _remove(element, outside, log, "it is 1")


def _uniform(element: SceneElement, log: Log) -> None:
    """An emitter's spectrum of one number, white in version 0.6, is a reddish one in version 3: equal energy."""
    for part in element if element.tag == "emitter" else ():
        values = numbers(part.get("value", ""))
        if part.tag == "spectrum" and "type" not in part.attrib and len(values) == 1:
            log(part, "rgb, white as in version 0.6; version 3 has equal energy here, which is reddish")
            part.tag = "rgb"
            part.set("value", shown(values * 3))


_RULES = (_names, _parameters, _plugin, _colour)
_OLD_RULES = (_conductor, _uniform)
