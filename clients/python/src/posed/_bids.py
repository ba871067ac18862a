"""A take as Motion-BIDS (BIDS 1.10, Motion): the solved body, poses and IMUs as tracking systems of one recording of one subject.

In: the columns of a take. Out: files below the root of a data set, which begins with the first of them. A tracking system has one clock, so IMUs that do not measure at the same instants are
systems of their own. Every system has a channel LATENCY with the capture times, s from its first sample; `scans.tsv` has when that was, so that systems can be laid over one another.
"""

from __future__ import annotations

import csv
import json
import pathlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from .errors import PosedError
from .frames import USABLE

if TYPE_CHECKING:
    from .take import Take

Floats = npt.NDArray[Any]
MISSING = "n/a"
DATASET = {"BIDSVersion": "1.10.0", "DatasetType": "raw"}
XYZ = "xyz"
QUATERNION = {"quat_x": "qx", "quat_y": "qy", "quat_z": "qz", "quat_w": "qw"}
# Channels that a sidecar counts.
COUNTED = ("ACCEL", "ANGACCEL", "GYRO", "JNTANG", "LATENCY", "MAGN", "MISC", "ORNT", "POS", "VEL")
FRAMES = {
    "room": "The stage's room: x and y level, z up, right-handed; quaternions turn from the tracked point's own axes to it. x is east only where the stage was set up so.",
    "sensor": "The axes of the sensor's housing. Acceleration is specific force: 9.81 upwards at rest.",
}


@dataclass
class System:
    """A tracking system: channels that were sampled together."""

    name: str
    t_s: Floats
    rows: list[dict[str, str]] = field(default_factory=list)
    values: list[Floats] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.add("latency", MISSING, "LATENCY", MISSING, "s", MISSING, self.t_s - self.t_s[0])

    def add(self, name: str, component: str, kind: str, point: str, units: str, frame: str, values: Floats) -> None:
        self.rows.append({"name": name, "component": component, "type": kind, "tracked_point": point, "units": units, "reference_frame": frame})
        self.values.append(values)

    def place(self, point: str, columns: Mapping[str, Floats], prefix: str, usable: npt.NDArray[np.bool_]) -> None:
        """Position, where there is any, and orientation in the room; what is not usable is missing."""
        for axis in XYZ:
            values = np.where(usable, columns[f"{prefix}{axis}_m"], np.nan)
            if np.isfinite(values).any():
                self.add(f"{point}_pos_{axis}", axis, "POS", point, "m", "room", values)
        for component, column in QUATERNION.items():
            values = np.where(usable, columns[f"{prefix}{column}"], np.nan)
            if np.isfinite(values).any():
                self.add(f"{point}_{component}", component, "ORNT", point, MISSING, "room", values)

    @property
    def rate_hz(self) -> tuple[float, float]:
        """Nominal and effective."""
        steps_s = np.diff(self.t_s)
        return float(np.round(1 / np.median(steps_s), 1)), float(np.round((len(self.t_s) - 1) / (self.t_s[-1] - self.t_s[0]), 4))


def write(take: Take[Any], root: pathlib.Path, subject: str, task: str, session: str | None, run: int | None, body: str | None) -> pathlib.Path:
    for name, label in (("subject", subject), ("task", task), ("session", session or "a")):
        if not re.fullmatch("[0-9A-Za-z]+", label):
            raise ValueError(f"{name} {label!r}: BIDS takes letters and digits alone")
    if run is not None and run < 1:
        raise ValueError(f"run {run}: runs are counted from 1")
    systems = [system for system in _systems(take, body) if len(system.rows) > 1]
    if not systems:
        raise PosedError(f"{take.path.name} has nothing that Motion-BIDS could hold: neither a body, nor poses that are good, nor IMUs")
    parts = [f"sub-{subject}", *([f"ses-{session}"] if session else [])]
    above = root.joinpath(*parts)
    folder = above / "motion"
    named = "_".join([*parts, f"task-{task}"])
    ending = f"_run-{run:02}" if run else ""
    if any(folder.glob(f"{named}_tracksys-*{ending}_motion.tsv")):
        raise FileExistsError(f"{folder} has {named}{ending} already: give another task or run, or remove it")
    folder.mkdir(parents=True, exist_ok=True)
    _begin(root, take.stage, subject)
    scans = []
    for system in systems:
        stem = f"{named}_tracksys-{system.name}{ending}"
        _system(folder / stem, system, task)
        scans.append((f"motion/{stem}_motion.tsv", _utc(take, system.t_s[0])))
    _append(above / f"{'_'.join(parts)}_scans.tsv", ("filename", "acq_time"), scans)
    begin_s = min(system.t_s[0] for system in systems)
    _events(folder / f"{named}{ending}_events", list(_happened(take, begin_s)))
    return folder


