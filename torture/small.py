"""`python -m torture.small ...`: metapp with pictures of BRDFs at 16 px, which cost nothing."""

import pytest

from metapp.cli import main
from tests.small_spheres import shrink_spheres

if __name__ == "__main__":
    shrink_spheres(pytest.MonkeyPatch())  # for the whole run
    main()
