"""The client for programs without `asyncio`: the same connection, on a thread of its own."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine, Iterator, Sequence
from types import TracebackType
from typing import Any, Generic, TypeVar, cast

from . import _subscriptions as wanted
from ._inboxes import BlockingInbox
from ._link import Link, Subscription
from ._linked import Linked
from ._mock import Speed
from ._requests import BlockingRequests
from ._schema import DropPolicy, Field, Job, ServerMessage, Started
from .errors import Disconnected
from .frames import BodyFrame, SensorsFrame

T = TypeVar("T")


class _Loop:
    """An asyncio loop on a thread that ends with the program."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, name="posed", daemon=True)
        self._thread.start()

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        if self.loop.is_closed():
            work.close()
            raise Disconnected("the connection was closed")
        return asyncio.run_coroutine_threadsafe(work, self.loop).result()

    def soon(self, call: Any, *args: Any) -> None:
        if not self.loop.is_closed():
            self.loop.call_soon_threadsafe(call, *args)

    def end(self) -> None:
        if not self.loop.is_closed():
            self.loop.call_soon_threadsafe(self.loop.stop)
            self._thread.join()
            self.loop.close()


class Stream(Iterator[T], Generic[T]):
    """What comes of a subscription, one after the other."""

    def __init__(self, loop: _Loop, link: Link, want: wanted.Wanted[T]) -> None:
        self._loop = loop
        self._link = link
        self._inbox = BlockingInbox()
        self._subscription = Subscription(want.topics, want.options, want.make, self._inbox)
        loop.run(link.subscribe(self._subscription, want.after))

    @property
    def dropped(self) -> int:
        """How many were dropped here because they were taken too slowly; what the daemon dropped is in `message["dropped"]`."""
        return self._subscription.dropped

    def __next__(self) -> T:
        return cast(T, self._inbox.get())

    def get(self, timeout_s: float | None = None) -> T:
        """The next one; `TimeoutError` where none comes in time."""
        return cast(T, self._inbox.get(timeout_s))

    def close(self) -> None:
        """Ends the subscription. So does letting go of the stream."""
        self._loop.soon(self._link.forget, self._subscription)
        self._inbox.put(StopIteration(), None)


class Connection(Linked, BlockingRequests):
    """A connection to a running stage that lasts: it reconnects by itself, and asks for the events that were missed."""

    def __init__(self, address: str, token: str | None, reconnect: bool, timeout_s: float, speed: Speed) -> None:
        self._loop = _Loop()
        try:
            self._link = self._loop.run(_opened(address, token, reconnect, timeout_s, speed))
        except BaseException:
            self._loop.end()
            raise

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Ends the connection; what is iterated ends with `Disconnected`."""
        if not self._loop.loop.is_closed():
            self._loop.run(self._link.close())
            self._loop.end()

    def request(self, request: dict[str, Any]) -> Any:
        return self._loop.run(self._link.request(request))

    def _stream(self, want: wanted.Wanted[T]) -> Stream[T]:
        return Stream(self._loop, self._link, want)

    def sensors(
        self,
        names: Sequence[str] | None = None,
        *,
        fields: Sequence[Field] | None = None,
        max_rate_hz: float | None = None,
        drop: DropPolicy | None = None,
    ) -> Stream[SensorsFrame]:
        """Poses, frame by frame: of all sensors or of some, with what `fields` asks for, at most so often; `drop="queue"` keeps frames for who is slow."""
        return self._stream(wanted.sensors("sensors", names, fields, max_rate_hz, drop))

    def truth(
        self,
        names: Sequence[str] | None = None,
        *,
        fields: Sequence[Field] | None = None,
        max_rate_hz: float | None = None,
        drop: DropPolicy | None = None,
    ) -> Stream[SensorsFrame]:
        """Ground truth in the same form; of simulated stages only."""
        return self._stream(wanted.sensors("truth", names, fields, max_rate_hz, drop))

    def body(self, name: str | None = None, *, max_rate_hz: float | None = None, drop: DropPolicy | None = None) -> Stream[BodyFrame]:
        """Segments and joints, frame by frame: of all bodies, or of one."""
        return self._stream(wanted.body(name, max_rate_hz, drop))

    def events(self, *topics: str, after: int | None = None) -> Stream[ServerMessage]:
        """Events, of all topics that have any or of these; none is lost over a reconnection of less than ten minutes.

        With `after` those after that `event_id` come first (0: all of the last ten minutes).
        """
        return self._stream(wanted.events(topics, self.hello, after))

    def messages(self, *topics: str, drop: DropPolicy | None = None) -> Stream[ServerMessage]:
        """Messages as they come, such as those of `status`, `jobs` and `session`."""
        return self._stream(wanted.messages(topics, drop))

    def wait(self, job: int | Started, timeout_s: float | None = None) -> Job:
        """Waits until a job is over; `JobFailed` where it failed, `TimeoutError` where nothing is heard of it for so long."""
        number = wanted.number_of(job)
        jobs = self.messages("jobs")
        try:
            while True:
                over = wanted.ended(jobs.get(timeout_s), number)
                if over:
                    return over
        finally:
            jobs.close()


async def _opened(address: str, token: str | None, reconnect: bool, timeout_s: float, speed: Speed) -> Link:
    link = Link(address, token, reconnect, speed)
    await link.open(timeout_s)
    return link


def connect(address: str, *, token: str | None = None, reconnect: bool = True, timeout_s: float = 5.0, speed: Speed = 1.0) -> Connection:
    """Connects to a daemon; `with connect(...) as stage` ends it.

    `address` is HOST:PORT, the address of its page, that of a hub's stage or of a take (`http://HOST:8787/takes/NAME/`), or that of a websocket. `timeout_s`: how long
    it tries at first. Without `reconnect` what is iterated ends with the connection.

    A file in its place is played without a daemon: `take.jsonl`, as `posed export take.mcap --to jsonl` writes it, or a recording that holds messages. It begins with the first
    subscription, goes at `speed` (`"max"`: as fast as it can), and what is iterated ends with `Disconnected`.
    """
    return Connection(address, token, reconnect, timeout_s, speed)
