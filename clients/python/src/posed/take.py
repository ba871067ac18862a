"""A recording as columns and data frames.

A recording holds the devices' bytes, not poses: these follow from it by the pipeline, which is the program `posed`'s. So the first `read` of a recording has
`posed export` make its messages anew, which takes as long as a replay, and keeps their columns in `exports/` beside it, where the daemon looks when it
forgets a person. Every further `read` takes a moment. A recording with all messages (`[recording] content = "full"`, `posed export --to mcap`) is read
without the program.
"""

from __future__ import annotations

import csv
import json
import os
import pathlib
import shutil
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeAlias, TypeVar, cast, overload

import numpy as np
import numpy.typing as npt

from ._columns import VERSION, Columns, gathered, shown
from .errors import NoProgram, PosedError

if TYPE_CHECKING:
    import pandas
    import polars
    from matplotlib.figure import Figure

__all__ = ["Table", "Take", "read"]

Table: TypeAlias = dict[str, npt.NDArray[Any]]
"""Columns by name, all of one length."""
F = TypeVar("F")


@dataclass(frozen=True)
class Coded:
    """A column of few texts, by their numbers: frames have a type for it that takes an eighth of the memory."""

    texts: list[str]
    codes: npt.NDArray[np.signedinteger[Any]]

    def plain(self) -> npt.NDArray[Any]:
        texts: npt.NDArray[Any] = np.array(self.texts, dtype=object)
        return cast(npt.NDArray[Any], texts[self.codes])


_Columns: TypeAlias = dict[str, npt.NDArray[Any] | Coded]
Make: TypeAlias = Callable[[_Columns], Any]

XYZ, WXYZ = "xyz", "wxyz"
TABLES = ("sensors", "measured", "body", "events", "labels")


