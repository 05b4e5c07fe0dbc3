"""Files are tested with paths of the image method, which need no ray tracer; traced cases ask for it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.raytrace.image_tracer import images_for_rays, rays_again


@pytest.fixture(scope="module", autouse=True)
def _images() -> Iterator[None]:
    """The image method in place of the ray tracer."""
    with images_for_rays():
        yield


@pytest.fixture
def traced() -> Iterator[None]:
    """The ray tracer itself."""
    with rays_again():
        yield
