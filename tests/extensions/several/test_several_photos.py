"""Several photographs of one material: the loss, where fits begin, what more photos are worth."""

import itertools

import pytest
import torch
from torch import Generator, Tensor

from data_tools.readers.svbrdf_task import flash_photo, svbrdf_task
from data_tools.synthetic.svbrdf_nonstationary import held_places, synthetic_tasks
from metapp.appearance.flash import Maps, camera, camera_distance, unpack
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary, field_of
from metapp.apps.svbrdf_nonstationary.maps import FLASH, flash_of, linear, photographed
from metapp.extensions.several.app import SeveralPhotos, flashes_of, radiance_of
from metapp.learning.app import stack
from metapp.learning.recipe import Adam
from metapp.learning.task import Params, Task, Tasks
from metapp.rules import rule_of
from tests.apps.test_svbrdf_nonstationary import material

SIDE, COUNT = 16, 3


def several(seed: int, count: int = COUNT) -> Task:
    """A task of so many photos, from known places."""
    maps, places = material(seed), held_places(1, count, Generator().manual_seed(seed))[0][0]
    photos = [flash_photo(maps, place, float((place[2] / camera_distance()) ** 2), place) for place in places]
    task = svbrdf_task(f"material-{seed}", maps, photo=photos[0])
    return task._replace(
        data=task.data | {"others": torch.stack(photos[1:]), "places": places[:, None].repeat(1, 2, 1)}
    )


@pytest.fixture
def app() -> SeveralPhotos:
    return SeveralPhotos(field_of(SIDE, hidden=8)._replace(code=3), encoder_width=2, protocol="photo")


@pytest.fixture
def tasks(app: SeveralPhotos) -> Tasks:
    return stack(app, [several(seed) for seed in range(2)])


def started(app: SeveralPhotos, tasks: Tasks) -> Params:
    """Random parameters, as Overfit begins."""
    theta = app.init(Generator().manual_seed(0), len(tasks))
    return theta | app.known(tasks)


def test_one_photo_has_the_loss_of_the_application(app: SeveralPhotos) -> None:
    """From straight above, to rounding, whether it has a place or none; that is the norm of the difference of logs."""
    plain = SvbrdfNonstationary(app.network, encoder_width=2, protocol="photo")
    alone = Task("wall", {key: value for key, value in several(0).data.items() if key in ("photo", "maps")})
    one, theta = stack(plain, [alone]), plain.init(Generator().manual_seed(0), 1)
    assert theta["flash"].shape == (1, FLASH)
    photo, maps = one.data["photo"], plain.maps_of(theta, one.data["photo"])
    moved = theta | {"flash": torch.tensor([[0.01, -0.02, 0.03, 0.01]])}
    short = (photo + 0.1).log() - (photographed(maps, flash_of(60 * moved["flash"])) + 0.1).log()
    short = torch.where(photo > 0.95, short.relu(), short)
    assert torch.equal(plain.loss(moved, plain.sample(one, Generator(), 1), {}), short.abs().mean((1, 2, 3)))
    loss = plain.loss(theta, plain.sample(one, Generator(), 1), {})
    for task in (alone, alone._replace(data=alone.data | {"places": camera().expand(1, 2, 3)})):
        placed = stack(app, [task])
        again = app.loss(theta | app.known(placed), app.sample(placed, Generator(), 1), {})
        torch.testing.assert_close(again, loss)


def test_the_loss_is_the_mean_over_photos_whatever_their_order(app: SeveralPhotos, tasks: Tasks) -> None:
    batch, theta = app.sample(tasks, Generator(), 1), started(app, tasks)
    theta["flash"] = 0.02 * torch.randn(theta["flash"].shape, generator=Generator().manual_seed(1))
    maps = app.maps_of(theta, batch["photo"])
    photos = torch.cat([batch["photo"][:, None], batch["others"]], 1)
    losses = []
    for order in map(list, itertools.permutations(range(COUNT))):
        mixed = {"photo": photos[:, order[0]], "others": photos[:, order[1:]], "places": batch["places"][:, order]}
        losses.append(app._photo_loss({"flash": theta["flash"][:, :, order]}, maps, mixed, {}))
    for loss in losses[1:]:
        torch.testing.assert_close(loss, losses[0])
    singles = [
        {"photo": photos[:, i], "others": photos[:, :0], "places": batch["places"][:, i : i + 1]} for i in range(COUNT)
    ]
    each = [app._photo_loss({"flash": theta["flash"][:, :, i : i + 1]}, maps, one, {}) for i, one in enumerate(singles)]
    torch.testing.assert_close(torch.stack(each).mean(0), losses[0])


def test_true_maps_from_true_places_have_no_loss(
    app: SeveralPhotos, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SeveralPhotos, "maps_of", lambda app, theta, photo: unpack(tasks.data["maps"]))
    batch, theta = app.sample(tasks, Generator(), 1), started(app, tasks)
    assert app.loss(theta, batch, {}).max() < 0.03  # the maps are the photos' means, and 8 bits
    for axis, off in ((0, 0.02), (2, 0.02), (3, 0.02)):
        moved = theta["flash"].clone()
        moved[:, axis, 1] = off
        assert (app.loss(theta | {"flash": moved}, batch, {}) > app.loss(theta, batch, {})).all(), axis


