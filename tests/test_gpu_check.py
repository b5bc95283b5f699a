"""tools/gpu_check.py: a dry run on the CPU."""

import runpy
from pathlib import Path

import pytest
import torch

main = runpy.run_path(str(Path(__file__).parent.parent / "tools" / "gpu_check.py"))["main"]
FEW = ["--device", "cpu", "--steps", "1", "--seeds", "1"]
pytestmark = pytest.mark.filterwarnings("ignore:.* the visible loss rose")  # of one step


@pytest.mark.parametrize(
    ("subjects", "rows"), [(["illumination:photo"], 5), pytest.param([], 40, marks=pytest.mark.slow)]
)
def test_a_device_is_compared_with_the_cpu(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], subjects: list[str], rows: int
) -> None:
    assert main([*FEW, "--data", str(tmp_path), *subjects]) == 0
    head, line, *cells, _, sum_ = capsys.readouterr().out.splitlines()
    assert head.count("|") == line.count("|") == 9
    assert len(cells) == rows
    for row in cells:
        _, app, _, _, cpu, other, *_ = (cell.strip() for cell in row.split("|"))
        assert cpu == other, app  # of the same draws
    assert sum_.endswith(f"1 steps: {rows} of {rows} as on the CPU")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_failures_on_a_device_are_lines_of_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--device", "cuda", *FEW[2:], "--data", str(tmp_path), "illumination:reference"]) == 1
    assert capsys.readouterr().out.count("no CUDA device") == 5


def test_unknown_subjects_are_refused_with_the_known_ones() -> None:
    with pytest.raises(SystemExit, match="svbrdf_nonstationary:photo"):
        main([*FEW, "tissue"])
