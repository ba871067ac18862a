"""Against a running `posed demo`: both forms, frames as arrays, requests, events, and the notebook."""

from __future__ import annotations

import asyncio
import pathlib

import numpy as np
import pytest

import posed

ROOT = pathlib.Path(__file__).resolve().parents[1]


def unit(q_wxyz: np.ndarray) -> None:
    norms = np.linalg.norm(q_wxyz, axis=1)
    assert np.allclose(norms[np.isfinite(norms)], 1, atol=1e-4)


def test_frames_are_arrays_with_capture_times(stage_address: str) -> None:
    with posed.connect(stage_address) as stage:
        frames = stage.sensors(fields=["position_m", "orientation_wxyz", "sigma_m", "velocity", "covariance", "measured"])
        some = [frames.get(60) for _ in range(5)]
        assert all(one.t_s < other.t_s for one, other in zip(some, some[1:], strict=False))
        assert [one.seq for one in some] == list(range(5)) and frames.dropped == 0
        frame = some[-1]
        assert frame.names == [sensor["name"] for sensor in stage.hello["sensors"]]
        sensors = len(frame.names)
        assert frame.position_m.shape == (sensors, 3) and frame.covariance.shape == (sensors, 6, 6)
        magnetic = np.array([sensor["magnetic"] for sensor in stage.hello["sensors"]])
        assert np.isnan(frame.position_m[~magnetic]).all()
        unit(frame.q_room_sensor_wxyz)
        assert np.isfinite(frame.measured("specific_force_m_s2")[~magnetic & frame.usable]).all()
        assert abs(frame.utc - np.datetime64("now", "ns")) < np.timedelta64(60, "s")
        with pytest.raises(KeyError, match="wand"):
            frame.index("nobody")


def test_a_body_has_segments_and_joint_angles(stage_address: str) -> None:
    with posed.connect(stage_address) as stage:
        body = next(body for body in stage.body("person") if "ok" in body.states)
        assert body.position_m.shape == (len(body.segments), 3)
        unit(body.q_room_segment_wxyz)
        assert set(body.angles_deg) >= {"elbow_r_flexion", "knee_l_flexion", "shoulder_r_elevation"}
        assert body.index("torso") == 0


def test_sensors_and_rate_are_as_asked_for(stage_address: str) -> None:
    with posed.connect(stage_address) as stage:
        frames = stage.sensors(["wand"], max_rate_hz=20)
        times = [frames.get(60).t_s for _ in range(5)]
        assert min(np.diff(times)) > 0.03
        assert frames.get(60).names == ["wand"]


def test_events_and_refusals(stage_address: str) -> None:
    with posed.connect(stage_address) as stage:
        marks = stage.events("marks")
        stage.mark(label="here")
        mark = marks.get(60)
        assert mark["type"] == "marks" and mark["label"] == "here"
        # Who comes later asks for what was.
        again = stage.events("marks", after=mark["event_id"] - 1)
        old = again.get(60)
        assert old["type"] == "marks" and old["event_id"] == mark["event_id"]
        with pytest.raises(posed.Refused) as refused:
            stage.replay_open("none.mcap")
        assert refused.value.code == "live"


def test_the_awaited_form_has_the_same(stage_address: str) -> None:
    async def test() -> None:
        async with posed.aio.connect(stage_address) as stage:
            async for truth in stage.truth():
                assert set(truth.states) == {"ok"}
                break
            marks = await stage.events("marks").begin()
            await stage.mark(label="there")
            mark = await anext(marks)
            assert mark["type"] == "marks" and mark["label"] == "there"
            found = [await anext(stage.events("marks", after=mark["event_id"] - 1)) for _ in range(1)]
            assert found[0]["event_id"] == mark["event_id"]  # type: ignore[typeddict-item]

    asyncio.run(asyncio.wait_for(test(), 60))


def test_both_forms_have_the_same_shape() -> None:
    for ours, theirs in ((posed.Connection, posed.aio.Connection), (posed.Stream, posed.aio.Stream)):
        shape = [{name for name in vars(one) if not name.startswith("_")} for one in (ours, theirs)]
        assert shape[0] - shape[1] <= {"get"} and shape[1] - shape[0] <= {"begin"}


def test_the_notebook_runs(stage_address: str, take: pathlib.Path) -> None:
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.reads((ROOT / "examples/posed.ipynb").read_text(encoding="utf-8"), as_version=4)  # type: ignore[no-untyped-call]
    for cell in notebook.cells:
        # It is about a stage on this computer, at the usual port.
        cell.source = cell.source.replace("127.0.0.1:8787", stage_address).replace("take.mcap", take.name)
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(take.parent)}}).execute()
