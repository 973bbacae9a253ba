"""Marks of tests: which of many alike run by default, as each new combination of features is compiled for seconds."""

from collections.abc import Iterable
from typing import Any

import pytest

FORKS = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
"""Of tests that fork beside threads, which Python 3.12 and later warn of."""


def long_but(names: Iterable[Any], *kept: Any) -> list[Any]:
    """Parameters of a test, of which all but those kept wait for --long. A tuple stands for several arguments."""
    return _marked_but(names, kept, pytest.mark.long)


def slow_but(names: Iterable[Any], *kept: Any) -> list[Any]:
    """Likewise, of which all but those kept wait for --slow."""
    return _marked_but(names, kept, pytest.mark.slow)


def _marked_but(names: Iterable[Any], kept: tuple[Any, ...], mark: pytest.MarkDecorator) -> list[Any]:
    found = list(names)
    assert set(kept) <= set(found), f"{set(kept) - set(found)} are not among {found}"
    return [
        name if name in kept else pytest.param(*(name if isinstance(name, tuple) else (name,)), marks=mark)
        for name in found
    ]
