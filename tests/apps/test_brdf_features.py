"""Learned features of BRDFs, of which least squares combines a material, and the protocol of all their networks."""

import math

import pytest
import torch
from torch import Generator, Tensor

from data_tools.readers.brdf_task import make_brdf_task
from metapp.appearance.geometry import angle_cosines, half_difference_and_cosine, half_difference_vectors
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import BrdfNetwork, find_network, parameter_shapes
from metapp.apps.brdf.feature_network import Featured, isotropic_inputs
from metapp.apps.brdf.recipes import RECIPES
from metapp.apps.brdf.sample_augmentation import (
    FEWEST_SAMPLES,
    MAX_MEASURED_RAD,
    draw_measurements,
    is_reachable,
    sample_densities,
)
from metapp.apps.brdf.sample_sight import MANY_SAMPLES
from metapp.learned_rules import rule_of
from metapp.learning.app import stack_tasks
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms.methods import fit_tasks, make_method
from metapp.registry import registry

SIZE = Featured(width=12, features=7, code=3, encoder=8)
APP = Brdf(SIZE)
RECIPE = RECIPES["full"]


@pytest.fixture
def theta() -> Params:
    """The parameters of a network with a random material that reflects everywhere."""
    rng = Generator().manual_seed(1)
    one = APP.init(rng, 1)
    last = 0.2 * torch.randn(one["last"].shape, generator=rng)
    last[:, :, -1] = 3
    return one | {"last": last, "z": torch.randn(1, 3, 1, generator=rng)}


@pytest.fixture
def where() -> torch.Tensor:
    angles = torch.tensor([math.pi / 2, math.pi / 2, 2 * math.pi]) * torch.rand(
        500, 3, generator=Generator().manual_seed(2)
    )
    return torch.cat([half_difference_vectors(angles), angle_cosines(angles).incident[:, None]], 1).T[None]


def tasks_of(theta: Params) -> Tasks:
    single = {key: value[0] for key, value in theta.items()}
    return stack_tasks(APP, [make_brdf_task("made", lambda angles: APP.reflectance(single, angles), samples=4096)])


def test_inputs_are_reciprocal_and_mirror_images_alike(rng: Generator) -> None:
    """Inputs agree to rounding, for every phi_d where the half vector is the normal, and are smooth at sign changes."""
    angles = torch.rand(2000, 3, generator=rng, dtype=torch.float64) * torch.tensor([1.5, 1.5, math.tau])

    def inputs(angles: Tensor) -> Tensor:
        return isotropic_inputs(half_difference_and_cosine(angles).T[None])

    theta_h, theta_d, phi_d = angles.unbind(-1)
    for same in (-phi_d, phi_d + math.pi, math.pi - phi_d):
        torch.testing.assert_close(inputs(torch.stack([theta_h, theta_d, same], -1)), inputs(angles))
    normal = torch.zeros_like(theta_h)
    at_normal = inputs(torch.stack([normal, theta_d, phi_d], -1))
    torch.testing.assert_close(at_normal, inputs(torch.stack([normal, theta_d, normal], -1)))
    for edge in (0.0, math.pi / 2):
        step = torch.full_like(phi_d, 1e-5)
        before, after = (inputs(torch.stack([theta_h, theta_d, edge + sign * step], -1)) for sign in (-1, 1))
        torch.testing.assert_close(before, after)
        apart = inputs(torch.stack([theta_h, theta_d, edge + 2 * step], -1)) - after
        assert float(apart.abs().max()) < 1e-5  # a slope of 0 there, and no corner


def test_a_material_is_linear_in_the_last_layer(theta: Params, where: torch.Tensor) -> None:
    """The last feature is constant."""
    assert bool((SIZE.linear_features(theta, where)[:, -1] == 1).all())
    twice = theta | {"last": 2 * theta["last"]}
    logs = [torch.log1p(SIZE.reflectance(parameters, where)) for parameters in (theta, twice)]
    torch.testing.assert_close(2 * logs[0], logs[1], rtol=1e-4, atol=1e-5)


def test_ridge_recovers_a_material_that_its_features_span(theta: Params) -> None:
    """From a last layer of zeros, in five steps of 512 samples."""
    start = MetaParameters(
        {key: value[0] for key, value in (theta | {"last": 0 * theta["last"]}).items()},
        rule_of("ridge").initial_alpha(APP, {key: value[0] for key, value in theta.items()}, 5, Adam(1e-3)),
    )
    start.alpha["penalty.last"].fill_(-20.0)
    tasks = tasks_of(theta)
    method = make_method("meta", APP, RECIPE, start, rule="ridge", steps=5)
    fit = fit_tasks(method, tasks, Generator().manual_seed(5))
    before = float(APP.errors({key: value[None] for key, value in start.theta.items()}, tasks)["error"])
    assert float(APP.errors(fit, tasks)["error"]) < 1e-3 * before
    for key, value in fit.items():
        assert key == "last" or torch.equal(value, theta[key])