def test_general_reads_the_first_and_begins_as_bright_as_each_photo(app: SeveralPhotos, tasks: Tasks) -> None:
    weights = app.init_encoder(Generator().manual_seed(0))
    batch = app.condition(tasks, Generator())
    theta = app.encode(weights, batch)
    alone = super(SeveralPhotos, app).encode(weights, {"photo": batch["photo"]})
    assert torch.equal(theta["z"], alone["z"])
    darker = batch | {"others": torch.stack([0.25 * batch["others"][:, 0], batch["others"][:, 1]], 1)}
    change = app.network.gain * (app.encode(weights, darker)["flash"] - theta["flash"])
    assert change[:, :3].abs().max() == 0
    assert change[:, 3, [0, 2]].abs().max() == 0
    assert (change[:, 3, 1] < -2).all()  # log(1/4) = -4.6 times 0.3, less where it clipped
    flash = flashes_of(app.network.gain * theta["flash"], batch["places"])
    shown = radiance_of(app.maps_of(theta, batch["photo"]), flash)
    photos = torch.cat([batch["photo"][:, None], batch["others"]], 1)
    whole = photos < 0.95
    torch.testing.assert_close((shown * whole).sum((2, 3, 4)), (photos * whole).sum((2, 3, 4)), rtol=1e-4, atol=0)


def test_camera_and_flash_move_together() -> None:
    places = torch.tensor([[[[0.1, 0.2, 3.0], [0.3, 0.2, 2.0]]]])
    flash = torch.zeros(1, FLASH, 1)
    given = flashes_of(flash, places)
    torch.testing.assert_close(torch.stack([given.eye, given.place], 2), places)
    moved = flashes_of(flash + torch.tensor([1.0, -1.0, 0.5, 0.0])[:, None], places)
    for before, after in ((given.eye, moved.eye), (given.place, moved.place)):
        torch.testing.assert_close(after[..., :2] - before[..., :2], torch.tensor([[[0.3, -0.3]]]))
        torch.testing.assert_close(after[..., 2] / before[..., 2], torch.tensor([[0.1]]).exp())
    white = Maps(
        torch.ones(1, 3, 33, 33), torch.zeros(1, 3, 33, 33), torch.ones(1, 1, 33, 33), torch.zeros(1, 3, 33, 33)
    )
    white.normal[:, 2] = 1
    above = flashes_of(flash, torch.tensor([[[[0.0, 0.0, 5.0], [0.0, 0.0, 5.0]]]]))
    assert float(radiance_of(white, above)[0, 0, 0, 16, 16]) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("rule", ["meta-encoder", "meta-sgd"])
def test_learned_rates_of_one_flash_serve_all(app: SeveralPhotos, tasks: Tasks, rule: str) -> None:
    """A learned rule that is a plain Adam moves flashes of several photos as that Adam does, each by itself."""
    theta = started(app, tasks)
    one = {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}
    alpha = rule_of(rule).alpha(app, one, 4, Adam(1e-3))
    spread = {key: value[:, None].expand(-1, 2, *value.shape[1:]) for key, value in alpha.items()}
    step = {name: value[0] for name, value in spread.items()}
    assert step["rate.flash"].shape == (2, FLASH)
    learned = rule_of(rule).rule(step)
    grads = {key: torch.ones_like(value) for key, value in theta.items()}
    moved, _ = learned.step(step, theta, grads, learned.init(theta))
    change = moved["flash"] - theta["flash"]
    torch.testing.assert_close(change, torch.full_like(change, -1e-3), rtol=1e-3, atol=0)


def test_tasks_of_different_numbers_are_not_fitted_together(app: SeveralPhotos) -> None:
    alone = Task("wall", {"photo": several(0).data["photo"]})
    for other in (several(1, 2), alone):
        with pytest.raises(ValueError, match=r"others \(.*expected \(2, 3, 16, 16\) as of material-0; convert both"):
            stack(app, [several(0), other])
    data = several(0).data
    for broken in (data | {"places": data["places"][:2]}, {key: data[key] for key in ("photo", "others")}):
        with pytest.raises(ValueError, match=r"leaf: 3 photos and [02] places, expected as many"):
            app.prepare(Task("leaf", broken))


def test_drawn_photos_are_those_of_the_places(rng: Generator) -> None:
    """The first is the one of sets of one photo; measured places explain the others nearly, others do not."""
    (one,), (five,) = (list(synthetic_tasks("train", 1, photos=count)) for count in (1, 5))
    assert all(torch.equal(one.data[key], five.data[key]) for key in ("photo", "maps"))
    assert set(one.data) == {"photo", "maps"}
    maps, places = unpack(five.data["maps"].float()[None]), five.data["places"]
    assert five.data["others"].shape == (4, 3, 128, 128)

    def off(place: Tensor) -> Tensor:
        seen = radiance_of(maps, flashes_of(torch.zeros(1, FLASH, 4), place[None]))[0].clamp(0, 1)
        return (seen - linear(five.data["others"])).abs().mean((1, 2, 3))

    mirrored = places[1:] * torch.tensor([-1.0, -1.0, 1.0])
    assert (off(places[1:]) < off(mirrored)).all()
    assert off(places[1:]).mean() < 0.5 * off(mirrored).mean()
