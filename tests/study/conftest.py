"""A setup that all tests of studies share, with polars that need no engine."""

import numpy as np
import pytest

from mufly.drive import load_drive
from mufly.rotor import load_rotor
from mufly.study import StudySetup


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory):
    """Polars computed by these tests are kept in a folder of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MUFLY_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def thin_plate(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of a table with the lift of a thin plate and a drag that grows with its square."""
    alpha = np.arange(-20.0, 20.1, 1.0)
    cl = 2 * np.pi * np.sin(np.radians(alpha))
    lines = [f"{a},{c},{0.02 + 0.03 * c**2}" for a, c in zip(alpha, cl, strict=True)]
    path = tmp_path_factory.mktemp("polars") / "plate.csv"
    path.write_text("\n".join(["alpha_deg,cl,cd", *lines]), encoding="utf-8")
    return str(path)


@pytest.fixture(scope="session")
def setup(thin_plate: str) -> StudySetup:
    """The standard blade with that table, 0.4 N, adapted gear, muFly's drive."""
    return StudySetup(
        load_rotor("naca4412-r60-c20"),
        load_drive("mufly"),
        {"airfoil": thin_plate, "thrust": 0.4, "gear": "adapted"},
    )
