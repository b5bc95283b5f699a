"""How much a flash photo says of a material beyond what General reads from it; `make bench-photo` runs it.

What is measured: non-stationary svBRDFs under `--observe photo`, by the General that ships, on the test tasks of a data
set (the embedded one, or the folder that is named).

- How well General's maps explain the photo, and how well the true ones do, under the flash that suits these best.
- How far steps on the photo bring General's maps towards the truth if every texel may move by itself, all maps or one
  kind of them: Adam, the best of its rates and of its steps, chosen on the very tasks that are judged. So a start or a
  rate that moves the maps by nothing but the photo's loss, texel by texel, has no more than that to win. Once the flash
  starts where General believes it, once it is told.
- What General's error would be with the true normals, and the true maps' error with flat ones.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from torch import Generator, Tensor

from metapp.appearance.flash import Maps, unpack
from metapp.apps.svbrdf_nonstationary.app import JUDGED, SvbrdfNonstationary, _pairs
from metapp.apps.svbrdf_nonstationary.maps import FLASH, RAW, decoded, inputs_of
from metapp.apps.svbrdf_nonstationary.recipes import QUICK
from metapp.cli.console import run
from metapp.learning.app import stack
from metapp.learning.task import Params
from metapp.paradigms import Job
from metapp.paradigms.general import GENERAL
from metapp.runs.checkpoints.shipped import shipped_path
from metapp.runs.inputs.sources import tasks_of_data
from metapp.storage.records import load_checkpoint

APP = SvbrdfNonstationary(QUICK.setup, "reference")

RATES = (1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
STEPS, LOOKED_AT = 120, 5
KINDS = ("normals", "diffuse", "roughness", "specular")
CALIBRATING = 300  # steps that look for the flash of true maps


class Bench:
    """The tasks, what General makes of them, and what is true of them."""

    def __init__(self, data: Path | None) -> None:
        tasks = stack(APP, tasks_of_data(APP, data, quiet=True)[0])
        general, _ = load_checkpoint(shipped_path(APP.name, "general"))
        theta = GENERAL.fit(Job(APP, QUICK, QUICK.rule), general, tasks, Generator().manual_seed(0))
        self.photo, self.truth = tasks.data["photo"], unpack(tasks.data["maps"])
        self.pairs = _pairs(JUDGED)[None]
        self.wanted = APP._logs(self.truth, self.pairs)
        self.raw = APP.field(theta, inputs_of(self.photo)).detach()
        self.flash = {"flash": theta["flash"].detach()}

    def error(self, maps: Maps) -> float:
        """What tables print."""
        with torch.no_grad():
            return float((APP._logs(maps, self.pairs) - self.wanted).abs().mean())

    def of_photo(self, maps: Maps, flash: Params) -> Tensor:
        """The photo's loss, [T]."""
        return APP._photo_loss(flash, maps, {"photo": self.photo}, {})

    def true_flash(self) -> Params:
        """The flash under which the true maps look like the photo best."""
        flash = torch.zeros(len(self.photo), FLASH, requires_grad=True)
        optimiser = torch.optim.Adam([flash], 0.03 / APP.field.gain)
        for _ in range(CALIBRATING):
            optimiser.zero_grad()
            self.of_photo(self.truth, {"flash": flash}).sum().backward()
            optimiser.step()
        return {"flash": flash.detach()}

    def moved(self, kind: str, rate: float, flash: Params, told: bool) -> tuple[float, int]:
        """The lowest error on the way, and after how many steps, when texels of a kind of map move by the photo."""
        raw = [part.clone() for part in self.raw.split(RAW, 1)]
        free = raw if kind == "all" else [raw[KINDS.index(kind)]]
        groups = [{"params": [part.requires_grad_() for part in free], "lr": rate}]
        place = flash["flash"].clone().requires_grad_(not told)
        if not told:
            groups.append({"params": [place], "lr": rate / APP.field.gain})
        optimiser, found = torch.optim.Adam(groups), []
        for step in range(1, STEPS + 1):
            optimiser.zero_grad()
            self.of_photo(decoded(torch.cat(raw, 1)), {"flash": place}).sum().backward()
            optimiser.step()
            if step % LOOKED_AT == 0:
                found.append((self.error(decoded(torch.cat(raw, 1))), step))
        return min(found)


def main() -> None:
    """Print what the photo says."""
    torch.set_num_threads(1)
    bench = Bench(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
    maps, calibrated = decoded(bench.raw), bench.true_flash()
    general, flat = bench.error(maps), torch.zeros_like(bench.truth.normal)
    flat[:, 2] = 1
    losses = [float(bench.of_photo(*each).mean()) for each in ((maps, bench.flash), (bench.truth, calibrated))]
    print(f"{len(bench.photo)} materials. General: error {general:.4f}; loss on the photo {losses[0]:.4f}")
    print(f"the true maps: loss on the photo {losses[1]:.4f}, under the flash that suits them best")
    for name, changed in (
        ("General with the true normals", maps._replace(normal=bench.truth.normal)),
        ("the true maps with General's normals", bench.truth._replace(normal=maps.normal)),
        ("the true maps with flat normals", bench.truth._replace(normal=flat)),
    ):
        error = bench.error(changed)
        print(f"{name}: error {error:.4f}, {100 * (error / general - 1):+.1f} %")
    for told, flash in ((False, bench.flash), (True, calibrated)):
        print(f"\nsteps on the photo from General's maps, {'told the flash' if told else 'looking for the flash, too'}")
        for kind in ("all", *KINDS):
            ways = [(*bench.moved(kind, rate, flash, told), rate) for rate in RATES]
            error, step, rate = min(ways)
            change = f"{100 * (error / general - 1):+.1f} %"
            print(f"  {kind + ' move:':16} at best {error:.4f}, {change}, after {step} steps at rate {rate:g}")


if __name__ == "__main__":
    sys.exit(run(main))
