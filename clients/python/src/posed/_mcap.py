"""What an MCAP recording says of itself in front, and its messages where it holds them."""

from __future__ import annotations

import datetime
import os
import pathlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Header, Metadata
from mcap.stream_reader import StreamReader

from .errors import PosedError

MAGIC = b"\x89MCAP0\r\n"
"""What stands at both ends of the format."""
TOPIC = "/posed/"


@dataclass(frozen=True)
class Beginning:
    """The front part of a recording."""

    stage: str
    epoch_utc: str
    full: bool


def begins(path: pathlib.Path) -> Beginning:
    """Reads the front part; `PosedError` where it is no recording of posed."""
    try:
        with path.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, Header) and record.profile not in ("", "posed"):
                    break
                if isinstance(record, Metadata) and record.name == "posed":
                    about = record.metadata
                    seconds, rest = divmod(int(about["epoch_utc_ns"]), 1_000_000_000)
                    utc = datetime.datetime.fromtimestamp(seconds, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S")
                    return Beginning(about["stage"], f"{utc}.{rest:09d}Z", about.get("content", "full") == "full")
    except McapError as error:
        raise PosedError(f"{path.name} is no recording: {error}") from error
    raise PosedError(f"{path.name} is no recording of posed")


def messages(path: pathlib.Path) -> Iterator[bytes]:
    """The messages of a recording that holds them, as JSON."""
    return _of(path, lambda topic: topic.startswith(TOPIC))


def columns(path: pathlib.Path) -> Iterator[bytes]:
    """The blocks of its columns; none of one that broke off, whose last ones are missing."""
    with path.open("rb") as file:
        file.seek(-min(len(MAGIC), path.stat().st_size), os.SEEK_END)
        is_whole = file.read() == MAGIC
    if is_whole:
        try:
            yield from _of(path, lambda topic: topic == "/columns")
        except McapError as error:
            raise PosedError(f"{path.name} cannot be read: {error}") from error


def _of(path: pathlib.Path, wanted: Callable[[str], bool]) -> Iterator[bytes]:
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        # By its index, where it was ended in order.
        topics = None if summary is None else [one.topic for one in summary.channels.values() if wanted(one.topic)]
        for _, channel, message in reader.iter_messages(topics):
            if wanted(channel.topic):
                yield message.data