def _systems(take: Take[Any], body: str | None) -> Iterator[System]:
    bodies = take.table("body")
    names = list(dict.fromkeys(bodies["body"]))
    if body is None and len(names) > 1:
        raise ValueError(f"there are several bodies, and BIDS has one subject in a file: say body= one of {', '.join(names)}")
    if body is not None and body not in names:
        raise ValueError(f"there is no body {body!r}: there are {', '.join(names) or 'none'}")
    if names:
        mine = bodies["body"] == (body or names[0])
        yield from _body({name: values[mine] for name, values in bodies.items()})
    yield from _poses(take.table("sensors"))
    yield from _imus(take.table("measured"))


def _body(columns: Mapping[str, Floats]) -> Iterator[System]:
    if len(columns["t_s"]) < 2:
        return
    system = System("body", columns["t_s"])
    for name, values in columns.items():
        if name.endswith("_deg") and np.isfinite(values).any():
            angle = name.removesuffix("_deg")
            system.add(angle, MISSING, "JNTANG", angle.rsplit("_", 1)[0], "deg", MISSING, values)
    for name, states in columns.items():
        if name.endswith("_state"):
            segment = name.removesuffix("_state")
            system.place(segment, columns, f"{segment}_", np.isin(states.astype(str), ("ok", "inferred")))
    yield system


def _poses(columns: Mapping[str, Floats]) -> Iterator[System]:
    t_s = np.unique(columns["t_s"])
    if len(t_s) < 2:
        return
    system = System("poses", t_s)
    for sensor in dict.fromkeys(columns["sensor"]):
        mine = columns["sensor"] == sensor
        at = np.searchsorted(t_s, columns["t_s"][mine])
        usable = np.zeros(len(t_s), dtype=bool)
        usable[at] = np.isin(columns["state"][mine].astype(str), sorted(USABLE))
        spread = {}
        for name in (*(f"{axis}_m" for axis in XYZ), *QUATERNION.values()):
            spread[name] = np.full(len(t_s), np.nan)
            spread[name][at] = columns[name][mine]
        system.place(sensor, spread, "", usable)
    yield system


def _imus(columns: Mapping[str, Floats]) -> Iterator[System]:
    together: dict[bytes, tuple[Floats, list[tuple[str, npt.NDArray[np.bool_]]]]] = {}
    for sensor in dict.fromkeys(columns["sensor"]):
        mine = columns["sensor"] == sensor
        t_s = columns["t_s"][mine]
        if len(t_s) > 1:
            together.setdefault(t_s.tobytes(), (t_s, []))[1].append((sensor, mine))
    for number, (t_s, sensors) in enumerate(together.values(), 1):
        system = System(f"imus{number if len(together) > 1 else ''}", t_s)
        for sensor, mine in sensors:
            for kind, what, unit, columns_of in (("ACCEL", "acc", "m/s^2", "f{}_m_s2"), ("GYRO", "gyro", "rad/s", "w{}_rad_s")):
                for axis in XYZ:
                    values = columns[columns_of.format(axis)][mine]
                    if np.isfinite(values).any():
                        system.add(f"{sensor}_{what}_{axis}", axis, kind, sensor, unit, "sensor", values)
        yield system


def _begin(root: pathlib.Path, stage: str, subject: str) -> None:
    """What a data set has in front; what is there stays."""
    about = root / "dataset_description.json"
    if not about.exists():
        _json(about, {"Name": stage, **DATASET, "GeneratedBy": [{"Name": "posed"}]})
    readme = root / "README"
    if not readme.exists():
        readme.write_text(f"Motion recorded on the stage {stage!r} by posed. Say here who was recorded, how, and why.\n", encoding="utf-8")
    _append(root / "participants.tsv", ("participant_id",), [(f"sub-{subject}",)])


