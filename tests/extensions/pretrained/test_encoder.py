"""What General reads of a photograph: VGG's features, an overview, and what General by full says."""

from __future__ import annotations

import pytest
import torch
from torch import Generator

from metapp.appearance.flash import positions
from metapp.apps import app_of, recipes_of
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import FLASH, inputs_of
from metapp.extensions.pretrained.augmentation import variants
from metapp.extensions.pretrained.encoder import (
    DARK,
    FULL_APP,
    GUESS,
    OVERVIEW,
    PARTS,
    _balanced,
    full_encoder,
    init_decoder,
    patch_of,
    read_photos,
)
from metapp.storage.checkpoints import tensor_digest
from tests.extensions.pretrained.conftest import APP

DIGEST = "6bc8d907167d"  # the digest of General by "full" that the checkpoint's was trained beside


@pytest.mark.usefixtures("weights")
def test_the_same_parameters_read_photos_of_several_sizes(rng: Generator) -> None:
    decoder = init_decoder(rng, 5)
    for side in (32, 64):
        read = read_photos(decoder, torch.rand(2, 3, side, side, generator=rng))
        assert read["z"].shape == (2, 5 + FULL_APP.network.code, side, side)
        assert read["deviation"].shape == (2, len(PARTS), side // 4, side // 4)
        assert read["flash"].shape == (2, FLASH)
    with pytest.raises(ValueError, match="44 px, expected a multiple of 8"):
        read_photos(decoder, torch.rand(1, 3, 44, 44))


@pytest.mark.usefixtures("weights")
def test_the_flash_is_where_full_sees_it_in_all_of_the_patch(rng: Generator) -> None:
    """It is not in most windows."""
    decoder, photos = init_decoder(rng, 5), torch.rand(2, 3, 32, 32, generator=rng) ** 2
    side = FULL_APP.network.height
    large = torch.nn.functional.interpolate(photos, (side, side), mode="bilinear")
    with torch.no_grad():
        seen = FULL_APP.network.gain * FULL_APP.encode(full_encoder(photos.device), {"photo": large})["flash"]
    torch.testing.assert_close(read_photos(decoder, photos)["flash"], seen)
    window = photos[..., :16, :16], positions(32, 32)[None, :, :16, :16]
    torch.testing.assert_close(read_photos(decoder, *window, patch_of(photos))["flash"], seen)


def test_exposure_and_white_balance_are_inputs_of_their_own(rng: Generator) -> None:
    """The rest of what is known of a photo, and what VGG sees, stays as it is; these move by as much."""
    photo, place = 0.1 + 0.3 * torch.rand(1, 3, 16, 16, generator=rng), positions(16, 16)[None]
    gains = torch.tensor([1.3, 1.0, 0.6])[:, None, None]
    mean = photo.mean((2, 3), keepdim=True)
    (seen, known), (again, others) = _balanced(photo, place, mean), _balanced(photo * gains, place, mean * gains)
    torch.testing.assert_close(again, seen)
    torch.testing.assert_close(others[:, :-4], known[:, :-4])
    change = (others - known)[0, -4:, 0, 0]
    torch.testing.assert_close((3 * change[:1] + change[1:]).exp(), gains.flatten())


@pytest.mark.usefixtures("weights")
def test_a_window_is_read_with_all_of_its_patch(rng: Generator) -> None:
    """Gloss is read off an overview, which says the same of a patch in any window and at any resolution."""
    side = 64
    made = [variants(torch.rand(2, 10, 128, 128, generator=rng), torch.ones(2, 4), side, rng) for _ in range(12)]
    whole = [float(each["inputs"][:, -2:].std()) > 0.5 for each in made]
    assert set(whole) == {True, False}
    for each, seen in zip(made, whole, strict=True):
        assert each["overview"].shape == (2, 3, OVERVIEW, OVERVIEW)
        assert each["photo"].shape[-1] == each["maps"].shape[-1] == each["inputs"].shape[-1] == side
        if seen:
            torch.testing.assert_close(inputs_of(each["photo"]), each["inputs"])
            coarse = torch.nn.functional.avg_pool2d(each["overview"], OVERVIEW)
            torch.testing.assert_close(each["photo"].mean((2, 3), keepdim=True), coarse)
    fine = torch.rand(1, 3, 512, 512, generator=rng)
    smooth = torch.nn.functional.avg_pool2d(fine, 2)
    torch.testing.assert_close(*(patch_of(photo)["overview"] for photo in (fine, smooth)))
    untrained = init_decoder(rng, 5)
    trained = {key: value + (0.1 if ".overview" in key else 0) for key, value in untrained.items()}
    patch, middle = patch_of(smooth), (slice(None), slice(None), slice(96, 160), slice(96, 160))
    window = (smooth[middle], positions(256, 256)[None][middle])
    for parameters, same in ((untrained, True), (trained, False)):  # of another patch with the same mean
        turned = patch | {"overview": patch["overview"].flip(3)}
        read, other = (read_photos(parameters, *window, each)["z"] for each in (patch, turned))
        assert torch.allclose(read, other, atol=1e-5) == same


def test_the_guess_is_what_general_by_full_says(rng: Generator) -> None:
    """Of all of the patch, whatever the photograph's size; and of the checkpoint that this one was trained beside."""
    assert tensor_digest(full_encoder(torch.device("cpu"))) == DIGEST, "train pretrained beside this General, too"
    photo = torch.rand(1, 3, 256, 256, generator=rng)
    guess = patch_of(photo)["guess"]
    full = app_of(APP, recipes_of(APP, "photo")["full"], "photo")
    assert isinstance(full, SvbrdfNonstationary)
    with torch.no_grad():
        maps = full.maps_of(full.encode(full_encoder(torch.device("cpu")), {"photo": photo}), photo)
    assert guess.shape == (1, GUESS, 256, 256)
    torch.testing.assert_close(guess[:, :1], maps.roughness)
    torch.testing.assert_close(guess[:, 1:].exp() - DARK, torch.stack([maps.specular, maps.diffuse], 1).mean(2))
    twice = photo.repeat_interleave(2, 2).repeat_interleave(2, 3)
    torch.testing.assert_close(patch_of(twice)["guess"], guess)


@pytest.mark.usefixtures("weights")
def test_windows_are_read_beside_the_guess_of_their_patch(rng: Generator) -> None:
    untrained = init_decoder(rng, 5)
    trained = {key: value + (0.1 if ".guess.kernel" in key else 0) for key, value in untrained.items()}
    photo = torch.rand(1, 3, 32, 32, generator=rng)
    patch = patch_of(photo)
    for parameters, same in ((untrained, True), (trained, False)):
        changed = patch | {"guess": 1 - patch["guess"]}
        read, other = (read_photos(parameters, photo, patch=each)["z"] for each in (patch, changed))
        assert torch.allclose(read, other, atol=1e-5) == same
