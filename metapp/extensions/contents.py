"""What each extension that ships adds to the registry, by name: a function for each, which setup.cfg names.

References are texts, so that nothing of an extension is imported before it is used. Every command calls these
functions, so nothing but the registry is imported here.
"""

from __future__ import annotations

from metapp.application import Export, Format
from metapp.entries import Lazy
from metapp.registry import Command, FileExport, Measure, Plugin, Registry, TableEntry

_HERE = "metapp.extensions"  # the package that references begin with


def assets(registry: Registry) -> None:
    """Register exports of fitted materials and textures: glTF, USD, MaterialX, Mitsuba, Blender, image files."""
    here = f"{_HERE}.assets"
    for asset in ("surface", "texture"):
        registry.exports[asset, "asset"] = Export(f"{here}.surface_pictures:write_asset")
        registry.exports[asset, "exr"] = Export(f"{here}.surface_pictures:write_exr")
        registry.exports[asset, "png16"] = Export(f"{here}.surface_pictures:write_png16")
    registry.exports["surface", "blender"] = Export(f"{here}.surface_pictures:write_blender")
    registry.exports["surface", "gltf"] = Export(f"{here}.gltf:write_gltf")
    registry.exports["surface", "materialx"] = Export(f"{here}.materialx:write_openpbr")
    registry.exports["surface", "mitsuba"] = Export(f"{here}.mitsuba_surfaces:write_mitsuba")
    registry.exports["surface", "usd"] = Export(f"{here}.usd:write_usd", needs=("pxr", "usd-core"))


def baselines(registry: Registry) -> None:
    """Register methods without a network, their command and their table."""
    methods = {
        "brdf": ("pca_20", "pca_66", "pca_150", "ggx_2", "nearest"),
        "illumination": ("sh", "unwrap"),
        "svbrdf_nonstationary": ("flat", "predicted"),
        "svbrdf_stationary": ("nearest", "quilting"),
        "texture": ("nearest", "quilting", "blending"),
    }
    for app, names in methods.items():
        for name in names:
            registry.applications[app].baselines[name] = Lazy(f"{_HERE}.baselines.{app}:baselines")
    registry.commands["baseline"] = Command(f"{_HERE}.baselines.baseline_command:baseline_group", position=80)
    registry.tables["baselines"] = TableEntry(
        f"{_HERE}.baselines.baselines_table:baselines_table", "Methods without a network"
    )


def capture(registry: Registry) -> None:
    """Register what reads photos taken by hand: of a mirror ball, of flat materials, and under a lamp that moves."""
    here = f"{_HERE}.capture"
    illumination = registry.applications["illumination"]
    illumination.formats["ball"] = Format(f"{here}.ball.ball_reader", "LDR photos of a ball")
    illumination.merges["shutter"] = Lazy(f"{here}.ball.capture:merge_photos")
    registry.commands["data markers"] = Command(f"{here}.rectified.marker_commands:markers_command", position=150)
    registry.commands["data rectify"] = Command(f"{here}.rectified.marker_commands:rectify_command", position=160)
    registry.commands["data ball"] = Command(f"{here}.ball.ball_command:ball_command", position=170)
    registry.commands["data lights"] = Command(f"{here}.lights.lights_command:lights_command", position=175)


def compare(registry: Registry) -> None:
    """Register the command that shows runs side by side."""
    registry.commands["compare"] = Command(f"{_HERE}.compare.compare_command:compare_command", position=70)


def doctor(registry: Registry) -> None:
    """Register the command that reports on the installation."""
    registry.commands["doctor"] = Command(f"{_HERE}.doctor.doctor_command:doctor_command", position=110)


def examples(registry: Registry) -> None:
    """Register commands that work as they are, and the command that prints them."""
    registry.commands["examples"] = Command(f"{_HERE}.examples.examples_command:examples_command", position=20)
    for app in ("brdf", "illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture", "transport"):
        registry.applications[app].examples = Lazy(f"{_HERE}.examples.application_examples:{app.upper()}_EXAMPLES")


def guided(registry: Registry) -> None:
    """Register path guiding while rendering: an integrator of Mitsuba 3, and the output `--render` of transport."""
    registry.plugins["metapp_guided_path"] = Plugin(
        f"{_HERE}.guided.integrator:register_guided_path",
        integrator="guided_path guides all bounces and learns while it renders",
    )
    registry.applications["transport"].outputs["render"] = Lazy(f"{_HERE}.guided.rendering:render_task")


def measures(registry: Registry) -> None:
    """Register measures that compare pictures of fits with the references."""
    here = f"{_HERE}.measures"
    # PSNR compares pixel by pixel, which says nothing about pictures that are generated from noise.
    aligned_apps = ("brdf", "svbrdf_nonstationary", "illumination", "transport")
    flat_apps = ("texture", "svbrdf_stationary", "svbrdf_nonstationary")
    registry.measures["CIE 2000, median"] = Measure(
        f"{here}.pixels:MEDIAN_COLOUR_DIFFERENCE",
        "CIE 2000 colour difference (D65), of which about 1 is just noticeable",
        ("brdf",),
    )
    registry.measures["CIE 2000, 95 %"] = Measure(
        f"{here}.pixels:HIGH_COLOUR_DIFFERENCE", "CIE 2000 colour difference (D65), 95th percentile", ("brdf",)
    )
    registry.measures["sliced Wasserstein"] = Measure(
        f"{here}.textures:WASSERSTEIN",
        "distance of the distributions of features that no fit is compared by, over their deviation",
        ("texture",),
    )
    registry.measures["order"] = Measure(
        f"{here}.textures:ORDER",
        "of exemplars that repeat, the autocorrelation's peaks on their lattice, as high as the exemplar's at 1",
        ("texture",),
    )
    registry.measures["PSNR"] = Measure(f"{here}.pixels:PSNR", "dB, at most 100, more is better", aligned_apps)
    registry.measures["LPIPS"] = Measure(
        f"{here}.perceptual:LPIPS",
        "Zhang et al. 2018, version 0.1, 0 for equal pictures",
        (*flat_apps, "illumination", "transport"),
    )
    registry.measures["DISTS"] = Measure(
        f"{here}.perceptual:DISTS", "Ding et al. 2020, 0 for equal pictures", flat_apps
    )


