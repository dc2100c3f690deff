"""A rendered stack that several files of tests read."""

import pytest

from tests.pixel_stacks import cone_stack


@pytest.fixture(scope="session")
def paper_stack(tmp_path_factory):
    """A withdrawal from printed paper."""
    return cone_stack(tmp_path_factory.mktemp("paper") / "stack")
