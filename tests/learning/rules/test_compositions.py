"""Compositions of parts: their names, and what is refused."""

import itertools
from dataclasses import replace

import pytest
from torch import Generator

from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.task import Params
from metapp.registry import registry
from tests.recipe_apps import app_by_recipe, app_names, observations_of, recipes_of


def parts_of(name: str) -> list[str]:
    return [part.name for part in rule_of(name).parts]


def one(app: App) -> Params:
    return {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}


def test_a_composition_has_the_parts_of_all_its_names() -> None:
    assert parts_of("adam+curvature+average") == ["rates", "betas", "curvature", "average"]
    assert parts_of("meta-sgd") == parts_of("sgd") == ["sgd"]
    assert parts_of("tied+betas") == ["shared", "betas", "pace"]


@pytest.mark.parametrize("parts", ["adam+curvature+average", "tied+betas+eps", "adam+loss", "sgd+basis"])
def test_the_same_parts_are_the_same_rule(parts: str) -> None:
    """Order and repetition do not count, since trainings and compiled steps are found by the rule."""
    for order in itertools.permutations(parts.split("+")):
        assert rule_of("+".join([*order, order[0]])) == rule_of(parts)
    assert rule_of("+".join(reversed(parts_of(parts)))) == rule_of(parts)


def test_every_name_names_its_own_rule() -> None:
    """A composition that has a name goes by that name."""
    assert rule_of("eps+pace+loss+betas+shared").name == "meta-encoder"
    assert rule_of("adam+loss+curvature").name == "meta-curvature"
    assert rule_of("betas+rates+average+curvature").name == "adam+curvature+average"
    assert rule_of("sgd+curvature").name == "sgd+curvature"
    names, rules = registry().rule_words, list(registry().rules)
    assert [rule_of(name).name for name in rules] == rules
    assert len({rule_of(name).parts for name in rules}) == len(rules)
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("adam+magic", "'magic' is unknown, expected names of these.*meta-sgd.*curvature"),
        ("adam+", "'' is unknown, expected names of these"),
        ("betas+curvature", "rule 'betas+curvature': no part for rates, expected one of sgd, rates, shared, solve"),
        ("adam+sgd", "rule 'adam+sgd': sgd and rates for rates, expected one of sgd, rates, shared, solve"),
        ("adam+solve", "rates and solve for rates"),
        ("sgd+eps", "rule 'sgd+eps': eps has no effect alone, expected betas beside it"),
        ("sgd+pace", "rule 'sgd+pace': pace has no effect alone, expected rates or shared beside it"),
    ],
)
def test_names_that_are_no_rule_are_refused_in_one_line(name: str, line: str) -> None:
    with pytest.raises(ValueError, match=line.replace("+", r"\+")) as caught:
        rule_of(name)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


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
    assert recipe.training("adam+curvature") == replace(recipe.meta[recipe.rule], guard=None)
    for rule, training in recipe.meta.items():
        assert recipe.training(rule) is training
