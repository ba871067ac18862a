"""Messages of a recording gathered into columns, and these as a file."""

from __future__ import annotations

import json
import pathlib
import zipfile
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from ._schema import EVENT_TOPICS

VERSION = 1
"""Of the file's layout."""
STEP = 512
"""Messages that are gathered as lists before they become arrays."""
# As messages are rounded: seven digits are enough of all but times.
NUMBER = np.float32

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]
NO_VEC3: Vec3 = (np.nan,) * 3
NO_VEC4: Vec4 = (np.nan,) * 4


# Only what is gathered: the reader passes over the rest, which is most of it.
class Record(msgspec.Struct, gc=False):
    t_s: float
    angular_velocity_rad_s: Vec3 | None = None
    specific_force_m_s2: Vec3 | None = None
    magnetic_field: Vec3 | None = None


class Sensor(msgspec.Struct, gc=False):
    name: str
    state: str
    position_m: Vec3 | None = None
    orientation_wxyz: Vec4 | None = None
    sigma_m: float | None = None
    velocity_m_s: Vec3 | None = None
    angular_velocity_rad_s: Vec3 | None = None
    measured: Record | None = None


class Sensors(msgspec.Struct, tag="sensors"):
    t_s: float
    sensors: list[Sensor]


class Segment(msgspec.Struct, gc=False):
    name: str
    state: str
    position_m: Vec3 | None = None
    orientation_wxyz: Vec4 | None = None


class Joint(msgspec.Struct, gc=False):
    name: str
    angles_deg: dict[str, float | None]


class Body(msgspec.Struct, tag="body"):
    t_s: float
    name: str
    segments: list[Segment]
    joints: list[Joint]


class Kind(msgspec.Struct):
    type: str


class Xyz(msgspec.Struct, gc=False):
    x: float
    y: float
    z: float
    w: float = 0.0


class Transform(msgspec.Struct, gc=False):
    timestamp: dict[str, int]
    child_frame_id: str
    translation: Xyz
    rotation: Xyz


class Transforms(msgspec.Struct):
    transforms: list[Transform]


class Columns:
    """Arrays by name, and in `header` what is not numbers."""

    def __init__(self, header: dict[str, Any], numbers: dict[str, npt.NDArray[Any]]) -> None:
        self.header = header
        self.numbers = numbers

    def save(self, path: pathlib.Path) -> None:
        """Whole or not at all."""
        beside = path.with_suffix(".part")
        with beside.open("wb") as file:
            header = np.frombuffer(json.dumps(self.header).encode(), dtype=np.uint8)
            np.savez(file, **{"header": header, **self.numbers}, allow_pickle=False)
        beside.replace(path)

    @classmethod
    def load(cls, path: pathlib.Path, identity: str) -> Columns | None:
        """None where it was made of another recording, by another version, or is damaged. Arrays are read when they are looked at."""
        try:
            numbers = np.load(path)
            header = json.loads(numbers["header"].tobytes())
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None
        return cls(header, _Kept(numbers)) if header["identity"] == identity else None


class _Kept(dict[str, npt.NDArray[Any]]):
    """Arrays of a file, each read once."""

    def __init__(self, file: Any) -> None:
        super().__init__()
        self._file = file

    def __missing__(self, name: str) -> npt.NDArray[Any]:
        self[name] = self._file[name]
        return self[name]


class _Names:
    """Numbers for names, in the order in which they come."""

    def __init__(self) -> None:
        self.of: dict[str, int] = {}

    def __getitem__(self, name: str) -> int:
        return self.of.setdefault(name, len(self.of))


class _Growing:
    """A column that is appended to in steps."""

    def __init__(self, dtype: Any, *shape: int) -> None:
        self.shape = shape
        self.dtype = dtype
        self.parts: list[npt.NDArray[Any]] = []

    def extend(self, values: Sequence[Any]) -> None:
        self.parts.append(np.array(values, dtype=self.dtype).reshape(len(values), *self.shape))

    def whole(self) -> npt.NDArray[Any]:
        return np.concatenate(self.parts) if self.parts else np.empty((0, *self.shape), dtype=self.dtype)


