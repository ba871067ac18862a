"""What people type as an address of a daemon, as that of its websocket."""

from __future__ import annotations

from urllib.parse import urlsplit, urlunsplit

PORT = 8787
SCHEMES = {"ws": "ws", "wss": "wss", "http": "ws", "https": "wss"}


def websocket_of(address: str) -> str:
    """`127.0.0.1`, `HOST:PORT`, the address of the page (of a hub's stage, of a take) or that of the websocket itself."""
    parts = urlsplit(address if "://" in address else f"ws://{address}")
    if parts.scheme not in SCHEMES or not parts.hostname:
        raise ValueError(f"{address!r} is no address of a daemon: give HOST:PORT, or ws://HOST:PORT/ws")
    place = parts.netloc if parts.port or "://" in address else f"{parts.netloc}:{PORT}"
    path = parts.path if parts.path.endswith("/ws") else parts.path.rstrip("/") + "/ws"
    return urlunsplit((SCHEMES[parts.scheme], place, path, parts.query, ""))
