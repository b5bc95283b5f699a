"""Estimate the kinds of materials of the recipe few: few_kinds.py CHECKPOINT TARGET DATA...

Each data set of BRDFs is a kind: its training materials are fitted with all their samples, mean and covariance of what
they weigh features by are estimated by expectation maximisation, and features are turned so that luminance varies
independently in them. CHECKPOINT is one that training wrote; of its kinds the first one begins all.
"""

import sys
from pathlib import Path

import torch
from torch import Tensor

from metapp.apps.brdf.app import Brdf
from metapp.extensions.few import gaussian
from metapp.extensions.few.network import NETWORK, OF_KINDS
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params
from metapp.networks.coded import with_decoder
from metapp.storage.records import load_checkpoint, save_checkpoint
from metapp.storage.shards import read_shard

SAMPLES, ROUNDS = 900, 2
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


def weights_of(theta: Params, batch: Params, mean: Tensor, inverse: Tensor) -> tuple[Tensor, Tensor]:
    """Mean [3, F] and covariance [3, F, F] of what a material weighs features by, after its samples."""
    at = gaussian.linear(theta | {"last": mean[None].float()}, batch)
    features, weights = at.features[0].double(), at.weights[0].double() / at.features.shape[2]
    covariance = torch.linalg.inv((features * weights) @ features.T + inverse)
    moment = (at.residual[0].double() * weights) @ features.T
    return mean + torch.einsum("cfg,cg->cf", covariance, moment), covariance


def kind_of(theta: Params, materials: list[Params]) -> Params:
    """`w3`, `b3`, `last` and `deviation` of a kind, without task axis."""
    first = torch.diag_embed(torch.exp(2 * theta["deviation"][0].double()))
    mean, covariance = theta["last"][0].double(), first
    for _ in range(ROUNDS):
        inverse = torch.linalg.inv(covariance)
        pairs = [weights_of(theta, each, mean, inverse) for each in materials]
        means, covariances = (torch.stack(each) for each in zip(*pairs, strict=True))
        mean = means.mean(0)
        apart = means - mean
        scatter = torch.einsum("tcf,tcg->cfg", apart, apart) / len(apart) + covariances.mean(0)
        covariance = (1 - SHRUNK) * scatter + SHRUNK * first
    turn = torch.linalg.eigh(covariance[0]).eigenvectors  # features' new axes, [F, F], a column each
    old = torch.cat([theta["w3"][0], theta["b3"][0]], 1).double()
    old = torch.cat([old, torch.eye(1, old.shape[1]).roll(-1, 1).double()])  # the last feature is 1
    new = turn.T @ old
    deviation = torch.stack([(turn.T @ each @ turn).diagonal() for each in covariance]).log() / 2
    nothing = torch.zeros(3, 1).double()
    last, deviation = torch.cat([mean @ turn, nothing], 1), torch.cat([deviation, nothing - 9], 1)
    made = {"w3": new[:, :-1], "b3": new[:, -1:], "last": last, "deviation": deviation}
    return {key: value.float() for key, value in made.items()}


def main(checkpoint: Path, target: Path, *data: Path) -> None:
    """Write the checkpoint with a kind for each data set."""
    prepared, about = load_checkpoint(checkpoint)
    if prepared.encoder:
        one = {key: prepared.encoder[f"encoder.{key}"][:1] for key in OF_KINDS}
        theta = with_decoder(one, prepared.encoder)
    else:
        theta = {key: value[None] for key, value in prepared.theta.items()}
    with torch.no_grad():
        kinds = [kind_of(theta, samples_of(each)) for each in data]
    encoder = {f"encoder.{key}": torch.stack([kind[key] for kind in kinds]) for key in OF_KINDS}
    encoder |= {f"decoder.{key}": value[0] for key, value in theta.items() if key not in OF_KINDS}
    if len(kinds) != NETWORK.kinds:
        sys.exit(f"few_kinds: {len(kinds)} data sets, expected {NETWORK.kinds}")
    names = [each.name for each in data]
    # penalties beside the prior are all about alike
    penalties = prepared.alpha["penalty.last"].mean().expand(1, kinds[0]["last"].shape[1])
    save_checkpoint(
        target, MetaParameters({}, prepared.alpha | {"penalty.last": penalties}, encoder), about | {"kinds": names}
    )


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
