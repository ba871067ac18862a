"""Requests as methods. Generated from docs/schema/posed.v1.schema.json by clients/python/generate.py; do not edit."""

from __future__ import annotations

from typing import Any, cast

from ._schema import (
    AnchorSpec,
    Demonstration,
    Digested,
    Exercises,
    FaultClass,
    Forgotten,
    HealthHistory,
    Invitation,
    KeptFile,
    Labels,
    ListedSessions,
    Look,
    MapVersion,
    Model,
    People,
    Phones,
    Plan,
    Plans,
    RecordingBegun,
    Recordings,
    Removed,
    Renamed,
    Report,
    ReportLanguage,
    RoomPoint,
    SessionBegun,
    Setup,
    Shown,
    Speed,
    StageChange,
    Started,
    Takes,
    Thoroughness,
    Tracked,
)


class AwaitedRequests:
    """Requests, awaited; a refused one raises `Refused`."""

    async def request(self, request: dict[str, Any]) -> Any:
        """Sends a request by its `type`; what is None is left out. The `result` of the answer."""
        raise NotImplementedError

    async def record_start(self, *, name: str | None = None) -> RecordingBegun:
        """Begins a recording.

        `name`: File name within the recordings' folder, without a path; absent: stage and time.
        """
        return cast(RecordingBegun, await self.request({"type": "record.start", "name": name}))

    async def record_stop(self) -> None:
        """Ends the recording."""
        await self.request({"type": "record.stop"})

    async def mark(self, *, label: str | None = None) -> None:
        """Notes this moment: an event of the topic `marks`, and in the recording that is in progress.

        `label`: What happens now, 200 bytes at most; absent: nothing is said of it.
        """
        await self.request({"type": "mark", "label": label})

    async def replay_list(self) -> Recordings:
        """Names the recordings."""
        return cast(Recordings, await self.request({"type": "replay.list"}))

    async def replay_open(self, name: str) -> None:
        """Opens a recording.

        `name`: A name that `replay.list` gave.
        """
        await self.request({"type": "replay.open", "name": name})

    async def replay_track(self, name: str, *, columns: list[str] | None = None) -> Tracked:
        """Reads a few channels of a whole recording, to compare runs; answered when it is read.

        `name`: A name that `replay.list` gave.
        `columns`: Up to six channels; absent: only their names are answered.
        """
        return cast(Tracked, await self.request({"type": "replay.track", "name": name, "columns": columns}))

    async def replay_seek(self, t_s: float) -> Started:
        """Goes to a time in the open recording.

        `t_s`: Seconds since the recording's epoch.
        """
        return cast(Started, await self.request({"type": "replay.seek", "t_s": t_s}))

    async def replay_speed(self, speed: Speed) -> None:
        """Sets the speed of the replay.

        `speed`: Multiple of real time; 0 pauses.
        """
        await self.request({"type": "replay.speed", "speed": speed})

    async def replay_look(self, t_s: float) -> Look:
        """Tells where everything was at a time of the open recording, from what it shows to viewers: at once, and without moving the replay.

        `t_s`: Seconds since the recording's epoch.
        """
        return cast(Look, await self.request({"type": "replay.look", "t_s": t_s}))

    async def replay_labels(self, name: str) -> Labels:
        """Tells what somebody has said that a recording shows: the labels beside it, which `segments.train` learns from.

        `name`: A name that `library.list` gave.
        """
        return cast(Labels, await self.request({"type": "replay.labels", "name": name}))

    async def replay_label(self, name: str, from_s: float, to_s: float, label: str) -> Labels:
        """Says what a recording shows for a while, in the place of what was said of that time before; kept beside it, where
`segments.train` reads it. The recording needs a digest.

        `name`: A name that `library.list` gave.
        `from_s`: Since when, stage time, s.
        `to_s`: Until when, s.
        `label`: What it shows, 200 bytes at most; empty: nothing is said of that time any more.
        """
        return cast(Labels, await self.request({"type": "replay.label", "name": name, "from_s": from_s, "to_s": to_s, "label": label}))

    async def library_list(self, *, bin: bool | None = None) -> Takes:
        """Tells which recordings there are, with what can be known of each without reading it.

        `bin`: Those in the bin instead; absent: those in the folder.
        """
        return cast(Takes, await self.request({"type": "library.list", "bin": bin}))

    async def library_digest(self, name: str, *, make: bool | None = None) -> Digested:
        """Tells what happens in a recording.

        `name`: A name that `library.list` gave.
        `make`: Whether a job makes one where there is none: by a replay, as long as that takes; needs the role
            `operate`. Absent: no.
        """
        return cast(Digested, await self.request({"type": "library.digest", "name": name, "make": make}))

    async def library_rename(self, name: str, to: str) -> Renamed:
        """Gives a recording another name; what is kept beside it goes along.

        `name`: A name that `library.list` gave.
        `to`: File name of letters, digits, `-`, `_`, `.` and spaces, without a path; one that is free.
        """
        return cast(Renamed, await self.request({"type": "library.rename", "name": name, "to": to}))

    async def library_remove(self, name: str) -> Renamed:
        """Puts a recording into the bin.

        `name`: A name that `library.list` gave.
        """
        return cast(Renamed, await self.request({"type": "library.remove", "name": name}))

    async def library_restore(self, name: str) -> Renamed:
        """Takes a recording out of the bin.

        `name`: A name that `library.list` of the bin gave.
        """
        return cast(Renamed, await self.request({"type": "library.restore", "name": name}))

    async def library_empty_bin(self) -> Removed:
        """Removes for good what is in the bin."""
        return cast(Removed, await self.request({"type": "library.empty_bin"}))

    async def library_export(self, name: str, format: str, *, body: str | None = None, bones: str | None = None, frame: str | None = None, model: str | None = None) -> Started:
        """Writes a recording as a file for another program into the folder `exports`, from where `/exports/FILE` serves it; a job, whose result is `{file, rows, bytes}`.

        `name`: A name that `library.list` gave.
        `format`: As `--to` of `posed export`: `csv`, `jsonl`, `bvh`, `trc`, `glb`, `vrm`, `vrma`, `usda`, `c3d`,
            `sto`, `mot`, `mcap`.
        `body`: As `--body`: which of several bodies is shown, by name.
        `bones`: As `--bones`, for `bvh`; absent: `posed`.
        `frame`: As `--frame`, for `csv`: `room` or `transmitter`; absent: `room`.
        `model`: As `--model`, for `mot`; absent: `rajagopal`.
        """
        return cast(Started, await self.request({"type": "library.export", "name": name, "format": format, "body": body, "bones": bones, "frame": frame, "model": model}))

    async def health_history(self) -> HealthHistory:
        """Tells how the sensors were in the last hour."""
        return cast(HealthHistory, await self.request({"type": "health.history"}))

    async def field_start(self, sensors: list[str], spacing_m: float) -> None:
        """Begins a guided calibration of the field: move the pole, and follow what the topic `field` says.

        `sensors`: The pole's sensors by name, in their order along it.
        `spacing_m`: Measured distance between neighbours, m.
        """
        await self.request({"type": "field.start", "sensors": sensors, "spacing_m": spacing_m})

    async def field_finish(self, *, anchors: list[AnchorSpec] | None = None) -> Started:
        """Ends the guided calibration and solves it, as a job.

        `anchors`: Surveyed points that a sensor of the pole stood on meanwhile; three or more make positions
            absolute.
        """
        return cast(Started, await self.request({"type": "field.finish", "anchors": anchors}))

    async def field_accept(self) -> MapVersion:
        """Uses the map of the last calibration from the next frame on, and keeps it as the stage's newest version."""
        return cast(MapVersion, await self.request({"type": "field.accept"}))

    async def field_rollback(self) -> MapVersion:
        """Goes back to the version before; to no map before the first."""
        return cast(MapVersion, await self.request({"type": "field.rollback"}))

    async def exercise_list(self) -> Exercises:
        """Names the exercises that can be selected: those in the stage's folder."""
        return cast(Exercises, await self.request({"type": "exercise.list"}))

    async def exercise_demonstration(self, exercise: str) -> Demonstration:
        """Shows how an exercise was taught, as a figure that moves.

        `exercise`: Its name, as `exercise.list` gave it.
        """
        return cast(Demonstration, await self.request({"type": "exercise.demonstration", "exercise": exercise}))

    async def exercise_teach(self, name: str, repetitions: int, *, body: str | None = None, channels: list[str] | None = None, last_s: float | None = None, sensors: list[str] | None = None, subject: str | None = None) -> Started:
        """Teaches an exercise from what is tracked; a job. The exercise is kept as a file, loaded, and counted for the
subject from then on.

        `name`: Name of the exercise: 1 to 64 letters, digits, spaces, `-` and `_`.
        `repetitions`: How many repetitions it is taught from; 3 to 10 are good.
        `body`: The body whose joints are looked at, by name; absent: the one that is called as the subject, or else
            the first one.
        `channels`: Only these channels; absent: those that do the same in every repetition.
        `last_s`: The repetitions lie in the last so many seconds; absent: they are about to be done, and the job
            ends once they were done and the subject rests.
        `sensors`: Only these sensors, by name; absent: all.
        `subject`: Who moves; absent: the name of the body, or `default`.
        """
        return cast(Started, await self.request({"type": "exercise.teach", "name": name, "repetitions": repetitions, "body": body, "channels": channels, "last_s": last_s, "sensors": sensors, "subject": subject}))

    async def exercise_select(self, exercises: list[str], *, body: str | None = None, repetitions: int | None = None, rest_s: float | None = None, sensors: dict[str, str] | None = None, sets: int | None = None, subject: str | None = None) -> None:
        """Counts exercises from 0 for a subject, and no others.

        `exercises`: Their names; none ends the counting.
        `body`: The body whose joints are counted, by name; absent: the one that is called as the subject, or else
            the first one.
        `repetitions`: Repetitions of a set; absent: one set without end.
        `rest_s`: Rest after a set, s; absent: none.
        `sensors`: For each sensor that the exercises were taught with the one that this subject wears; absent: the
            same.
        `sets`: Sets of each exercise; absent: no end.
        `subject`: Who moves; absent: the name of the body, or `default`.
        """
        await self.request({"type": "exercise.select", "exercises": exercises, "body": body, "repetitions": repetitions, "rest_s": rest_s, "sensors": sensors, "sets": sets, "subject": subject})

    async def exercise_reset(self, *, subject: str | None = None) -> None:
        """Counts a subject's exercises from 0 again.

        `subject`: Who moves; absent: `default`.
        """
        await self.request({"type": "exercise.reset", "subject": subject})

    async def faults_train(self, *, last_s: float | None = None, recording: str | None = None) -> Started:
        """Learns a fault map; a job. It is kept as a file, and takes the place of the one in use.

        `last_s`: From the last so many seconds; absent: from all that is remembered, five minutes at most.
        `recording`: From a recording instead: a name that `replay.list` gave.
        """
        return cast(Started, await self.request({"type": "faults.train", "last_s": last_s, "recording": recording}))

    async def faults_name_cell(self, row: int, column: int, class_: FaultClass) -> KeptFile:
        """Gives a cell of the fault map another class; kept as a file.

        `row`: Row, from 0.
        `column`: Column, from 0.
        `class_`: What frames of this cell are.
        """
        return cast(KeptFile, await self.request({"type": "faults.name_cell", "row": row, "column": column, "class": class_}))

    async def segments_train(self, *, epochs: int | None = None, look_ahead: int | None = None) -> Started:
        """Learns to name segments of the motion from the recordings that have labels beside them (`TAKE.labels.csv` or `TAKE.eaf`); a
job. The model is kept as a file, and takes the place of the one in use.

        `epochs`: Most epochs; absent: 30.
        `look_ahead`: Frames of 1/24 s that the network may look ahead: the fewer, the sooner labels are sure. More
            than 40, half of what it sees, is 40; absent: 40.
        """
        return cast(Started, await self.request({"type": "segments.train", "epochs": epochs, "look_ahead": look_ahead}))

    async def body_calibrate(self, *, body: str | None = None, how: Thoroughness | None = None) -> Started:
        """Finds how the body's sensors sit, and with `assign` on which segment each does, from poses and movements that the job's message
asks for one after the other; a job. It notices by itself when each was done, and swaps in what it found if it is good to
five degrees. Its result has `quality_deg` and `sensors` by segment.

        `body`: The person, by the name of the body; absent: the only one.
        `how`: How much is asked for; absent: `full`.
        """
        return cast(Started, await self.request({"type": "body.calibrate", "body": body, "how": how}))

    async def heading_reset(self, *, body: str | None = None, heading_deg: float | None = None, sensor: str | None = None) -> None:
        """The person looks this way now, upright: the headings of IMUs on the body that no field identifies begin anew from it. Gyros drift; this takes it away.

        `body`: The person, by the name of the body; absent: the one who wears the IMU, or the only one.
        `heading_deg`: How far to the left of the room's x the person looks, degrees, -360 to 360; absent: 0.
        `sensor`: The IMU, by name; absent: all on the body.
        """
        await self.request({"type": "heading.reset", "body": body, "heading_deg": heading_deg, "sensor": sensor})

    async def stage_align(self, *, anchors: list[RoomPoint] | None = None, sensor: str | None = None) -> Started:
        """Finds how the transmitter stands in the room, and how the IMU sits on a magnetic sensor that has one; a job, whose message
states what to do next. Both are swapped in if they are good.

        `anchors`: Surveyed points of the room that the sensor is held at, in this order; three or more where no IMU
            is attached to it.
        `sensor`: The magnetic sensor, by name; absent: the first that has an IMU, else the first.
        """
        return cast(Started, await self.request({"type": "stage.align", "anchors": anchors, "sensor": sensor}))

    async def imu_calibrate(self, *, sensor: str | None = None) -> Started:
        """Finds the intrinsics of an IMU that is placed in one direction after the other and turned between; a job, whose message
states what to do next and whose result states which directions were held. They are kept as a file of the unit and used from
then on, if they are good.

        `sensor`: The sensor, by name; absent: the only IMU of the stage.
        """
        return cast(Started, await self.request({"type": "imu.calibrate", "sensor": sensor}))

    async def session_begin(self, person: str, *, plan: str | None = None, subject: str | None = None) -> SessionBegun:
        """Begins a session: what a subject does from now on is kept for this person. With a plan its steps are selected one after the
other, with their rests, and the session ends after the last.

        `person`: Who trains: a name or a number of 1 to 64 bytes; taken in where it is new.
        `plan`: A plan that `session.plans` gave; absent: what is selected by hand.
        `subject`: The subject of the exercises; absent: `default`.
        """
        return cast(SessionBegun, await self.request({"type": "session.begin", "person": person, "plan": plan, "subject": subject}))

    async def session_end(self, *, subject: str | None = None) -> None:
        """Ends a session.

        `subject`: Of this subject; absent: `default`.
        """
        await self.request({"type": "session.end", "subject": subject})

    async def session_list(self, *, limit: int | None = None, person: str | None = None) -> ListedSessions:
        """Names sessions, the newest first.

        `limit`: At most so many, 1 to 1000; absent: 100.
        `person`: Only those of this person.
        """
        return cast(ListedSessions, await self.request({"type": "session.list", "limit": limit, "person": person}))

    async def session_show(self, session: int) -> Shown:
        """Gives a session in full.

        `session`: Its number.
        """
        return cast(Shown, await self.request({"type": "session.show", "session": session}))

    async def session_report(self, *, language: ReportLanguage | None = None, person: str | None = None, session: int | None = None, time_zone: str | None = None) -> Report:
        """Writes a report of one session, or of all sessions of a person.

        `language`: In which language; absent: `english`.
        `person`: the person.
        `session`: Number of the session; or
        `time_zone`: Time zone of its dates by its IANA name, `Europe/Berlin`; absent: that of the daemon.
        """
        return cast(Report, await self.request({"type": "session.report", "language": language, "person": person, "session": session, "time_zone": time_zone}))

    async def session_correct(self, session: int, set: int, counted: int) -> None:
        """Keeps the count of a set that somebody has seen, beside the one that was counted.

        `session`: Number of the session.
        `set`: Number of the set in it.
        `counted`: Repetitions that were really done.
        """
        await self.request({"type": "session.correct", "session": session, "set": set, "counted": counted})

    async def session_people(self) -> People:
        """Names everybody who trains."""
        return cast(People, await self.request({"type": "session.people"}))

    async def session_forget(self, person: str, recordings: bool) -> Forgotten:
        """Removes a person with everything of them.

        `person`: Who.
        `recordings`: Whether the recordings of their sessions go too, whoever else is in them.
        """
        return cast(Forgotten, await self.request({"type": "session.forget", "person": person, "recordings": recordings}))

    async def session_plans(self) -> Plans:
        """Gives all plans."""
        return cast(Plans, await self.request({"type": "session.plans"}))

    async def session_save_plan(self, plan: Plan) -> None:
        """Keeps a plan, in the place of one of its name.

        `plan`: The plan.
        """
        await self.request({"type": "session.save_plan", "plan": plan})

    async def session_delete_plan(self, name: str) -> None:
        """Removes a plan.

        `name`: Its name.
        """
        await self.request({"type": "session.delete_plan", "name": name})

    async def setup_read(self, *, changes: list[StageChange] | None = None) -> Setup:
        """Reads the stage file, as it would be with these changes, and says all that is wrong with it; nothing is written.

        `changes`: Made one after the other; none: the file as it is.
        """
        return cast(Setup, await self.request({"type": "setup.read", "changes": changes}))

    async def setup_save(self, changes: list[StageChange], revision: str) -> None:
        """Writes changes into the stage file, keeps the file of before beside it (its name and `~`), and begins the changed stage: all
connections are closed with code 1012 and served again at once. Refused as `busy` while a recording or another job runs, as
`changed` where the file is not what was read, as `failed` where the stage could not run like this.

        `changes`: Made one after the other.
        `revision`: The `revision` that `setup.read` gave.
        """
        await self.request({"type": "setup.save", "changes": changes, "revision": revision})

    async def setup_find(self, *, port: str | None = None) -> Started:
        """Asks the ports that no device of the stage has what is there; a job, whose `result` (`Found`) grows as they answer. A unit that
streams is stopped by the question; nothing else is changed.

        `port`: Only this one: path of a serial port, tcp://HOST:PORT or udp://HOST:PORT; absent: all serial ports,
            and the units that announce themselves on the network.
        """
        return cast(Started, await self.request({"type": "setup.find", "port": port}))

    async def phone_invite(self) -> Invitation:
        """Lets phones come as sensors, and says how: an address with a token that allows only this, as a text and as a
        QR code. The daemon listens there from then on.
        """
        return cast(Invitation, await self.request({"type": "phone.invite"}))

    async def phone_list(self) -> Phones:
        """The phones and other devices that are connected to the websocket `/imu` just now."""
        return cast(Phones, await self.request({"type": "phone.list"}))

    async def phone_blink(self, phone_id: str) -> None:
        """Has one of them show itself: a phone's page flashes. Refused as `not_connected` where it is not there.

        `phone_id`: Its id.
        """
        await self.request({"type": "phone.blink", "phone_id": phone_id})

    async def job_cancel(self, job: int) -> None:
        """Cancels a job.

        `job`: Its number.
        """
        await self.request({"type": "job.cancel", "job": job})

    async def model_load(self, model: Model) -> None:
        """Swaps a model in between two frames.

        `model`: The model, in full.
        """
        await self.request({"type": "model.load", "model": model})


