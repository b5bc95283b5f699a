"""What convergence and figures are computed by, and the paper's figures."""

from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load, save

from metapp.evaluation.figures import step_sizes
from metapp.evaluation.rows import carried, paper
from metapp.evaluation.tables.convergence import (
    FURTHER,
    named,
    near,
    project,
    project_paths,
    steps_needed,
)


def test_the_papers_figures_have_sources_and_agree_with_each_other() -> None:
    known = paper()
    assert set(known["sources"]) == set(known) - {"source", "sources", "titles"}
    for kind in ("error", "seconds"):
        assert set(known[kind]) == set(known["titles"])
    gaps = {}
    for app in known["titles"]:
        names = ("general", "overfit", "meta")
        rows = [{"paradigm": name, **{key: known[key][app][name] for key in ("error", "seconds")}} for name in names]
        gaps[app], _ = carried(rows, "error", "seconds")
    # as the design brief prints them
    expected = (0.80, 0.93, 0.60, 0.78, 0.97, 0.77)
    assert [round(gap, 2) for gap in gaps.values()] == list(expected)
    assert known["storage"]["factor"] == known["storage"]["meta_networks"] / known["storage"]["exemplars"]
    for each in known["samples"].values():
        assert 1 - each["seen"] / each["all"] == pytest.approx(each["saved"], abs=1e-3)


def record(overfit: float, further: list[tuple[int, float]]) -> dict[str, Any]:
    return {"curves": {"overfit": [[0, 9.0], [40, overfit]]}, "further": further}


def test_further_steps_are_counted_until_one_is_near() -> None:
    assert steps_needed(record(1.0, [(0, 1.005)])) == 0
    assert steps_needed(record(1.0, [(0, 2.0), (8, 1.2), (16, 1.009)])) == 16
    assert steps_needed(record(1.0, [(0, 2.0), (FURTHER[-1], 1.02)])) is None
    assert near(-3.97, -4.0)  # lower is better, also below 0
    assert not near(-3.95, -4.0)
    assert near(-4.5, -4.0)


def test_the_plane_of_most_variance_keeps_distances_within_it(rng: torch.Generator) -> None:
    basis = torch.linalg.qr(torch.randn(50, 2, generator=rng, dtype=torch.float64))[0]
    flat = torch.randn(9, 2, generator=rng, dtype=torch.float64)
    states = flat @ basis.T + 3
    places, explained = project(states)
    torch.testing.assert_close(torch.cdist(places, places), torch.cdist(flat, flat))
    assert explained == pytest.approx(1)
    assert project(states + 0.5 * torch.randn(9, 50, generator=rng, dtype=torch.float64))[1] < 0.99
    # networks of different sizes have no common paths
    small, large = ([{"w": torch.full((1, size), float(i))} for i in range(3)] for size in (4, 6))
    paths, explained = project_paths(small, small)
    assert (len(paths["meta"]), len(paths["overfit"]), explained) == (3, 3, pytest.approx(1))
    assert project_paths(small, large) == ({"meta": [], "overfit": []}, 0.0)


def test_parameters_that_no_step_moves_are_saved_for_every_part() -> None:
    still = torch.ones(1, 3)
    found = named({0.0: {"w": still}, 0.5: {"w": still, "b": 2 * still}})
    assert set(load(save(found))) == {"0/w", "0.5/w", "0.5/b"}
    assert all(value.shape == (3,) for value in found.values())


def test_step_sizes_of_rules() -> None:
    alpha = {"rate.w": torch.tensor([[[-0.5, 2.0]]]), "rate.b": torch.zeros(1, 1), "beta1": torch.zeros(3)}
    assert step_sizes("meta-sgd", alpha)["w"].tolist() == [-0.5, 2.0]
    assert set(step_sizes("meta-sgd", alpha)) == {"w"}  # one number is no histogram
    paced = step_sizes("meta-encoder", alpha | {"pace.w": torch.tensor([0.0, 1.0])})["w"]
    np.testing.assert_allclose(paced, np.exp([-0.5, 2.0, 0.5, 3.0]), rtol=1e-6)
