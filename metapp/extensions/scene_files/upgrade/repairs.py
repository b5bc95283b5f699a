"""What scenes of Mitsuba 0.6, and of other people's integrators, need so that Mitsuba 3 loads them: a table of repairs.

A repair edits an element in place and logs it; what it cannot repair it leaves. Names and defaults are those of the
documentation of Mitsuba 0.6 and of Mitsuba 3.9.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from metapp.extensions.scene_files.upgrade import materials
from metapp.extensions.scene_files.upgrade.values import (
    blackbody,
    child,
    linear,
    linear_rgb,
    made,
    number,
    numbers,
    shown,
    snake_case,
    taken,
)
from metapp.extensions.scene_files.xml import SceneElement
from metapp.rendering.scenes.plugins import plugins

Log = Callable[[SceneElement, str], None]


class Repair(NamedTuple):
    """What was done to an element.

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
_RENAMED = {
    ("diffuse", "diffuse_reflectance"): "reflectance",
    ("bitmap", "wrap_mode_u"): "wrap_mode",
}
_MESH = {"collapse", "max_smooth_angle", "srgb"}
_DROPPED = {
    "bitmap": {"max_anisotropy", "cache", "wrap_mode_v"},
    "envmap": {"gamma", "cache"},
    "obj": _MESH,
    "ply": _MESH,
    "serialized": _MESH,
}
_MICROFACETS = dict.fromkeys(("phong", "as"), "beckmann")
_FORMATS = ("luminance", "luminance_alpha", "rgb", "rgba", "xyz", "xyza")
_VALUES = {
    ("bitmap", "filter_type"): dict.fromkeys(("trilinear", "ewa", "isotropic", "anisotropic"), "bilinear"),
    ("bitmap", "wrap_mode"): dict.fromkeys(("zero", "one", "black", "white"), "clamp"),
    ("roughconductor", "distribution"): _MICROFACETS,
    ("roughdielectric", "distribution"): _MICROFACETS,
    ("roughplastic", "distribution"): _MICROFACETS,
    ("hdrfilm", "file_format"): dict.fromkeys(("png", "jpg", "jpeg", "numpy", "matlab", "mathematica"), "openexr"),
}
_BSDFS = {"phong": materials.phong, "ward": materials.ward, "mixturebsdf": materials.mixture,
          "roughdiffuse": materials.matt}  # fmt: skip
_METALS = {"conductor", "roughconductor"}  # whose default material version 3 changed
_LEFT = {
    "coating": "version 3 has no layers; give a 'principled' BSDF with clearcoat",
    "roughcoating": "version 3 has no layers; give a 'principled' BSDF with clearcoat",
    "difftrans": "version 3 has no diffuse transmission of this kind; give 'principledthin' with diff_trans",
    "hk": "version 3 has no layer of a scattering medium; give 'diffuse' or 'principledthin'",
    "irawan": "version 3 has no woven cloth; give 'principled' with sheen",
    **dict.fromkeys(("sky", "sun", "sunsky"), "axes and units differ in version 3; give 'sunsky', or an 'envmap' that "
                                              "was rendered of it"),
}  # fmt: skip


def repair(root: SceneElement) -> tuple[list[Repair], list[Repair]]:
    """Repair a scene in place.

    Args:
        root: of the document, as `metapp.rendering.scenes.loading.merged` gives it.

    Returns:
        What was done, and the elements that stay as they are though Mitsuba 3 lacks them.
    """
    done: dict[SceneElement, Repair] = {}
    left: list[Repair] = []
    version = root.get("version", "")
    old = version.startswith(("0.", "1."))

    def log(element: SceneElement, what: str) -> None:
        before = done.get(element, Repair(element.line, str(element), ""))
        gone = not before.done or what.startswith(_GONE)  # whatever was done to it before
        done[element] = before._replace(done=what if gone else f"{before.done}; {what}")

    if version != "3.0.0" and (old or version.startswith("2.")):
        log(root, f"version {version} is 3.0.0")
        root.set("version", "3.0.0")
    for element in _all(root):
        for rule in _RULES:
            rule(element, log)
        if old:
            for rule in _OLD_RULES:
                rule(element, log)
        kind = element.get("type", "")
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
    name = element.get("name", "")
    if snake_case(name) != name:
        log(element, snake_case(name))
        element.set("name", snake_case(name))


def _children_names(element: SceneElement, log: Log) -> None:
    for part in element:
        _names(part, log)


