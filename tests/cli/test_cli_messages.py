"""One test for each kind of message: its exit code, its one line, and the facts that the line holds.

Facts are what was named, what was found, what was expected, and the option or command that helps. The words around them
are free: a new wording changes no test.
"""

import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from metapp.storage.checkpoint_files import read_entry, write_entry
from metapp.storage.shipped_checkpoints import shipped_checkpoint_path
from tests.pictures import write_noise_photo

NETWORKS = 2
BOUND_OF_SEEDS = "9,223,372,036,854,775,807"


@pytest.fixture
def inputs(networks: Path, metapp: Callable) -> None:
    """Write what the commands below name: inputs, a folder and files of other kinds, data sets, checkpoints."""
    for place in ("m1", "c/gold", "d/gold", "bad"):
        shutil.copytree(networks / "m1", place)
    np.save("bad/b3.npy", np.full(3, np.nan, np.float32))
    Path("folder").mkdir()
    Path("empty").mkdir()
    Path("link.csv").symlink_to("nowhere")
    for name, content in {"text.binary": b"not a material", "photo.png": b"\x89PNG", "folder/notes.txt": b"",
                          "klems.xml": b"<?xml version='1.0'?><!-- <a> --><WindowElement><b/></WindowElement>",
                          "rows.json": b'[{"theta_i": 3, "red": 1}]', "rows.xlsx": b"PK\3\4\x14", "empty.png": b"",
                          "page.pdf": b"%PDF-1.7"}.items():  # fmt: skip
        Path(name).write_bytes(content)
    write_noise_photo(Path("a.png"))
    Path("broken.safetensors").write_bytes(b"broken")
    save_file({"x": torch.zeros(2)}, "foreign.safetensors")
    phi, header = read_entry(shipped_checkpoint_path("brdf"), "general")
    write_entry(Path("general.safetensors"), "general", phi, header)
    for split in ("train", "test"):
        metapp("data", "nbrdf", "m1", "--out", split, "--split", split, "--samples", "512")


UNKNOWN_NAMES = """
meta brdfs                                | 'brdfs' ; brdf, illumination
mta                                       | 'mta'
meta brdf --rule meta-magic               | --rule ; 'meta-magic' ; meta-sgd
meta brdf --recipe slow                   | --recipe 'slow' ; quick
meta brdf --export blend | --export 'blend' ; bsdf, bsdf-spectral, cpp, glsl, hlsl, materialx, merl, mitsuba
meta brdf --device tpu                    | --device 'tpu' ; auto, cpu, cuda
evaluate brdf --which nothing             | --which 'nothing' ; results
evaluate brdf --format word               | --format 'word' ; markdown
evaluate brdf --recipe slow               | --recipe 'slow' ; quick
evaluate texture svbrdf_nonstationary --observe mirror --no-run | 'mirror' ; svbrdf_nonstationary ; reference, photo
data merl in --out out --split valid      | --split 'valid' ; train, test, auto
data synth glass                          | 'glass' ; brdf
data synth brdf --as exr                  | --as ; 'exr' ; shards, merl ; brdf
data maps in --out out --normals left     | --normals 'left' ; opengl
"""

WRONG_VALUES = f"""
meta brdf --steps -1                      | --steps -1 ; 0 to 1,000,000,000
meta brdf --steps ten                     | --steps ; integer
meta brdf --batch 0                       | --batch 0 ; 1
overfit brdf --seed -1                    | --seed -1 ; 0 to {BOUND_OF_SEEDS}
overfit brdf --steps 99999999999999999999 | --steps 99999999999999999999 ; 0 to 1,000,000,000
general brdf --train --train-steps 99999999999999999999 | --train-steps 99999999999999999999 ; 1 to 1,000,000,000
data synth brdf --seed 99999999999999999999        | --seed ; {BOUND_OF_SEEDS.replace(",", "")}
data nbrdf m1 --out out --samples 1                | --samples 1 ; 2 to 10,000,000
data nbrdf m1 --out out --samples 99999999999999999 | --samples 99999999999999999 ; 2 to 10,000,000
data synth brdf --count 0                 | --count 0 ; 1 to
data cornell --out out --count 0          | --count 0 ; 1 to
data images in --out out --size x         | --size ; integer
data strips in --out out --gamma 0        | --gamma 0 ; 0.1 to 10
overfit texture a.png --size 48x          | --size '48x' ; HEIGHTxWIDTH
overfit svbrdf_nonstationary a.png --size 32x64 | --size 32x64 ; svbrdf_nonstationary ; 32 to 4096 px
data strips c --out out --predicted none  | --predicted 'none' ; no such folder
general brdf ''                           | empty
general brdf m1 --export ''               | empty ; --export
general brdf m1 --out=                    | empty
general brdf '' m1                        | empty
"""

