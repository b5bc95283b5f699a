"""The integrator metapp_guided_path: the mean of Mitsuba's path, less noise, and path where it cannot help."""

import itertools
import math
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch

from data_tools.synthetic.cornell import random_scene
from tests.marked import long
from tests.needs_mitsuba import needs_mitsuba

pytestmark = needs_mitsuba
SIZE, SPP, RUNS = 16, 64, 8
LAMPS = ("light", "sky", "bulb")


@pytest.fixture(autouse=True)
def _warnings_are_errors(mi: Any) -> Iterator[None]:
    """Every reason may be warned of once a test; none is unless a test expects it."""
    from metapp.extensions.guided import integrator

    integrator._WARNED.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def ease(integrator: Any, max_error_ratio: float = math.inf) -> Any:
    """Have small pictures guided, too: from few paths on, and whatever their noise."""
    integrator.min_learning_paths, integrator.min_surveyed_paths = 2**10, 2**11
    integrator.max_error_ratio = max_error_ratio
    return integrator


def load_guided(mi: Any, max_depth: int = 5, max_error_ratio: float = math.inf, **more: Any) -> Any:
    return ease(mi.load_dict({"type": "metapp_guided_path", "max_depth": max_depth, **more}), max_error_ratio)


def load_scene_with_film(mi: Any, scene: dict[str, Any], size: int = SIZE) -> Any:
    from metapp.rendering.scenes.rules import instantiate_scene

    scene["sensor"]["film"] |= {"width": size, "height": size}
    return instantiate_scene(mi, scene)


