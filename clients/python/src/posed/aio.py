"""The client for `asyncio`: everything of `posed.connect`, awaited.

    async with posed.aio.connect("127.0.0.1:8787") as stage:
        async for body in stage.body(max_rate_hz=100):
            print(body.t_s, body.angles_deg["elbow_r_flexion"])
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Generator, Sequence
from types import TracebackType
from typing import Any, Generic, TypeVar, cast

from . import _subscriptions as wanted
from ._inboxes import AwaitedInbox
from ._link import Link, Subscription
from ._linked import Linked
from ._mock import Speed
from ._requests import AwaitedRequests
from ._schema import DropPolicy, Field, Job, ServerMessage, Started
from .frames import BodyFrame, SensorsFrame

__all__ = ["Connection", "Stream", "connect"]

T = TypeVar("T")


class Stream(AsyncIterator[T], Generic[T]):
    """What comes of a subscription, one after the other. It begins with the first `anext`, or with `begin`."""

    def __init__(self, link: Link, want: wanted.Wanted[T]) -> None:
        self._link = link
        self._inbox = AwaitedInbox()
        self._after = want.after
        self._subscription = Subscription(want.topics, want.options, want.make, self._inbox)
        self._begun = False

    @property
    def dropped(self) -> int:
        """How many were dropped here because they were taken too slowly; what the daemon dropped is in `message["dropped"]`."""
        return self._subscription.dropped

    async def begin(self) -> Stream[T]:
        """Subscribes now."""
        if not self._begun:
            self._begun = True
            await self._link.subscribe(self._subscription, self._after)
        return self

    async def __anext__(self) -> T:
        await self.begin()
        return cast(T, await self._inbox.get())

    async def close(self) -> None:
        """Ends the subscription. So does letting go of the stream."""
        self._link.forget(self._subscription)
        self._inbox.put(StopAsyncIteration(), None)


class Connection(Linked, AwaitedRequests):
    """A connection to a running stage that lasts: it reconnects by itself, and asks for the events that were missed."""

    def __init__(self, address: str, token: str | None, reconnect: bool, timeout_s: float, speed: Speed) -> None:
        self._link = Link(address, token, reconnect, speed)
        self._timeout_s = timeout_s

    def __await__(self) -> Generator[Any, None, Connection]:
        return self.__aenter__().__await__()

    async def __aenter__(self) -> Connection:
        await self._link.open(self._timeout_s)
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        await self.close()

    async def close(self) -> None:
        """Ends the connection; what is iterated ends with `Disconnected`."""
        await self._link.close()

    async def request(self, request: dict[str, Any]) -> Any:
        return await self._link.request(request)

    def sensors(
        self,
        names: Sequence[str] | None = None,
        *,
        fields: Sequence[Field] | None = None,
        max_rate_hz: float | None = None,
        drop: DropPolicy | None = None,
    ) -> Stream[SensorsFrame]:
        """Poses, frame by frame: of all sensors or of some, with what `fields` asks for, at most so often; `drop="queue"` keeps frames for who is slow."""
        return Stream(self._link, wanted.sensors("sensors", names, fields, max_rate_hz, drop))

    def truth(
        self,
        names: Sequence[str] | None = None,
        *,
        fields: Sequence[Field] | None = None,
        max_rate_hz: float | None = None,
        drop: DropPolicy | None = None,
    ) -> Stream[SensorsFrame]:
        """Ground truth in the same form; of simulated stages only."""
        return Stream(self._link, wanted.sensors("truth", names, fields, max_rate_hz, drop))

    def body(self, name: str | None = None, *, max_rate_hz: float | None = None, drop: DropPolicy | None = None) -> Stream[BodyFrame]:
        """Segments and joints, frame by frame: of all bodies, or of one."""
        return Stream(self._link, wanted.body(name, max_rate_hz, drop))

    def events(self, *topics: str, after: int | None = None) -> Stream[ServerMessage]:
        """Events, of all topics that have any or of these; none is lost over a reconnection of less than ten minutes.

        With `after` those after that `event_id` come first (0: all of the last ten minutes).
        """
        return Stream(self._link, wanted.events(topics, self.hello, after))

    def messages(self, *topics: str, drop: DropPolicy | None = None) -> Stream[ServerMessage]:
        """Messages as they come, such as those of `status`, `jobs` and `session`."""
        return Stream(self._link, wanted.messages(topics, drop))

    async def wait(self, job: int | Started) -> Job:
        """Waits until a job is over; `JobFailed` where it failed."""
        number = wanted.number_of(job)
        jobs = self.messages("jobs")
        try:
            async for message in jobs:
                over = wanted.ended(message, number)
                if over:
                    return over
        finally:
            await jobs.close()
        raise AssertionError("a stream ends with an exception")


def connect(address: str, *, token: str | None = None, reconnect: bool = True, timeout_s: float = 5.0, speed: Speed = 1.0) -> Connection:
    """Connects to a daemon: `async with connect(...) as stage`, or `stage = await connect(...)`.

    `address` is HOST:PORT, the address of its page, that of a hub's stage or of a take (`http://HOST:8787/takes/NAME/`), or that of a websocket. `timeout_s`: how long
    it tries at first. Without `reconnect` what is iterated ends with the connection.

    A file in its place is played without a daemon: `take.jsonl`, as `posed export take.mcap --to jsonl` writes it, or a recording that holds messages. It begins with the first
    subscription, goes at `speed` (`"max"`: as fast as it can), and what is iterated ends with `Disconnected`.
    """
    return Connection(address, token, reconnect, timeout_s, speed)
