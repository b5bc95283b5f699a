"""Where reduced precision is bfloat16: on CPUs that are made for it."""

from __future__ import annotations

import os
from functools import cache

import torch

FLOAT32 = "METAPP_FLOAT32"  # of the environment: 1 for float32 everywhere


@cache
def has_bfloat16() -> bool:
    """True if the CPU multiplies bfloat16 by instructions of its own (AVX512-BF16, AMX), faster than float32."""
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


def in_bfloat16(device: torch.device) -> bool:
    """True if features in reduced precision are computed in bfloat16 on a device; METAPP_FLOAT32=1: never."""
    return device.type == "cpu" and has_bfloat16() and os.environ.get(FLOAT32, "") in ("", "0")
