"""A browser for all tests of a file."""

import pytest
from support.browser import browser


@pytest.fixture(scope="module")
def opened():
    with browser() as found:
        yield found
