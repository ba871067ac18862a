"""The websocket: connects, subscribes, asks, reconnects by itself, and asks for the events that were missed. Runs on one asyncio loop.

It knows two kinds of users only by what they put messages into: `Inbox`, whose two forms are awaited (`aio`) or block (`_blocking`).
"""

from __future__ import annotations

import asyncio
import logging
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias, cast

import msgspec
import numpy as np
from websockets.asyncio.client import ClientConnection
from websockets.asyncio.client import connect as connect_websocket
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.typing import Subprotocol

from ._address import websocket_of
from ._mock import Speed, take_at
from ._schema import EVENT_TOPICS, Hello
from .errors import Disconnected, PosedError, Refused, Unauthorised

_log = logging.getLogger("posed")

PROTOCOL = Subprotocol("posed.v1.msgpack")
RETRY_S = (0.5, 1.0, 2.0, 5.0)
"""How long it waits before it tries again: the last one for ever."""
STAGE_CHANGED = 1012
"""The code with which the daemon closes connections where its stage has changed: the next one waits already."""
STAGE_CHANGED_RETRY_S = 0.05
LATEST = 16
"""So many messages of a subscription wait for who takes too long; as the daemon keeps for a client that reads too slowly."""
QUEUE = 10_000
"""The same where it was asked to keep them (`drop="queue"`)."""
_REFUSED_FOR_GOOD = {
    401: "this daemon wants a token, or does not take this one",
    403: "this daemon takes no connections from here",
    404: "there is no stage or take of this name",
    422: "this take cannot be played",
}

Message: TypeAlias = dict[str, Any]


class Inbox(Protocol):
    """Where a subscription's messages wait for whoever takes them."""

    def put(self, item: Any, most: int | None) -> int:
        """Adds one; of more than `most` the oldest go, and how many did is returned. An exception is raised for who takes it."""


class Subscription:
    """Topics with their options, and where their messages go."""

    def __init__(
        self, topics: Sequence[str], options: Mapping[str, Any], make: Callable[[Message, np.datetime64], Any], inbox: Inbox
    ) -> None:
        self.topics = tuple(topics)
        self.options = {key: value for key, value in options.items() if value is not None}
        self.make = make
        self.inbox = inbox
        self.dropped = 0
        """Messages that were dropped because they were taken too slowly, here; the daemon's own are in the messages."""
        self.last_event = 0
        """The newest event that was put into the inbox."""
        self.most = QUEUE if self.options.get("drop") == "queue" else LATEST
        """So many messages wait; events are never dropped."""

    def put(self, message: Message, epoch_utc: np.datetime64, most: int | None) -> None:
        """Puts what is made of a message into the inbox: nothing where it is None."""
        item = self.make(message, epoch_utc)
        if item is not None:
            self.dropped += self.inbox.put(item, most)