def gathered(lines: Iterable[bytes]) -> Columns:
    """Columns of messages, each one as JSON."""
    decode_kind = msgspec.json.Decoder(Kind).decode
    decode_sensors = msgspec.json.Decoder(Sensors).decode
    decode_body = msgspec.json.Decoder(Body).decode
    names, states, bodies, events = _Names(), _Names(), _Names(), []
    angles: dict[str, int] = {}
    segments: dict[str, int] = {}
    sensors_rows = _SensorsRows(names, states)
    body_rows = _BodyRows(bodies, states, angles, segments)
    for line in lines:
        # The type stands in front: most messages are identified by it without a look at the rest.
        if line.startswith(b'{"type":"sensors"'):
            sensors_rows.add(decode_sensors(line))
        elif line.startswith(b'{"type":"body"'):
            body_rows.add(decode_body(line))
        elif decode_kind(line).type in EVENT_TOPICS:
            events.append(json.loads(line))
    # A recording that holds messages has those of an instant by their topics.
    events.sort(key=lambda event: event["event_id"])
    # Names are complete once all rows are.
    numbers = {**sensors_rows.whole(), **body_rows.whole()}
    header = {
        "sensors": list(names.of), "bodies": list(bodies.of), "angles": list(angles), "segments": list(segments), "states": list(states.of), "events": events,
    }
    return Columns(header, numbers)


SHOWN = "shown"
"""State of what a recording shows to viewers: it was good then, and how good is not reported."""


def shown(lines: Iterable[bytes], epoch_ns: int) -> Columns:
    """Columns of the transforms that a recording holds for viewers."""
    decode = msgspec.json.Decoder(Transforms).decode
    names, states, bodies, segments = _Names(), _Names(), _Names(), dict[str, int]()
    sensors_rows, body_rows = _SensorsRows(names, states), _BodyRows(bodies, states, {}, segments)
    for line in lines:
        message = decode(line)
        sensors: list[Sensor] = []
        figures: dict[str, list[Segment]] = {}
        for one in message.transforms:
            at, q = one.translation, one.rotation
            q_wxyz = (q.w, q.x, q.y, q.z)
            whose, slash, name = one.child_frame_id.partition("/")
            if whose == "sensors":
                # An IMU, which measures no position, is shown at the room's origin to the last bit.
                position_m = (at.x, at.y, at.z) if (at.x, at.y, at.z) != (0.0, 0.0, 0.0) else None
                sensors.append(Sensor(name, SHOWN, position_m, q_wxyz))
            elif slash:
                figures.setdefault(whose, []).append(Segment(name, SHOWN, (at.x, at.y, at.z), q_wxyz))
        if message.transforms:
            time = message.transforms[0].timestamp
            t_s = (time["sec"] * 1_000_000_000 + time["nsec"] - epoch_ns) * 1e-9
            if sensors:
                sensors_rows.add(Sensors(t_s, sensors))
            for whose, figure in figures.items():
                body_rows.add(Body(t_s, whose, figure, []))
    numbers = {**sensors_rows.whole(), **body_rows.whole()}
    header = {"sensors": list(names.of), "bodies": list(bodies.of), "angles": [], "segments": list(segments), "states": list(states.of), "events": []}
    return Columns(header, numbers)


class _SensorsRows:
    def __init__(self, names: _Names, states: _Names) -> None:
        self.names, self.states = names, states
        self.waiting: list[Sensors] = []
        self.frames = 0
        self.columns = {
            "sensors_t_s": _Growing(np.float64),
            "sensors_frame": _Growing(np.int32),
            "sensors_sensor": _Growing(np.int16),
            "sensors_state": _Growing(np.int8),
            "sensors_position_m": _Growing(NUMBER, 3),
            "sensors_orientation_wxyz": _Growing(NUMBER, 4),
            "sensors_sigma_m": _Growing(NUMBER),
            "sensors_velocity_m_s": _Growing(NUMBER, 3),
            "sensors_angular_velocity_rad_s": _Growing(NUMBER, 3),
            "measured_t_s": _Growing(np.float64),
            "measured_sensor": _Growing(np.int16),
            "measured_angular_velocity_rad_s": _Growing(NUMBER, 3),
            "measured_specific_force_m_s2": _Growing(NUMBER, 3),
            "measured_magnetic_field": _Growing(NUMBER, 3),
        }

    def add(self, message: Sensors) -> None:
        self.waiting.append(message)
        if len(self.waiting) == STEP:
            self.settle()

    def settle(self) -> None:
        waiting, self.waiting = self.waiting, []
        column = self.columns
        column["sensors_t_s"].extend([message.t_s for message in waiting])
        column["sensors_frame"].extend([self.frames + at for at, message in enumerate(waiting) for _ in message.sensors])
        self.frames += len(waiting)
        rows = [sensor for message in waiting for sensor in message.sensors]
        column["sensors_sensor"].extend([self.names[row.name] for row in rows])
        column["sensors_state"].extend([self.states[row.state] for row in rows])
        column["sensors_position_m"].extend([row.position_m or NO_VEC3 for row in rows])
        column["sensors_orientation_wxyz"].extend([row.orientation_wxyz or NO_VEC4 for row in rows])
        column["sensors_sigma_m"].extend([row.sigma_m for row in rows])
        column["sensors_velocity_m_s"].extend([row.velocity_m_s or NO_VEC3 for row in rows])
        column["sensors_angular_velocity_rad_s"].extend([row.angular_velocity_rad_s or NO_VEC3 for row in rows])
        # Records of an IMU, with its own time.
        raw = [(row.name, row.measured) for row in rows if row.measured and row.measured.angular_velocity_rad_s]
        column["measured_t_s"].extend([record.t_s for _, record in raw])
        column["measured_sensor"].extend([self.names[name] for name, _ in raw])
        column["measured_angular_velocity_rad_s"].extend([record.angular_velocity_rad_s for _, record in raw])
        column["measured_specific_force_m_s2"].extend([record.specific_force_m_s2 or NO_VEC3 for _, record in raw])
        column["measured_magnetic_field"].extend([record.magnetic_field or NO_VEC3 for _, record in raw])

    def whole(self) -> dict[str, npt.NDArray[Any]]:
        self.settle()
        return {name: column.whole() for name, column in self.columns.items()}


