"""Polars computed by these tests are kept in a folder of their own."""

import pytest


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MUFLY_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
