"""What figures show."""

from __future__ import annotations

import numpy as np
import torch

from metapp.evaluation.figures import step_sizes


def test_step_sizes_of_rules() -> None:
    alpha = {"rate.w": torch.tensor([[[-0.5, 2.0]]]), "rate.b": torch.zeros(1, 1), "beta1": torch.zeros(3)}
    assert step_sizes("meta-sgd", alpha)["w"].tolist() == [-0.5, 2.0]
    assert set(step_sizes("meta-sgd", alpha)) == {"w"}  # one number is no histogram
    paced = step_sizes("meta-encoder", alpha | {"pace.w": torch.tensor([0.0, 1.0])})["w"]
    np.testing.assert_allclose(paced, np.exp([-0.5, 2.0, 0.5, 3.0]), rtol=1e-6)
