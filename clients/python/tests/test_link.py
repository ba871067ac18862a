"""The connection against a daemon that the test plays: requests, refusals, reconnection and resume."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from conftest import Daemon, Peer, run

import posed
from posed import _link
from posed._address import websocket_of


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_link, "RETRY_S", (0.01,))


@pytest.mark.parametrize(
    ("given", "websocket"),
    [
        ("127.0.0.1", "ws://127.0.0.1:8787/ws"),
        ("stage.local:80", "ws://stage.local:80/ws"),
        ("http://hub:8790/hall/", "ws://hub:8790/hall/ws"),
        ("https://hub/takes/a b.mcap/#watch", "wss://hub/takes/a b.mcap/ws"),
        ("wss://hub/ws?token=x", "wss://hub/ws?token=x"),
    ],
)
def test_what_people_type_is_an_address(given: str, websocket: str) -> None:
    assert websocket_of(given) == websocket


def test_what_is_no_address_is_refused() -> None:
    with pytest.raises(ValueError, match="no address"):
        websocket_of("ftp://127.0.0.1")


def test_an_answer_is_a_result_and_an_error_an_exception() -> None:
    async def script(peer: Peer, _: int) -> None:
        await peer.hello()
        request = await peer.ok("record.start", {"name": "a.mcap", "job": 3})
        assert request["name"] == "a.mcap"
        request = await peer.hear()
        # What is not given is not sent.
        assert set(request) == {"type", "id"}
        await peer.say(type="error", id=request["id"], code="busy", message="a recording runs already")
        await peer.stay()

    async def test() -> None:
        async with Daemon(script) as address, posed.aio.connect(address) as stage:
            assert (await stage.record_start(name="a.mcap"))["job"] == 3
            with pytest.raises(posed.Refused, match="runs already") as refused:
                await stage.record_start()
            assert refused.value.code == "busy"

    run(test())


def test_a_job_is_waited_for() -> None:
    jobs = [{"job": 1, "state": "running"}, {"job": 2, "state": "done"}], [{"job": 1, "state": "failed"}]

    async def script(peer: Peer, _: int) -> None:
        await peer.hello()
        await peer.ok("subscribe")
        for seq, some in enumerate(jobs):
            about: dict[str, Any] = {"kind": "field.finish", "message": "too few readings", "progress": None, "remaining_s": None}
            await peer.say(type="jobs", seq=seq, dropped=0, t_s=float(seq), jobs=[{**about, **one} for one in some])
        await peer.stay()

    async def test() -> None:
        async with Daemon(script) as address, posed.aio.connect(address) as stage:
            with pytest.raises(posed.JobFailed, match="too few readings"):
                await stage.wait({"job": 1})

    run(test())


def test_missed_events_come_after_a_reconnection_in_order_and_once() -> None:
    peers: list[Peer] = []

    async def script(peer: Peer, number: int) -> None:
        peers.append(peer)
        await peer.hello(last_event_id=(3, 8)[number])
        await peer.ok("subscribe")
        if number == 0:
            await peer.ok("unsubscribe")
            await peer.mark(4)
            await peer.mark(5)
            await peer.socket.close(1011)
            return
        # The newest state and an event of just now are there before those that were missed.
        await peer.mark(5)
        await peer.mark(9)
        request = await peer.ok("resume", {"complete": True, "last_event_id": 9})
        assert request["after"] == 5
        for event in (6, 7, 8):
            await peer.mark(event)
        await peer.ok("unsubscribe")
        await peer.mark(10)
        await peer.stay()

    async def test() -> None:
        async with Daemon(script) as address, posed.aio.connect(address) as stage:
            events = stage.events("marks")
            found = [(await anext(events)) for _ in range(7)]
            assert [event["event_id"] for event in found] == [4, 5, 6, 7, 8, 9, 10]  # type: ignore[typeddict-item]

    run(test())


def test_a_stage_that_began_anew_gives_its_events_from_the_first() -> None:
    async def script(peer: Peer, number: int) -> None:
        await peer.hello(last_event_id=(40, 2)[number], epoch_utc=f"2026-11-21T10:21:1{number}.000000000Z")
        await peer.ok("subscribe")
        if number == 0:
            await peer.ok("unsubscribe")
            await peer.mark(41)
            await peer.socket.close(1012, "the stage has changed: connect again")
            return
        assert (await peer.ok("resume", {"complete": True, "last_event_id": 2}))["after"] == 0
        await peer.mark(1)
        await peer.mark(2)
        await peer.ok("unsubscribe")
        await peer.stay()

    async def test() -> None:
        async with Daemon(script) as address, posed.aio.connect(address) as stage:
            events = stage.events("marks")
            found = [(await anext(events))["event_id"] for _ in range(3)]  # type: ignore[typeddict-item]
            assert found == [41, 1, 2]
            assert str(stage.epoch_utc).startswith("2026-11-21T10:21:11")

    run(test())


def test_who_lets_go_of_a_stream_unsubscribes_and_options_must_agree() -> None:
    unsubscribed = asyncio.Event()

    async def frames(peer: Peer) -> None:
        for seq in range(10_000):
            await peer.say(type="sensors", seq=seq, dropped=0, t_s=seq * 0.01, sensors=[])
            await asyncio.sleep(0.001)

    async def script(peer: Peer, _: int) -> None:
        await peer.hello()
        request = await peer.ok("subscribe")
        assert (request["max_rate_hz"], request["sensors"]) == (50, ["wand"])
        sending = asyncio.create_task(frames(peer))
        request = await peer.ok("unsubscribe")
        assert request["topics"] == ["sensors"]
        sending.cancel()
        unsubscribed.set()
        await peer.stay()

    async def test() -> None:
        async with Daemon(script) as address, posed.aio.connect(address) as stage:
            async for frame in stage.sensors(["wand"], max_rate_hz=50):
                with pytest.raises(ValueError, match="other options"):
                    await anext(stage.sensors())
                assert frame.position_m.shape == (0, 3)
                break
            await unsubscribed.wait()

    run(test())


def test_who_is_slow_gets_the_newest_and_is_told_how_many_were_dropped() -> None:
    async def script(peer: Peer, _: int) -> None:
        await peer.hello()
        await peer.ok("subscribe")
        for seq in range(100):
            await peer.say(type="sensors", seq=seq, dropped=0, t_s=seq * 0.01, sensors=[])
        await peer.ok("mark")
        await peer.stay()

    async def test() -> None:
        async with Daemon(script) as address, posed.aio.connect(address) as stage:
            frames = await stage.sensors().begin()
            await stage.mark()
            assert (await anext(frames)).seq == 100 - _link.LATEST
            assert frames.dropped == 100 - _link.LATEST

    run(test())


def test_a_request_ends_with_the_connection() -> None:
    async def script(peer: Peer, _: int) -> None:
        await peer.hello()
        await peer.hear()
        await peer.socket.close(1001)

    async def test() -> None:
        async with Daemon(script) as address, posed.aio.connect(address, reconnect=False) as stage:
            with pytest.raises(posed.Disconnected):
                await stage.mark()
            with pytest.raises(posed.Disconnected):
                await anext(stage.sensors())

    run(test())


def test_who_goes_says_goodbye() -> None:
    codes: list[int | None] = []

    async def script(peer: Peer, _: int) -> None:
        await peer.hello()
        await peer.stay()
        codes.append(peer.socket.close_code)

    async def test() -> None:
        async with Daemon(script) as address:
            async with posed.aio.connect(address) as stage:
                frames = stage.events("marks")
            while not codes:
                await asyncio.sleep(0.001)
            with pytest.raises(posed.Disconnected, match="was closed"):
                await anext(frames)

    run(test())
    assert codes == [1000]


def test_a_token_is_shown_and_who_is_not_let_in_does_not_try_again() -> None:
    from websockets.asyncio.server import serve

    asked: list[Any] = []

    async def test() -> None:
        def refuse(connection: Any, request: Any) -> Any:
            asked.append(request.headers.get("Authorization"))
            return connection.respond(401, "give a token")

        async with serve(lambda _: asyncio.sleep(0), "127.0.0.1", 0, process_request=refuse) as server:
            port = server.sockets[0].getsockname()[1]
            with pytest.raises(posed.Unauthorised, match="token"):
                await posed.aio.connect(f"127.0.0.1:{port}", token="secret")

    run(test())
    assert asked == ["Bearer secret"]


def test_nobody_there_is_told_in_time() -> None:
    with pytest.raises(posed.Disconnected, match="nobody answers"):
        posed.connect("127.0.0.1:9", timeout_s=0.2)
