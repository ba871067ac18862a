"""A recording as data frames, held against what `posed export` writes of it."""

from __future__ import annotations

import csv
import json
import os
import pathlib
import shutil
import subprocess
import sys

import numpy as np
import pytest

import posed


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


def test_once_read_it_is_kept_and_polars_has_the_same(take: pathlib.Path) -> None:
    first = posed.read(take).body
    assert (take.parent / "exports" / "client.columns.npz").exists()
    again = posed.read(take, frames="polars", program="/no/such/program").body
    assert again.columns == list(first.columns) and np.array_equal(again["t_s"].to_numpy(), first["t_s"])


def test_what_was_kept_of_another_recording_is_not_used(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    other = tmp_path / take.name
    other.write_bytes(take.read_bytes())
    (tmp_path / "exports").mkdir()
    kept = tmp_path / "exports" / "client.columns.npz"
    kept.write_bytes((take.parent / "exports" / "client.columns.npz").read_bytes())
    os.utime(other, ns=(1, 1))
    with pytest.raises(FileNotFoundError):
        posed.read(other, program="/no/such/program")
    kept.write_bytes(b"damaged")
    with pytest.raises(FileNotFoundError):
        posed.read(other, program="/no/such/program")


def test_a_recording_with_all_messages_needs_no_program(take: pathlib.Path, tmp_path: pathlib.Path) -> None:
    full = export(take, "mcap", tmp_path / "full.mcap")
    ours, theirs = posed.read(full, frames="numpy", program="/no/such/program"), posed.read(take, frames="numpy")
    for one, other in ((getattr(ours, name), getattr(theirs, name)) for name in ("sensors", "measured", "body", "events")):
        assert list(one) == list(other)
        for name in one:
            same = one[name] == other[name]
            assert (same | ((one[name] != one[name]) & (other[name] != other[name]))).all(), name


def test_a_preview_shows_what_was_good_without_the_program(take: pathlib.Path) -> None:
    preview, whole = posed.read(take, preview=True, program="/no/such/program"), posed.read(take).body
    assert 5 < len(preview.body) < len(whole) / 10
    at = np.searchsorted(whole["t_s"], preview.body["t_s"].to_numpy() - 1e-6)
    assert np.allclose(whole["t_s"].to_numpy()[at], preview.body["t_s"], atol=1e-6)
    for column in ("torso_x_m", "shank_l_qw"):
        shown, known = preview.body[column].to_numpy(), whole[column].to_numpy()[at]
        assert np.allclose(shown, known, atol=1e-5, equal_nan=True) and np.isfinite(shown).any(), column
    imus = preview.sensors[preview.sensors["sensor"].str.startswith("imu_")]
    assert len(imus) > 5 and imus["x_m"].isna().all() and imus["qw"].notna().all()


def test_without_the_program_it_says_what_to_do(take: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("POSED")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(posed.NoProgram, match="posed export"):
        posed.read(take, keep=False)


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
