"""Tasks and recipes small enough for what every application and paradigm promises."""

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
from metapp.appearance.flash import Maps, normal_from_height, pack_maps
from metapp.appearance.latlong import mean_luminance, texel_directions
from metapp.appearance.photograph import photograph_spheres
from metapp.apps import app_of, recipes_of
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.feature_network import Featured
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.illumination.app import Illumination
from metapp.apps.svbrdf_nonstationary.coded_maps import FromMaps, field_of
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.apps.texture.app import Texture
from metapp.apps.transport.app import Transport
from metapp.apps.transport.flow import Flow
from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters, final_item
from metapp.learning.recipe import Adam, MetaTraining, Recipe
from metapp.learning.rules.solve import linear_parameter
from metapp.learning.task import Task
from metapp.names import app_names
from metapp.networks.field import LocalField
from metapp.networks.generators import UNet
from metapp.paradigms import PARADIGMS, paradigm_of
from metapp.paradigms.meta import Meta
from metapp.paradigms.paradigm import Paradigm
from metapp.paradigms.phi_training import TrainState
from metapp.registry import registry
from tests.marked import long
from tests.small_spheres import shrink_spheres

COUNT = 12
# an application that has a second network stands for two
FEATURED = "brdf, features"
KINDS = [*app_names(), FEATURED]
OWN_RULES = {name: recipes_of(name)["quick"].rule for name in app_names()} | {FEATURED: "ridge"}
ONE_QUICK = ["brdf", *(long(kind) for kind in KINDS if kind != "brdf")]  # trainings of one application, of others long


class Small(NamedTuple):
    """What makes an application small enough for its contract: small networks, and tasks."""

    tasks: Callable[[], list[Task]]
    app: App


def brdf_tasks() -> list[Task]:
    with pytest.MonkeyPatch.context() as patch:
        shrink_spheres(patch)
        return [make_brdf_task(each.name, each.evaluate, samples=512) for each in synthetic_materials("train", COUNT)]


def picture_tasks() -> list[Task]:
    return list(synthetic_tasks("train", COUNT, size=32))


def map_tasks() -> list[Task]:
    """Maps of one lamp each, all around, and a photograph."""
    generator, towards, tasks = rng(7), texel_directions(16, 32), []
    for i in range(COUNT):
        lamp = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0)
        colour = 0.3 + torch.rand(3, 1, 1, generator=generator)
        light = 0.3 + colour * (6 * (torch.einsum("c,chw->hw", lamp, towards) - 0.6)).exp()
        light = light / mean_luminance(light)
        photos = (photograph_spheres(light[None], generator) * 255).round().to(torch.uint8)
        tasks.append(Task(f"lamp-{i}", {"map": light, "scale": torch.tensor(2.0), "photos": photos}))
    return tasks


def material_tasks() -> list[Task]:
    """Smooth materials of two colours each, and how they look under a flash."""
    generator, tasks = rng(7), []
    for i in range(COUNT):
        coarse = torch.rand(1, 8, 3, 3, generator=generator)
        smooth = torch.nn.functional.interpolate(coarse, (16, 16), mode="bilinear")[0]
        normal = normal_from_height(3 * smooth[:1])
        maps = Maps(0.8 * smooth[1:4], 0.1 + 0.4 * smooth[4:7], 0.2 + 0.6 * smooth[7:], normal)
        tasks.append(make_svbrdf_task(f"material-{i}", pack_maps(maps)))
    return tasks


def path_tasks() -> list[Task]:
    """Samples of which half are on a lamp, and others come from where it is, and a picture of 8 px."""
    generator, tasks = rng(7), []
    for i in range(COUNT):
        lamp = 0.2 + 0.6 * torch.rand(2, generator=generator)
        samples = torch.rand(2048, 4, generator=generator)
        samples[:1024, :2] = lamp + 0.1 * (samples[:1024, :2] - 0.5)
        samples[1024:, 2:] = 0.5 + 0.5 * (lamp - samples[1024:, :2]) + 0.1 * (samples[1024:, 2:] - 0.5)
        samples = samples.clamp(0, 0.999)[torch.randperm(2048, generator=generator)]
        row, column = ((8 * samples[:, k]).long() for k in (1, 0))
        image = torch.bincount(8 * row + column, minlength=64).reshape(1, 8, 8).expand(3, -1, -1) / 32
        tasks.append(Task(f"room-{i}", {"samples": samples[:1536], "held": samples[1536:], "image": image.clone()}))
    return tasks