def test_weights_follow_the_loss(theta: Params) -> None:
    """The gradient of the weighted squares is that of the smoothed loss, but for what weights do to three channels.

    Where all channels are the same, it is the same.
    """
    theta = {key: value.double() for key, value in theta.items()}
    theta["last"] = theta["last"][:, :1].expand(-1, 3, -1).clone()
    tasks = tasks_of({key: value.float() for key, value in theta.items()})
    batch = {key: value.double() for key, value in APP.sample(tasks, Generator().manual_seed(6), 300).items()}
    changed = theta | {"last": (theta["last"] + 1e-4).requires_grad_()}
    loss_parameters = {"smoothing": torch.tensor([math.log(0.02)], dtype=torch.float64)}
    loss_parameters["evidence"] = torch.zeros(1, 2, dtype=torch.float64)
    expected = torch.autograd.grad(APP.loss(changed, batch, loss_parameters).sum(), changed["last"])[0]
    near = APP.least_squares(changed, batch, loss_parameters)
    found = -(near.residual * near.weights[:, None]) @ near.features.mT / near.weights.shape[1]
    torch.testing.assert_close(found / 3, expected, rtol=2e-2, atol=2e-2 * float(expected.abs().max()))


def test_few_samples_and_samples_that_are_missed_count_less(theta: Params) -> None:
    """Weights are those of many samples times learned powers of the count and of the misfit."""
    tasks = tasks_of(theta)
    batch = APP.sample(tasks, Generator().manual_seed(6), 300)
    changed = theta | {"last": theta["last"] + 0.01}
    loss_parameters = {"smoothing": torch.tensor([math.log(0.02)]), "evidence": torch.zeros(1, 2)}
    plain = APP.least_squares(changed, batch, loss_parameters)
    few, missed = 0.8, 0.6
    loss_parameters["evidence"] = torch.tensor([[few, missed]])
    for count in (100.0, float(MANY_SAMPLES), 10.0 * MANY_SAMPLES):
        weighted = APP.least_squares(changed, batch | {"distinct": torch.tensor([count])}, loss_parameters)
        factor = (min(count, MANY_SAMPLES) / MANY_SAMPLES) ** few * (1 + plain.losses / 0.02) ** -missed
        torch.testing.assert_close(weighted.weights, plain.weights * factor[:, None])
        torch.testing.assert_close(weighted.losses, plain.losses)


# Which samples are there to be seen, and which judge

MATERIALS, HALF = 256, 400


@pytest.fixture
def data() -> Params:
    """The samples of a grey material, MATERIALS times, at the same angles above the horizon."""
    rng = Generator().manual_seed(5)
    high = torch.tensor([math.pi / 2, math.pi / 2, 2 * math.pi])
    angles = torch.rand(40 * HALF, 3, generator=rng, dtype=torch.float64) * high
    at = angle_cosines(angles)
    kept = torch.minimum(at.incident, at.outgoing) > 0.01
    angles = angles[kept][: 2 * HALF]
    where = torch.cat([half_difference_vectors(angles), angle_cosines(angles).incident[:, None]], 1).float()
    target = torch.log1p(0.3 * where[:, 6:]).expand(-1, 3)
    return {"where": where.expand(MATERIALS, -1, -1), "target": target.expand(MATERIALS, -1, -1)}


def lower(where: Tensor) -> Tensor:
    half, other = where[..., :3], where[..., 3:6]
    incident = other[..., 2] * half[..., 2] - other[..., 0] * half[..., 0]
    return torch.minimum(incident, other[..., 2] * half[..., 2] + other[..., 0] * half[..., 0])


def test_some_materials_lack_grazing_samples(data: Params, rng: Generator) -> None:
    where = data["where"]
    reached = is_reachable(where, rng)
    least = lower(where).where(reached, 1.0).amin(1)
    cut = ~reached.all(1)
    assert 0.2 < float(cut.float().mean()) < 0.47
    assert float(least[cut].min()) > math.cos(MAX_MEASURED_RAD[1]) - 1e-6
    assert float(least.max()) < math.cos(MAX_MEASURED_RAD[0]) + 0.02


