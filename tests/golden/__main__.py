"""Compute golden values and write them to values.json: python -m tests.golden [PART]..."""

import json
import sys
import tempfile
import time
from pathlib import Path

import torch

from metapp.appearance import features
from tests.golden.golden_values import PARTS
from tests.golden.test_golden import FILE

if __name__ == "__main__":
    import os

    os.environ[features.FLOAT32_VARIABLE] = "1"
    torch.set_num_threads(1)
    values = json.loads(FILE.read_text()) if FILE.exists() else {}
    for part in sys.argv[1:] or PARTS:
        begin = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            values[part] = PARTS[part](Path(folder))
        print(f"{part}: {len(values[part])} values, {time.perf_counter() - begin:.1f} s", flush=True)
        FILE.write_text(json.dumps(values, indent=0) + "\n")
