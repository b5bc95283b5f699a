"""Learned rules by name, and what is refused."""

from dataclasses import replace

import pytest
from torch import Generator

from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.task import Params
from metapp.registry import registry
from tests.recipe_apps import app_by_recipe, app_names, observations_of, recipes_of


def one(app: App) -> Params:
    return {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}


def test_every_name_names_its_own_rule() -> None:
    names = list(registry().rules)
    rules = [rule_of(name) for name in names]
    assert [rule.name for rule in rules] == names
    assert len({rule.parts for rule in rules}) == len(rules)


def test_an_unknown_name_is_refused_with_the_names_that_are_known() -> None:
    with pytest.raises(ValueError, match=r"^'meta-curvatur' is not a rule; expected one of meta-sgd.*") as caught:
        rule_of("meta-curvatur")
    assert str(caught.value).endswith("Did you mean 'meta-curvature'?")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("app", "rule", "part"),
    [
        ("brdf", "meta-lgd", "network does not apply to brdf: no parameter lies on a grid"),
        ("brdf", "ridge", "solve does not apply to brdf: its network is not linear"),
        ("illumination", "meta-basis", "average does not apply to illumination: its fits see nothing random"),
    ],
)
def test_a_part_that_does_not_apply_is_refused_by_name(app: str, rule: str, part: str) -> None:
    of = app_by_recipe(app)
    with pytest.raises(ValueError, match=f"its part {part}"):
        rule_of(rule).initial_alpha(of, one(of), 5, Adam(1e-3))


@pytest.mark.parametrize("name", app_names())
def test_all_rules_of_recipes_apply(name: str) -> None:
    for observe in observations_of(name):
        for recipe in recipes_of(name, observe).values():
            for rule in (*recipe.meta, recipe.rule):
                app_with_rule = recipe.app_with(rule)
                rule_of(rule).check_app(app_with_rule, one(app_with_rule))


def test_recipes_train_other_rules_as_their_default() -> None:
    recipe = recipes_of("brdf")["quick"]
    assert recipe.training("meta-adam") == replace(recipe.meta[recipe.rule], guard=None)
    for rule, training in recipe.meta.items():
        assert recipe.training(rule) is training
