"""Help and options of `metapp data materials`."""

from __future__ import annotations

from dataclasses import dataclass

from data_tools.converters import Maps, Size


@dataclass(frozen=True)
class Materials(Maps):
    """Convert real materials for training, with drawn ones beside them.

    As `metapp data maps`, but a set may lack its roughness: one is made up, and losses of made-up maps count
    nothing. A specular map without a roughness is an old game's, with shading in its colours, which count less. Maps
    that are smaller than --size are repeated, as such sets tile. Folders of data sets, as of `metapp data synth
    svbrdf_nonstationary --size 512`, are drawn materials; of these and of real ones the recipe pretrained sees as
    many, whatever their numbers. Give maps room for crops: 512 px or more.

    Examples:
      metapp data materials scans drawn --split train --out mixed
      metapp data materials scans/rock scans/bark games --size 512 --out real
    """

    size: Size = 512
