"""MAML in 30 lines: learn an initialisation from which five gradient steps fit any sinusoid (Finn et al. 2017).

It prints errors on sinusoids that training never saw, before and after these steps, from random weights and from the
learned initialisation. Derivatives of both loops are exact: `after_learning` differentiates through the steps.
"""

import math

import torch

from metapp.learning.adjoint import DrawnBatch, Loss
from metapp.learning.learn import MetaParameters, after_learning, expand_tasks, learn, over_tasks
from metapp.learning.recipe import Adam
from metapp.learning.rules import fixed_adam, sgd
from metapp.learning.task import Tasks

STEPS, POINTS, WIDTH, OUTER_STEPS = 5, 10, 40, 600
rng = torch.Generator().manual_seed(0)


def sinusoids(count):
    """Draw tasks, y = amplitude * sin(x + phase)."""
    amplitude, phase = 0.1 + 4.9 * torch.rand(count, generator=rng), math.pi * torch.rand(count, generator=rng)
    return Tasks(tuple(map(str, range(count))), {"amplitude": amplitude, "phase": phase}, torch.arange(count))


def draw(tasks, rng, done):
    """Draw the batch of a step: points x and y of each task, [T, 1, POINTS]."""
    amplitude, phase = (tasks.data[key][tasks.rows, None, None] for key in ("amplitude", "phase"))
    x = 10 * torch.rand(len(tasks), 1, POINTS, generator=rng) - 5
    return DrawnBatch(tasks.selected_names, {"x": x, "y": amplitude * torch.sin(x + phase)})


def error(theta, batch, learned):
    """Return the mean squared errors [T] of a network with two hidden layers, its parameters [T, ...]."""
    hidden = torch.tanh(theta["w1"] @ batch["x"] + theta["b1"])
    hidden = torch.tanh(theta["w2"] @ hidden + theta["b2"])
    return (theta["w3"] @ hidden + theta["b3"] - batch["y"]).square().mean((1, 2))


loss, sizes = Loss(draw, error), [1, WIDTH, WIDTH, 1]
theta = {f"w{i + 1}": torch.randn(sizes[i + 1], sizes[i], generator=rng) / sizes[i] ** 0.5 for i in range(3)}
theta |= {f"b{i + 1}": torch.zeros(sizes[i + 1], 1) for i in range(3)}
random = MetaParameters(theta, alpha={"rate": torch.full((STEPS,), 0.01)})  # a rate for each step, learned, too

meta_loss = over_tasks(after_learning(loss, sgd, steps=STEPS, order=2, clip=10.0), count=25)
adam = fixed_adam(Adam(5e-3, final_rate_share=0.1), random.flatten(), OUTER_STEPS)
learned = learn(random.flatten(), adam, sinusoids(1000), meta_loss, steps=OUTER_STEPS, rng=rng)

unseen = sinusoids(200)
print(f"mean squared error   before   after {STEPS} steps")
for name, phi in (("random weights", random), ("learned by MAML", MetaParameters.unflatten(learned))):
    before = expand_tasks(phi.theta, len(unseen), 0)
    after = learn(before, sgd(phi.alpha), unseen, loss, steps=STEPS, rng=rng)
    batch = draw(unseen, rng, 1.0).batch
    print(f"{name:<18} {error(before, batch, {}).mean():8.3f} {error(after, batch, {}).mean():15.3f}")
