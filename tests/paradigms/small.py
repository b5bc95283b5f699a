"""Small tasks, networks and recipes of every application, for tests of the contract of applications and paradigms."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import pytest
import torch
from torch import Generator

from data_tools.readers.brdf_task import make_brdf_task
from data_tools.readers.svbrdf_task import make_svbrdf_task
from data_tools.synthetic.brdf import synthetic_materials
from data_tools.synthetic.texture import synthetic_tasks
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.latlong import mean_luminance, texel_directions
from metapp.appearance.photograph import photograph_spheres
from metapp.appearance.svbrdf_maps import Maps, pack_maps
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.feature_network import Featured
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.ball_sight import BallSight
from metapp.apps.illumination.lighting import LightField
from metapp.apps.illumination.map_sight import MapSight
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.encoder import PhotoEncoder
from metapp.apps.svbrdf_nonstationary.field_judge import FieldJudge
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps, field_of
from metapp.apps.svbrdf_nonstationary.maps_sight import MapsSight
from metapp.apps.svbrdf_nonstationary.photo_sight import PhotoSight
from metapp.apps.svbrdf_stationary.app import compose_svbrdf
from metapp.apps.texture.app import compose_texture
from metapp.apps.transport.app import Transport
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.path_fits import FlowDensity
from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters, final_item
from metapp.learning.recipe import Adam, MetaTraining, Recipe
from metapp.learning.task import Task
from metapp.networks.field import LocalField
from metapp.networks.generators import UNet
from metapp.networks.quilted import LightGrid
from metapp.paradigms.training import TrainState
from metapp.registry import registry
from tests.marked import long
from tests.recipe_apps import app_names, recipes_of
from tests.small_spheres import shrink_spheres

TASK_COUNT = 12
# the second network of BRDFs, and that of textures, are tested as if they were applications of their own
FEATURE_NETWORK, QUILTED_TEXTURE = "brdf, features", "texture, quilted"
NETWORK_KINDS = [*app_names(), FEATURE_NETWORK, QUILTED_TEXTURE]
OWN_RULES = {name: recipes_of(name)["quick"].rule for name in app_names()} | {
    FEATURE_NETWORK: "ridge",
    QUILTED_TEXTURE: "meta-encoder",
}
KINDS_BUT_BRDF_LONG = [
    "brdf",
    *(long(kind) for kind in NETWORK_KINDS if kind != "brdf"),
]  # trainings of other applications than BRDF take seconds
# quilts have low errors before any training, which improves them little
GENERATING_KINDS_BUT_BRDF_LONG = [
    "brdf",
    *(long(kind) for kind in NETWORK_KINDS if kind not in ("brdf", QUILTED_TEXTURE)),
]


class SmallApplication(NamedTuple):
    """A function that makes an application's small tasks, and the application with a small network."""

    tasks: Callable[[], list[Task]]
    app: App


def brdf_tasks() -> list[Task]:
    """Make synthetic BRDFs of 512 samples."""
    with pytest.MonkeyPatch.context() as patch:
        shrink_spheres(patch)
        materials = synthetic_materials("train", TASK_COUNT)
        return [make_brdf_task(material.name, material.evaluate, samples=512) for material in materials]


def picture_tasks() -> list[Task]:
    """Make synthetic textures of 32 px."""
    return list(synthetic_tasks("train", TASK_COUNT, size=32))


def map_tasks() -> list[Task]:
    """Make environment maps of one lamp each, with photographs of spheres in them."""
    generator, towards, tasks = seeded_generator(7), texel_directions(16, 32), []
    for i in range(TASK_COUNT):
        lamp = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0)
        colour = 0.3 + torch.rand(3, 1, 1, generator=generator)
        light = 0.3 + colour * (6 * (torch.einsum("c,chw->hw", lamp, towards) - 0.6)).exp()
        light = light / mean_luminance(light)
        photos = (photograph_spheres(light[None], generator) * 255).round().to(torch.uint8)
        tasks.append(Task(f"lamp-{i}", {"map": light, "scale": torch.tensor(2.0), "photos": photos}))
    return tasks


def material_tasks() -> list[Task]:
    """Make smooth random material maps of 16 px, with flash photographs."""
    generator, tasks = seeded_generator(7), []
    for i in range(TASK_COUNT):
        coarse = torch.rand(1, 8, 3, 3, generator=generator)
        smooth = torch.nn.functional.interpolate(coarse, (16, 16), mode="bilinear")[0]
        normal = normal_from_height(3 * smooth[:1])
        maps = Maps(0.8 * smooth[1:4], 0.1 + 0.4 * smooth[4:7], 0.2 + 0.6 * smooth[7:], normal)
        tasks.append(make_svbrdf_task(f"material-{i}", pack_maps(maps)))
    return tasks


def path_tasks() -> list[Task]:
    """Make samples of light paths that lie on a lamp or depend on where it is, with a picture of 8 px."""
    generator, tasks = seeded_generator(7), []
    for i in range(TASK_COUNT):
        lamp = 0.2 + 0.6 * torch.rand(2, generator=generator)
        samples = torch.rand(2048, 4, generator=generator)
        samples[:1024, :2] = lamp + 0.1 * (samples[:1024, :2] - 0.5)
        samples[1024:, 2:] = 0.5 + 0.5 * (lamp - samples[1024:, :2]) + 0.1 * (samples[1024:, 2:] - 0.5)
        samples = samples.clamp(0, 0.999)[torch.randperm(2048, generator=generator)]
        row, column = ((8 * samples[:, k]).long() for k in (1, 0))
        image = torch.bincount(8 * row + column, minlength=64).reshape(1, 8, 8).expand(3, -1, -1) / 32
        tasks.append(Task(f"room-{i}", {"samples": samples[:1536], "held_out": samples[1536:], "image": image.clone()}))
    return tasks


