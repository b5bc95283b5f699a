"""Arrays and tensors of every kind: read as they are, or refused in one line before anything is copied."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from data_tools.readers import brdf_objects, picture_objects
from data_tools.readers.picture_objects import LARGEST, array_of

PICTURE = np.random.default_rng(1).random((96, 96, 3)).astype(np.float32)
DENSE = torch.rand(4, 3, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize(
    "half", [PICTURE.astype(np.float16), torch.from_numpy(PICTURE).half()], ids=["array", "tensor"]
)
def test_a_picture_of_halves_is_the_picture(half: object) -> None:
    task = picture_objects.texture(half, "half")
    expected = picture_objects.texture(np.asarray(half, np.float32), "half")
    torch.testing.assert_close(task.data["image"], expected.data["image"])


REFUSED = {
    "sparse": (DENSE.to_sparse(), "a tensor (float32, sparse_coo, on cpu)"),
    "masked": (np.ma.masked_less(np.ones((4, 3)) * [1, 0.1, 1], 0.5), "4 values are masked"),
    "vast": (np.broadcast_to(np.float32(0.5), (60000, 60000, 3)), "10,800,000,000 values"),
    "words": (np.array([["a"]]), "an array of <U1"),
}


@pytest.mark.parametrize(("source", "said"), REFUSED.values(), ids=REFUSED)
def test_other_arrays_are_refused_in_one_line(source: object, said: str) -> None:
    with pytest.raises(ValueError, match=r"^it: ") as caught:
        array_of("it", source)
    assert said in str(caught.value)
    assert "expected" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_function_may_return_more_rows_than_it_was_asked_for_no_copy() -> None:
    """Refused by its size: nothing of 3e9 rows is copied."""
    with pytest.raises(ValueError, match=rf"values, expected {LARGEST:,} or fewer"):
        brdf_objects.from_object(lambda wi, wo: np.broadcast_to(0.5, (10**9, 3)), "f")


def test_a_conjugate_is_read() -> None:
    view = torch.complex(DENSE, DENSE).conj().imag
    np.testing.assert_array_equal(array_of("it", view), -DENSE.numpy())