class Take(Generic[F]):
    """What happened in a recording. Times are capture times, s since the stage's epoch; poses are in the room: metres, z up."""

    def __init__(self, path: pathlib.Path, columns: Columns, make: Make) -> None:
        self.path = path
        self._columns = columns
        self._make = make
        self._tables: dict[str, _Columns] = {}

    @property
    def stage(self) -> str:
        """Name of the stage."""
        return cast(str, self._columns.header["stage"])

    @property
    def epoch_utc(self) -> np.datetime64:
        """The stage's epoch, from which times count."""
        return np.datetime64(self._columns.header["epoch_utc"].removesuffix("Z"), "ns")

    def table(self, name: Literal["sensors", "measured", "body", "events", "labels"]) -> Table:
        """A table as NumPy columns, whatever the frames are."""
        return _numpy(self._table(name))

    def _table(self, name: str) -> _Columns:
        if name not in self._tables:
            self._tables[name] = getattr(self, f"_{name}")()
        return self._tables[name]

    @property
    def sensors(self) -> F:
        """A row for each sensor in each frame: `t_s`, `sensor`, `state`, position `x_m` to `z_m`, quaternion from sensor to room `qw` to `qz`, `sigma_m`, velocities.

        Poses to use are those whose state is `ok`, `repaired` or `extrapolated`.
        """
        return cast(F, self._make(self._table("sensors")))

    @property
    def measured(self) -> F:
        """A row for each raw record of an IMU: `t_s`, `sensor`, and in its own axes angular velocity, specific force and magnetic field."""
        return cast(F, self._make(self._table("measured")))

    @property
    def body(self) -> F:
        """A row for each body in each frame: `t_s`, `body`, `JOINT_ANGLE_deg`, and of each segment position, quaternion from segment to room, and state."""
        return cast(F, self._make(self._table("body")))

    @property
    def events(self) -> F:
        """A row for each event: `t_s`, the capture time that it speaks of (`t_valid_s`), `event_id`, `topic`, `event`, `subject`, `label`, and all of it as JSON."""
        return cast(F, self._make(self._table("events")))

    @property
    def labels(self) -> F:
        """What somebody has said that it shows, from the file of labels beside it: `from_s`, `to_s`, `label`."""
        return cast(F, self._make(self._table("labels")))

    def plot(self, *columns: str) -> Figure:
        """Curves of columns of `body` (`elbow_r_flexion_deg`), or by `SENSOR.COLUMN` of `sensors` (`wand.x_m`), with events and labels; without any the likeliest."""
        from ._plot import plot

        return plot(self, columns)

    def write_parquet(self, folder: str | os.PathLike[str]) -> pathlib.Path:
        """Writes each table as a Parquet file of its name, `body.parquet` and so on, zipped with Zstandard; the folder. Needs polars.

        Every file has `stage` and `epoch_utc`, from which `t_s` counts, in its metadata.
        """
        into = pathlib.Path(folder)
        into.mkdir(parents=True, exist_ok=True)
        said = {"stage": self.stage, "epoch_utc": self._columns.header["epoch_utc"]}
        for name in TABLES:
            _polars(self._table(name)).write_parquet(into / f"{name}.parquet", compression="zstd", metadata=said)
        return into

    def write_bids(
        self,
        root: str | os.PathLike[str],
        *,
        subject: str,
        task: str,
        session: str | None = None,
        run: int | None = None,
        body: str | None = None,
    ) -> pathlib.Path:
        """Adds it to a data set of Motion-BIDS at `root`, which it begins where there is none; the folder of its files. Needs polars.

        `subject`, `task` and `session` are labels of BIDS, letters and digits. The solved body, the poses of sensors and the IMUs' own measurements are tracking systems of their own; marks, labels and
        repetitions are its events. Of several bodies `body` says whose it is.
        """
        from ._bids import write

        return write(self, pathlib.Path(root), subject, task, session, run, body)

    def _sensors(self) -> _Columns:
        found, names = self._columns.numbers, self._columns.header["sensors"]
        table: _Columns = {
            "t_s": found["sensors_t_s"][found["sensors_frame"]],
            "sensor": Coded(names, found["sensors_sensor"]),
            "state": Coded(self._columns.header["states"], found["sensors_state"]),
        }
        _spread(table, found["sensors_position_m"], [f"{axis}_m" for axis in XYZ])
        _spread(table, found["sensors_orientation_wxyz"], [f"q{axis}" for axis in WXYZ])
        table["sigma_m"] = found["sensors_sigma_m"]
        _spread(table, found["sensors_velocity_m_s"], [f"v{axis}_m_s" for axis in XYZ])
        _spread(table, found["sensors_angular_velocity_rad_s"], [f"w{axis}_rad_s" for axis in XYZ])
        return table

    def _measured(self) -> _Columns:
        found, names = self._columns.numbers, self._columns.header["sensors"]
        table: _Columns = {"t_s": found["measured_t_s"], "sensor": Coded(names, found["measured_sensor"])}
        _spread(table, found["measured_angular_velocity_rad_s"], [f"w{axis}_rad_s" for axis in XYZ])
        _spread(table, found["measured_specific_force_m_s2"], [f"f{axis}_m_s2" for axis in XYZ])
        _spread(table, found["measured_magnetic_field"], [f"m{axis}" for axis in XYZ])
        return table

    def _body(self) -> _Columns:
        found, header = self._columns.numbers, self._columns.header
        table: _Columns = {"t_s": found["body_t_s"], "body": Coded(header["bodies"], found["body_body"])}
        _spread(table, found["body_angles_deg"], [f"{angle}_deg" for angle in header["angles"]])
        for at, segment in enumerate(header["segments"]):
            _spread(table, found["body_position_m"][:, at], [f"{segment}_{axis}_m" for axis in XYZ])
            _spread(table, found["body_orientation_wxyz"][:, at], [f"{segment}_q{axis}" for axis in WXYZ])
            table[f"{segment}_state"] = Coded(header["states"], found["body_state"][:, at])
        return table

    def _events(self) -> _Columns:
        messages = self._columns.header["events"]

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
            "message": np.array([json.dumps(one) for one in messages], dtype=object),
        }

    def _labels(self) -> _Columns:
        spans = list(_labels_beside(self.path, cast(npt.NDArray[np.float64], self._columns.numbers["sensors_t_s"])))
        return {
            "from_s": np.array([span[0] for span in spans], dtype=np.float64),
            "to_s": np.array([span[1] for span in spans], dtype=np.float64),
            "label": np.array([span[2] for span in spans], dtype=object),
        }

    def __repr__(self) -> str:
        return f"<Take {self.path.name} of {self.stage}>"


def _spread(table: _Columns, values: npt.NDArray[Any], names: list[str]) -> None:
    for at, name in enumerate(names):
        table[name] = values[:, at]


def _labels_beside(path: pathlib.Path, frames_s: npt.NDArray[np.float64]) -> Iterator[tuple[float, float, str]]:
    """From `TAKE.labels.csv` or, where there is none, `TAKE.eaf`, whose times count from the take's first frame."""
    if len(frames_s) == 0:
        return
    by_frame, annotated = path.with_suffix(".labels.csv"), path.with_suffix(".eaf")
    if by_frame.exists():
        with by_frame.open(encoding="utf-8", newline="") as file:
            said = [row["label"] for row in csv.DictReader(line for line in file if not line.startswith("#"))]
        begun = 0
        for at in range(1, len(said) + 1):
            if at == len(said) or said[at] != said[begun]:
                if said[begun]:
                    last = min(at, len(frames_s) - 1)
                    yield float(frames_s[min(begun, last)]), float(frames_s[last]), said[begun]
                begun = at
    elif annotated.exists():
        root = ET.parse(annotated).getroot()
        slots = {one.get("TIME_SLOT_ID"): float(one.get("TIME_VALUE", "nan")) * 1e-3 for one in root.iter("TIME_SLOT")}
        tiers = root.findall("TIER")
        tier = next((one for one in tiers if one.get("TIER_ID") == "segments"), tiers[0] if tiers else None)
        for one in [] if tier is None else tier.iter("ALIGNABLE_ANNOTATION"):
            span = slots[one.get("TIME_SLOT_REF1")], slots[one.get("TIME_SLOT_REF2")]
            yield float(frames_s[0] + span[0]), float(frames_s[0] + span[1]), one.findtext("ANNOTATION_VALUE") or ""


