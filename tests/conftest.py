"""What holds for every test."""

from __future__ import annotations

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Refuse tests that do not say what they are for."""
    tests = [item for item in items if isinstance(item, pytest.Function)]
    mute = sorted({test.nodeid.split("[")[0] for test in tests if not test.function.__doc__})
    if mute:
        raise pytest.UsageError("expected a docstring in every test, missing in:\n  " + "\n  ".join(mute))