def _parameters(element: SceneElement, log: Log) -> None:
    kind = element.get("type", "")
    for part in list(element):
        name = part.get("name", "")
        new = _RENAMED.get((kind, name))
        if new and child(element, new) is None:
            log(part, new)
            part.set("name", new)
        elif name in _DROPPED.get(kind, ()):
            log(part, f"{_GONE}, version 3 has no such parameter")
            element.remove(part)
        value = _VALUES.get((kind, part.get("name", "")), {}).get(part.get("value", "").lower())
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
        depth = next((part for part in element.iter() if snake_case(part.get("name", "")) == "max_depth"), None)
        of_depth = f" of max_depth {depth.get('value')}" if depth is not None else ""
        log(element, f"'{new}'{of_depth}{', as it has no default' if '$' in kind else ''}")
        element.set("type", new)
        if depth is not None and depth not in list(element):
            element.append(made("integer", name="max_depth", value=depth.get("value", "")))
        _parameters(element, log)
    kept = _KEPT.get(element.get("type", ""), set())
    for part in list(element) if kept else ():
        if part.tag == "rfilter":
            continue
        unset = "$" in part.get("value", "")
        if part.get("name") not in kept or unset or _wrong_format(part):
            log(part, f"{_GONE}, as it has no default" if unset else f"{_GONE}, version 3 has no such parameter")
            element.remove(part)


def _wrong_format(part: SceneElement) -> bool:
    return part.get("name") == "pixel_format" and part.get("value", "").lower() not in _FORMATS


def _bsdf(element: SceneElement, log: Log) -> None:
    if element.tag == "bsdf" and element.get("type") in _BSDFS:
        _BSDFS[element.get("type", "")](element, log)


def _metal(element: SceneElement, log: Log) -> None:
    if element.tag == "bsdf" and element.get("type") in _METALS:
        materials.metal(element, log)


def _texture(element: SceneElement, log: Log) -> None:
    """Bitmaps that are linear; coordinates u * uscale + uoffset of version 0.6; vertex colours; normal maps."""
    kind = element.get("type")
    if element.tag == "bsdf" and kind == "normalmap":
        for part in element:
            if part.tag == "texture" and part.get("name") != "normalmap":
                log(part, "named normalmap")
                part.set("name", "normalmap")
    if element.tag != "texture":
        return
    gamma = taken(element, "gamma") if kind == "bitmap" else None
    if gamma is not None:
        raw = number(gamma, 0.0) == 1
        log(gamma, "raw, no conversion" if raw else f"{_GONE}, version 3 takes what the file says")
        if raw and child(element, "raw") is None:
            element.append(made("boolean", name="raw", value="true"))
    if kind == "vertexcolors":
        log(element, "'mesh_attribute' of vertex_color")
        element.set("type", "mesh_attribute")
        element.append(made("string", name="name", value="vertex_color"))
    _coordinates(element, log)


def _coordinates(element: SceneElement, log: Log) -> None:
    defaults = {"uscale": "1", "vscale": "1", "uoffset": "0", "voffset": "0"}
    if not any(child(element, name) is not None for name in defaults):
        return
    parts = {name: taken(element, name) for name in defaults}
    u, v, right, up = (defaults[name] if part is None else part.get("value", "") for name, part in parts.items())
    log(next(part for part in parts.values() if part is not None), f"to_uv: scale {u}, {v}, then offset {right}, {up}")
    steps = (made("scale", x=u, y=v), made("translate", x=right, y=up))
    element.append(made("transform", *steps, name="to_uv"))


def _colour(element: SceneElement, log: Log) -> None:
    """Colours as linear RGB: those in sRGB, and the three numbers of a spectrum."""
    if element.tag not in ("rgb", "srgb", "spectrum") or "type" in element.attrib:
        return
    value = element.get("value", "")
    values, found = numbers(value) or (), None  # type: tuple[float, ...], tuple[float, ...] | None
    if value.startswith("#"):
        found = linear(value)
    elif element.tag == "srgb":
        found = linear_rgb(values * 3 if len(values) == 1 else values) if len(values) in (1, 3) else None
    else:
        found = values if element.tag == "spectrum" and len(values) == 3 else None  # of builds for RGB
    if found is not None:
        log(element, f"rgb {shown(found)}, linear")
        element.tag = "rgb"
        element.set("value", shown(found))
    if "intent" in element.attrib:
        log(element, "without 'intent', version 3 takes it from the place")
        del element.attrib["intent"]


def _blackbody(element: SceneElement, log: Log) -> None:
    if element.tag != "blackbody":
        return
    kelvin = numbers(element.get("temperature", "").removesuffix("K").removesuffix("k"))
    scale = numbers(element.get("scale", "1"))
    if kelvin and scale and kelvin[0] > 0:
        log(element, f"spectrum of {kelvin[0]:g} K from 360 to 830 nm, as version 3 has none for RGB")
        element.tag = "spectrum"
        for name in ("temperature", "scale"):
            element.attrib.pop(name, None)
        element.set("value", blackbody(kelvin[0], scale[0]))


def _uniform(element: SceneElement, log: Log) -> None:
    """An emitter's spectrum of one number, white in version 0.6, is a reddish one in version 3: equal energy."""
    for part in element if element.tag == "emitter" else ():
        values = numbers(part.get("value", "")) or ()
        if part.tag == "spectrum" and "type" not in part.attrib and len(values) == 1:
            log(part, "rgb, white as in version 0.6; version 3 has equal energy here, which is reddish")
            part.tag = "rgb"
            part.set("value", shown(values * 3))


_RULES = (_names, _children_names, _parameters, _plugin, _bsdf, _texture, _colour, _blackbody)
_OLD_RULES = (_metal, _uniform)
