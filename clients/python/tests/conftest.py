"""What the tests run against: messages of a daemon that the tests play, and a running one where POSED_TEST_STAGE names its address."""

from __future__ import annotations

import asyncio
import os
import pathlib
from collections.abc import Callable, Coroutine
from typing import Any

import msgspec
import pytest
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.typing import Subprotocol

decode, encode = msgspec.msgpack.decode, msgspec.msgpack.encode
HELLO = {
    "type": "hello", "version": "0.1.0", "stage": "Played", "epoch_utc": "2026-11-21T10:21:11.425736412Z", "bodies": [], "skeleton": None, "height_m": None,
    "topics": ["sensors", "marks", "jobs"], "sensors": [], "transmitter": {"position_m": [0, 0, 0], "orientation_wxyz": [1, 0, 0, 0]}, "role": "operate",
    "last_event_id": 0,
}


class Daemon:
    """A daemon that does as a test says: `script` gets the number of the connection, from 0."""

    def __init__(self, script: Callable[[Peer, int], Coroutine[Any, Any, None]]) -> None:
        self.script = script
        self.connections = 0
        self.headers: list[Any] = []
        self.server: Server | None = None

    async def __aenter__(self) -> str:
        self.server = await serve(self._meet, "127.0.0.1", 0, subprotocols=[Subprotocol("posed.v1.msgpack")])
        host, port = self.server.sockets[0].getsockname()
        return f"{host}:{port}"

    async def __aexit__(self, *_: Any) -> None:
        assert self.server
        self.server.close()

    async def _meet(self, socket: ServerConnection) -> None:
        number, self.connections = self.connections, self.connections + 1
        assert socket.request
        self.headers.append(socket.request.headers)
        await self.script(Peer(socket), number)


class Peer:
    """One connection, as the daemon sees it."""

    def __init__(self, socket: ServerConnection) -> None:
        self.socket = socket
        self.asked: list[dict[str, Any]] = []

    async def say(self, **message: Any) -> None:
        await self.socket.send(encode(message))

    async def hello(self, **changes: Any) -> None:
        await self.say(**{**HELLO, **changes})

    async def hear(self) -> dict[str, Any]:
        message: dict[str, Any] = decode(await self.socket.recv(decode=False))
        self.asked.append(message)
        return message

    async def ok(self, kind: str, result: Any = None) -> dict[str, Any]:
        """The next request, which must be this one, is answered."""
        request = await self.hear()
        assert request["type"] == kind, request
        await self.say(type="ok", id=request["id"], **({} if result is None else {"result": result}))
        return request

    async def mark(self, number: int) -> None:
        await self.say(type="marks", seq=0, dropped=0, t_s=float(number), event_id=number, t_valid_s=float(number), label="")

    async def stay(self) -> None:
        await self.socket.wait_closed()


@pytest.fixture
def stage_address() -> str:
    """Of a running `posed demo`."""
    address = os.environ.get("POSED_TEST_STAGE")
    if not address:
        pytest.skip("set POSED_TEST_STAGE to HOST:PORT of a running `posed demo`")
    return address


@pytest.fixture(scope="session")
def take(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A recording of a few seconds of it, beside which files may be kept."""
    address, folder = os.environ.get("POSED_TEST_STAGE"), os.environ.get("POSED_TEST_RECORDINGS")
    if not address or not folder or not os.environ.get("POSED"):
        pytest.skip("set POSED_TEST_STAGE, POSED_TEST_RECORDINGS to its folder of recordings and POSED to the program")
    import posed

    with posed.connect(address) as stage:
        # The simulated trackers take their time to boot.
        wand = stage.sensors(["wand"])
        while not wand.get(60).usable[0]:
            pass
        begun = stage.record_start(name="client.mcap")
        bodies = stage.body()
        first = bodies.get(60).t_s
        stage.mark(label="half")
        while bodies.get(60).t_s < first + 2.0:
            pass
        stage.record_stop()
        stage.wait(begun["job"], timeout_s=60)
    path = pathlib.Path(folder) / begun["name"]
    assert path.exists()
    return path


def run(work: Coroutine[Any, Any, None]) -> None:
    """A test of a few messages ends in a moment, or is broken."""
    asyncio.run(asyncio.wait_for(work, 30))