def test_augmented_measurements_have_the_stated_number_of_samples(data: Params, rng: Generator) -> None:
    """Two thirds of the materials keep all their samples in place; the others see fewer, scattered or noisy ones."""
    given = data["where"].clone()
    drawn = draw_measurements(data, rng)
    assert torch.equal(data["where"], given)
    assert torch.equal(drawn["where"][:, HALF:], given[:, HALF:])  # what judges stays
    assert torch.equal(drawn["target"][:, HALF:], data["target"][:, HALF:])
    dense = drawn["distinct"] == HALF
    assert 0.55 < float(dense.float().mean()) < 0.78
    assert FEWEST_SAMPLES <= float(drawn["distinct"].min()) < 2 * FEWEST_SAMPLES
    kept = (drawn["where"][:, :HALF] == given[:, :HALF]).all(2).float().mean(1)
    assert float(kept[dense].median()) == 1
    noise = (drawn["target"][:, :HALF] / torch.log1p(0.3 * drawn["where"][:, :HALF, 6:]) - 1).abs().amax((1, 2))
    assert float(noise[dense].max()) < 1e-4
    assert 0.3 < float((noise[~dense] < 1e-4).float().mean()) < 0.7

    tasks = Tasks(tuple(map(str, range(MATERIALS))), drawn, torch.arange(MATERIALS))
    batch = Brdf(SIZE).sample(tasks, rng, 64)
    assert torch.equal(batch["distinct"], drawn["distinct"])
    few = int(drawn["distinct"].argmin())
    seen = {tuple(row) for row in drawn["where"][few, : int(drawn["distinct"][few])].tolist()}
    assert {tuple(row) for row in batch["where"][few].T.tolist()} <= seen


def test_scattered_samples_are_as_dense_as_random_pairs_of_directions() -> None:
    """Shares of pairs near the highlight, against pairs that are drawn by the cosines of their directions."""
    rng = Generator().manual_seed(7)
    highest = torch.tensor([math.pi / 2, math.pi / 2, math.tau])
    angles = torch.rand(400_000, 3, generator=rng, dtype=torch.float64) * highest
    at = angle_cosines(angles)
    angles = angles[torch.minimum(at.incident, at.outgoing) > 0]
    where = torch.cat([half_difference_vectors(angles), angle_cosines(angles).incident[:, None]], 1).float()
    density = sample_densities(where[None])[1][0].double()
    draws = torch.rand(200_000, 4, generator=rng, dtype=torch.float64)
    light, viewer = (
        torch.stack([r.sqrt() * (math.tau * u).cos(), r.sqrt() * (math.tau * u).sin(), (1 - r).sqrt()], -1)
        for r, u in (draws[:, :2].unbind(1), draws[:, 2:].unbind(1))
    )
    half = torch.nn.functional.normalize(light + viewer, dim=1)[:, 2].arccos()
    for degrees in (5, 10, 20, 40, 60):
        limit = math.radians(degrees)
        share = float(density[angles[:, 0] < limit].sum() / density.sum())
        assert share == pytest.approx(float((half < limit).double().mean()), rel=0.05), degrees


def test_outer_losses_are_of_the_half_that_fits_do_not_see(data: Params, rng: Generator) -> None:
    tasks = Tasks(tuple(map(str, range(MATERIALS))), data, torch.arange(MATERIALS)).select([0])
    seen = {tuple(row) for row in data["where"][0, :HALF].tolist()}
    inner, outer = (draw(tasks, rng, 64)["where"][0].T.tolist() for draw in (Brdf().sample, Brdf().outer_sample))
    assert all(tuple(row) in seen for row in inner)
    assert not any(tuple(row) in seen for row in outer)


# The protocol of the networks of BRDFs, and how parameters tell which one they belong to


each_network = pytest.mark.parametrize("network", registry().load_all("networks of brdf").values(), ids=repr)


@each_network
def test_networks_are_recognised_by_their_parameters(network: BrdfNetwork) -> None:
    theta = {key: value[0] for key, value in network.init(Generator().manual_seed(1), 2).items()}
    assert find_network(theta) is network
    assert {key: tuple(value.shape) for key, value in theta.items()} == parameter_shapes(network)
    assert set(network.unshared_parameters) <= set(theta)
    assert network.linear_parameter in ("", *theta)
    with pytest.raises(ValueError, match=r"^parameters .*, expected the parameters of a BRDF fit"):
        find_network({key: value for key, value in theta.items() if key != "w1"})


@each_network
def test_phi_h_counts_where_a_network_says_so(network: BrdfNetwork) -> None:
    rng = Generator().manual_seed(2)
    theta = {
        key: value[0] + 0.1 * torch.randn(value.shape[1:], generator=rng) for key, value in network.init(rng, 1).items()
    }
    angles = torch.tensor([0.3, 0.5, 1.0, 0.0]).repeat(2, 3, 1)
    angles[1, :, 3] = 0.7
    values = network.evaluate(theta, angles)
    assert values.shape == (2, 3, 3)
    # one at a time: the rows of one product of matrices need not be the same to the bit
    first, turned = (network.evaluate(theta, four_angles) for four_angles in angles)
    assert torch.equal(first, turned) != network.anisotropic
    torch.testing.assert_close(network.evaluate(theta, angles[0, :, :3]), values[0])
    assert (network.fold(theta).axes_azimuth_rad is not None) == network.anisotropic
