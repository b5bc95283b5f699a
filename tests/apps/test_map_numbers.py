"""Unbounded numbers stand for maps: encoding inverts decoding, but at the ends of ranges."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps, encode_maps

EXAMPLES = settings(max_examples=200, derandomize=True, database=None, deadline=None)
# Numbers of each kind that stand for values off the ends of their ranges
RANGES = ((-6.0, 6.0), (-3.8, 3.8), (-4.5, 4.5), (-1.8, 5.8))
NUMBERS = st.tuples(*(st.floats(*limits) for limits, count in zip(RANGES, CHANNELS, strict=True) for _ in range(count)))
SHARE = st.floats(0, 1)


@EXAMPLES
@given(NUMBERS)
def test_encoding_inverts_decoding(numbers: tuple[float, ...]) -> None:
    raw = torch.tensor(numbers, dtype=torch.float64)[None, :, None, None]
    torch.testing.assert_close(encode_maps(decode_maps(raw)), raw, rtol=0, atol=1e-9)


@EXAMPLES
@given(st.tuples(*7 * [SHARE]), st.floats(-3.14, 3.14), SHARE)
def test_decoding_inverts_encoding_up_to_ends_of_ranges(
    values: tuple[float, ...], azimuth: float, normal_z: float
) -> None:
    up = torch.tensor([azimuth, normal_z], dtype=torch.float64)
    across = (1 - up[1] ** 2).sqrt() * torch.stack([up[0].cos(), up[0].sin()])
    shares = torch.tensor(values, dtype=torch.float64)
    roughness = 0.05 + 0.95 * shares[3:4]
    packed = torch.cat([across, up[1:], shares[:3], roughness, shares[4:]])[None, :, None, None]
    maps = unpack_maps(packed)
    found = decode_maps(encode_maps(maps))
    for part, gamma in (("diffuse", 2.2), ("specular", 2.0), ("roughness", 1.0)):
        decoded, known = (getattr(material, part) ** (1 / gamma) for material in (found, maps))
        assert float((decoded - known).abs().max()) < 0.021, part
    if normal_z > 0.1:
        torch.testing.assert_close(found.normal, maps.normal)
