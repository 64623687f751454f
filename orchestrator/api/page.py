"""The live page: `/` and the files under `/web`, with headers that keep the browser on this server."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.responses import FileResponse
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from orchestrator.web import STATIC, VENDOR, missing_vendor_files

router = APIRouter(include_in_schema=False)

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "connect-src 'self'",
        "manifest-src 'self'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    # The page and the server belong together: a browser asks every time whether its copy is still the right one.
    "Cache-Control": "no-cache",
}


class _Files(StaticFiles):
    """Static files with the page's headers."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        response.headers.update(HEADERS)
        return response


@router.get("/")
async def page() -> FileResponse:
    """The page, or one that says how to get what it needs (503)."""
    if missing_vendor_files():
        return FileResponse(STATIC / "missing.html", 503, headers=HEADERS)
    return FileResponse(STATIC / "index.html", headers=HEADERS)


@router.get("/favicon.ico")
async def favicon() -> FileResponse:
    """The icon, for browsers that ask for it by this name."""
    return FileResponse(STATIC / "icon.svg", media_type="image/svg+xml", headers=HEADERS)


def install(app: FastAPI) -> None:
    """Serve the page from an app. Its files hold no secrets: they need no token, the API behind them does."""
    app.include_router(router)
    folders: dict[str, Any] = {"/web/vendor": VENDOR, "/web": STATIC}
    for path, folder in folders.items():
        app.mount(path, _Files(directory=folder, check_dir=False), name=path.rpartition("/")[2])