def _append(path: pathlib.Path, header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    """Adds rows to a table by their first column; those that are there stay."""
    known: list[list[str]] = []
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            known = list(csv.reader(file, delimiter="\t"))
    columns = known[0] if known else list(header)
    names = {row[0] for row in known[1:] if row}
    for row in rows:
        if row[0] not in names:
            # Whoever has added columns fills them.
            said = dict(zip(header, row, strict=True))
            known.append([said.get(column, MISSING) for column in columns])
    body = known if known and known[0] == columns else [columns, *known]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, delimiter="\t", lineterminator="\n").writerows(body)


def _system(stem: pathlib.Path, system: System, task: str) -> None:
    import polars as pl

    numbers = {row["name"]: np.ascontiguousarray(values, dtype=np.float64) for row, values in zip(system.rows, system.values, strict=True)}
    # As fine as messages are rounded.
    pl.DataFrame(numbers, nan_to_null=True).write_csv(f"{stem}_motion.tsv", separator="\t", include_header=False, null_value=MISSING, float_precision=6)
    with open(f"{stem}_channels.tsv", "w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(system.rows[0]), delimiter="\t", lineterminator="\n")
        table.writeheader()
        table.writerows(system.rows)
    used = {row["reference_frame"] for row in system.rows}
    frames = {name: {"Description": said} for name, said in FRAMES.items() if name in used}
    _json(pathlib.Path(f"{stem}_channels.json"), {"reference_frame": {"Levels": frames}})
    nominal_hz, effective_hz = system.rate_hz
    kinds = [row["type"] for row in system.rows]
    _json(
        pathlib.Path(f"{stem}_motion.json"),
        {
            "TaskName": task,
            "SamplingFrequency": nominal_hz,
            "SamplingFrequencyEffective": effective_hz,
            "TrackingSystemName": system.name,
            "MotionChannelCount": len(kinds),
            "TrackedPointsCount": len({row["tracked_point"] for row in system.rows} - {MISSING}),
            **{f"{kind}ChannelCount": kinds.count(kind) for kind in COUNTED},
            "MissingValues": MISSING,
        },
    )


def _happened(take: Take[Any], begin_s: float) -> Iterator[tuple[float, float | None, str, str]]:
    """Onset and duration, s, kind and what: labels, marks, repetitions."""
    labels = take.table("labels")
    for from_s, to_s, label in zip(labels["from_s"], labels["to_s"], labels["label"], strict=True):
        yield from_s - begin_s, to_s - from_s, "label", label
    for text in take.table("events")["message"]:
        event = json.loads(text)
        if event["type"] == "marks":
            yield event["t_valid_s"] - begin_s, 0.0, "mark", event["label"]
        elif event["type"] == "exercise" and event["event"] in ("counted", "rejected"):
            yield event["t_start_s"] - begin_s, event["t_valid_s"] - event["t_start_s"], event["event"], event["exercise"]


def _events(stem: pathlib.Path, events: list[tuple[float, float | None, str, str]]) -> None:
    with open(f"{stem}.tsv", "w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, delimiter="\t", lineterminator="\n", quoting=csv.QUOTE_MINIMAL)
        table.writerow(("onset", "duration", "trial_type", "value"))
        for onset_s, duration_s, kind, what in sorted(events, key=lambda event: event[0]):
            # A table of BIDS has no quotes.
            plain = re.sub(r"\s+", " ", what.replace('"', "'")).strip()
            table.writerow((f"{onset_s:.6f}", f"{duration_s:.6f}", kind, plain or MISSING))
    levels = {"label": "Somebody has said what goes on", "mark": "Somebody noted the moment", "counted": "A repetition that counts", "rejected": "One that does not"}
    about = {"trial_type": {"LongName": "Kind of event", "Levels": levels}, "value": {"Description": "The label, the mark, or the exercise"}}
    _json(pathlib.Path(f"{stem}.json"), about)


def _utc(take: Take[Any], t_s: float) -> str:
    at = take.epoch_utc + np.timedelta64(round(t_s * 1e6), "us")
    return cast(str, np.datetime_as_string(at, unit="us"))


def _json(path: pathlib.Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