def mitsuba_bsdfs(registry: Registry) -> None:
    """Register BSDFs of Mitsuba 3 that show fits."""
    registry.plugins["neural_brdf"] = Plugin(f"{_HERE}.mitsuba_bsdfs.neural_brdf:register_neural_brdf")
    registry.plugins["neural_svbrdf"] = Plugin(f"{_HERE}.mitsuba_bsdfs.neural_svbrdf:register_neural_svbrdf")


def native(registry: Registry) -> None:
    """Register steps of learning in C, and compiled by torch, and gradients of outer steps of Meta-SGD in C."""
    registry.hooks["steps"] = Lazy(f"{_HERE}.native.step_choice:choose_steps")


def plan(registry: Registry) -> None:
    """Register the command that chooses directions in which to measure a BRDF."""
    registry.commands["plan"] = Command(f"{_HERE}.plan.plan_command:plan_command", position=90)


def rgl(registry: Registry) -> None:
    """Register BRDFs as Mitsuba 3 has them: files of the RGL material database, and scenes that show fits."""
    here = f"{_HERE}.rgl"
    brdf = registry.applications["brdf"]
    brdf.formats["bsdf"] = Format(f"{here}.rgl", "RGL .bsdf files")
    registry.commands["data bsdf"] = Command(f"{here}.bsdf_converter:BsdfConverter", position=30)
    registry.exports["reflectance", "bsdf"] = Export(f"{here}.rgl:export")
    registry.exports["reflectance", "bsdf-spectral"] = Export(f"{here}.rgl:export_spectral")
    registry.exports["reflectance", "mitsuba"] = Export(f"{here}.brdf_scene:write_brdf_scenes")
    for kind in ("merl", "bsdf", "bsdf-spectral"):
        registry.file_exports[kind] = FileExport(
            f"{here}.brdf_conversion:write_converted",
            files="MERL tables, RGL files, NBRDF networks, folders of them (RUN is the file)",
        )


def rti_files(registry: Registry) -> None:
    """Register exports of objects under many lamps: Polynomial Texture Maps, and folders of the program Relight."""
    registry.exports["lit photos", "ptm"] = Export(f"{_HERE}.rti_files.ptm_file:write_ptm")
    registry.exports["lit photos", "relight"] = Export(f"{_HERE}.rti_files.relight_folder:write_relight")


def scene_files(registry: Registry) -> None:
    """Register scene files of Mitsuba as inputs of light transport."""
    here = f"{_HERE}.scene_files"
    transport = registry.applications["transport"]
    transport.formats["mitsuba"] = Format(
        f"{here}.scene_reader",
        "Mitsuba scenes (.xml, .json) with a perspective camera",
        is_self_contained=False,
    )
    transport.read_object = Lazy(f"{here}.scene_reader:task_of_object")
    registry.hooks["scene"] = Lazy(f"{here}.scene_reader:check_stored_scene")


def shaders(registry: Registry) -> None:
    """Register exports of fitted BRDFs as source code of shaders."""
    weights = ("w1", "b1", "w2", "b2", "w3", "b3")  # 675 numbers; other networks are distilled into a network of these
    for name in ("cpp", "glsl", "hlsl", "materialx", "osl", "wgsl"):
        registry.exports["reflectance", name] = Export(f"{_HERE}.shaders.shader_files:write_{name}", holds=weights)


def vgg(registry: Registry) -> None:
    """Register the command that finds or fetches the ImageNet weights of VGG-16, which losses on pictures read."""
    registry.commands["data vgg"] = Command(f"{_HERE}.vgg.vgg_command:vgg_command", position=180)


def viewer(registry: Registry) -> None:
    """Register interactive HTML pages of fits, and the commands that write them."""
    here = f"{_HERE}.viewer"
    registry.commands["view"] = Command(f"{here}.viewer_commands:view_command", position=50)
    registry.commands["try"] = Command(f"{here}.viewer_commands:try_command", position=10)
    registry.methods["view"] = Lazy(f"{here}.runs_page:write_fit_page")
    registry.pages["reflectance"] = Lazy(f"{here}.pages.brdf:make_reflectance_page")
    registry.pages["radiance"] = Lazy(f"{here}.pages.illumination:make_radiance_page")
    registry.pages["path guide"] = Lazy(f"{here}.pages.transport:make_path_guide_page")
    registry.pages["surface"] = Lazy(f"{here}.pages.flat:make_surface_page")
    registry.pages["texture"] = Lazy(f"{here}.pages.flat:make_texture_page")
