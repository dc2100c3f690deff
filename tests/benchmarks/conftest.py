"""What the tests of sets share: one drawn set, which no test may change."""

import pytest

from tests.support.drawn.drawn_sets import write_set


@pytest.fixture(scope="session")
def drawn(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("drawn") / "set")