def zoo() -> dict[str, Any]:
    """A Cornell box with textured, coated, rough, see-through and masked spheres, a point light and a sky."""
    scene = {key: value for key, value in random_scene(3).items() if not key.startswith("sphere")}
    checked = {"type": "checkerboard", "to_uv": [[8.0, 0, 0], [0, 8.0, 0], [0, 0, 1.0]]}
    bsdfs: list[dict[str, Any]] = [
        {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": checked}},
        {"type": "roughplastic", "alpha": 0.2},
        {"type": "plastic"},
        {"type": "principled", "roughness": 0.4, "metallic": 0.3},
        {"type": "mask", "opacity": 0.5, "bsdf": {"type": "diffuse"}},
        {"type": "roughconductor", "alpha": 0.3},
        {"type": "roughdielectric", "alpha": 0.2},
        {"type": "dielectric"},
        {"type": "neural_svbrdf", "roughness": 0.4},
    ]
    for i, bsdf in enumerate(bsdfs):
        centre = [0.6 * (i % 3) - 0.6, 0.6 * (i // 3) - 0.7, 0.3 * (i % 2) - 0.2]
        scene[f"ball{i}"] = {"type": "sphere", "center": centre, "radius": 0.26, "bsdf": bsdf}
    scene["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}}
    scene["bulb"] = {"type": "point", "position": [0.3, 0.3, 0.8], "intensity": {"type": "rgb", "value": [0.3] * 3}}
    return scene


def pictures(mi: Any, scene: Any, kind: str, spp: int = SPP, **more: Any) -> np.ndarray[Any, Any]:
    """Several pictures, [runs, rows, columns, 3], in double precision."""
    integrator = (
        load_guided(mi, **more) if kind == "metapp_guided_path" else mi.load_dict({"type": kind, "max_depth": 5})
    )
    first = 100 if kind == "path" else 0
    result = [mi.render(scene, integrator=integrator, spp=spp, seed=first + seed) for seed in range(RUNS)]
    return np.stack([np.array(rendering, np.float64)[..., :3] for rendering in result])


def deviation(first: np.ndarray[Any, Any], second: np.ndarray[Any, Any]) -> float:
    """The difference of two means over runs, in standard errors."""
    means = first.mean((1, 2, 3)), second.mean((1, 2, 3))
    error = math.sqrt(sum(mean_of_runs.var(ddof=1) for mean_of_runs in means) / RUNS)
    assert error < 0.03 * means[1].mean()  # or it would say little
    return float((means[0].mean() - means[1].mean()) / error)


def test_mean_agrees_with_path_in_a_box(mi: Any) -> None:
    scene = load_scene_with_film(mi, random_scene(1))  # has glass and metal
    guided = pictures(mi, scene, "metapp_guided_path")
    plain = pictures(mi, scene, "path")
    assert abs(deviation(guided[:, SIZE // 2 :], plain[:, SIZE // 2 :])) < 3
    assert abs(deviation(guided, plain)) < 3


@pytest.mark.parametrize("lamp", [long(lamp) for lamp in LAMPS])
def test_mean_agrees_with_path_for_all_materials_in_all_lights(mi: Any, lamp: str) -> None:
    scene = zoo()
    for other in set(LAMPS) - {lamp}:
        del scene[other]
    scene = load_scene_with_film(mi, scene)
    assert abs(deviation(pictures(mi, scene, "metapp_guided_path"), pictures(mi, scene, "path"))) < 3


@pytest.mark.long
def test_guided_pictures_have_less_noise_than_path(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from metapp.extensions.guided.guide_cache import GuideCache

    scene, noise = load_scene_with_film(mi, random_scene(101), 64), []
    integrator = load_guided(mi)
    for learns in (True, False):
        if not learns:
            monkeypatch.setattr(GuideCache, "update_histograms", lambda cache: 0)
        result = [np.array(mi.render(scene, integrator=integrator, spp=256, seed=seed)) for seed in (1, 2)]
        noise.append(np.mean(np.abs(result[0] - result[1]) / (result[0] + result[1] + 1e-2)))
    assert noise[0] < 0.85 * noise[1]


@pytest.mark.long
def test_pictures_depend_on_the_seed_alone(mi: Any) -> None:
    scene = load_scene_with_film(mi, random_scene(1))
    guided = load_guided(mi, 4)
    first, again, other = (np.array(mi.render(scene, integrator=guided, spp=32, seed=seed)) for seed in (3, 3, 4))
    assert np.allclose(first, again, rtol=1e-5)
    assert not np.allclose(first, other, rtol=1e-2)


def test_integrator_loads_from_xml_with_films_of_any_size(mi: Any) -> None:
    scene = mi.load_string("""<scene version="3.0.0">
      <integrator type="metapp_guided_path"><integer name="max_depth" value="4"/></integrator>
      <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
        <sampler type="multijitter"><integer name="sample_count" value="36"/></sampler>
        <film type="hdrfilm"><string name="pixel_format" value="rgba"/>
          <integer name="width" value="33"/><integer name="height" value="18"/>
          <integer name="crop_offset_x" value="2"/><integer name="crop_width" value="21"/></film>
      </sensor>
      <shape type="sphere"><bsdf type="diffuse"/></shape>
      <emitter type="constant"/>
    </scene>""")
    ease(scene.integrator())
    picture = np.array(mi.render(scene))
    assert picture.shape == (18, 21, 4)
    plain = np.array(mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 4}), spp=400))
    assert np.abs(picture - plain).mean() < 0.02
    assert np.array(scene.sensors()[0].film().bitmap()).shape == (18, 21, 4)


FILMS = {
    "border": '<boolean name="sample_border" value="true"/><rfilter type="gaussian"/>',
    "wide border of a crop": '<boolean name="sample_border" value="true"/><integer name="crop_width" value="9"/>'
    '<integer name="crop_offset_y" value="3"/><integer name="crop_height" value="7"/><rfilter type="lanczos"/>',
    "luminance": '<string name="pixel_format" value="luminance_alpha"/>',
    "halves": '<string name="component_format" value="float16"/><boolean name="compensate" value="true"/>',
}


@pytest.mark.parametrize("film", FILMS.values(), ids=FILMS)
def test_pictures_agree_with_path_in_films_of_all_kinds(mi: Any, film: str) -> None:
    scene = mi.load_string(f"""<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/>{film}</film></sensor>
      <shape type="sphere"><bsdf type="diffuse"/></shape>
      <emitter type="constant"/>
    </scene>""")
    guided, plain = (
        np.array(mi.render(scene, integrator=integrator, spp=400), np.float64)
        for integrator in (load_guided(mi, 4), mi.load_dict({"type": "path", "max_depth": 4}))
    )
    assert guided.shape == plain.shape
    assert np.abs(guided - plain).mean() < 0.02
    assert np.abs(guided[0] - plain[0]).mean() < 0.02


def test_guide_ignores_the_default_device_of_the_program(mi: Any) -> None:
    scene, guided = load_scene_with_film(mi, random_scene(1)), load_guided(mi, 4)
    expected = np.array(mi.render(scene, integrator=guided, spp=32))
    with torch.device("meta"):  # stands for CUDA
        assert np.allclose(np.array(mi.render(scene, integrator=guided, spp=32)), expected, rtol=1e-5)


def test_derivatives_are_refused(mi: Any) -> None:
    import drjit as dr

    scene = load_scene_with_film(mi, random_scene(1))
    values = mi.traverse(scene)
    key = next(key for key in values.keys() if "reflectance" in key)  # noqa: SIM118  (no mapping)
    dr.enable_grad(values[key])
    values.update()
    picture = mi.render(scene, values, integrator=load_guided(mi, 4), spp=16)
    with pytest.raises(Exception, match="metapp_guided_path") as caught:
        dr.backward(dr.mean(picture, axis=None))
    assert "metapp_guided_path has no derivatives, expected an integrator that has; take prb" in (
        f"{caught.value} {caught.value.__cause__}"
    )


@pytest.mark.parametrize(
    ("more", "spp", "why"),
    [
        ({"max_depth": 2}, 32, "direct light alone"),
        ({"hide_emitters": True}, 32, "hide_emitters"),
        ({}, 2, "512 paths .*, expected 2,048 or more"),
    ],
)
def test_path_renders_with_one_warning_where_guiding_cannot_help(mi: Any, more: Any, spp: int, why: str) -> None:
    scene = load_scene_with_film(mi, random_scene(1))
    guided, plain = load_guided(mi, **more), mi.load_dict({"type": "path", "max_depth": 5} | more)
    with pytest.warns(UserWarning, match=f"metapp_guided_path: .*{why}.*; rendered by path"):
        found = mi.render(scene, integrator=guided, spp=spp, seed=1)
    assert np.array_equal(np.array(found), np.array(mi.render(scene, integrator=plain, spp=spp, seed=1)))
    mi.render(scene, integrator=guided, spp=spp, seed=1)  # a second warning would be an error


def test_inside_another_integrator_path_renders(mi: Any) -> None:
    scene = load_scene_with_film(mi, random_scene(1))
    both = mi.load_dict({"type": "aov", "aovs": "d:depth", "own": load_guided(mi, 4)})
    with pytest.warns(UserWarning, match="another integrator"):
        assert np.isfinite(np.array(mi.render(scene, integrator=both, spp=16))).all()


@pytest.mark.parametrize(
    ("spp", "pixels"), [(4, 2**20), (7, 2**20), (16, 16), (17, 65536), (64, 4096), (1000, 65536), (4096, 2**20)]
)
def test_parts_of_samples_double_and_sum_to_all(spp: int, pixels: int) -> None:
    from metapp.extensions.guided import guided_picture

    regular, *guided, last = guided_picture.split_samples(spp, pixels)
    assert regular + sum(guided) + last == spp
    assert last >= spp / 2
    assert regular == max(1, guided[0] // 2)
    assert guided[0] <= spp / 4
    assert all(after == 2 * before for before, after in itertools.pairwise(guided))


@pytest.mark.parametrize(("spread", "bounces", "pays"), [(0.1, 4, False), (0.04, 4, True), (0.04, 40, False)])
def test_the_guard_compares_errors_in_the_same_time(spread: float, bounces: float, pays: bool) -> None:
    """Whose error is 0.4 of the regular one's may take 0.4**-2 of its time; what a picture shows is no noise."""
    from metapp.extensions.guided import guided_picture

    rng = np.random.default_rng(0)
    shown = rng.uniform(0, 9, (64, 64, 1))
    regular = guided_picture.PartCost(shown + 0.1 * rng.standard_normal((64, 64, 8)), 4.0)
    guided = guided_picture.PartCost(shown + spread * rng.standard_normal((64, 64, 16)), bounces)
    assert guided.reduces_error(regular) is pays
    assert guided_picture.PartCost(np.zeros((40, 3, 8)), 1.0).relative_noise(8) == 0


@pytest.mark.parametrize("sides", [1, 2])
def test_lambertian_shortcut_agrees_with_the_plugin(mi: Any, sides: int) -> None:
    import drjit as dr

    from metapp.extensions.guided.vertex import is_lambertian, lambertian_functions

    plain = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.9]}}
    bsdf = mi.load_dict(plain if sides == 1 else {"type": "twosided", "inside": plain})
    assert is_lambertian(bsdf)
    rng = np.random.default_rng(0)
    wi, wo = (mi.Vector3f(vectors / np.linalg.norm(vectors, axis=0)) for vectors in rng.standard_normal((2, 3, 1000)))
    si = dr.zeros(mi.SurfaceInteraction3f, 1000)
    si.wi = wi
    value, density = lambertian_functions(bsdf, si, mi.Bool(True))(wo)
    expected, expected_density = bsdf.eval_pdf(mi.BSDFContext(), si, wo)
    assert value.numpy() == pytest.approx(expected.numpy(), rel=1e-5)
    assert density.numpy() == pytest.approx(expected_density.numpy(), rel=1e-5)
    for other in ({"type": "twosided", "inside": {"type": "roughplastic"}}, {"type": "bumpmap", "arbitrary": {
            "type": "checkerboard"}, "inside": plain}, {"type": "mask", "inside": plain}):  # fmt: skip
        assert not is_lambertian(mi.load_dict(other))


@pytest.mark.long
def test_pictures_of_few_samples_are_guided_by_the_survey(mi: Any) -> None:
    scene = load_scene_with_film(mi, random_scene(101), 128)
    integrator = load_guided(mi)
    noise = []
    for tested in (integrator, mi.load_dict({"type": "path", "max_depth": 5})):
        result = [np.array(mi.render(scene, integrator=tested, spp=3, seed=seed)).mean(-1) for seed in (1, 2, 3, 4)]
        noise.append(np.mean(np.abs(result[0] + result[1] - result[2] - result[3]) / (sum(result) + 1e-2)))
    assert list(integrator.spent) == ["survey", "guided samples", "learning"]
    assert noise[0] < 0.95 * noise[1]


@pytest.mark.parametrize(("size", "surveys"), [(8, 0), (16, 1)])
def test_pictures_of_few_paths_are_rendered_without_a_survey(
    mi: Any, monkeypatch: pytest.MonkeyPatch, size: int, surveys: int
) -> None:
    from metapp.extensions.guided import guided_picture

    result, survey = [], guided_picture.survey
    monkeypatch.setattr(guided_picture, "survey", lambda *arguments: result.append(survey(*arguments)) or result[-1])
    integrator = load_guided(mi, 4)
    mi.render(load_scene_with_film(mi, random_scene(101), size), integrator=integrator, spp=16)
    assert len(result) == surveys
    assert "guided samples" in integrator.spent


def test_guard_drops_a_guide_that_does_not_reduce_errors(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from metapp.extensions.guided.guide_cache import GuideCache
    from metapp.extensions.guided.histogram import HISTOGRAM_BINS

    # whatever is learned, all paths but the fewest go one way
    one = torch.eye(HISTOGRAM_BINS, dtype=torch.float64)[5:6]
    monkeypatch.setattr(GuideCache, "update_histograms", lambda cache: cache._tabulate(one))
    scene = load_scene_with_film(mi, random_scene(2), 32)
    guided = load_guided(mi, max_error_ratio=1.0)
    with pytest.warns(UserWarning, match="does not lower the noise enough"):
        mi.render(scene, integrator=guided, spp=SPP)
