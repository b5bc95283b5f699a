"""The step sizes that Meta has learned: a histogram for each layer."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from metapp.evaluation.figures import Drawn
from metapp.evaluation.figures.style import COLOURS, INK, new
from metapp.evaluation.subject import Subject
from metapp.learning.rules import rule_of
from metapp.learning.task import Params

BINS = 48


def step_sizes(rule: str, alpha: Params) -> dict[str, np.ndarray]:
    """Step sizes of each parameter tensor, over its entries and all steps; of any sign where the rule is SGD."""
    sizes = {}
    for name, value in alpha.items():
        part, _, key = name.partition(".")
        if part == "rate" and value.numel() > 1:
            pace = alpha.get(f"pace.{key}")
            rate = value if pace is None else value + pace.reshape(-1, *[1] * (value.ndim - 1))
            sizes[key] = (rate if rule_of(rule).has("sgd") else rate.exp()).flatten().double().cpu().numpy()
    return sizes


def _rates(alpha: Params) -> list[Tensor]:
    return [value for name, value in alpha.items() if name.startswith("rate.") and value.numel() > 1 and value.ndim > 1]


def histogram(subject: Subject) -> Drawn | None:
    """Magnitudes of learned step sizes, layer above layer."""
    fit = subject.fits["meta"]
    alpha = fit.prepared.alpha if fit.checkpoint else {}
    sizes = step_sizes(fit.job.rule, alpha)
    if not sizes:
        return None
    logs = {key: np.log10(np.abs(values[values != 0])) for key, values in sizes.items()}
    logs = {key: values for key, values in logs.items() if len(values)}
    low, high = (f(f(values) for values in logs.values()) for f in (min, max))
    edges = np.linspace(low - 0.1, high + 0.1, BINS + 1)
    figure, axes = new(4.0, 0.24 * len(logs) + 1.2)
    axis = axes[0, 0]
    for i, values in enumerate(logs.values()):
        counts, _ = np.histogram(values, edges)
        heights = -i + 0.9 * counts / counts.max()
        axis.fill_between(edges[:-1], -i, heights, step="post", color=COLOURS["meta"], alpha=0.55, linewidth=0)
        axis.step(edges[:-1], heights, where="post", color=INK, linewidth=0.5)
    axis.set_yticks([-i for i in range(len(logs))], list(logs), fontsize=7)
    axis.set_xlabel("learned step size, power of ten")
    axis.set_title(f"{subject.title}: {fit.job.rule}")
    negative = {key: float((values < 0).mean()) for key, values in sizes.items()}
    more = f"; negative: {np.mean(list(negative.values())):.0%}" if any(negative.values()) else ""
    middle = np.median(np.concatenate(list(logs.values())))
    if all(len(np.unique(rates.flatten(1)[0].numpy())) == 1 for rates in _rates(alpha)):
        more += "; the same for all weights, as its Adam was searched"
    what = f"step sizes that {fit.job.rule} has learned, a row a layer; median {10**middle:.1e}{more}"
    return Drawn(figure, f"{subject.title}: {what}.")
