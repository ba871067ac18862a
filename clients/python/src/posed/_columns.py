"""The columns that a recording holds, as tables of arrays.

Layout and meaning are those of the project's docs/recordings.md: blocks of a few seconds, each a MessagePack map of whole numbers that are packed column by column.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import msgspec
import numpy as np
import numpy.typing as npt

UNKNOWN = np.iinfo(np.int32).min
# As messages are rounded: seven digits are enough of all but times.
NUMBER = np.float32
XYZ, WXYZ = "xyz", "wxyz"
TIME = 5
"""Numbers of a row's time and time code, in front of all others."""
MISSING = "missing"
"""The state of what is not there, of sensors and segments alike."""

Ints: TypeAlias = npt.NDArray[np.int32]
Quantity: TypeAlias = tuple[str, float]
"""Name of a column, and its steps to the unit."""


def _vector(names: Iterable[str], steps: float) -> list[Quantity]:
    return [(name, steps) for name in names]


POSE = [*_vector((f"{axis}_m" for axis in XYZ), 1e5), *_vector((f"q{axis}" for axis in WXYZ), 1e6)]
OF_SENSOR: list[Quantity] = [
    *POSE, ("sigma_m", 1e6), *_vector((f"v{axis}_m_s" for axis in XYZ), 1e4), *_vector((f"w{axis}_rad_s" for axis in XYZ), 1e4),
]  # fmt: skip
OF_RECORD = _vector((name.format(axis) for name in ("w{}_rad_s", "f{}_m_s2", "m{}") for axis in XYZ), 1e6)
# Beside these a state, or whether there is a record, and its time.
SENSOR, RECORD = 1 + len(OF_SENSOR), 3 + len(OF_RECORD)


class _Table(msgspec.Struct):
    states: list[str]
    rows: int
    width: int
    values: bytes

    def numbers(self, columns: slice) -> Ints:
        """(columns, rows): packed as planes of bytes, of the differences along each column in zigzag coding."""
        planes = np.frombuffer(self.values, dtype=np.uint8).reshape(4, self.width, self.rows)[:, columns]
        packed = np.ascontiguousarray(np.moveaxis(planes, 0, -1)).view("<u4")[..., 0]
        differences = (packed >> 1).view(np.int32) ^ -(packed & 1).view(np.int32)
        return np.cumsum(differences, axis=1, dtype=np.int32)


class SensorsPart(_Table, tag_field="of", tag="sensors"):
    names: list[str]
    imus: list[str]


class BodyPart(_Table, tag_field="of", tag="body"):
    name: str
    angles: list[str]
    segments: list[str]


class EventsPart(msgspec.Struct, tag_field="of", tag="events"):
    messages: list[str]


class EndPart(msgspec.Struct, tag_field="of", tag="end"):
    pass


Part: TypeAlias = SensorsPart | BodyPart | EventsPart | EndPart


@dataclass(frozen=True)
class Coded:
    """A column of few texts, by their numbers: frames have a type for it that takes an eighth of the memory."""

    texts: list[str]
    codes: npt.NDArray[np.signedinteger[Any]]

    def __len__(self) -> int:
        return len(self.codes)

    def plain(self) -> npt.NDArray[Any]:
        texts: npt.NDArray[Any] = np.array(self.texts, dtype=object)
        plain: npt.NDArray[Any] = texts[self.codes]
        return plain


Table: TypeAlias = dict[str, npt.NDArray[Any] | Coded]


