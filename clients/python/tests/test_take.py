"""A recording as data frames, held against what `posed export` writes of it."""

from __future__ import annotations

import csv
import json
import os
import pathlib
import shutil
import subprocess
import sys

import msgspec
import numpy as np
import pytest

import posed
from posed._columns import Coded, Columns
from posed.take import Table


def export(take: pathlib.Path, to: str, into: pathlib.Path) -> pathlib.Path:
    subprocess.run([os.environ["POSED"], "export", str(take), "--to", to, "-o", str(into)], check=True, capture_output=True)
    return into


def test_poses_are_those_of_the_export(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    with export(take, "csv", tmp_path / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    sensors = posed.read(take).sensors
    posed_rows = sensors[sensors["qw"].notna()].reset_index(drop=True)
    assert len(posed_rows) == len(rows) > 500
    for ours, theirs in (("t_s", "t"), ("x_m", "x"), ("qw", "qw"), ("qz", "qz")):
        expected = np.array([float(row[theirs] or "nan") for row in rows])
        assert np.allclose(posed_rows[ours], expected, atol=1e-5, equal_nan=True), ours
    assert list(posed_rows["sensor"]) == [row["sensor"] for row in rows]


def test_body_and_events_are_those_of_the_messages(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    messages = [json.loads(line) for line in export(take, "jsonl", tmp_path / "messages.jsonl").open()]
    found = posed.read(take)
    bodies = [message for message in messages if message["type"] == "body"]
    assert np.array_equal(found.body["t_s"], [body["t_s"] for body in bodies])
    elbow = [joint["angles_deg"]["flexion"] for body in bodies for joint in body["joints"] if joint["name"] == "elbow_r"]
    assert np.allclose(found.body["elbow_r_flexion_deg"], np.array(elbow, dtype=float), atol=1e-4, equal_nan=True)
    last = bodies[-1]["segments"][0]
    assert np.allclose(found.body["torso_x_m"].iloc[-1], last["position_m"][0], atol=1e-5) and found.body["torso_state"].iloc[-1] == last["state"]
    assert list(found.events["event_id"]) == [message["event_id"] for message in messages if "event_id" in message]
    marks = found.events[found.events["topic"] == "marks"]
    assert list(marks["label"]) == ["half"]
    raw = sum("angular_velocity_rad_s" in (sensor["measured"] or {}) for message in messages if message["type"] == "sensors" for sensor in message["sensors"])
    assert len(found.measured) == raw > 500


def equal(one: posed.Take[Table], other: posed.Take[Table]) -> None:
    for name in ("sensors", "measured", "body", "events"):
        ours, theirs = one.table(name), other.table(name)
        assert list(ours) == list(theirs) and len(ours["t_s"]) == len(theirs["t_s"]), name
        for column in ours:
            same = ours[column] == theirs[column]
            assert (same | ((ours[column] != ours[column]) & (theirs[column] != theirs[column]))).all(), (name, column)


def test_a_recording_needs_no_program_and_polars_has_the_same(take: pathlib.Path) -> None:
    pandas, polars = posed.read(take, program="/no/such/program").body, posed.read(take, frames="polars", program="/no/such/program").body
    assert polars.columns == list(pandas.columns) and np.array_equal(polars["t_s"].to_numpy(), pandas["t_s"])
    assert not (take.parent / "exports").exists()


def test_its_columns_are_those_of_a_replay_and_of_a_recording_with_all_messages(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    found = posed.read(take, frames="numpy")
    equal(found, posed.read(take, frames="numpy", replay=True, keep=False))
    assert not (take.parent / "exports").exists()
    equal(found, posed.read(export(take, "mcap", tmp_path / "full.mcap"), frames="numpy", program="/no/such/program"))


def torn(take: pathlib.Path, folder: pathlib.Path) -> pathlib.Path:
    """As a power cut leaves it."""
    broken = folder / take.name
    broken.write_bytes(take.read_bytes()[: -take.stat().st_size // 4])
    return broken


def test_one_that_broke_off_is_replayed_and_what_that_makes_is_kept(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    broken = torn(take, tmp_path)
    with pytest.raises(FileNotFoundError):
        posed.read(broken, program="/no/such/program")
    whole, part = posed.read(take, frames="numpy"), posed.read(broken, frames="numpy")
    rows = len(part.body["t_s"])
    assert 10 < rows < len(whole.body["t_s"]) and np.array_equal(part.body["t_s"], whole.body["t_s"][:rows])
    assert [file.name for file in (tmp_path / "exports").iterdir()] == ["client.columns.mcap"]
    equal(part, posed.read(broken, frames="numpy", program="/no/such/program"))
    # What was kept of an older recording, or is damaged, is not used.
    kept = tmp_path / "exports" / "client.columns.mcap"
    kept.write_bytes(b"damaged")
    with pytest.raises(FileNotFoundError):
        posed.read(broken, program="/no/such/program")
    equal(part, posed.read(broken, frames="numpy"))
    os.utime(kept, ns=(1, 1))
    with pytest.raises(FileNotFoundError):
        posed.read(broken, program="/no/such/program")


def test_without_the_program_it_says_what_to_do(take: pathlib.Path, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("POSED")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(posed.NoProgram, match="posed export"):
        posed.read(torn(take, tmp_path))


UNKNOWN = -(2**31)


def part(of: str, rows: list[list[int]], **more: object) -> bytes:
    """A block's table, packed as a recording has it."""
    numbers = np.array(rows, dtype=np.int64).T
    differences = np.diff(numbers, axis=1, prepend=0).astype(np.int32)
    zigzag = (differences << 1) ^ (differences >> 31)
    planes = zigzag.astype("<i4").reshape(-1, 1).view(np.uint8).T
    return msgspec.msgpack.encode({"of": of, "states": ["ok", "missing"], "rows": len(rows), "width": len(rows[0]), "values": planes.tobytes(), **more})


def test_two_bodies_and_time_code_are_read_from_blocks() -> None:
    pose = [0, 100_000, -50_000, UNKNOWN, 1_000_000, 0, 0, 0]
    code = [36_000, 1250, 1]
    blocks = [
        part("body", [[1, 500_000, *code, 0, 90_000, *pose], [1, 600_000, UNKNOWN, UNKNOWN, UNKNOWN, 2, -1, *pose]], name="anna", angles=["elbow_r_flexion"], segments=["torso"]),
        part("body", [[1, 500_000, *code, 1, *pose]], name="ben", angles=[], segments=["pelvis"]),
        part("body", [[2, 0, *code, 3, *pose]], name="ben", angles=[], segments=["pelvis"]),
    ]
    broken, whole = Columns(blocks), Columns([*blocks, msgspec.msgpack.encode({"of": "end"})])
    assert (broken.whole, whole.whole) == (False, True)
    plain = {name: column.plain() if isinstance(column, Coded) else column for name, column in whole.body().items()}
    assert plain["t_s"].tolist() == [1.5, 1.5, 1.6, 2.0] and plain["body"].tolist() == ["anna", "ben", "anna", "ben"]
    assert plain["timecode"].tolist() == ["10:00:00;12.50", "10:00:00;12.50", "", "10:00:00;12.50"]
    assert plain["torso_state"].tolist() == ["ok", "missing", "ok", "missing"] and plain["pelvis_state"].tolist() == ["missing", "ok", "missing", "ok"]
    assert np.array_equal(plain["elbow_r_flexion_deg"], np.array([90, np.nan, -0.001, np.nan], np.float32), equal_nan=True)
    assert np.array_equal(plain["torso_x_m"], np.array([1, np.nan, 1, np.nan], np.float32), equal_nan=True) and np.isnan(plain["pelvis_z_m"]).all()
    assert len(whole.sensors()["t_s"]) == len(whole.measured()["t_s"]) == len(whole.events()["t_s"]) == 0


def test_labels_count_from_the_first_frame(take: pathlib.Path) -> None:
    first = posed.read(take, frames="numpy").sensors["t_s"][0]
    annotated, by_frame = take.with_suffix(".eaf"), take.with_suffix(".labels.csv")
    annotated.write_text(
        '<ANNOTATION_DOCUMENT><TIME_ORDER><TIME_SLOT TIME_SLOT_ID="a" TIME_VALUE="500"/><TIME_SLOT TIME_SLOT_ID="b" TIME_VALUE="1250"/></TIME_ORDER>'
        '<TIER TIER_ID="segments"><ANNOTATION><ALIGNABLE_ANNOTATION TIME_SLOT_REF1="a" TIME_SLOT_REF2="b"><ANNOTATION_VALUE>curl</ANNOTATION_VALUE>'
        "</ALIGNABLE_ANNOTATION></ANNOTATION></TIER></ANNOTATION_DOCUMENT>"
    )
    try:
        labels = posed.read(take, frames="numpy").labels
        assert (labels["from_s"] - first).round(6).tolist() == [0.5] and (labels["to_s"] - first).round(6).tolist() == [1.25]
        assert labels["label"].tolist() == ["curl"]
        by_frame.write_text("frame,t,label,confidence\n0,,,\n1,,curl,\n2,,curl,\n3,,rest,\n")
        times = np.unique(posed.read(take, frames="numpy").sensors["t_s"])
        labels = posed.read(take, frames="numpy").labels
        assert labels["label"].tolist() == ["curl", "rest"]
        assert labels["from_s"].tolist() == [times[1], times[3]]
    finally:
        annotated.unlink()
        by_frame.unlink(missing_ok=True)


def test_a_take_is_plotted_in_one_call(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    found = posed.read(take)
    for columns in ((), ("elbow_r_flexion_deg", "wand.x_m")):
        picture = tmp_path / "plot.png"
        found.plot(*columns).savefig(picture)
        assert picture.stat().st_size > 10_000
    with pytest.raises(KeyError, match="SENSOR.COLUMN"):
        found.plot("elbow")


def test_what_is_no_recording_is_refused(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "a.mcap"
    file.write_bytes(b"no recording at all")
    with pytest.raises(posed.PosedError, match="no recording"):
        posed.read(file)


def test_parquet_has_the_tables_for_any_reader(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    import pyarrow.parquet as pq  # type: ignore[import-untyped]

    found = posed.read(take, frames="numpy")
    folder = found.write_parquet(tmp_path / "take")
    for name in ("sensors", "measured", "body", "events", "labels"):
        table, columns = pq.read_table(folder / f"{name}.parquet"), found.table(name)
        assert table.column_names == list(columns) and table.num_rows == len(next(iter(columns.values()))), name
        for column, values in columns.items():
            theirs = table[column].to_numpy(zero_copy_only=False)
            same = (theirs == values) if values.dtype == object else np.isclose(theirs, values, rtol=0, atol=0, equal_nan=True)
            assert np.all(same), (name, column)
        assert pq.read_metadata(folder / f"{name}.parquet").metadata[b"epoch_utc"].endswith(b"Z")


def validated(root: pathlib.Path) -> list[str]:
    """The codes of the errors that BIDS' own validator finds."""
    program = pathlib.Path(sys.executable).with_name("bids-validator-deno")
    done = subprocess.run([str(program), "--json", "--ignoreWarnings", str(root)], capture_output=True, text=True, check=False)
    issues = json.loads(done.stdout)["issues"]["issues"]
    errors = [issue["code"] for issue in issues if issue["severity"] == "error"]
    assert (done.returncode == 0) == (not errors), done
    return errors


def test_motion_bids_is_what_its_validator_accepts(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    found, root = posed.read(take, frames="numpy"), tmp_path / "study"
    folder = found.write_bids(root, subject="01", task="curls", run=1)
    found.write_bids(root, subject="02", task="curls", session="a")
    assert validated(root) == []
    # And finds what is not right.
    broken = tmp_path / "broken"
    shutil.copytree(root, broken)
    (broken / "sub-01/motion/sub-01_task-curls_tracksys-body_run-01_channels.tsv").unlink()
    assert validated(broken)

    stem = folder / "sub-01_task-curls_tracksys-body_run-01"
    names = [row["name"] for row in csv.DictReader(open(f"{stem}_channels.tsv"), delimiter="\t")]
    rows = np.genfromtxt(f"{stem}_motion.tsv", delimiter="\t", missing_values="n/a", filling_values=np.nan)
    body = found.body
    t_s = body["t_s"]
    assert rows.shape == (len(t_s), len(names))
    assert np.allclose(rows[:, names.index("latency")], t_s - t_s[0], atol=1e-6)
    assert np.allclose(rows[:, names.index("elbow_r_flexion")], body["elbow_r_flexion_deg"], atol=1e-5, equal_nan=True)
    shown = np.isin(body["torso_state"].astype(str), ("ok", "inferred"))
    assert np.allclose(rows[shown][:, names.index("torso_quat_w")], body["torso_qw"][shown], atol=1e-5)
    with open(folder / "sub-01_task-curls_run-01_events.tsv") as file:
        assert [(row["trial_type"], row["value"]) for row in csv.DictReader(file, delimiter="\t")].count(("mark", "half")) == 1
    with open(root / "participants.tsv") as file:
        assert [row["participant_id"] for row in csv.DictReader(file, delimiter="\t")] == ["sub-01", "sub-02"]

    for bad, why in (({"subject": "0 1"}, "letters"), ({"subject": "01", "task": "a-b"}, "letters"), ({"subject": "01", "run": 0}, "from 1"), ({"subject": "01", "body": "nobody"}, "no body")):
        with pytest.raises(ValueError, match=why):
            found.write_bids(root, **{"task": "curls", **bad})  # type: ignore[arg-type]
    with pytest.raises(FileExistsError, match="already"):
        found.write_bids(root, subject="01", task="curls", run=1)
