"""The named rules: what they are before training, and what their hyperparameters do to a step."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from torch import Generator

from metapp.apps.brdf import Brdf
from metapp.learning.learn import spread
from metapp.learning.recipe import Adam
from metapp.learning.rules import META_EPS, RULES, fixed_adam
from metapp.learning.task import Params
from tests.learning.rules.steps import STEPS, assert_same, one_task, run
from tests.paradigms.small import applicable

APP = Brdf()

ON_MATRICES = applicable(APP)


@pytest.mark.parametrize("rule", ON_MATRICES)
def test_learned_rules_start_well_formed(rule: str, theta: Params) -> None:
    alpha = RULES[rule].alpha(APP, one_task(theta), 5, Adam(5e-3, beta2=0.99))
    for key, value in alpha.items():
        assert value.dtype == torch.float64 or rule == "meta-sgd", key
        # one entry for all steps, or one a step
        paced = f"pace.{key.removeprefix('rate.')}" in alpha
        tied = rule == "meta-sgd" or paced or key == "eps" or key.startswith(("out.", "in."))
        assert value.shape[0] == (1 if tied else 5), key
        value += 0  # each has memory of its own, which training may write to
    built = RULES[rule].rule(alpha)
    assert {key for key in built.alpha if key.startswith("loss.")} == (
        set() if rule == "meta-sgd" else {f"loss.{key}" for key in APP.loss_parameters(5)}
    )


@pytest.mark.parametrize("settings", [Adam(5e-3, beta2=0.99), Adam(2e-2, 0.6, 0.95, final=0.1), Adam(1e-3, final=0.0)])
@pytest.mark.parametrize("rule", [name for name in ON_MATRICES if name != "meta-sgd"])
def test_learned_adam_starts_as_adam(rule: str, settings: Adam, theta: Params, grads: list[Params]) -> None:
    start, single = one_task(theta), [one_task(grad) for grad in grads]
    own = dataclasses.replace(settings, eps=1e-3)
    learned = RULES[rule].rule(RULES[rule].alpha(APP, start, STEPS, own))
    plain = fixed_adam(own if "eps" in learned.alpha else dataclasses.replace(own, eps=META_EPS), start, STEPS)
    until = -1 if "mean" in learned.alpha else None  # the last answer is a mean then
    assert_same(run(learned, start, single)[:until], run(plain, start, single)[:until])


def test_tied_rates_are_adam_s_where_its_rates_are_alike(theta: Params, grads: list[Params]) -> None:
    """With paces of 0 and the same rates at every step; a pace multiplies the rates of one tensor at one step."""
    start, single, rng = one_task(theta), [one_task(grad) for grad in grads], Generator().manual_seed(0)
    tied = RULES["meta-adam-tied"].alpha(APP, start, STEPS, Adam(5e-3, beta2=0.99))
    free = RULES["meta-adam"].alpha(APP, start, STEPS, Adam(5e-3, beta2=0.99))
    for key in start:
        tied[f"rate.{key}"] = tied[f"rate.{key}"] + torch.randn(start[key].shape, generator=rng).double()
        free[f"rate.{key}"] = tied[f"rate.{key}"].repeat(STEPS, *[1] * start[key].ndim)
    assert set(tied) - set(free) == {f"pace.{key}" for key in start}
    path = run(RULES["meta-adam-tied"].rule(tied), start, single)
    assert_same(path, run(RULES["meta-adam"].rule(free), start, single))

    tied["pace.w2"] = tied["pace.w2"].clone()
    tied["pace.w2"][3] = math.log(3)
    free["rate.w2"][3] += math.log(3)
    paced = run(RULES["meta-adam-tied"].rule(tied), start, single)
    assert_same(paced, run(RULES["meta-adam"].rule(free), start, single))
    torch.testing.assert_close(paced[3]["w2"] - paced[2]["w2"], 3 * (path[3]["w2"] - path[2]["w2"]))


def test_tied_rates_of_each_task_stand_for_themselves(theta: Params, grads: list[Params]) -> None:
    alpha = RULES["meta-adam-tied"].alpha(APP, one_task(theta), STEPS, Adam(5e-3, beta2=0.99))
    for key in theta:
        alpha[f"pace.{key}"] = torch.linspace(-1, 1, STEPS).double()
    both = run(RULES["meta-adam-tied"].rule(spread(alpha, 2, 1)), theta, grads)[-1]
    for task in (0, 1):
        start, own = ({key: value[task] for key, value in tree.items()} for tree in (theta, grads[0]))
        single = [{key: grad[key][task] for key in own} for grad in grads]
        alone = run(RULES["meta-adam-tied"].rule(alpha), start, single)[-1]
        for key, value in alone.items():
            torch.testing.assert_close(both[key][task], value)


@pytest.mark.parametrize("steps", [1, 15])
def test_tied_rates_are_few(steps: int, theta: Params) -> None:
    start = one_task(theta)
    weights = sum(value.numel() for value in start.values())
    learned = sum(value.numel() for value in APP.loss_parameters(steps).values())

    def size(rule: str) -> int:
        return sum(value.numel() for value in RULES[rule].alpha(APP, start, steps, Adam(5e-3, beta2=0.99)).values())

    assert size("meta-sgd") == weights
    assert size("meta-adam-tied") == weights + steps * (len(start) + 2) + learned
    assert size("meta-adam") == steps * (weights + 2) + learned


def test_curvature_multiplies_from_both_sides(theta: Params, grads: list[Params]) -> None:
    start, rng = one_task(theta), Generator().manual_seed(0)
    alpha = RULES["meta-curvature"].alpha(APP, start, STEPS, Adam(5e-3, beta2=0.99))
    left, right = (torch.randn(21, 21, generator=rng).double() for _ in "lr")
    alpha |= {"left.w2": left[None], "right.w2": right[None]}
    plain = RULES["meta-adam"].alpha(APP, start, STEPS, Adam(5e-3, beta2=0.99))
    first = one_task(grads[0])
    bent = run(RULES["meta-curvature"].rule(alpha), start, [first])[0]
    straight = run(RULES["meta-adam"].rule(plain), start, [first])[0]
    torch.testing.assert_close(bent["w2"] - start["w2"], left @ (straight["w2"] - start["w2"]) @ right)
    for key in set(start) - {"w2"}:
        torch.testing.assert_close(bent[key], straight[key])


@pytest.mark.parametrize("steps", [1, 5, 15])
def test_tail_averaging_gives_the_mean_of_the_last_parameters(steps: int, theta: Params, rng: Generator) -> None:
    start = one_task(theta)
    grads = [{key: torch.randn(v.shape, generator=rng).to(v) for key, v in start.items()} for _ in range(steps)]
    tied, mean = (
        RULES[rule].alpha(APP, start, steps, Adam(5e-3, eps=META_EPS)) for rule in ("meta-adam-tied", "meta-mean")
    )
    path = run(RULES["meta-adam-tied"].rule(tied), start, grads)
    averaged = run(RULES["meta-mean"].rule(mean), start, grads)
    assert_same(averaged[:-1], path[:-1])
    last = path[-max(round(0.4 * steps), 1) :]
    for key in start:
        torch.testing.assert_close(averaged[-1][key], torch.stack([each[key] for each in last]).mean(0))
