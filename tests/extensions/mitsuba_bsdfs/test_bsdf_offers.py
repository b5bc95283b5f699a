"""The plugins of other extensions, after `import metapp.mitsuba` without this one."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.needs_mitsuba import needs_mitsuba

SCRIPT = """
import metapp.mitsuba, mitsuba
mitsuba.set_variant("llvm_ad_rgb")
print(mitsuba.load_dict({"type": "metapp_guided_path"}).class_name())
mitsuba.load_dict({"type": "neural_svbrdf"})
"""


@needs_mitsuba
def test_other_plugins_are_registered_without_it() -> None:
    environment = os.environ | {"METAPP_WITHOUT": "mitsuba_bsdfs"}
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False, env=environment)
    assert done.stdout, done.stderr
    assert "neural_svbrdf" in done.stderr
    assert done.returncode == 1
