"""A take in the place of a stage: messages from a file, at the distances in time at which they came, for programs that are tested without the daemon.

In: a file of messages, `posed export take.mcap --to jsonl` or a recording that holds them. Out: a websocket on this computer that speaks as a stage does, so that the client
needs to know nothing of it. It streams, and refuses every request but those of subscriptions.
"""

from __future__ import annotations

import asyncio
import math
import pathlib
from collections.abc import Callable, Iterator
from typing import Any, Literal, TypeAlias

import msgspec
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from ._mcap import begins, messages
from .errors import PosedError

Speed: TypeAlias = float | Literal["max"]
Message: TypeAlias = dict[str, Any]

FILES = (".jsonl", ".mcap")
MSGPACK, JSON = Subprotocol("posed.v1.msgpack"), Subprotocol("posed.v1")
OVER = "the take is over"
_KNOWN = {"subscribe", "unsubscribe", "resume"}


def take_at(address: str, speed: Speed) -> MockStage | None:
    """What plays the file that an address names; None where it names a daemon."""
    path = pathlib.Path(address)
    return None if "://" in address or path.suffix not in FILES else MockStage(path, speed)


class _Kind(msgspec.Struct):
    """What is looked at in every message before the first is played."""

    type: str
    t_s: float = math.nan


class MockStage:
    """Plays a file to every connection from its beginning, once the client has subscribed."""

    def __init__(self, path: pathlib.Path, speed: Speed) -> None:
        if speed != "max" and not speed > 0:
            raise ValueError(f"a speed is above 0, or 'max': not {speed!r}")
        self._speed = math.inf if speed == "max" else float(speed)
        self._lines = _lines(path)
        self._hello = _greeting(path, self._lines)
        self._server: Server | None = None

    async def start(self) -> str:
        """The address of its websocket."""
        self._server = await serve(self._meet, "127.0.0.1", 0, subprotocols=[MSGPACK, JSON], compression=None)
        host, port = self._server.sockets[0].getsockname()[:2]
        return f"ws://{host}:{port}/ws"

    async def end(self) -> None:
        if self._server:
            self._server.close()
            await self._server.wait_closed()

    async def _meet(self, socket: ServerConnection) -> None:
        try:
            await _Peer(socket, self._hello, self._lines, self._speed).run()
        except ConnectionClosed:
            pass


class _Peer:
    """One client of it."""

    def __init__(self, socket: ServerConnection, hello: Message, lines: Callable[[], Iterator[bytes]], speed: float) -> None:
        self._socket, self._hello, self._lines, self._speed = socket, hello, lines, speed
        packs = socket.subprotocol != JSON
        self._encode: Callable[[Any], bytes] = msgspec.msgpack.encode if packs else msgspec.json.encode
        self._decode: Callable[[Any], Any] = msgspec.msgpack.decode if packs else msgspec.json.decode
        self._wanted: dict[str, _Wanted] = {}

    async def run(self) -> None:
        await self._say(self._hello)
        playing: asyncio.Task[None] | None = None
        try:
            async for data in self._socket:
                await self._answer(self._decode(data))
                if playing is None and self._wanted:
                    playing = asyncio.create_task(self._play())
        finally:
            if playing:
                playing.cancel()

    async def _say(self, message: Message) -> None:
        data = self._encode(message)
        await self._socket.send(data, text=self._socket.subprotocol == JSON)

    async def _answer(self, request: Message) -> None:
        kind, number = request.get("type"), request.get("id")
        if kind not in _KNOWN:
            await self._say({"type": "error", "id": number, "code": "mock", "message": f"a take that is played from a file only streams: it does no {kind!r}"})
            return
        for topic in request.get("topics", ()):
            if kind == "subscribe":
                self._wanted[topic] = _Wanted(request.get("sensors"), request.get("max_rate_hz"))
            else:
                self._wanted.pop(topic, None)
        await self._say({"type": "ok", "id": number})

    async def _play(self) -> None:
        clock = asyncio.get_running_loop().time
        began, first_s = clock(), None
        for line in self._lines():
            message = msgspec.json.decode(line)
            if "t_s" not in message:
                continue
            first_s = message["t_s"] if first_s is None else first_s
            # Also at the highest speed others have their turn.
            await asyncio.sleep(max(0.0, began + (message["t_s"] - first_s) / self._speed - clock()))
            wanted = self._wanted.get(message["type"])
            shown = wanted and wanted.of(message)
            if shown:
                await self._say(shown)
        await self._socket.close(1000, OVER)


class _Wanted:
    """How a client has a topic."""

    def __init__(self, sensors: list[str] | None, max_rate_hz: float | None) -> None:
        self._sensors = sensors
        self._period_s = 1 / max_rate_hz if max_rate_hz else 0.0
        self._due_s = -math.inf
        self._seq = 0

    def of(self, message: Message) -> Message | None:
        """The message as it goes out; None where it is too soon for another. Events are all due."""
        if "event_id" not in message:
            if message["t_s"] < self._due_s:
                return None
            # At the stated rate on average, unless there was a pause.
            following_s = self._due_s + self._period_s
            self._due_s = following_s if following_s > message["t_s"] else message["t_s"] + self._period_s
        if self._sensors is not None and "sensors" in message:
            by_name = {one["name"]: one for one in message["sensors"]}
            message = {**message, "sensors": [by_name[name] for name in self._sensors if name in by_name]}
        message = {**message, "seq": self._seq, "dropped": 0}
        self._seq += 1
        return message


def _lines(path: pathlib.Path) -> Callable[[], Iterator[bytes]]:
    """Reads the messages, as often as it is called."""
    if path.suffix == ".mcap":
        if not begins(path).full:
            raise PosedError(f"{path.name} holds what the devices sent, not messages: `posed export {path.name} --to jsonl -o {path.stem}.jsonl` makes them, and that can be played")
        return lambda: messages(path)

    def lines() -> Iterator[bytes]:
        with path.open("rb") as file:
            yield from (line for line in file if not line.isspace())

    return lines


def _greeting(path: pathlib.Path, lines: Callable[[], Iterator[bytes]]) -> Message:
    """The `hello` in the file, or one that is made of what is in it: exports have none."""
    firsts: dict[str, bytes] = {}
    for number, line in enumerate(lines(), 1):
        try:
            firsts.setdefault(msgspec.json.decode(line, type=_Kind).type, line)
        except msgspec.DecodeError as error:
            raise PosedError(f"{path.name} is no file of messages: line {number}: {error}") from None
    found = {kind: msgspec.json.decode(line) for kind, line in firsts.items()}
    if "hello" in found:
        return {**found["hello"], "last_event_id": 0}
    if not found:
        raise PosedError(f"{path.name} holds no message")
    sensors = found.get("sensors", {}).get("sensors", [])
    return {
        "type": "hello",
        "version": "mock",
        "stage": path.stem,
        "epoch_utc": "1970-01-01T00:00:00.000000000Z",
        "topics": list(found),
        "sensors": [{"name": one["name"], "device": one["device"], "magnetic": one.get("position_m") is not None} for one in sensors],
        "bodies": [],
        "skeleton": None,
        "height_m": None,
        "transmitter": {"position_m": [0.0, 0.0, 0.0], "orientation_wxyz": [1.0, 0.0, 0.0, 0.0]},
        "role": "watch",
        "last_event_id": 0,
    }