SMALL_OCTAVES = Octaves(16, 16, ("relu1_1",))
SMALL_LIGHT_FIELD = LightField(LocalField(8, 16, rows=4, columns=8, code=3, hidden=8, layers=2))
SMALL_FIELD_MAPS = FieldMaps(field_of(16, hidden=8)._replace(code=3))
SMALL_APPLICATIONS: dict[str, SmallApplication] = {
    "brdf": SmallApplication(brdf_tasks, Brdf(NBRDF_NETWORK)),
    "illumination": SmallApplication(map_tasks, Illumination(SMALL_LIGHT_FIELD, MapSight())),
    "svbrdf_nonstationary": SmallApplication(
        material_tasks, SvbrdfNonstationary(SMALL_FIELD_MAPS, MapsSight(), FieldJudge(), PhotoEncoder(2))
    ),
    "svbrdf_stationary": SmallApplication(
        picture_tasks, compose_svbrdf(UNet(4, levels=2, noise=2, code=4, outputs=6), SMALL_OCTAVES)
    ),
    "texture": SmallApplication(
        picture_tasks, compose_texture(UNet(4, levels=2, noise=2, code=4, outputs=3), SMALL_OCTAVES)
    ),
    "transport": SmallApplication(
        path_tasks, Transport(FlowDensity(Flow(rows=4, columns=4, code=3, hidden=8, bins=4, film_bins=8, blobs=6)))
    ),
}


SMALL_PHOTO_APPS: dict[str, App] = {
    "illumination": Illumination(SMALL_LIGHT_FIELD, BallSight()),
    "svbrdf_nonstationary": SvbrdfNonstationary(SMALL_FIELD_MAPS, PhotoSight(), FieldJudge(), PhotoEncoder(2)),
}


def small_app(kind: str, observes: str = "") -> App:
    """Return an application with a small network; BRDFs and textures have a second one each."""
    if kind == FEATURE_NETWORK:
        return Brdf(Featured(width=8, features=5, code=3, encoder=8))
    if kind == QUILTED_TEXTURE:
        return compose_texture(LightGrid(4, 4), SMALL_OCTAVES, candidates=1)
    return SMALL_PHOTO_APPS[kind] if observes == "photo" else SMALL_APPLICATIONS[kind].app


def small_recipe(app: App) -> Recipe:
    """Return the quick recipe with few samples, tasks and steps, and with every rule that applies."""
    recipe = recipes_of(app.name)["quick"]

    few_steps: dict[str, Any] = {
        "steps": 6,
        "tasks": 3,
        "warmup_steps": 0,
        "validate_every": 2,
        "validation_variants": 0,
    }

    def shorten(training: MetaTraining) -> MetaTraining:
        rates = training.rates if training.steps else {"": 1e-4, "alpha.out.": 0.0, "alpha.in.": 0.0}
        # thresholds of a guard hold for trained rules alone
        return replace(training, **few_steps, rates=rates, searches_adam=False, app=None, guard=None)

    return replace(
        recipe,
        steps=3,
        samples=min(64, recipe.samples),
        overfit_steps=20,
        finetune_steps=8,
        general=replace(recipe.general, **few_steps),
        meta={rule: shorten(recipe.meta.get(rule, recipe.meta[recipe.rule])) for rule in applicable_rules(app)},
        app=app,
        rule="ridge" if app.linear_parameter else recipe.rule,
    )


def applicable_rules(app: App) -> list[str]:
    """Return the names of the rules whose parts all apply to an application."""
    theta = {key: value[0] for key, value in app.init(seeded_generator(), 1).items()}
    return [name for name in registry().rules if not any(part.refusal(app, theta) for part in rule_of(name).parts)]


def seeded_generator(seed: int = 0) -> Generator:
    """Return a new generator of torch with a seed."""
    return Generator().manual_seed(seed)


def untrained_phi(app: App, recipe: Recipe, rule: str = "") -> MetaParameters:
    """Return phi with a random encoder, a random theta_0 and the initial hyperparameters of a rule."""
    theta = {key: value[0] for key, value in app.init(seeded_generator(1), 1).items()}
    alpha = rule_of(rule or recipe.rule).initial_alpha(app, theta, recipe.steps, Adam(5e-3, beta2=0.99))
    return MetaParameters(theta, alpha, app.init_encoder(seeded_generator(2)))


def best_state(training: Iterable[TrainState]) -> TrainState:
    """Run a training to its end and return the best state."""
    return final_item(training)


def untrained_checkpoint(paradigm: str, app: App, recipe: Recipe, rule: str = "") -> MetaParameters:
    """Return the parts of phi that the training of a paradigm would learn, untrained."""
    phi = untrained_phi(app, recipe, rule)
    return phi._replace(encoder={}) if paradigm == "meta" else MetaParameters(encoder=phi.encoder)


# each application with its own rule, and each other rule with BRDFs, the fastest, instead of all combinations
KINDS_AND_RULES = [
    *OWN_RULES.items(),
    *(("brdf", rule) for rule in applicable_rules(Brdf(NBRDF_NETWORK)) if rule not in OWN_RULES.values()),
]
