"""What path guiding gains in another renderer: Cycles with OpenPGL over Cycles without, in equal time, same scenes.

It needs `bpy` (Blender as a module, 350 MB), which metapp does not: install it beside metapp in an environment of its
own. Scenes are those of `bench_guiding` that have rectangles, cubes, spheres, diffuse and glass alone. Both render on
two threads, with the light tree, without denoiser, adaptive sampling, clamping or filtered caustics; paths have as many
edges as those of `bench_guiding`. Times are CPU seconds of the process less those of a picture of one sample, which
holds the building of the scene. The error is MAPE to a long picture without guiding, which is kept.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.guiding_scenes import scenes
from data_tools.synthetic.cornell import Scene
from metapp.appearance.metrics import mape
from metapp.rendering.paths.path_space import DEPTH

try:
    import bpy
except ImportError:
    bpy = None

MISSING = "bench_cycles: no module bpy, expected Blender as a module; pip install bpy==4.5.15 (Python 3.11)."
METHODS = ("unguided", "guided")
NEAR = 0.1  # of the seconds
THREADS = 2
SUBDIVISIONS = 6  # of the icosahedron that a ball is made of
CORNERS = list(itertools.product((-1, 1), (-1, 1), (-1, 1)))
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # of a cube


class Bench:
    """One scene in Cycles.

    Args:
        name: of the scene.
        options: of the command line.
    """

    def __init__(self, name: str, options: argparse.Namespace) -> None:
        self.picture_file = options.out / "cycles.exr"
        build(scenes()[name], options.size)
        kept = options.out / f"cycles-{name}-{options.size}-{options.reference}.pt"
        if not kept.exists():
            halves = [self.rendered("unguided", options.reference // 2, seed)[0] for seed in (91, 92)]
            torch.save(torch.stack(halves), kept)
        both = torch.load(kept, weights_only=True)
        self.reference = both.mean(0)
        self.own_error = float(mape(both[:1], self.reference[None]))
        self.costs: dict[str, tuple[float, float]] = {}
        for method in METHODS:
            fixed = min(self.rendered(method, 1, seed)[1] for seed in (1, 2))
            self.costs[method] = fixed, max(1e-3, (self.rendered(method, 33, 3)[1] - fixed) / 32)

    def measured(self, method: str, seconds: float, seed: int) -> dict[str, Any]:
        """A picture that takes so many seconds, within NEAR, at the last of three attempts."""
        for _ in range(3):
            fixed, per_sample = self.costs[method]
            spp = max(1, round(seconds / per_sample))
            picture, total = self.rendered(method, spp, seed)
            spent = total - fixed
            self.costs[method] = fixed, spent / spp
            if abs(spent - seconds) < NEAR * seconds:
                break
        error = float(mape(picture[None], self.reference[None]))
        mean = float(picture.mean() / self.reference.mean())
        return {"error": error, "seconds": spent, "spp": spp, "fixed": fixed, "mean": mean, "own": self.own_error}

    def rendered(self, method: str, spp: int, seed: int) -> tuple[Tensor, float]:
        """A picture, linear RGB [3, rows, columns], and its seconds of CPU."""
        scene = bpy.context.scene
        scene.cycles.use_guiding = method == "guided"
        scene.cycles.samples, scene.cycles.seed = spp, seed
        scene.render.filepath = str(self.picture_file)
        begin = time.process_time()
        bpy.ops.render.render(write_still=True)
        seconds = time.process_time() - begin
        image = bpy.data.images.load(str(self.picture_file), check_existing=False)
        values = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(values)
        width, height = image.size
        bpy.data.images.remove(image)
        picture = values.reshape(height, width, -1)[::-1, :, :3].copy()
        return torch.from_numpy(picture).permute(2, 0, 1), seconds


def build(scene: Scene, size: int) -> None:
    """Make a scene of Mitsuba Blender's."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    target = bpy.context.scene
    target.world = None
    configure(target, size)
    for name, shape in scene.items():
        if isinstance(shape, dict) and shape["type"] in ("rectangle", "cube", "sphere"):
            bsdf = shape["bsdf"]
            mesh = mesh_of(name, shape)
            mesh.materials.append(material(name, scene[bsdf["id"]] if bsdf["type"] == "ref" else bsdf, shape))
            target.collection.objects.link(bpy.data.objects.new(name, mesh))
    sensor = scene["sensor"]
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.angle = math.radians(sensor["fov"])
    # Blender's cameras look along -z, with x to the right
    place = np.array(sensor["to_world"]) @ np.diag([-1.0, 1.0, -1.0, 1.0])
    import mathutils

    camera.matrix_world = mathutils.Matrix(place.tolist())
    target.collection.objects.link(camera)
    target.camera = camera