class Link:
    """A connection that lasts."""

    def __init__(self, address: str, token: str | None, reconnect: bool, speed: Speed) -> None:
        self._mock = take_at(address, speed)
        self.url = address if self._mock else websocket_of(address)
        self.hello: Hello | None = None
        self.epoch_utc = np.datetime64(0, "ns")
        self._headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        # A file that is over does not begin again.
        self._reconnect = reconnect and self._mock is None
        self._socket: ClientConnection | None = None
        self._decode = msgspec.msgpack.Decoder().decode
        self._encode = msgspec.msgpack.Encoder().encode
        self._next_id = 1
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        # Weakly, so that an iterator which nobody has any more ends its subscription.
        self._subscriptions: weakref.WeakSet[Subscription] = weakref.WeakSet()
        # Those of the connection, by topic, and with which options.
        self._of_topic: dict[str, list[weakref.ref[Subscription]]] = {}
        self._last_event = 0
        # Events, until those that were asked for are all here: they come in another order.
        self._held: list[Message] | None = None
        self._holding = asyncio.Lock()
        self._greeted = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self._background: set[asyncio.Task[None]] = set()
        self._ended: PosedError | None = None

    async def open(self, timeout_s: float) -> None:
        """Connects; returns once the daemon has said who it is."""
        if self._mock:
            self.url = await self._mock.start()
        self._task = asyncio.create_task(self._stay())
        greeted = asyncio.create_task(self._greeted.wait())
        try:
            done, _ = await asyncio.wait({greeted, self._task}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            greeted.cancel()
        if self._ended:
            raise self._ended
        if greeted not in done:
            await self.close()
            raise Disconnected(f"nobody answers at {self.url}")

    async def close(self) -> None:
        """Ends the connection and what is iterated."""
        self._ended = self._ended or Disconnected("the connection was closed")
        if self._socket:
            await self._socket.close()
        if self._task:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        if self._mock:
            await self._mock.end()
        self._lose(self._ended, for_good=True)

    @property
    def connected(self) -> bool:
        return self._socket is not None

    async def request(self, request: Mapping[str, Any]) -> Any:
        """The `result` of the answer. `Refused` where it is an error, `Disconnected` where none came."""
        socket = self._socket
        if socket is None:
            raise self._ended or Disconnected(f"not connected to {self.url}")
        number, self._next_id = self._next_id, self._next_id + 1
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer
        sent = {key: value for key, value in request.items() if value is not None}
        try:
            await socket.send(self._encode({**sent, "id": number}))
            return await answer
        except ConnectionClosed as error:
            raise Disconnected("the connection broke before the answer") from error
        finally:
            self._waiting.pop(number, None)

    async def subscribe(self, subscription: Subscription, after: int | None = None) -> None:
        """Has the messages of these topics put into its inbox, from now on and after every reconnection.

        A connection gets each topic once: with the same options it may be iterated several times, with others not. With `after` the events after that
        one come first, of the last ten minutes.
        """
        for topic in subscription.topics:
            for other in self._of(topic):
                if other.options != subscription.options:
                    raise ValueError(f"this connection gets `{topic}` with other options already: close that iterator, or open another connection")
        for topic in subscription.topics:
            self._of_topic.setdefault(topic, []).append(weakref.ref(subscription))
        self._subscriptions.add(subscription)
        subscription.last_event = after or 0
        try:
            await self._subscribe([(subscription.options, list(subscription.topics))], after)
        except PosedError:
            self.forget(subscription)
            raise

    async def _subscribe(self, groups: list[tuple[dict[str, Any], list[str]]], after: int | None) -> None:
        """Topics by their options; of events also those after one."""
        if not any(topic in EVENT_TOPICS for _, topics in groups for topic in topics):
            for options, topics in groups:
                await self.request({"type": "subscribe", "topics": topics, **options})
            return
        async with self._holding:
            socket, self._held = self._socket, []
            try:
                for options, topics in groups:
                    await self.request({"type": "subscribe", "topics": topics, **options})
                if after is not None:
                    await self.request({"type": "resume", "after": after})
                # Answers and events come in one order: when this one is answered, all that were asked for are here.
                await self.request({"type": "unsubscribe", "topics": []})
            finally:
                # Where the connection broke meanwhile, the next one asks for them again.
                if socket is self._socket:
                    held, self._held = self._held or [], None
                    for message in sorted(held, key=lambda message: cast(int, message["event_id"])):
                        self._event(message)

    def forget(self, subscription: Subscription) -> None:
        """Ends a subscription; topics that nobody else gets are no longer sent."""
        self._subscriptions.discard(subscription)
        for topic in subscription.topics:
            self._of_topic[topic] = [ref for ref in self._of_topic.get(topic, []) if ref() not in (None, subscription)]
        self._unsubscribe([topic for topic in subscription.topics if not self._of_topic[topic]])

    def _of(self, topic: str) -> list[Subscription]:
        return [one for ref in self._of_topic.get(topic, ()) if (one := ref()) is not None]

    def _unsubscribe(self, topics: list[str]) -> None:
        for topic in topics:
            self._of_topic.pop(topic, None)
        if topics and self._socket:
            self._in_background(self.request({"type": "unsubscribe", "topics": topics}))

    def _in_background(self, work: Any) -> None:
        async def quietly() -> None:
            try:
                await work
            except PosedError as error:
                _log.debug("%s", error)

        task = asyncio.create_task(quietly())
        self._background.add(task)
        task.add_done_callback(self._background.discard)

    async def _stay(self) -> None:
        """Connects again and again, until it is refused for good."""
        attempts = 0
        while True:
            wait_s = RETRY_S[min(attempts, len(RETRY_S) - 1)]
            attempts += 1
            why: PosedError
            refused_for_good = False
            try:
                # The daemon is on this machine or in the same network: no proxy, and no packing, which costs it and us more than it saves.
                async with connect_websocket(
                    self.url, subprotocols=[PROTOCOL], additional_headers=self._headers, compression=None, max_size=None, proxy=None
                ) as socket:
                    try:
                        await self._listen(socket)
                    except ConnectionClosed:
                        pass
                    if self._socket is not None:
                        attempts, wait_s = 1, RETRY_S[0]
                    if socket.close_code == STAGE_CHANGED:
                        wait_s = STAGE_CHANGED_RETRY_S
                    why = Disconnected(socket.close_reason or f"the connection was lost ({socket.close_code})")
            except InvalidStatus as error:
                status = error.response.status_code
                sentence = _REFUSED_FOR_GOOD.get(status)
                refused_for_good = sentence is not None
                why = (Unauthorised if status in (401, 403) else Disconnected)(f"{self.url}: {sentence or f'HTTP {status}'}")
            except (OSError, InvalidHandshake) as error:
                why = Disconnected(f"nobody answers at {self.url}: {error}")
            for_good = refused_for_good or not self._reconnect and self.hello is not None
            self._lose(why, for_good)
            if for_good:
                return
            _log.info("%s; again in %s s", why, wait_s)
            await asyncio.sleep(wait_s)

    def _lose(self, why: PosedError, for_good: bool) -> None:
        self._socket = None
        self._held = None
        for answer in self._waiting.values():
            if not answer.done():
                answer.set_exception(Disconnected("the connection broke before the answer"))
        self._waiting.clear()
        if for_good:
            self._ended = self._ended or why
            for subscription in list(self._subscriptions):
                subscription.inbox.put(self._ended, None)

    async def _listen(self, socket: ClientConnection) -> None:
        decode = self._decode
        while True:
            message = decode(await socket.recv(decode=False))
            kind = message["type"]
            if kind == "ok" or kind == "error":
                self._answer(message)
            elif kind == "hello":
                self._greet(message, socket)
            elif "event_id" in message:
                if self._held is not None:
                    self._held.append(message)
                else:
                    self._event(message)
            else:
                self._deliver(kind, message)

    def _answer(self, message: Message) -> None:
        waiting = self._waiting.get(message.get("id") or 0)
        if waiting is None:
            if message["type"] == "error":
                _log.warning("the daemon says: %s", message["message"])
        elif not waiting.done():
            if message["type"] == "ok":
                waiting.set_result(message.get("result"))
            else:
                waiting.set_exception(Refused(message["code"], message["message"]))

    def _greet(self, message: Message, socket: ClientConnection) -> None:
        before, self.hello = self.hello, cast(Hello, message)
        self._socket = socket
        self.epoch_utc = np.datetime64(message["epoch_utc"].removesuffix("Z"), "ns")
        if before is None:
            self._last_event = message["last_event_id"]
        else:
            # A stage that began anew counts its events from one again.
            if before["epoch_utc"] != message["epoch_utc"] or self._last_event > message["last_event_id"]:
                self._last_event = 0
                for subscription in self._subscriptions:
                    subscription.last_event = 0
            self._in_background(self._again())
        self._greeted.set()

    async def _again(self) -> None:
        """Subscribes on a new connection to what there was on the one before, and gets the events that were missed."""
        groups: list[tuple[dict[str, Any], list[str]]] = []
        for topic in list(self._of_topic):
            users = self._of(topic)
            if not users:
                self._of_topic.pop(topic)
                continue
            same = next((topics for options, topics in groups if options == users[0].options), None)
            if same is None:
                groups.append((users[0].options, [topic]))
            else:
                same.append(topic)
        events = [group for group in groups if group[1][0] in EVENT_TOPICS]
        for some in ([group] for group in groups if group not in events):
            await self._subscribe_or_tell(some, None)
        await self._subscribe_or_tell(events, self._last_event)

    async def _subscribe_or_tell(self, groups: list[tuple[dict[str, Any], list[str]]], after: int | None) -> None:
        try:
            await self._subscribe(groups, after)
        except Refused as refused:
            # A changed stage may have no such sensor any more.
            for subscription in {one for _, topics in groups for topic in topics for one in self._of(topic)}:
                subscription.inbox.put(refused, None)

    def _event(self, message: Message) -> None:
        number = cast(int, message["event_id"])
        self._last_event = max(self._last_event, number)
        for subscription in self._users(message["type"]):
            # The state that each subscription is answered with, and what is asked for again, may have been here before.
            if number > subscription.last_event:
                subscription.last_event = number
                subscription.put(message, self.epoch_utc, None)

    def _deliver(self, topic: str, message: Message) -> None:
        for subscription in self._users(topic):
            subscription.put(message, self.epoch_utc, subscription.most)

    def _users(self, topic: str) -> list[Subscription]:
        users = self._of(topic)
        # Whoever iterated has let go of it.
        if not users and topic in self._of_topic:
            self._unsubscribe([topic])
        return users
