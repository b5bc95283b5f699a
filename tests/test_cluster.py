"""The examples for clusters, on a local cluster of two workers; make test-cluster installs what they need."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import metapp

EXAMPLES = Path(__file__).parent.parent / "examples"
pytestmark = [pytest.mark.long, pytest.mark.usefixtures("compiled_in_cache")]


def goniometer_table(path: Path) -> Path:
    """A table of a goniometer, of a grey material."""
    angles = [(i % 80, 9 * i % 360, 7 * i % 80) for i in range(200)]
    rows = [f"{incident},{turned},{outgoing},0,0.2,0.2,0.2" for incident, turned, outgoing in angles]
    path.write_text("\n".join(["theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b", *rows]))
    return path


@pytest.mark.parametrize(("script", "package"), [("dask_fits.py", "distributed"), ("ray_fits.py", "ray")])
def test_two_workers_fit_as_one_process_does(
    script: str, package: str, write_nbrdf_networks: Callable[[int], Path], tmp_path: Path
) -> None:
    """Each source once, with the same error, also at an address; a bad one is a row with its reason."""
    if not importlib.util.find_spec(package):
        pytest.skip(f"{package} is not installed; make test-cluster installs it")
    networks = [str(folder) for folder in sorted(write_nbrdf_networks(9).iterdir())]
    (tmp_path / "torn.binary").write_bytes(b"x")
    torn = str(tmp_path / "torn.binary")
    table = goniometer_table(tmp_path / "paint.csv")
    address = f"file://{table}"
    process = subprocess.run(
        [sys.executable, EXAMPLES / script, *networks, torn, address],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(EXAMPLES.parent)},
    )
    assert process.returncode == 0, process.stderr[-2000:]
    rows = {row["source"]: row for row in map(json.loads, process.stdout.splitlines())}
    assert rows.keys() == {*networks, torn, address}
    assert len(process.stdout.splitlines()) == 11
    assert rows[torn]["failure"].startswith(f"{torn}: 1 bytes, expected 34,992,012")
    for place, path in (*((one, one) for one in networks[::8]), (address, table)):
        assert rows[place]["error"] == pytest.approx(metapp.fit("brdf", path).error, rel=1e-6)