SMALL_OCTAVES = Octaves(16, 16, ("relu1_1",))
SMALL: dict[str, Small] = {
    "brdf": Small(brdf_tasks, Brdf(NBRDF_NETWORK)),
    "illumination": Small(map_tasks, Illumination(LocalField(8, 16, rows=4, columns=8, code=3, hidden=8, layers=2))),
    "svbrdf_nonstationary": Small(material_tasks, FromMaps(field_of(16, hidden=8)._replace(code=3), encoder_width=2)),
    "svbrdf_stationary": Small(
        picture_tasks, SvbrdfStationary(UNet(4, levels=2, noise=2, code=4, outputs=6), SMALL_OCTAVES)
    ),
    "texture": Small(picture_tasks, Texture(UNet(4, levels=2, noise=2, code=4, outputs=3), SMALL_OCTAVES)),
    "transport": Small(path_tasks, Transport(Flow(rows=4, columns=4, code=3, hidden=8, bins=4, film_bins=8, blobs=6))),
}


def small_app(kind: str) -> App:
    """An application, or its second network, small."""
    if kind == FEATURED:
        return Brdf(Featured(width=8, features=5, code=3, encoder=8))
    return app_of(kind, replace(recipes_of(kind)["quick"], app=SMALL[kind].app))


def small_recipe(app: App) -> Recipe:
    """The quick recipe, with few samples, tasks and steps, and every rule that applies."""
    recipe = recipes_of(app.name)["quick"]

    few: dict[str, Any] = {"steps": 6, "tasks": 3, "warmup": 0, "validate_every": 2, "validation_variants": 0}

    def short(training: MetaTraining) -> MetaTraining:
        rates = training.rates if training.steps else {"": 1e-4, "alpha.out.": 0.0, "alpha.in.": 0.0}
        # a guard's shares are of trained rules
        return replace(training, **few, rates=rates, tuned=False, app=None, guard=None)

    return replace(
        recipe,
        steps=3,
        batch=min(64, recipe.batch),
        overfit_steps=20,
        finetune_steps=8,
        general=replace(recipe.general, **few),
        meta={rule: short(recipe.meta.get(rule, recipe.meta[recipe.rule])) for rule in applicable(app)},
        app=app,
        rule="ridge" if linear_parameter(app) else recipe.rule,
    )


def applicable(app: App) -> list[str]:
    """The named rules whose parts apply to an application."""
    theta = {key: value[0] for key, value in app.init(rng(), 1).items()}
    return [name for name in registry().rules if not any(part.refusal(app, theta) for part in rule_of(name).parts)]


def rng(seed: int = 0) -> Generator:
    return Generator().manual_seed(seed)


def fits_of(app: App, recipe: Recipe, rule: str = "", steps: int | None = None) -> dict[str, Paradigm]:
    """The five paradigms of an application, by name."""
    return {name: paradigm_of(name).of(app, recipe, rule, steps) for name in PARADIGMS}


def untrained(paradigm: Paradigm) -> MetaParameters:
    """phi for every paradigm: a random encoder, a random theta_0 and its rule's initial hyperparameters."""
    app = paradigm.app
    theta = {key: value[0] for key, value in app.init(rng(1), 1).items()}
    rule = paradigm.learned_rule if isinstance(paradigm, Meta) else rule_of(paradigm.recipe.rule)
    alpha = rule.initial_alpha(app, theta, paradigm.recipe.steps, Adam(5e-3, beta2=0.99))
    return MetaParameters(theta, alpha, app.init_encoder(rng(2)))


def result(preparation: Iterable[TrainState]) -> TrainState:
    """The best state at the end of a preparation."""
    return final_item(preparation)


def prepared_for(paradigm: Paradigm) -> MetaParameters:
    """What its preparation would leave, untrained."""
    phi = untrained(paradigm)
    return phi._replace(encoder={}) if paradigm.name == "meta" else MetaParameters(encoder=phi.encoder)


# each application with its own rule, and each other rule on the fastest application, instead of all with all
PAIRS = [
    *OWN_RULES.items(),
    *(("brdf", rule) for rule in applicable(Brdf(NBRDF_NETWORK)) if rule not in OWN_RULES.values()),
]
