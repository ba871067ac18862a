"""A take that is played from a file, without a daemon."""

from __future__ import annotations

import asyncio
import json
import pathlib
import time
from typing import Any

import pytest
from websockets.asyncio.client import connect as connect_websocket
from websockets.typing import Subprotocol

import posed


def sensors(t_s: float) -> dict[str, Any]:
    entries = [{"name": name, "device": "flock", "state": "ok", "position_m": [t_s, 0, 0], "orientation_wxyz": [1, 0, 0, 0]} for name in ("left", "wand")]
    return {"type": "sensors", "seq": 7, "dropped": 1, "t_s": t_s, "sensors": entries}


def mark(t_s: float, number: int) -> dict[str, Any]:
    return {"type": "marks", "seq": 0, "dropped": 0, "t_s": t_s, "event_id": number, "t_valid_s": t_s, "label": f"number {number}"}


@pytest.fixture
def take(tmp_path: pathlib.Path) -> str:
    """A second and a half at 100 Hz from 290 s on, with two marks."""
    said = [sensors(290 + 0.01 * n) for n in range(150)]
    said[50:50], said[100:100] = [mark(290.495, 1)], [mark(290.985, 2)]
    path = tmp_path / "walk.jsonl"
    path.write_text("".join(json.dumps(one) + "\n" for one in said))
    return str(path)


def test_it_speaks_as_a_stage_does_at_the_times_of_the_take_and_ends(take: str) -> None:
    began = time.monotonic()
    with posed.connect(take, speed=5) as stage:
        assert (stage.hello["stage"], stage.hello["topics"]) == ("walk", ["sensors", "marks"])
        assert stage.hello["sensors"][1] == {"name": "wand", "device": "flock", "magnetic": True}
        marks = stage.events("marks")
        frames = stage.sensors(["wand"], max_rate_hz=20, drop="queue")
        got = []
        with pytest.raises(posed.Disconnected, match="the take is over"):
            while True:
                got.append(next(frames))
        # Every fifth of 150, but for those before it was subscribed to.
        assert [frame.seq for frame in got] == list(range(len(got))) and 25 < len(got) <= 30
        assert {tuple(frame.names) for frame in got} == {("wand",)} and got[-1].t_s > 291.4
        assert [mark["event_id"] for mark in (marks.get(5), marks.get(5))] == [1, 2]  # type: ignore[typeddict-item]
    assert 0.2 < time.monotonic() - began < 5


def test_what_it_cannot_do_is_refused_and_all_else_goes_on(take: str) -> None:
    async def test() -> None:
        async with posed.aio.connect(take) as stage:
            with pytest.raises(posed.Refused, match=r"only streams.*mark") as refused:
                await stage.mark(label="here")
            assert refused.value.code == "mock"
            frame = await anext(stage.sensors())
            assert frame.names == ["left", "wand"] and frame.seq == 0
            # Whatever else speaks to stages may listen too.
            async with connect_websocket(stage.url, subprotocols=[Subprotocol("posed.v1")]) as socket:
                assert json.loads(await socket.recv())["type"] == "hello"
                await socket.send(json.dumps({"type": "subscribe", "id": 1, "topics": ["sensors"]}))
                assert [json.loads(await socket.recv())["type"] for _ in range(2)] == ["ok", "sensors"]

    asyncio.run(asyncio.wait_for(test(), 30))


def test_files_that_are_none_are_refused_in_words(tmp_path: pathlib.Path, take: str) -> None:
    (tmp_path / "empty.jsonl").write_text("\n")
    (tmp_path / "poem.jsonl").write_text('{"type": "sensors", "t_s": 1}\nroses are red\n')
    (tmp_path / "number.jsonl").write_text("[1]\n")
    (tmp_path / "none.mcap").write_bytes(b"\x89MCAP0\r\n")
    for name, why in (("empty.jsonl", "no message"), ("poem.jsonl", "line 2"), ("number.jsonl", "line 1"), ("none.mcap", "no recording")):
        with pytest.raises(posed.PosedError, match=why):
            posed.connect(str(tmp_path / name))
    with pytest.raises(FileNotFoundError):
        posed.connect(str(tmp_path / "gone.jsonl"))
    with pytest.raises(ValueError, match="speed"):
        posed.connect(take, speed=0)
