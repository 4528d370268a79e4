"""Which requests the view's server answers: those of pages that it has delivered itself, on this machine.

The server listens on 127.0.0.1. That alone does not keep out pages of the web that the same browser shows: they can
address 127.0.0.1, or a name of theirs that they let point there (DNS rebinding). So the name by which the server is
addressed, and the page that asks, must be its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


def hosts(port: int) -> frozenset[str]:
    """Return the values of the header ``Host`` by which the server may be addressed."""
    return frozenset(f"{name}:{port}" for name in ("127.0.0.1", "localhost"))


def refusal(headers: Mapping[str, str], port: int, *, websocket: bool) -> str | None:
    """Say why a request is refused; None if it is not.

    Parameters
    ----------
    headers : mapping
        Of the request; names in any case.
    port : int
        On which the server listens.
    websocket : bool
        Whether it asks for the connection over which the data go; browsers name the asking page there always.
    """
    allowed = hosts(port)
    if headers.get("Host", "").lower() not in allowed:
        return "this server is addressed as 127.0.0.1 or localhost only"
    origin = headers.get("Origin")
    if origin is None and websocket:
        return "a connection must name the page that asks for it"
    if origin is not None and origin.lower() not in {f"http://{host}" for host in allowed}:
        return "pages of other origins get nothing from this server"
    if headers.get("Sec-Fetch-Site", "none") not in {"none", "same-origin"}:
        return "pages of other sites get nothing from this server"
    return None


def response_headers(port: int) -> dict[str, str]:
    """Return the headers of all answers: nothing from elsewhere, nothing inline, in no frame, nothing kept."""
    sockets = " ".join(f"ws://{host}" for host in sorted(hosts(port)))
    return {
        "Content-Security-Policy": (
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
            f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        ),
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cache-Control": "no-store",
    }
