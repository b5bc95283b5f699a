"""The number of objects of a scene with all references written out, which Mitsuba's compiled code grows with.

Mitsuba loads an object once, however often others refer to it. But its code for a material calls the code of the
materials and textures within it in place: 14 materials that each refer twice to the next become 32,767. Along a chain
of materials it takes the square of the chain's length: 0.5 s of CPU time for 8 blends, 1.8 s for 16, 4.5 s for 24. A
shape's code looks its material up instead, so thousands of shapes may share one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

_FREE_OBJECTS = 1_000  # objects, references written out, that any scene may have: 10 ms of CPU time a material
_MOST_OBJECTS_PER_WRITTEN = 8  # 20 textures that one material shares, or 8 that all materials do
_MOST_LEVELS = 16  # of objects within each other, or by references; public scenes have 4
_MOST_INSTANCED_SHAPES = 100_000  # shapes of all groups, once for each instance: 1 ms of CPU time each
_MOST_SHOWN = 10**12  # greatest number that a message writes out
_SHAPES = {
    "bsplinecurve", "cube", "cylinder", "disk", "ellipsoids", "ellipsoidsmesh", "instance", "linearcurve", "merge",
    "obj", "ply", "rectangle", "sdfgrid", "serialized", "shapegroup", "sphere",
}  # fmt: skip

Object = dict[str, Any]  # an object of a scene's dictionary, see :mod:`metapp.rendering.scenes.rules`


class _Size(NamedTuple):
    """The size of an object with all that it refers to written out.

    Attributes:
        objects: the number of objects.
        levels: the number of levels of objects within each other.
    """

    objects: int
    levels: int


def check_expansion(scene: Object) -> None:
    """Refuse a scene whose references make many objects of few, or long chains.

    Args:
        scene: the whole scene, whose values are checked.

    Raises:
        ValueError: too many objects, levels or instanced shapes.
    """
    written = sum(1 for _ in _objects_within(scene))
    counter = _ExpandedCounter(scene)
    sizes = [(counter.measure(value).objects, name) for name, value in _compiled_objects(scene)]
    total, most_objects = sum(size for size, _ in sizes), max(_FREE_OBJECTS, _MOST_OBJECTS_PER_WRITTEN * written)
    if total > most_objects:
        _, name = max(sizes)
        raise ValueError(
            f"{min(total, _MOST_SHOWN):,} objects with references written out, {name[:40]!r} most of them, "
            f"expected {most_objects:,} at most for {written:,} in the file; let fewer objects in it refer to others."
        )
    instanced = counter.count_instanced_shapes()
    if instanced > _MOST_INSTANCED_SHAPES:
        raise ValueError(
            f"{min(instanced, _MOST_SHOWN):,} shapes in all instances of shape groups, expected "
            f"{_MOST_INSTANCED_SHAPES:,} at most; join meshes of a group, or leave instances out."
        )


class _ExpandedCounter:
    """A counter of a scene's objects with references written out; each object is measured once."""

    def __init__(self, scene: Object) -> None:
        self.scene = scene
        self.sizes: dict[int, _Size] = {}  # by the identity of the object, whose size is (0, 0) while it is measured
        self.targets: dict[str, list[Object]] = {}  # objects by all names that a reference may mean them by
        for path, value in _objects_within(scene):
            for name in {".".join(path), str(value.get("id", ""))} - {""}:
                self.targets.setdefault(name, []).append(value)

    def measure(self, value: Object, depth: int = 0) -> _Size:
        """Return the size of an object; a cycle of references, which Mitsuba refuses, counts once."""
        if id(value) in self.sizes:
            return self.sizes[id(value)]
        self.sizes[id(value)] = _Size(0, 0)
        objects, levels = 1, 1
        if depth <= _MOST_LEVELS and value["type"] not in _SHAPES:
            for part in _parts(value):
                sizes = [self.measure(target, depth + 1) for target in self._resolve(part)]
                objects += max((size.objects for size in sizes), default=0)
                levels = max(levels, 1 + max((size.levels for size in sizes), default=0))
        if max(depth, levels) > _MOST_LEVELS:
            raise ValueError(
                f"objects within each other or by references, more than {_MOST_LEVELS} deep, expected fewer; "
                "let fewer objects refer to others."
            )
        self.sizes[id(value)] = _Size(objects, levels)
        return self.sizes[id(value)]

    def count_instanced_shapes(self) -> int:
        """Return the number of shapes in groups, each counted once for each instance of its group."""
        shape_counts = {
            id(value): sum(1 for _ in _parts(value))
            for _, value in _objects_within(self.scene)
            if value["type"] == "shapegroup"
        }
        return sum(
            max((shape_counts.get(id(target), 0) for target in self._resolve(part)), default=0)
            for _, value in _objects_within(self.scene)
            if value["type"] == "instance"
            for part in _parts(value)
        )

    def _resolve(self, part: Object) -> list[Object]:
        """Return the objects that a part of an object may mean: itself, or those of the name that it refers to."""
        return self.targets.get(part["id"], []) if part["type"] == "ref" else [part]


def _parts(value: Object) -> Iterator[Object]:
    """Yield the objects and references directly within an object."""
    return (part for part in value.values() if isinstance(part, dict))


def _objects_within(value: Object, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Object]]:
    """Yield all objects within an object, at any depth, with their paths of keys; references are none."""
    for key, part in value.items():
        if isinstance(part, dict) and part["type"] != "ref":
            yield (*path, key), part
            yield from _objects_within(part, (*path, key))


def _compiled_objects(value: Object, path: str = "") -> Iterator[tuple[str, Object]]:
    """Yield the objects of a scene and of its shapes, which Mitsuba compiles code for, with their ids or paths."""
    for key, part in value.items():
        if isinstance(part, dict) and part["type"] != "ref":
            yield str(part.get("id", f"{path}{key}")), part
            if part["type"] in _SHAPES:
                yield from _compiled_objects(part, f"{path}{key}.")
