"""The part `network` of update rules: untrained it changes nothing, derivatives are exact, and grids wrap around."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.lighting import LightField
from metapp.apps.illumination.map_sight import MapSight
from metapp.apps.illumination.radiance_losses import describe_maps
from metapp.learning.adjoint import Loss, at_step, learn_differentiably
from metapp.learning.app import App
from metapp.learning.learn import expand_tasks
from metapp.learning.recipe import Adam
from metapp.learning.rules.named_rules import META_ENCODER, META_SGD
from metapp.learning.rules.network import MEMORY_CHANNELS, StepNetwork
from metapp.learning.rules.rule import LearnedRule, StepInput
from metapp.learning.task import Params
from metapp.networks.field import LocalField
from tests.learning.parabolas import refuse_to_draw

TASKS, STEPS = 2, 3
FIELD = LocalField(8, 16, rows=4, columns=8, code=3, hidden=6, layers=2)
FIRST = Adam(5e-3, 0.7, 0.99, eps=1e-3, final_rate_share=0.1)


def small_app() -> Illumination:
    return Illumination(LightField(FIELD), MapSight())


@pytest.fixture(scope="module")
def app() -> App:
    return small_app()


def single_task_parameters(app: App) -> Params:
    return {key: value[0].double() for key, value in app.init(Generator().manual_seed(1), 1).items()}


def batches_for(app: Illumination, randn: Callable[..., Tensor], count: int) -> list[dict[str, Tensor]]:
    photos = torch.zeros(TASKS, 3, 64, 64)  # which fits of maps do not see
    return [app.sight.observe(describe_maps(torch.exp(randn(TASKS, 3, 8, 16))), photos)._asdict() for _ in range(count)]


@pytest.mark.parametrize("plain", [META_ENCODER, META_SGD])
def test_untrained_network_part_leaves_the_rule_unchanged(
    plain: LearnedRule, app: Any, randn: Callable[..., Tensor]
) -> None:
    theta, batches = expand_tasks(single_task_parameters(app), TASKS, 0), batches_for(app, randn, STEPS)
    moved = []
    for learned_rule in (LearnedRule("test", (*plain.parts, StepNetwork())), plain):
        alpha = learned_rule.initial_alpha(app, single_task_parameters(app), STEPS, FIRST)
        rule = learned_rule.update_rule(expand_tasks(alpha, TASKS, 1))
        moved.append(learn_differentiably(theta, rule, batches, Loss(refuse_to_draw, app.loss), order=1))
    torch.testing.assert_close(*moved, rtol=0, atol=0)
    assert not torch.equal(moved[0]["z"], theta["z"])


@pytest.fixture
def seen(randn: Callable[..., Tensor]) -> dict[str, Tensor]:
    """What a network sees of parameters [T, 3, 4, 8]."""
    seen = {key: randn(TASKS, 3, 4, 8) for key in ("value", "grad", "direction")}
    return seen | {"memory": randn(TASKS, MEMORY_CHANNELS, 4, 8)}


def network(randn: Callable[..., Tensor], *, periodic: bool) -> Params:
    of: Any = SimpleNamespace(is_periodic=periodic)
    alpha = StepNetwork().initial(of, {"z": torch.zeros(3, 4, 8)}, 1, Adam(0.1))
    alpha = {key: value.double() + 0.1 * randn(*value.shape) for key, value in alpha.items()}
    name = "around" if periodic else "within"
    return alpha | {f"{name}.z.place": torch.zeros(1, *alpha[f"{name}.z.place"].shape[1:]).double()}


def move(alpha: Params, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """The addition of a network to its parameter, and its memory after that."""
    step, zero = at_step(expand_tasks(alpha, TASKS, 1), 0), {"z": torch.zeros(TASKS, 3, 4, 8).double()}
    before = StepInput({"z": seen["value"]}, {"z": seen["grad"]}, {"z": seen["direction"]})
    moved, memory = StepNetwork().after_step(step, zero, before, {"memory.z": seen["memory"]})
    return moved["z"], memory["memory.z"]


@pytest.mark.parametrize("periodic", [True, False])
def test_a_periodic_grid_has_no_edge(periodic: bool, seen: dict[str, Tensor], randn: Callable[..., Tensor]) -> None:
    """Turned columns are moved as they were before they were turned; where there is an edge they are not."""
    alpha = network(randn, periodic=periodic)
    turned = move(alpha, {key: value.roll(3, -1) for key, value in seen.items()})
    for found, expected in zip(turned, move(alpha, seen), strict=True):
        assert torch.allclose(found, expected.roll(3, -1)) == periodic


def test_the_length_of_a_gradient_is_seen_by_itself(seen: dict[str, Tensor], randn: Callable[..., Tensor]) -> None:
    """A network that does not look at the log of the length is moved alike by gradients of any length."""
    alpha = network(randn, periodic=True)
    alpha["around.z.kernel0"][:, :, 9] = 0  # after value, gradient and direction
    moves = [move(alpha, seen | {"grad": seen["grad"] * factor})[0] for factor in (1.0, 1e-3, 1e4)]
    for later_move in moves[1:]:
        torch.testing.assert_close(later_move, moves[0])