def configure(target: Any, size: int) -> None:
    """How Cycles renders, the same with and without guiding."""
    target.render.engine = "CYCLES"
    target.render.threads_mode, target.render.threads = "FIXED", THREADS
    target.render.resolution_x = target.render.resolution_y = size
    target.render.resolution_percentage = 100
    image = target.render.image_settings
    image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGB", "32"
    cycles = target.cycles
    cycles.device = "CPU"
    cycles.use_denoising = cycles.use_adaptive_sampling = cycles.use_auto_tile = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    cycles.pixel_filter_type = "BOX"
    cycles.use_light_tree = True
    cycles.caustics_reflective = cycles.caustics_refractive = True
    for kind in ("", "diffuse_", "glossy_", "transmission_"):
        setattr(cycles, f"{kind}bounces" if kind else "max_bounces", DEPTH - 2)
    cycles.use_surface_guiding, cycles.use_volume_guiding = True, False


def mesh_of(name: str, shape: Scene) -> Any:
    """A mesh of a shape, in the world's place."""
    import bmesh
    import mathutils

    mesh = bpy.data.meshes.new(name)
    if shape["type"] == "sphere":
        grid = bmesh.new()
        bmesh.ops.create_icosphere(grid, subdivisions=SUBDIVISIONS, radius=shape["radius"])
        grid.to_mesh(mesh)
        grid.free()
        mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
        place = mathutils.Matrix.Translation(shape["center"])
    else:
        flat = shape["type"] == "rectangle"
        corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)] if flat else CORNERS
        mesh.from_pydata(corners, [], [(0, 1, 2, 3)] if flat else SIDES)
        place = mathutils.Matrix(shape["to_world"])
    mesh.transform(place)
    mesh.update()
    return mesh


def material(name: str, bsdf: Scene, shape: Scene) -> Any:
    """Nodes of a material; lamps shine from their front alone."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    if "emitter" in shape:
        front, back, mixed, geometry = (
            nodes.new(f"ShaderNode{kind}") for kind in ("Emission", "BsdfDiffuse", "MixShader", "NewGeometry")
        )
        front.inputs["Color"].default_value = [*shape["emitter"]["radiance"]["value"], 1.0]
        back.inputs["Color"].default_value = [0.0, 0.0, 0.0, 1.0]
        links.new(geometry.outputs["Backfacing"], mixed.inputs["Fac"])
        links.new(front.outputs[0], mixed.inputs[1])
        links.new(back.outputs[0], mixed.inputs[2])
        links.new(mixed.outputs[0], output.inputs["Surface"])
        return made
    if bsdf["type"] == "diffuse":
        surface = nodes.new("ShaderNodeBsdfDiffuse")
        surface.inputs["Color"].default_value = [*bsdf["reflectance"]["value"], 1.0]
    elif bsdf["type"] == "dielectric":
        surface = nodes.new("ShaderNodeBsdfGlass")
        surface.inputs["IOR"].default_value = bsdf["int_ior"] / bsdf["ext_ior"]
        surface.inputs["Roughness"].default_value = 0.0
    else:
        raise ValueError(f"{name}: a material {bsdf['type']}, expected diffuse or dielectric.")
    links.new(surface.outputs[0], output.inputs["Surface"])
    return made


def table(rows: list[dict[str, Any]]) -> str:
    """Errors of guided pictures over those of unguided ones in the same time, mean and seeds, as markdown."""
    held = {(row["scene"], row["time"], row["method"], row["seed"]): row for row in rows}
    lines = ["| scene | seconds | guided over unguided | seeds | MAPE | samples a pixel |", "|---" * 6 + "|"]
    for scene, seconds in dict.fromkeys((row["scene"], row["time"]) for row in rows):
        seeds = sorted({key[3] for key in held if key[:2] == (scene, seconds)})
        pairs = [[held[scene, seconds, method, seed] for method in METHODS] for seed in seeds]
        ratios = [guided["error"] / unguided["error"] for unguided, guided in pairs]
        middle = math.exp(np.mean(np.log(ratios)))
        errors, samples = (
            ", ".join(f"{np.mean([pair[i][key] for pair in pairs]):{form}}" for i in (1, 0))
            for key, form in (("error", ".3f"), ("spp", ".0f"))
        )
        each = ", ".join(f"{ratio:.2f}" for ratio in ratios)
        lines.append(f"| {scene} | {seconds:g} | {middle:.2f} | {each} | {errors} | {samples} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=256, help="px along a side")
    parser.add_argument("--reference", type=int, default=4096, help="samples a pixel of the reference")
    parser.add_argument("--times", type=float, nargs="+", default=[4.0, 16.0], help="seconds of CPU")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scenes", nargs="+", default=["mitsuba", "baffle", "caustic"])
    parser.add_argument("--out", type=Path, default=Path("runs/guiding"))
    options = parser.parse_args()
    if bpy is None:
        raise SystemExit(MISSING)
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    with (options.out / "cycles.jsonl").open("a", encoding="utf-8") as out:
        for name in options.scenes:
            bench = Bench(name, options)
            for seconds, seed, method in itertools.product(options.times, range(1, options.seeds + 1), METHODS):
                row = {"scene": name, "time": seconds, "seed": seed, "method": method, "size": options.size}
                rows.append(row | bench.measured(method, seconds, seed))
                print(json.dumps(rows[-1]), file=out, flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
