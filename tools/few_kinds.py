"""Estimate the kinds of materials of the recipe few: few_kinds.py CHECKPOINT TARGET DATA...

Each data set of BRDFs is a kind: its training materials are fitted with all their samples, mean and covariance of what
they weigh features by are estimated by expectation maximisation, and features are turned so that luminance varies
independently in them. CHECKPOINT is one that training wrote: of its kinds the first one, which that trained, begins the
others and becomes the last one.
"""

import sys
from pathlib import Path

import torch
from torch import Tensor

from metapp.apps.brdf.app import Brdf
from metapp.extensions.few import gaussian
from metapp.extensions.few.network import NETWORK, OF_KINDS
from metapp.learning.task import Params
from metapp.networks.coded import with_decoder
from metapp.storage.records import load_checkpoint, save_checkpoint
from metapp.storage.shards import read_shard

SAMPLES, ROUNDS = 900, 2
# training knows deviations and noise up to a common factor, as fits depend on their ratio alone: what makes expected
# errors of materials that validate those that they have
COMMON = 0.34
SHRUNK = 0.02  # of the covariance, what is left of the first one: kinds have fewer materials than features


def samples_of(data: Path) -> list[Params]:
    """`where` [1, 7, N] and `target` [1, 3, N] of the training materials, of samples that fits may see."""
    found = []
    for task in read_shard(data, "train"):
        made = Brdf().prepare(task)
        rows = slice(0, len(made["where"]) // 2, max(1, len(made["where"]) // 2 // SAMPLES))
        one = {key: made[key][rows].T[None] for key in ("where", "target")}
        found.append(one | {"count": torch.tensor([float(one["where"].shape[2])])})
    return found


def weights_of(theta: Params, batch: Params, mean: Tensor, inverse: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean [3, F] and covariance [3, F, F] of what a material weighs features by, after its samples.

    And the mean square of what is left, over the variance of the noise.
    """
    at = gaussian.linear(theta | {"last": mean[None].float()}, batch)
    features, weights = at.features[0].double(), at.weights[0].double() / at.features.shape[2]
    covariance = torch.linalg.inv((features * weights) @ features.T + inverse)
    moment = (at.residual[0].double() * weights) @ features.T
    change = torch.einsum("cfg,cg->cf", covariance, moment)
    left = (at.residual[0].double() - change @ features).square() + torch.einsum(
        "fn,cfg,gn->cn", features, covariance, features
    )
    return mean + change, covariance, (weights * left).mean()


def kind_of(theta: Params, materials: list[Params]) -> Params:
    """OF_KINDS of a kind, without task axis."""
    first = torch.diag_embed(torch.exp(2 * theta["deviation"][0].double()))
    mean, covariance = theta["last"][0].double(), first
    for _ in range(ROUNDS):
        inverse = torch.linalg.inv(covariance)
        found = [weights_of(theta, each, mean, inverse) for each in materials]
        means, covariances, left = (torch.stack(each) for each in zip(*found, strict=True))
        mean = means.mean(0)
        theta = theta | {"noise": theta["noise"] - left.mean().log().float() * torch.eye(3)[:1]}
        apart = means - mean
        scatter = torch.einsum("tcf,tcg->cfg", apart, apart) / len(apart) + covariances.mean(0)
        covariance = (1 - SHRUNK) * scatter + SHRUNK * first
    axes = independent(covariance[0])
    old = torch.cat([theta["w3"][0], theta["b3"][0]], 1).double()
    new = axes[:-1] @ torch.cat([old, torch.eye(1, old.shape[1]).roll(-1, 1).double()])  # the last feature is 1
    back = torch.linalg.inv(axes)
    deviation = torch.stack([(back.T @ each @ back).diagonal() for each in covariance]).log() / 2
    made = {
        "w3": new[:, :-1],
        "b3": new[:, -1:],
        "last": mean @ back,
        "deviation": deviation,
        "noise": theta["noise"][0],
    }
    return {key: value.float() for key, value in made.items()}


def independent(covariance: Tensor) -> Tensor:
    """Axes A [F, F], the last one the constant feature, with covariance A^T D A for a diagonal D.

    What the constant varies by itself is taken away; then the others are eigenvectors, and one eigenvalue is 0.
    """
    rest = covariance.clone()
    rest[-1, -1] -= 1 / torch.linalg.inv(covariance)[-1, -1]
    constant = torch.eye(len(rest))[-1:].to(rest)
    return torch.cat([torch.linalg.eigh(rest).eigenvectors[:, 1:].T, constant])


def main(checkpoint: Path, target: Path, *data: Path) -> None:
    """Write the checkpoint with a kind for each data set, and the one that was trained."""
    if len(data) != NETWORK.kinds - 1:
        sys.exit(f"few_kinds: {len(data)} data sets, expected {NETWORK.kinds - 1}")
    prepared, about = load_checkpoint(checkpoint)
    trained = {key: prepared.encoder[f"encoder.{key}"][0] for key in OF_KINDS}
    theta = with_decoder({key: value[None] for key, value in trained.items()}, prepared.encoder)
    with torch.no_grad():
        kinds = [kind_of(theta, samples_of(each)) for each in data]
    factor = torch.tensor(COMMON).log()
    trained |= {"deviation": trained["deviation"] + factor, "noise": trained["noise"] - 2 * factor * torch.eye(3)[0]}
    kinds.append(trained)
    own = {f"encoder.{key}": torch.stack([kind[key] for kind in kinds]) for key in OF_KINDS}
    about |= {"kinds": [*(each.name for each in data), "all"]}
    save_checkpoint(target, prepared._replace(encoder=prepared.encoder | own), about)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
