"""Names of types of Dr.Jit and Mitsuba, for signatures; importing them imports neither.

All are `Any`: the classes are different ones in each variant, and no annotation can name the active variant's. Numbers,
vectors and records hold one entry a path, ray or sample.
"""

from __future__ import annotations

from typing import Any

# numbers and masks
Float = Any
UInt32 = Any
Mask = Any
# vectors: Vector2f, Point2f in [0, 1)^2 unless said otherwise, Point3f, Vector3f, Color3f (linear Rec.709)
Vector2 = Any
Point2 = Any
Point3 = Any
Vector3 = Any
Color = Any
Frame = Any
Tensorf = Any
# records of Mitsuba: SurfaceInteraction3f, BSDFSample3f, DirectionSample3f, Ray3f or RayDifferential3f
Interaction = Any
BsdfSample = Any
Ray = Any
# objects of Mitsuba
Mitsuba = Any  # the module, in its variant
Scene = Any
Sensor = Any
Film = Any
Sampler = Any
ImageBlock = Any
Integrator = Any
Bsdf = Any
BsdfContext = Any
BsdfFlags = Any
Emitter = Any
Properties = Any
TraversalCallback = Any
RandomStreams = Any  # PCG32
PluginClass = Any  # a class of the variant
