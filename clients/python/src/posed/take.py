"""A recording as columns and data frames.

A recording holds the devices' bytes, and beside them what the pipeline made of these, as columns. One that lacks them (it broke off, or a version before wrote it) is replayed
by the program with `posed export --to columns`; what that writes is kept in `exports/` beside it, where the daemon looks when it forgets a person.
"""

from __future__ import annotations

import csv
import os
import pathlib
import shutil
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeAlias, TypeVar, cast, overload

import numpy as np
import numpy.typing as npt

from ._columns import Coded, Columns
from ._columns import Table as _Columns
from ._mcap import Beginning, begins, columns
from .errors import NoProgram, PosedError

if TYPE_CHECKING:
    import pandas
    import polars
    from matplotlib.figure import Figure

__all__ = ["Table", "Take", "read"]

Table: TypeAlias = dict[str, npt.NDArray[Any]]
"""Columns by name, all of one length."""
F = TypeVar("F")
Make: TypeAlias = Callable[[_Columns], Any]

TABLES = ("sensors", "measured", "body", "events", "labels")


class Take(Generic[F]):
    """What happened in a recording. Times are capture times, s since the stage's epoch; poses are in the room: metres, z up."""

    def __init__(self, path: pathlib.Path, beginning: Beginning, columns: Columns, make: Make) -> None:
        self.path = path
        self._beginning = beginning
        self._columns = columns
        self._make = make
        self._tables: dict[str, _Columns] = {}

    @property
    def stage(self) -> str:
        """Name of the stage."""
        return self._beginning.stage

    @property
    def epoch_utc(self) -> np.datetime64:
        """The stage's epoch, from which times count."""
        return np.datetime64(self._beginning.epoch_utc.removesuffix("Z"), "ns")

    def table(self, name: Literal["sensors", "measured", "body", "events", "labels"]) -> Table:
        """A table as NumPy columns, whatever the frames are."""
        return _numpy(self._table(name))

    def _table(self, name: str) -> _Columns:
        if name not in self._tables:
            self._tables[name] = self._labels() if name == "labels" else getattr(self._columns, name)()
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
        said = {"stage": self.stage, "epoch_utc": self._beginning.epoch_utc}
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

    def _labels(self) -> _Columns:
        spans = list(_labels_beside(self.path, self._columns.frames_s))
        return {
            "from_s": np.array([span[0] for span in spans], dtype=np.float64),
            "to_s": np.array([span[1] for span in spans], dtype=np.float64),
            "label": np.array([span[2] for span in spans], dtype=object),
        }

    def __repr__(self) -> str:
        return f"<Take {self.path.name} of {self.stage}>"


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
    return path.parent / "exports" / f"{path.stem}.columns.mcap"


def _replay(path: pathlib.Path, into: pathlib.Path, program: str | None) -> None:
    """Has the program make the columns."""
    found = program or os.environ.get("POSED") or shutil.which("posed")
    if found is None:
        raise NoProgram(
            f"{path.name} has no columns (it broke off, or a version before these wrote it), and `posed`, which makes them, is not there: install it, give its path as `program` or in the "
            f"variable POSED, or have `posed export {path.name} --to columns -o columns.mcap` made where it is, and read that"
        )
    done = subprocess.run([found, "export", str(path), "--to", "columns", "-o", str(into)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise PosedError(f"{path.name} cannot be read: {done.stderr.strip()}")


def _columns_of(path: pathlib.Path, program: str | None, keep: bool, replay: bool) -> Columns:
    if not replay:
        # What was kept is of the recording as it is, where it is not older.
        kept = _kept_at(path)
        of = kept if kept.exists() and kept.stat().st_mtime_ns >= path.stat().st_mtime_ns else path
        try:
            found = Columns(columns(of))
        except PosedError:
            if of == path:
                raise
            found = Columns(())
        if found.whole:
            return found
    with tempfile.TemporaryDirectory() as folder:
        made = pathlib.Path(folder) / "columns.mcap"
        if keep:
            made = _kept_at(path)
            made.parent.mkdir(exist_ok=True)
        _replay(path, made, program)
        return Columns(columns(made))


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
def read(path: str | os.PathLike[str], *, frames: Literal["pandas"] = ..., program: str | None = ..., keep: bool = ..., replay: bool = ...) -> Take[pandas.DataFrame]: ...
@overload
def read(path: str | os.PathLike[str], *, frames: Literal["polars"], program: str | None = ..., keep: bool = ..., replay: bool = ...) -> Take[polars.DataFrame]: ...
@overload
def read(path: str | os.PathLike[str], *, frames: Literal["numpy"], program: str | None = ..., keep: bool = ..., replay: bool = ...) -> Take[Table]: ...
def read(
    path: str | os.PathLike[str],
    *,
    frames: Literal["pandas", "polars", "numpy"] = "pandas",
    program: str | None = None,
    keep: bool = True,
    replay: bool = False,
) -> Take[Any]:
    """Reads a recording: `read("take.mcap").body` is a data frame.

    `frames`: whose data frames. What it says is what the program that recorded it made of the devices' bytes; with `replay` it is what the present one makes of them. One without columns is
    always replayed. `program` then is the path of `posed`, by default the one of the variable POSED or of PATH; `keep`: whether what it makes is kept in `exports/` beside the recording, and
    read from there the next time.
    """
    makes: dict[str, Make] = {"pandas": _pandas, "polars": _polars, "numpy": _numpy}
    file = pathlib.Path(path)
    return Take(file, begins(file), _columns_of(file, program, keep, replay), makes[frames])
