"""Messages as NumPy arrays. Each array is made when it is first looked at, so that what nobody looks at costs nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from ._schema import FigureMessage, SensorEntry, SensorsMessage, SensorState, TruthEntry, TruthsMessage

__all__ = ["BodyFrame", "SensorsFrame"]

Floats = npt.NDArray[np.float64]

USABLE: frozenset[str] = frozenset(("ok", "repaired", "extrapolated"))
"""States of a sensor whose pose is one to use; the others are there to be seen."""

# The upper triangle of a 6 x 6 matrix, row by row.
_UPPER = np.triu_indices(6)


def rows(entries: Sequence[Mapping[str, Any]], key: str, width: int) -> Floats:
    """A row for each entry; NaN where it has none."""
    found = [entry.get(key) for entry in entries]
    if None in found:
        absent = [np.nan] * width
        found = [absent if row is None else row for row in found]
    return np.array(found, dtype=np.float64).reshape(len(entries), width)


def numbers(entries: Sequence[Mapping[str, Any]], key: str) -> Floats:
    """A number for each entry; NaN where it has none."""
    return np.array([entry.get(key) for entry in entries], dtype=np.float64)


class _Frame:
    """What frames have in common."""

    def __init__(self, message: Any, epoch_utc: np.datetime64) -> None:
        self._message = message
        self._epoch_utc = epoch_utc

    @property
    def t_s(self) -> float:
        """Capture time, s since the stage's epoch."""
        return cast(float, self._message["t_s"])

    @property
    def utc(self) -> np.datetime64:
        """The same as UTC, by the clock of the daemon's computer."""
        return self._epoch_utc + np.timedelta64(round(self.t_s * 1e9), "ns")

    @property
    def seq(self) -> int:
        """Counts the topic's messages to this client; a gap is what was dropped. Begins anew with each connection."""
        return cast(int, self._message["seq"])


class SensorsFrame(_Frame):
    """Poses of all sensors at one time (or those that were asked for), in the room: metres, z up. Rows are in the order of `names`."""

    @property
    def message(self) -> SensorsMessage | TruthsMessage:
        """As it came."""
        return cast("SensorsMessage | TruthsMessage", self._message)

    @property
    def entries(self) -> Sequence[SensorEntry | TruthEntry]:
        """One for each sensor, as it came."""
        return self.message["sensors"]

    @cached_property
    def names(self) -> list[str]:
        """The sensors."""
        return [entry["name"] for entry in self.entries]

    @cached_property
    def states(self) -> list[SensorState]:
        """How far each pose can be trusted."""
        return [entry["state"] for entry in self.entries]

    @cached_property
    def usable(self) -> npt.NDArray[np.bool_]:
        """Which poses are to be used: those whose state is `ok`, `repaired` or `extrapolated`."""
        return np.array([state in USABLE for state in self.states], dtype=np.bool_)

    @cached_property
    def position_m(self) -> Floats:
        """(n, 3): position in the room, m; NaN for a sensor that measures none."""
        return rows(self._message["sensors"], "position_m", 3)

    @cached_property
    def q_room_sensor_wxyz(self) -> Floats:
        """(n, 4): unit quaternion, scalar first, that turns the sensor's coordinates into the room's; NaN where there is none."""
        return rows(self._message["sensors"], "orientation_wxyz", 4)

    @cached_property
    def sigma_m(self) -> Floats:
        """(n,): root mean square of the expected position error, m."""
        return numbers(self._message["sensors"], "sigma_m")

    @cached_property
    def velocity_m_s(self) -> Floats:
        """(n, 3): velocity in the room, m/s; with the field `velocity`."""
        return rows(self._message["sensors"], "velocity_m_s", 3)

    @cached_property
    def angular_velocity_rad_s(self) -> Floats:
        """(n, 3): angular velocity in sensor axes, rad/s; with the field `velocity`."""
        return rows(self._message["sensors"], "angular_velocity_rad_s", 3)

    @cached_property
    def covariance(self) -> Floats:
        """(n, 6, 6): of position in the room, m, and rotation error in sensor axes, rad; with the field `covariance`."""
        upper = rows(self._message["sensors"], "covariance", 21)
        whole = np.empty((len(upper), 6, 6))
        whole[:, _UPPER[0], _UPPER[1]] = upper
        whole[:, _UPPER[1], _UPPER[0]] = upper
        return whole

    def measured(self, key: str, width: int = 3) -> Floats:
        """(n, width): a vector of the raw records in device or sensor axes, such as `specific_force_m_s2`; with the field `measured`."""
        return rows([entry.get("measured") or {} for entry in self._message["sensors"]], key, width)

    def index(self, name: str) -> int:
        """The row of a sensor; `KeyError` where the frame has none of this name."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(f"no sensor {name!r}: there are {', '.join(self.names)}") from None

    def __repr__(self) -> str:
        return f"<SensorsFrame t_s={self.t_s:.6f}: {len(self.names)} sensors>"


class BodyFrame(_Frame):
    """Segments and joints of a body at one time, in the room: metres, z up. Rows are in the order of `segments`."""

    @property
    def message(self) -> FigureMessage:
        """As it came."""
        return cast(FigureMessage, self._message)

    @property
    def name(self) -> str:
        """Which body it is."""
        return self.message["name"]

    @cached_property
    def segments(self) -> list[str]:
        """Names of the segments."""
        return [segment["name"] for segment in self.message["segments"]]

    @cached_property
    def states(self) -> list[str]:
        """How far each segment can be trusted: `ok`, `inferred`, `suspect`, `missing`."""
        return [segment["state"] for segment in self.message["segments"]]

    @cached_property
    def position_m(self) -> Floats:
        """(n, 3): origin of each segment in the room, m; NaN where nothing shows it."""
        return rows(self._message["segments"], "position_m", 3)

    @cached_property
    def q_room_segment_wxyz(self) -> Floats:
        """(n, 4): unit quaternion, scalar first, that turns the segment's coordinates into the room's; NaN where nothing shows it."""
        return rows(self._message["segments"], "orientation_wxyz", 4)

    @cached_property
    def sigma_deg(self) -> Floats:
        """(n,): root mean square of each segment's expected error about an axis, degrees."""
        return numbers(self._message["segments"], "sigma_deg")

    @cached_property
    def angles_deg(self) -> dict[str, float]:
        """All joint angles, degrees, by `JOINT_ANGLE` as in tables (`elbow_r_flexion`); NaN where a segment beside the joint is not known."""
        return {
            f"{joint['name']}_{angle}": np.nan if value is None else value
            for joint in self.message["joints"]
            for angle, value in joint["angles_deg"].items()
        }

    def index(self, segment: str) -> int:
        """The row of a segment; `KeyError` where the body has none of this name."""
        try:
            return self.segments.index(segment)
        except ValueError:
            raise KeyError(f"no segment {segment!r}: there are {', '.join(self.segments)}") from None

    def __repr__(self) -> str:
        return f"<BodyFrame {self.name} t_s={self.t_s:.6f}: {len(self.segments)} segments>"
