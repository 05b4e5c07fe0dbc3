"""The exception tree."""

from __future__ import annotations

import inspect

import pytest

from estimator import errors


def test_all_errors_are_hapslam_errors() -> None:
    """One except clause at the command line catches every error raised on purpose."""
    classes = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]
    assert {kind.__name__ for kind in classes} == set(errors.__all__)
    assert all(issubclass(kind, errors.HapslamError) and kind.__doc__ for kind in classes)


@pytest.mark.parametrize(
    "kind", [errors.ConfigurationError, errors.FileFormatError, errors.OutputExistsError]
)
def test_bad_input_is_a_value_error(kind: type[Exception]) -> None:
    """Callers that know nothing of this tree catch bad input as ValueError."""
    with pytest.raises(ValueError, match="expected 1, got 2"):
        raise kind("expected 1, got 2")


def test_a_missing_ray_tracer_is_not_bad_input() -> None:
    """BackendError is a RuntimeError: the arguments were fine, the machine was not."""
    assert issubclass(errors.BackendError, RuntimeError)
    assert not issubclass(errors.BackendError, ValueError)
