"""The pages that people look at: the playground at `/`, the API's description at `/docs`, and their files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles

WEB = Path(__file__).resolve().parent.parent / "web"
"""What `make web` builds."""

# Nothing from elsewhere, whatever a page may come to hold: robots have no internet. `data:` is the icon in the tab.
_CONTENT_SECURITY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; connect-src 'self' ws: wss:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
_FRESH = {"Cache-Control": "no-cache"}
_FOREVER = {"Cache-Control": "public, max-age=31536000, immutable"}


class _Files(StaticFiles):
    """Asks are answered with 304 where nothing has changed; what carries a hash in its name never changes."""

    def file_response(self, *arguments: Any, **named: Any) -> Response:
        response = super().file_response(*arguments, **named)
        path = Path(arguments[0] if arguments else named["full_path"])
        response.headers.update(_FOREVER if path.parent.name == "assets" else _FRESH)
        return response


def add_site(app: FastAPI) -> None:
    """The routes `/`, `/docs` and `/web/…`."""

    @app.get("/", include_in_schema=False)
    async def index() -> FileResponse:
        return FileResponse(WEB / "index.html", headers=_FRESH | {"Content-Security-Policy": _CONTENT_SECURITY})

    @app.get("/docs", include_in_schema=False)
    async def docs() -> FileResponse:
        return FileResponse(WEB / "docs.html", headers=_FRESH)

    app.mount("/web", _Files(directory=WEB), name="web")
