"""Where messages wait: for who awaits them, and for who blocks."""

from __future__ import annotations

import asyncio
import collections
import queue
from typing import Any


class AwaitedInbox:
    """On one asyncio loop."""

    def __init__(self) -> None:
        self._items: collections.deque[Any] = collections.deque()
        self._waiting: asyncio.Future[None] | None = None

    def put(self, item: Any, most: int | None) -> int:
        dropped = 0
        while most is not None and len(self._items) >= most:
            self._items.popleft()
            dropped += 1
        self._items.append(item)
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)
        return dropped

    async def get(self) -> Any:
        while not self._items:
            self._waiting = asyncio.get_running_loop().create_future()
            await self._waiting
        item = self._items.popleft()
        if isinstance(item, Exception):
            # So that the next one that asks learns of it too.
            self._items.appendleft(item)
            raise item
        return item


class BlockingInbox:
    """From the thread of the connection to that of the user."""

    def __init__(self) -> None:
        self._items: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._ended: Exception | None = None

    def put(self, item: Any, most: int | None) -> int:
        dropped = 0
        while most is not None and self._items.qsize() >= most:
            try:
                self._items.get_nowait()
                dropped += 1
            except queue.Empty:
                break
        self._items.put(item)
        return dropped

    def get(self, timeout_s: float | None = None) -> Any:
        if self._ended is not None:
            raise self._ended
        try:
            item = self._items.get(timeout=timeout_s)
        except queue.Empty:
            raise TimeoutError(f"nothing came for {timeout_s} s") from None
        if isinstance(item, Exception):
            self._ended = item
            raise item
        return item