class BlockingRequests:
    """Requests that wait for their answer; a refused one raises `Refused`."""

    def request(self, request: dict[str, Any]) -> Any:
        """Sends a request by its `type`; what is None is left out. The `result` of the answer."""
        raise NotImplementedError

    def record_start(self, *, name: str | None = None) -> RecordingBegun:
        """Begins a recording.

        `name`: File name within the recordings' folder, without a path; absent: stage and time.
        """
        return cast(RecordingBegun, self.request({"type": "record.start", "name": name}))

    def record_stop(self) -> None:
        """Ends the recording."""
        self.request({"type": "record.stop"})

    def mark(self, *, label: str | None = None) -> None:
        """Notes this moment: an event of the topic `marks`, and in the recording that is in progress.

        `label`: What happens now, 200 bytes at most; absent: nothing is said of it.
        """
        self.request({"type": "mark", "label": label})

    def replay_list(self) -> Recordings:
        """Names the recordings."""
        return cast(Recordings, self.request({"type": "replay.list"}))

    def replay_open(self, name: str) -> None:
        """Opens a recording.

        `name`: A name that `replay.list` gave.
        """
        self.request({"type": "replay.open", "name": name})

    def replay_track(self, name: str, *, columns: list[str] | None = None) -> Tracked:
        """Reads a few channels of a whole recording, to compare runs; answered when it is read.

        `name`: A name that `replay.list` gave.
        `columns`: Up to six channels; absent: only their names are answered.
        """
        return cast(Tracked, self.request({"type": "replay.track", "name": name, "columns": columns}))

    def replay_seek(self, t_s: float) -> Started:
        """Goes to a time in the open recording.

        `t_s`: Seconds since the recording's epoch.
        """
        return cast(Started, self.request({"type": "replay.seek", "t_s": t_s}))

    def replay_speed(self, speed: Speed) -> None:
        """Sets the speed of the replay.

        `speed`: Multiple of real time; 0 pauses.
        """
        self.request({"type": "replay.speed", "speed": speed})

    def replay_look(self, t_s: float) -> Look:
        """Tells where everything was at a time of the open recording, from what it shows to viewers: at once, and without moving the replay.

        `t_s`: Seconds since the recording's epoch.
        """
        return cast(Look, self.request({"type": "replay.look", "t_s": t_s}))

    def replay_labels(self, name: str) -> Labels:
        """Tells what somebody has said that a recording shows: the labels beside it, which `segments.train` learns from.

        `name`: A name that `library.list` gave.
        """
        return cast(Labels, self.request({"type": "replay.labels", "name": name}))

    def replay_label(self, name: str, from_s: float, to_s: float, label: str) -> Labels:
        """Says what a recording shows for a while, in the place of what was said of that time before; kept beside it, where
`segments.train` reads it. The recording needs a digest.

        `name`: A name that `library.list` gave.
        `from_s`: Since when, stage time, s.
        `to_s`: Until when, s.
        `label`: What it shows, 200 bytes at most; empty: nothing is said of that time any more.
        """
        return cast(Labels, self.request({"type": "replay.label", "name": name, "from_s": from_s, "to_s": to_s, "label": label}))

    def library_list(self, *, bin: bool | None = None) -> Takes:
        """Tells which recordings there are, with what can be known of each without reading it.

        `bin`: Those in the bin instead; absent: those in the folder.
        """
        return cast(Takes, self.request({"type": "library.list", "bin": bin}))

    def library_digest(self, name: str, *, make: bool | None = None) -> Digested:
        """Tells what happens in a recording.

        `name`: A name that `library.list` gave.
        `make`: Whether a job makes one where there is none: by a replay, as long as that takes; needs the role
            `operate`. Absent: no.
        """
        return cast(Digested, self.request({"type": "library.digest", "name": name, "make": make}))

    def library_rename(self, name: str, to: str) -> Renamed:
        """Gives a recording another name; what is kept beside it goes along.

        `name`: A name that `library.list` gave.
        `to`: File name of letters, digits, `-`, `_`, `.` and spaces, without a path; one that is free.
        """
        return cast(Renamed, self.request({"type": "library.rename", "name": name, "to": to}))

    def library_remove(self, name: str) -> Renamed:
        """Puts a recording into the bin.

        `name`: A name that `library.list` gave.
        """
        return cast(Renamed, self.request({"type": "library.remove", "name": name}))

    def library_restore(self, name: str) -> Renamed:
        """Takes a recording out of the bin.

        `name`: A name that `library.list` of the bin gave.
        """
        return cast(Renamed, self.request({"type": "library.restore", "name": name}))

    def library_empty_bin(self) -> Removed:
        """Removes for good what is in the bin."""
        return cast(Removed, self.request({"type": "library.empty_bin"}))

    def library_export(self, name: str, format: str, *, body: str | None = None, bones: str | None = None, frame: str | None = None, model: str | None = None) -> Started:
        """Writes a recording as a file for another program into the folder `exports`, from where `/exports/FILE` serves it; a job, whose result is `{file, rows, bytes}`.

        `name`: A name that `library.list` gave.
        `format`: As `--to` of `posed export`: `csv`, `jsonl`, `bvh`, `trc`, `glb`, `vrm`, `vrma`, `usda`, `c3d`,
            `sto`, `mot`, `mcap`.
        `body`: As `--body`: which of several bodies is shown, by name.
        `bones`: As `--bones`, for `bvh`; absent: `posed`.
        `frame`: As `--frame`, for `csv`: `room` or `transmitter`; absent: `room`.
        `model`: As `--model`, for `mot`; absent: `rajagopal`.
        """
        return cast(Started, self.request({"type": "library.export", "name": name, "format": format, "body": body, "bones": bones, "frame": frame, "model": model}))

    def health_history(self) -> HealthHistory:
        """Tells how the sensors were in the last hour."""
        return cast(HealthHistory, self.request({"type": "health.history"}))

    def field_start(self, sensors: list[str], spacing_m: float) -> None:
        """Begins a guided calibration of the field: move the pole, and follow what the topic `field` says.

        `sensors`: The pole's sensors by name, in their order along it.
        `spacing_m`: Measured distance between neighbours, m.
        """
        self.request({"type": "field.start", "sensors": sensors, "spacing_m": spacing_m})

    def field_finish(self, *, anchors: list[AnchorSpec] | None = None) -> Started:
        """Ends the guided calibration and solves it, as a job.

        `anchors`: Surveyed points that a sensor of the pole stood on meanwhile; three or more make positions
            absolute.
        """
        return cast(Started, self.request({"type": "field.finish", "anchors": anchors}))

    def field_accept(self) -> MapVersion:
        """Uses the map of the last calibration from the next frame on, and keeps it as the stage's newest version."""
        return cast(MapVersion, self.request({"type": "field.accept"}))

    def field_rollback(self) -> MapVersion:
        """Goes back to the version before; to no map before the first."""
        return cast(MapVersion, self.request({"type": "field.rollback"}))

    def exercise_list(self) -> Exercises:
        """Names the exercises that can be selected: those in the stage's folder."""
        return cast(Exercises, self.request({"type": "exercise.list"}))

    def exercise_demonstration(self, exercise: str) -> Demonstration:
        """Shows how an exercise was taught, as a figure that moves.

        `exercise`: Its name, as `exercise.list` gave it.
        """
        return cast(Demonstration, self.request({"type": "exercise.demonstration", "exercise": exercise}))

    def exercise_teach(self, name: str, repetitions: int, *, body: str | None = None, channels: list[str] | None = None, last_s: float | None = None, sensors: list[str] | None = None, subject: str | None = None) -> Started:
        """Teaches an exercise from what is tracked; a job. The exercise is kept as a file, loaded, and counted for the
subject from then on.

        `name`: Name of the exercise: 1 to 64 letters, digits, spaces, `-` and `_`.
        `repetitions`: How many repetitions it is taught from; 3 to 10 are good.
        `body`: The body whose joints are looked at, by name; absent: the one that is called as the subject, or else
            the first one.
        `channels`: Only these channels; absent: those that do the same in every repetition.
        `last_s`: The repetitions lie in the last so many seconds; absent: they are about to be done, and the job
            ends once they were done and the subject rests.
        `sensors`: Only these sensors, by name; absent: all.
        `subject`: Who moves; absent: the name of the body, or `default`.
        """
        return cast(Started, self.request({"type": "exercise.teach", "name": name, "repetitions": repetitions, "body": body, "channels": channels, "last_s": last_s, "sensors": sensors, "subject": subject}))

    def exercise_select(self, exercises: list[str], *, body: str | None = None, repetitions: int | None = None, rest_s: float | None = None, sensors: dict[str, str] | None = None, sets: int | None = None, subject: str | None = None) -> None:
        """Counts exercises from 0 for a subject, and no others.

        `exercises`: Their names; none ends the counting.
        `body`: The body whose joints are counted, by name; absent: the one that is called as the subject, or else
            the first one.
        `repetitions`: Repetitions of a set; absent: one set without end.
        `rest_s`: Rest after a set, s; absent: none.
        `sensors`: For each sensor that the exercises were taught with the one that this subject wears; absent: the
            same.
        `sets`: Sets of each exercise; absent: no end.
        `subject`: Who moves; absent: the name of the body, or `default`.
        """
        self.request({"type": "exercise.select", "exercises": exercises, "body": body, "repetitions": repetitions, "rest_s": rest_s, "sensors": sensors, "sets": sets, "subject": subject})

    def exercise_reset(self, *, subject: str | None = None) -> None:
        """Counts a subject's exercises from 0 again.

        `subject`: Who moves; absent: `default`.
        """
        self.request({"type": "exercise.reset", "subject": subject})

    def faults_train(self, *, last_s: float | None = None, recording: str | None = None) -> Started:
        """Learns a fault map; a job. It is kept as a file, and takes the place of the one in use.

        `last_s`: From the last so many seconds; absent: from all that is remembered, five minutes at most.
        `recording`: From a recording instead: a name that `replay.list` gave.
        """
        return cast(Started, self.request({"type": "faults.train", "last_s": last_s, "recording": recording}))

    def faults_name_cell(self, row: int, column: int, class_: FaultClass) -> KeptFile:
        """Gives a cell of the fault map another class; kept as a file.

        `row`: Row, from 0.
        `column`: Column, from 0.
        `class_`: What frames of this cell are.
        """
        return cast(KeptFile, self.request({"type": "faults.name_cell", "row": row, "column": column, "class": class_}))

    def segments_train(self, *, epochs: int | None = None, look_ahead: int | None = None) -> Started:
        """Learns to name segments of the motion from the recordings that have labels beside them (`TAKE.labels.csv` or `TAKE.eaf`); a
job. The model is kept as a file, and takes the place of the one in use.

        `epochs`: Most epochs; absent: 30.
        `look_ahead`: Frames of 1/24 s that the network may look ahead: the fewer, the sooner labels are sure. More
            than 40, half of what it sees, is 40; absent: 40.
        """
        return cast(Started, self.request({"type": "segments.train", "epochs": epochs, "look_ahead": look_ahead}))

    def body_calibrate(self, *, body: str | None = None, how: Thoroughness | None = None) -> Started:
        """Finds how the body's sensors sit, and with `assign` on which segment each does, from poses and movements that the job's message
asks for one after the other; a job. It notices by itself when each was done, and swaps in what it found if it is good to
five degrees. Its result has `quality_deg` and `sensors` by segment.

        `body`: The person, by the name of the body; absent: the only one.
        `how`: How much is asked for; absent: `full`.
        """
        return cast(Started, self.request({"type": "body.calibrate", "body": body, "how": how}))

    def heading_reset(self, *, body: str | None = None, heading_deg: float | None = None, sensor: str | None = None) -> None:
        """The person looks this way now, upright: the headings of IMUs on the body that no field identifies begin anew from it. Gyros drift; this takes it away.

        `body`: The person, by the name of the body; absent: the one who wears the IMU, or the only one.
        `heading_deg`: How far to the left of the room's x the person looks, degrees, -360 to 360; absent: 0.
        `sensor`: The IMU, by name; absent: all on the body.
        """
        self.request({"type": "heading.reset", "body": body, "heading_deg": heading_deg, "sensor": sensor})

    def stage_align(self, *, anchors: list[RoomPoint] | None = None, sensor: str | None = None) -> Started:
        """Finds how the transmitter stands in the room, and how the IMU sits on a magnetic sensor that has one; a job, whose message
states what to do next. Both are swapped in if they are good.

        `anchors`: Surveyed points of the room that the sensor is held at, in this order; three or more where no IMU
            is attached to it.
        `sensor`: The magnetic sensor, by name; absent: the first that has an IMU, else the first.
        """
        return cast(Started, self.request({"type": "stage.align", "anchors": anchors, "sensor": sensor}))

    def imu_calibrate(self, *, sensor: str | None = None) -> Started:
        """Finds the intrinsics of an IMU that is placed in one direction after the other and turned between; a job, whose message
states what to do next and whose result states which directions were held. They are kept as a file of the unit and used from
then on, if they are good.

        `sensor`: The sensor, by name; absent: the only IMU of the stage.
        """
        return cast(Started, self.request({"type": "imu.calibrate", "sensor": sensor}))

    def session_begin(self, person: str, *, plan: str | None = None, subject: str | None = None) -> SessionBegun:
        """Begins a session: what a subject does from now on is kept for this person. With a plan its steps are selected one after the
other, with their rests, and the session ends after the last.

        `person`: Who trains: a name or a number of 1 to 64 bytes; taken in where it is new.
        `plan`: A plan that `session.plans` gave; absent: what is selected by hand.
        `subject`: The subject of the exercises; absent: `default`.
        """
        return cast(SessionBegun, self.request({"type": "session.begin", "person": person, "plan": plan, "subject": subject}))

    def session_end(self, *, subject: str | None = None) -> None:
        """Ends a session.

        `subject`: Of this subject; absent: `default`.
        """
        self.request({"type": "session.end", "subject": subject})

    def session_list(self, *, limit: int | None = None, person: str | None = None) -> ListedSessions:
        """Names sessions, the newest first.

        `limit`: At most so many, 1 to 1000; absent: 100.
        `person`: Only those of this person.
        """
        return cast(ListedSessions, self.request({"type": "session.list", "limit": limit, "person": person}))

    def session_show(self, session: int) -> Shown:
        """Gives a session in full.

        `session`: Its number.
        """
        return cast(Shown, self.request({"type": "session.show", "session": session}))

    def session_report(self, *, language: ReportLanguage | None = None, person: str | None = None, session: int | None = None, time_zone: str | None = None) -> Report:
        """Writes a report of one session, or of all sessions of a person.

        `language`: In which language; absent: `english`.
        `person`: the person.
        `session`: Number of the session; or
        `time_zone`: Time zone of its dates by its IANA name, `Europe/Berlin`; absent: that of the daemon.
        """
        return cast(Report, self.request({"type": "session.report", "language": language, "person": person, "session": session, "time_zone": time_zone}))

    def session_correct(self, session: int, set: int, counted: int) -> None:
        """Keeps the count of a set that somebody has seen, beside the one that was counted.

        `session`: Number of the session.
        `set`: Number of the set in it.
        `counted`: Repetitions that were really done.
        """
        self.request({"type": "session.correct", "session": session, "set": set, "counted": counted})

    def session_people(self) -> People:
        """Names everybody who trains."""
        return cast(People, self.request({"type": "session.people"}))

    def session_forget(self, person: str, recordings: bool) -> Forgotten:
        """Removes a person with everything of them.

        `person`: Who.
        `recordings`: Whether the recordings of their sessions go too, whoever else is in them.
        """
        return cast(Forgotten, self.request({"type": "session.forget", "person": person, "recordings": recordings}))

    def session_plans(self) -> Plans:
        """Gives all plans."""
        return cast(Plans, self.request({"type": "session.plans"}))

    def session_save_plan(self, plan: Plan) -> None:
        """Keeps a plan, in the place of one of its name.

        `plan`: The plan.
        """
        self.request({"type": "session.save_plan", "plan": plan})

    def session_delete_plan(self, name: str) -> None:
        """Removes a plan.

        `name`: Its name.
        """
        self.request({"type": "session.delete_plan", "name": name})

    def setup_read(self, *, changes: list[StageChange] | None = None) -> Setup:
        """Reads the stage file, as it would be with these changes, and says all that is wrong with it; nothing is written.

        `changes`: Made one after the other; none: the file as it is.
        """
        return cast(Setup, self.request({"type": "setup.read", "changes": changes}))

    def setup_save(self, changes: list[StageChange], revision: str) -> None:
        """Writes changes into the stage file, keeps the file of before beside it (its name and `~`), and begins the changed stage: all
connections are closed with code 1012 and served again at once. Refused as `busy` while a recording or another job runs, as
`changed` where the file is not what was read, as `failed` where the stage could not run like this.

        `changes`: Made one after the other.
        `revision`: The `revision` that `setup.read` gave.
        """
        self.request({"type": "setup.save", "changes": changes, "revision": revision})

    def setup_find(self, *, port: str | None = None) -> Started:
        """Asks the ports that no device of the stage has what is there; a job, whose `result` (`Found`) grows as they answer. A unit that
streams is stopped by the question; nothing else is changed.

        `port`: Only this one: path of a serial port, tcp://HOST:PORT or udp://HOST:PORT; absent: all serial ports,
            and the units that announce themselves on the network.
        """
        return cast(Started, self.request({"type": "setup.find", "port": port}))

    def phone_invite(self) -> Invitation:
        """Lets phones come as sensors, and says how: an address with a token that allows only this, as a text and as a
        QR code. The daemon listens there from then on.
        """
        return cast(Invitation, self.request({"type": "phone.invite"}))

    def phone_list(self) -> Phones:
        """The phones and other devices that are connected to the websocket `/imu` just now."""
        return cast(Phones, self.request({"type": "phone.list"}))

    def phone_blink(self, phone_id: str) -> None:
        """Has one of them show itself: a phone's page flashes. Refused as `not_connected` where it is not there.

        `phone_id`: Its id.
        """
        self.request({"type": "phone.blink", "phone_id": phone_id})

    def job_cancel(self, job: int) -> None:
        """Cancels a job.

        `job`: Its number.
        """
        self.request({"type": "job.cancel", "job": job})

    def model_load(self, model: Model) -> None:
        """Swaps a model in between two frames.

        `model`: The model, in full.
        """
        self.request({"type": "model.load", "model": model})