class _BodyRows:
    def __init__(self, bodies: _Names, states: _Names, angles: dict[str, int], segments: dict[str, int]) -> None:
        self.bodies, self.states, self.angles, self.segments = bodies, states, angles, segments
        self.waiting: list[Body] = []
        self.parts: list[tuple[int, dict[str, npt.NDArray[Any]]]] = []

    def add(self, message: Body) -> None:
        self.waiting.append(message)
        if len(self.waiting) == STEP:
            self.settle()

    def settle(self) -> None:
        waiting, self.waiting = self.waiting, []
        for message in waiting:
            # Bodies with sensors on other segments have further ones.
            for segment in message.segments:
                self.segments.setdefault(segment.name, len(self.segments))
            for joint in message.joints:
                for angle in joint.angles_deg:
                    self.angles.setdefault(f"{joint.name}_{angle}", len(self.angles))
        rows, missing = len(waiting), self.states["missing"]
        part: dict[str, npt.NDArray[Any]] = {
            "body_t_s": np.array([message.t_s for message in waiting], dtype=np.float64),
            "body_body": np.array([self.bodies[message.name] for message in waiting], dtype=np.int16),
            "body_angles_deg": np.full((rows, len(self.angles)), np.nan, dtype=NUMBER),
            "body_position_m": np.full((rows, len(self.segments), 3), np.nan, dtype=NUMBER),
            "body_orientation_wxyz": np.full((rows, len(self.segments), 4), np.nan, dtype=NUMBER),
            "body_state": np.full((rows, len(self.segments)), missing, dtype=np.int8),
        }
        for row, message in enumerate(waiting):
            at = [self.segments[segment.name] for segment in message.segments]
            part["body_position_m"][row, at] = [segment.position_m or NO_VEC3 for segment in message.segments]
            part["body_orientation_wxyz"][row, at] = [segment.orientation_wxyz or NO_VEC4 for segment in message.segments]
            part["body_state"][row, at] = [self.states[segment.state] for segment in message.segments]
            for joint in message.joints:
                for angle, value in joint.angles_deg.items():
                    if value is not None:
                        part["body_angles_deg"][row, self.angles[f"{joint.name}_{angle}"]] = value
        self.parts.append((rows, part))

    def whole(self) -> dict[str, npt.NDArray[Any]]:
        self.settle()
        names = self.parts[0][1]
        rows = sum(count for count, _ in self.parts)
        found = {}
        for name in names:
            newest = self.parts[-1][1][name]
            fill = self.states["missing"] if newest.dtype == np.int8 else np.nan if newest.dtype == NUMBER else 0
            column = np.full((rows, *newest.shape[1:]), fill, dtype=newest.dtype)
            begun = 0
            for count, part in self.parts:
                # Earlier parts may know fewer segments.
                column[(slice(begun, begun + count), *(slice(length) for length in part[name].shape[1:]))] = part[name]
                begun += count
            found[name] = column
        return found