class Columns:
    """What the messages of the channel hold, each table as it is asked for."""

    def __init__(self, messages: Iterable[bytes]) -> None:
        decode = msgspec.msgpack.Decoder(Part).decode
        self._sensors: list[SensorsPart] = []
        self._bodies: dict[str, list[BodyPart]] = {}
        self._events: list[str] = []
        self.whole = False
        """Whether they are of all of the recording."""
        for message in messages:
            match decode(message):
                case SensorsPart() as part:
                    self._sensors.append(part)
                case BodyPart() as part:
                    self._bodies.setdefault(part.name, []).append(part)
                case EventsPart() as part:
                    self._events += part.messages
                case EndPart():
                    self.whole = True

    @cached_property
    def frames_s(self) -> npt.NDArray[np.float64]:
        """Times of the sensors' frames."""
        seconds, micros = _joined(self._sensors, slice(2)) if self._sensors else np.empty((2, 0), np.int32)
        return _seconds(seconds, micros)

    def sensors(self) -> Table:
        if not self._sensors:
            return {"t_s": np.empty(0), "sensor": Coded([], _codes(0)), "state": Coded([], _codes(0)), **{name: np.empty(0, NUMBER) for name, _ in OF_SENSOR}}
        names, states = self._sensors[0].names, self._sensors[0].states
        count = len(names)
        frames = _joined(self._sensors, slice(TIME + SENSOR * count))
        rows = frames.shape[1]
        numbers = frames[TIME:].reshape(count, SENSOR, rows)

        def column(at: int) -> Ints:
            return numbers[:, at].T.ravel()

        table: Table = {"t_s": np.repeat(self.frames_s, count)}
        _add_timecode(table, frames, lambda codes: np.repeat(codes, count))
        table["sensor"] = Coded(names, np.tile(np.arange(count, dtype=np.int16), rows))
        table["state"] = Coded(states, column(0).astype(np.int8))
        return table | {name: _units(column(1 + at), steps) for at, (name, steps) in enumerate(OF_SENSOR)}

    def measured(self) -> Table:
        imus = self._sensors[0].imus if self._sensors else []
        if not imus:
            return {"t_s": np.empty(0), "sensor": Coded([], _codes(0)), **{name: np.empty(0, NUMBER) for name, _ in OF_RECORD}}
        names, count = self._sensors[0].names, len(imus)
        numbers = _joined(self._sensors, slice(-RECORD * count, None)).reshape(count, RECORD, -1)
        there = numbers[:, 0].T == 1
        which = np.array([names.index(imu) for imu in imus], dtype=np.int16)

        def column(at: int) -> Ints:
            found: Ints = numbers[:, at].T[there]
            return found

        table: Table = {"t_s": _seconds(column(1), column(2)), "sensor": Coded(names, which[np.nonzero(there)[1]])}
        return table | {name: _units(column(3 + at), steps) for at, (name, steps) in enumerate(OF_RECORD)}

    def body(self) -> Table:
        each = [_OneBody(parts[0], _joined(parts, slice(None))) for parts in self._bodies.values()]
        if not each:
            return {"t_s": np.empty(0), "body": Coded([], _codes(0))}
        # Rows of several are in the order in which they came.
        order = np.argsort(np.concatenate([one.came for one in each]), kind="stable") if len(each) > 1 else slice(None)
        table: Table = {"t_s": np.concatenate([one.t_s for one in each])[order]}
        _add_timecode(table, np.concatenate([one.times for one in each], axis=1)[:, order], lambda codes: codes)
        names = np.concatenate([np.full(len(one.t_s), at, np.int16) for at, one in enumerate(each)])
        table["body"] = Coded(list(self._bodies), names[order])
        # Bodies with sensors on other segments have further ones.
        for name, fill in {name: fill for one in each for name, fill in one.fills.items()}.items():
            column = np.concatenate([one.columns.get(name, np.full(len(one.t_s), fill)) for one in each])[order]
            table[name] = Coded(each[0].states, column.astype(np.int8)) if name.endswith("_state") else column.astype(NUMBER, copy=False)
        return table

    def events(self) -> Table:
        messages = [json.loads(message) for message in self._events]

        def text(*keys: str) -> npt.NDArray[Any]:
            return np.array([next((one[key] for key in keys if isinstance(one.get(key), str)), "") for one in messages], dtype=object)

        return {
            "t_s": np.array([one["t_s"] for one in messages], dtype=np.float64),
            "t_valid_s": np.array([one["t_valid_s"] for one in messages], dtype=np.float64),
            "event_id": np.array([one["event_id"] for one in messages], dtype=np.int64),
            "topic": text("type"),
            "event": text("event", "phase"),
            "subject": text("subject", "sensor", "body"),
            "label": text("label", "exercise", "cause"),
            "message": np.array(self._events, dtype=object),
        }


class _OneBody:
    """Columns of one body, and what stands in each where another one has it alone."""

    def __init__(self, part: BodyPart, numbers: Ints) -> None:
        self.states = part.states
        self.times = numbers[:TIME]
        self.t_s = _seconds(numbers[0], numbers[1])
        self.came = numbers[TIME]
        self.columns: dict[str, npt.NDArray[Any]] = {}
        self.fills: dict[str, float] = {}
        rest = iter(numbers[TIME + 1 :])
        for angle in part.angles:
            self._add(f"{angle}_deg", _units(next(rest), 1e3), np.nan)
        for segment in part.segments:
            state = next(rest)
            for name, steps in POSE:
                self._add(f"{segment}_{name}", _units(next(rest), steps), np.nan)
            self._add(f"{segment}_state", state, part.states.index(MISSING))

    def _add(self, name: str, column: npt.NDArray[Any], fill: float) -> None:
        self.columns[name], self.fills[name] = column, fill


def _codes(count: int) -> npt.NDArray[np.int16]:
    return np.empty(count, np.int16)


def _joined(parts: Sequence[_Table], columns: slice) -> Ints:
    """Columns of a table, with all rows."""
    return np.concatenate([part.numbers(columns) for part in parts], axis=1)


def _seconds(seconds: Ints, micros: Ints) -> npt.NDArray[np.float64]:
    return (seconds.astype(np.int64) * 1_000_000 + micros) / 1e6


def _units(numbers: Ints, steps: float) -> npt.NDArray[Any]:
    values = numbers / steps
    values[numbers == UNKNOWN] = np.nan
    return values.astype(NUMBER)


def _add_timecode(table: Table, numbers: Ints, spread: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]) -> None:
    """A column of the time code of each row, of a recording that has time code; empty where it was not known."""
    second, frame, drop = numbers[2:TIME]
    if (second == UNKNOWN).all():
        return
    texts = [
        "" if of_day == UNKNOWN else f"{of_day // 3600:02}:{of_day // 60 % 60:02}:{of_day % 60:02}{';' if dropped else ':'}{part // 100:02}.{part % 100:02}"
        for of_day, part, dropped in zip(second.tolist(), frame.tolist(), drop.tolist(), strict=True)
    ]
    distinct = {text: at for at, text in enumerate(dict.fromkeys(texts))}
    table["timecode"] = Coded(list(distinct), spread(np.array([distinct[text] for text in texts], dtype=np.int32)))