STRAY_OPTIONS = """
meta brdf --train-steps 5                 | --train-steps ; --train.
meta brdf --observe photo                 | --observe 'photo' ; brdf
evaluate texture svbrdf_stationary --observe photo --no-run | --observe 'photo' ; texture
meta brdf --recipe few --conserve         | --conserve ; few ; full
meta brdf --rule meta-lgd                 | 'meta-lgd' ; network ; brdf
meta illumination --rule meta-basis       | 'meta-basis' ; average ; illumination
overfit svbrdf_nonstationary a.png --observe reference --stops 1 | --stops ; --observe photo
overfit svbrdf_nonstationary --observe photo --stops 1 | --stops ; INPUT
overfit texture a.png --stops 1           | --stops
data merl in                              | --out
data synth brdf --as merl                 | --out ; folder ; merl
"""

MISSING_FILES = """
overfit brdf none.binary                  | none.binary ; no such file
overfit brdf --data none                  | none ; no such folder ; metapp data
general brdf m1 --data none               | none ; no such folder ; metapp data
general brdf m1 --checkpoint none.safetensors | none.safetensors ; no such checkpoint ; .safetensors
data merl none.binary --out out           | none.binary ; no such file ; MERL
data join none --out out                  | none ; no such folder ; metapp data
data check none                           | none ; no such folder ; metapp data
export none nbrdf                         | none ; no such folder ; runs/brdf/meta
view none                                 | none ; no such folder ; runs/brdf/meta
compare none none                         | none ; no such folder ; runs/brdf/meta
"""

FOREIGN_FILES = """
overfit brdf text.binary                  | text.binary ; 14 bytes ; 34,992,012 ; MERL
overfit brdf photo.png                    | photo.png ; brdf ; MERL ; NBRDF ; svbrdf_stationary, texture
overfit brdf folder                       | folder ; brdf ; MERL ; NBRDF
overfit brdf klems.xml                    | klems.xml ; XML ; <WindowElement> ; goniometer .csv ; transport reads
overfit brdf rows.xlsx                    | rows.xlsx ; packed ; spreadsheets ; unpack it ; .csv
overfit texture page.pdf                  | page.pdf ; PDF ; export ; PNG
overfit brdf empty.png                    | empty.png ; empty file ; goniometer .csv ; copy or download it again
overfit texture empty                     | empty ; empty folder ; put files into it
overfit brdf link.csv                     | link.csv ; link to nowhere ; existing input files
overfit transport klems.xml               | klems.xml ; XML document of <WindowElement> ; a scene of Mitsuba, <scene>
overfit brdf rows.json                    | rows.json ; JSON ; theta_i, red ; goniometer .csv ; transport reads
overfit brdf --data train                 | train ; 0 test tasks
general brdf --train --train-steps 3 --data test | brdf ; 0 tasks
general brdf m1 --checkpoint broken.safetensors  | broken.safetensors ; --train
general brdf m1 --checkpoint foreign.safetensors | foreign.safetensors ; --train
meta brdf m1 --checkpoint general.safetensors --rule meta-sgd | general.safetensors ; brdf general ; brdf meta-sgd
data nbrdf bad --out out                  | bad/b3.npy ; NaN ; finite
data nbrdf c/gold d/gold --out out        | c/gold ; d/gold ; 'gold'
data check folder                         | folder ; manifest.json ; metapp data
export folder nbrdf                       | folder ; runs/brdf/meta
"""

MISSING_CHECKPOINTS = """
meta brdf m1 --recipe paper --rule meta-encoder  | brdf meta-encoder ; paper ; --train ; --checkpoint
meta brdf m1 --recipe quick --rule meta-average  | brdf meta-average ; quick ; --train ; --checkpoint
"""

# how commands end with a line of each kind: 2 for wrong words, 1 for wrong files
KINDS = {
    "unknown names": (2, UNKNOWN_NAMES),
    "wrong values": (2, WRONG_VALUES),
    "stray options": (2, STRAY_OPTIONS),
    "missing files": (1, MISSING_FILES),
    "foreign files": (1, FOREIGN_FILES),
    "missing checkpoints": (1, MISSING_CHECKPOINTS),
}


@pytest.mark.usefixtures("inputs")
@pytest.mark.parametrize(("code", "table"), KINDS.values(), ids=KINDS)
def test_a_line_holds_the_facts_of_its_kind(metapp: Callable, code: int, table: str) -> None:
    for row in table.strip().splitlines():
        command, facts = row.split(" | ")
        result = metapp(*shlex.split(command))
        line = result.misuse if code == 2 else result.error
        assert all(fact.strip() in line for fact in facts.split(" ; ")), (command, line)
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("meta brdfs", "brdf"),
        ("mta", "meta"),
        ("meta brdf --rule meta-curvatur", "meta-curvature"),
        ("meta texture --export png61", "png16"),
        ("meta zzzz", ""),
        ("zzzz", ""),
        ("meta brdf --rule zzzz", ""),
        ("meta texture --export zzzz", ""),
    ],
)
def test_a_name_is_suggested_if_one_is_near(metapp: Callable, command: str, name: str) -> None:
    misuse = metapp(*command.split()).misuse
    assert f"Did you mean '{name}'?" in misuse if name else "Did you mean" not in misuse
