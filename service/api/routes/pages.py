"""The page, its files, and the reference of the interface; nothing comes from elsewhere."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse

from service.errors import NotFoundError

__all__ = ["router"]

router = APIRouter(include_in_schema=False)

_WEB = Path(__file__).parents[2] / "web"
_TYPES = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
    ".txt": "text/plain",
}


@router.get("/")
async def index() -> FileResponse:
    """The page."""
    return _file("index.html")


@router.get("/docs")
async def docs() -> FileResponse:
    """The reference, drawn from ``/openapi.json``."""
    return _file("docs.html")


@router.get("/web/{name}")
async def web(name: str) -> FileResponse:
    """A file of the page."""
    if name not in {file.name for file in _WEB.iterdir() if file.suffix in _TYPES}:
        raise NotFoundError(f"expected a file of the page, got {name[:64]!r}")
    return _file(name)


def _file(name: str) -> FileResponse:
    file = _WEB / name
    return FileResponse(file, media_type=_TYPES[file.suffix], headers={"Cache-Control": "no-cache"})
