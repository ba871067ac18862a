"""What each kind of iteration subscribes to, and what it makes of messages; the same for both forms of the client."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

import numpy as np

from ._schema import EVENT_TOPICS, DropPolicy, Field, Hello, Job, JobsMessage, ServerMessage, Started
from .errors import JobFailed
from .frames import BodyFrame, SensorsFrame

T = TypeVar("T")
Make = Callable[[dict[str, Any], np.datetime64], Any]


@dataclass(frozen=True)
class Wanted(Generic[T]):
    """A subscription that is still to be made."""

    topics: Sequence[str]
    make: Make
    max_rate_hz: float | None = None
    drop: DropPolicy | None = None
    sensors: Sequence[str] | None = None
    fields: Sequence[Field] | None = None
    after: int | None = None

    @property
    def options(self) -> dict[str, Any]:
        """As `subscribe` has them."""
        return {
            "max_rate_hz": self.max_rate_hz,
            "drop": self.drop,
            "sensors": None if self.sensors is None else list(self.sensors),
            "fields": None if self.fields is None else list(self.fields),
        }


def sensors(
    topic: str, names: Sequence[str] | None, fields: Sequence[Field] | None, max_rate_hz: float | None, drop: DropPolicy | None
) -> Wanted[SensorsFrame]:
    return Wanted((topic,), SensorsFrame, max_rate_hz, drop, names, fields)


def body(name: str | None, max_rate_hz: float | None, drop: DropPolicy | None) -> Wanted[BodyFrame]:
    def make(message: dict[str, Any], epoch_utc: np.datetime64) -> BodyFrame | None:
        return BodyFrame(message, epoch_utc) if name is None or message["name"] == name else None

    return Wanted(("body",), make, max_rate_hz, drop)


def messages(topics: Sequence[str], drop: DropPolicy | None = None, after: int | None = None) -> Wanted[ServerMessage]:
    return Wanted(topics, lambda message, _: message, drop=drop, after=after)


def events(topics: Sequence[str], hello: Hello, after: int | None) -> Wanted[ServerMessage]:
    for topic in topics:
        if topic not in EVENT_TOPICS:
            raise ValueError(f"{topic!r} is no topic of events: there are {', '.join(EVENT_TOPICS)}")
    return messages(topics or [topic for topic in hello["topics"] if topic in EVENT_TOPICS], after=after)


def number_of(job: int | Started) -> int:
    return job if isinstance(job, int) else job["job"]


def ended(message: ServerMessage, number: int) -> Job | None:
    """The job of that number where it is over; `JobFailed` where it failed."""
    for job in cast(JobsMessage, message)["jobs"]:
        if job["job"] == number and job["state"] != "running":
            if job["state"] != "done":
                raise JobFailed(job)
            return job
    return None