def _kept_at(path: pathlib.Path) -> pathlib.Path:
    return path.parent / "exports" / f"{path.stem}.columns.npz"


def _identity(path: pathlib.Path) -> str:
    about = path.stat()
    return f"{VERSION} {about.st_size} {about.st_mtime_ns}"


def _exported(path: pathlib.Path, program: str | None) -> Columns:
    """What follows from the bytes, by the program."""
    found = program or os.environ.get("POSED") or shutil.which("posed")
    if found is None:
        raise NoProgram(
            f"{path.name} holds what the devices sent, and `posed`, which makes poses of it, is not there: install it, give its path as `program` or in the variable POSED, read(..., preview=True), "
            f"or have `posed export {path.name} --to mcap -o full.mcap` made where it is, and read that"
        )
    with tempfile.TemporaryDirectory() as folder:
        lines = pathlib.Path(folder) / "messages.jsonl"
        done = subprocess.run([found, "export", str(path), "--to", "jsonl", "-o", str(lines)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise PosedError(f"{path.name} cannot be read: {done.stderr.strip()}")
        with lines.open("rb") as file:
            return gathered(file)


def _columns_of(path: pathlib.Path, program: str | None, keep: bool) -> Columns:
    from ._mcap import begins, messages

    identity, kept = _identity(path), _kept_at(path)
    if keep and kept.exists():
        columns = Columns.load(kept, identity)
        if columns is not None:
            return columns
    beginning = begins(path)
    columns = gathered(messages(path)) if beginning.full else _exported(path, program)
    columns.header |= {"stage": beginning.stage, "epoch_utc": beginning.epoch_utc, "identity": identity}
    if keep:
        kept.parent.mkdir(exist_ok=True)
        columns.save(kept)
    return columns


def _preview(path: pathlib.Path) -> Columns:
    from ._mcap import begins, transforms

    beginning = begins(path)
    epoch_ns = int(np.datetime64(beginning.epoch_utc.removesuffix("Z"), "ns").astype(np.int64))
    columns = shown(transforms(path), epoch_ns)
    columns.header |= {"stage": beginning.stage, "epoch_utc": beginning.epoch_utc}
    return columns


def _numpy(table: _Columns) -> Table:
    return {name: values.plain() if isinstance(values, Coded) else values for name, values in table.items()}


def _pandas(table: _Columns) -> Any:
    import pandas as pd

    def column(values: npt.NDArray[Any] | Coded) -> Any:
        return pd.Categorical.from_codes(values.codes, pd.Index(values.texts)) if isinstance(values, Coded) else values

    return pd.DataFrame({name: column(values) for name, values in table.items()}, copy=False)


def _polars(table: _Columns) -> Any:
    import polars as pl

    def column(values: npt.NDArray[Any] | Coded) -> Any:
        if isinstance(values, Coded):
            return pl.Series(values.texts, dtype=pl.Enum(values.texts)).gather(pl.Series(values.codes, dtype=pl.UInt32))
        return pl.Series(values.tolist(), dtype=pl.String) if values.dtype == object else np.ascontiguousarray(values)

    return pl.DataFrame({name: column(values) for name, values in table.items()})


@overload
def read(path: str | os.PathLike[str], *, frames: Literal["pandas"] = ..., program: str | None = ..., keep: bool = ..., preview: bool = ...) -> Take[pandas.DataFrame]: ...
@overload
def read(path: str | os.PathLike[str], *, frames: Literal["polars"], program: str | None = ..., keep: bool = ..., preview: bool = ...) -> Take[polars.DataFrame]: ...
@overload
def read(path: str | os.PathLike[str], *, frames: Literal["numpy"], program: str | None = ..., keep: bool = ..., preview: bool = ...) -> Take[Table]: ...
def read(
    path: str | os.PathLike[str],
    *,
    frames: Literal["pandas", "polars", "numpy"] = "pandas",
    program: str | None = None,
    keep: bool = True,
    preview: bool = False,
) -> Take[Any]:
    """Reads a recording: `read("take.mcap").body` is a data frame.

    `frames`: whose data frames; `program`: the path of `posed`, by default the one of the variable POSED or of PATH, which makes the poses where the recording
    holds only what devices sent; `keep`: whether the columns are kept in `exports/` beside it, so that the next time takes a moment. With `preview` it is what the
    recording shows to viewers: where good sensors and segments were, five times a second, without joint angles and events, at once and without the program.
    """
    makes: dict[str, Make] = {"pandas": _pandas, "polars": _polars, "numpy": _numpy}
    file = pathlib.Path(path)
    return Take(file, _preview(file) if preview else _columns_of(file, program, keep), makes[frames])
