"""Types of all messages. Generated from docs/schema/posed.v1.schema.json by clients/python/generate.py; do not edit."""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypeAlias, TypedDict

EVENT_TOPICS: tuple[str, ...] = ("exercise", "faults", "field", "keyframes", "marks", "segments")
"""Topics whose messages are events: never dropped, and asked for again after a reconnection."""

FIELDS: tuple[str, ...] = ("name", "state", "device", "position_m", "orientation_wxyz", "sigma_m", "measured", "covariance", "velocity", "quality", "fault", "change")
"""What a `sensors` message can say of each sensor."""


Addressing: TypeAlias = 'Literal["normal", "expanded", "super-expanded"]'
"""How units on the intra-bird bus are numbered."""


class AnchorSpec(TypedDict):
    """A surveyed point that a sensor of the pole stood on."""

    name: str
    """For messages."""

    position_m: list[float]
    """The point in the transmitter frame, m."""

    sensor: str
    """The sensor, by name."""

    t_end: float
    """Until when, stream time, s."""

    t_start: float
    """From when, stream time, s."""


Answer: TypeAlias = "Resumed | RecordingBegun | Started | Forgotten | Recordings | Tracked | Takes | Digested | Removed | Look | Labels | HealthHistory | Exercises | Demonstration | MapVersion | Setup | Invitation | Phones | KeptFile | SessionBegun | ListedSessions | Shown | Report | People | Plans | Renamed"
"""What a request was answered with; which one gets which: `Answers`. All others are answered with `ok` alone."""


Answers = TypedDict(
    "Answers",
    {
        "body.calibrate": "Started",
        "exercise.demonstration": "Demonstration",
        "exercise.list": "Exercises",
        "exercise.teach": "Started",
        "faults.name_cell": "KeptFile",
        "faults.train": "Started",
        "field.accept": "MapVersion",
        "field.finish": "Started",
        "field.rollback": "MapVersion",
        "health.history": "HealthHistory",
        "imu.calibrate": "Started",
        "library.digest": "Digested",
        "library.empty_bin": "Removed",
        "library.export": "Started",
        "library.list": "Takes",
        "library.remove": "Renamed",
        "library.rename": "Renamed",
        "library.restore": "Renamed",
        "phone.invite": "Invitation",
        "phone.list": "Phones",
        "record.start": "RecordingBegun",
        "replay.label": "Labels",
        "replay.labels": "Labels",
        "replay.list": "Recordings",
        "replay.look": "Look",
        "replay.seek": "Started",
        "replay.track": "Tracked",
        "resume": "Resumed",
        "segments.train": "Started",
        "session.begin": "SessionBegun",
        "session.forget": "Forgotten",
        "session.list": "ListedSessions",
        "session.people": "People",
        "session.plans": "Plans",
        "session.report": "Report",
        "session.show": "Shown",
        "setup.find": "Started",
        "setup.read": "Setup",
        "stage.align": "Started",
    },
)
"""The `result` of each request that has one, by the request's `type`."""


class Begun(TypedDict):
    """A repetition that is not judged."""

    count: int
    """Repetitions counted since it was selected or reset; only rises."""

    exercise: str
    """The exercise."""

    set_count: int
    """Repetitions of the set."""

    t_start_s: float
    """Beginning of the repetition, s."""


class CalibratedHinge(TypedDict):
    """A hinge between two sensors."""

    axis: list[float]
    """The same axis in the segment's own sensor."""

    parent_axis: list[float]
    """Unit axis in the parent's sensor."""

    quality_deg: float
    """How far two halves of the movement disagree about the axis, degrees."""

    zero_rad: float
    """Angle that counts as zero, rad, beside that of the segments' frames."""


class CalibratedSegment(TypedDict):
    """How one sensor of a chain sits."""

    hinge: NotRequired[CalibratedHinge | None]
    """The hinge to its parent; absent for the root."""

    name: str
    """The segment."""

    quat_wxyz: list[float]
    """Turns segment coordinates into the sensor's."""


class CallRecordStart(TypedDict):
    """Begins a recording."""

    id: RequestId
    """The reply carries it."""

    name: NotRequired[str | None]
    """File name within the recordings' folder, without a path; absent: stage and time."""

    type: Literal["record.start"]


class CallRecordStop(TypedDict):
    """Ends the recording."""

    id: RequestId
    """The reply carries it."""

    type: Literal["record.stop"]


class CallMark(TypedDict):
    """Notes this moment: an event of the topic `marks`, and in the recording that is in progress."""

    id: RequestId
    """The reply carries it."""

    label: NotRequired[str | None]
    """What happens now, 200 bytes at most; absent: nothing is said of it."""

    type: Literal["mark"]


class CallReplayList(TypedDict):
    """Names the recordings."""

    id: RequestId
    """The reply carries it."""

    type: Literal["replay.list"]


class CallReplayOpen(TypedDict):
    """Opens a recording."""

    id: RequestId
    """The reply carries it."""

    name: str
    """A name that `replay.list` gave."""

    type: Literal["replay.open"]


class CallReplayTrack(TypedDict):
    """Reads a few channels of a whole recording, to compare runs; answered when it is read."""

    columns: NotRequired[list[str]]
    """Up to six channels; absent: only their names are answered."""

    id: RequestId
    """The reply carries it."""

    name: str
    """A name that `replay.list` gave."""

    type: Literal["replay.track"]


class CallReplaySeek(TypedDict):
    """Goes to a time in the open recording."""

    id: RequestId
    """The reply carries it."""

    t_s: float
    """Seconds since the recording's epoch."""

    type: Literal["replay.seek"]


class CallReplaySpeed(TypedDict):
    """Sets the speed of the replay."""

    id: RequestId
    """The reply carries it."""

    speed: Speed
    """Multiple of real time; 0 pauses."""

    type: Literal["replay.speed"]


class CallReplayLook(TypedDict):
    """Tells where everything was at a time of the open recording, from what it shows to viewers: at once, and without
    moving the replay.
    """

    id: RequestId
    """The reply carries it."""

    t_s: float
    """Seconds since the recording's epoch."""

    type: Literal["replay.look"]


class CallReplayLabels(TypedDict):
    """Tells what somebody has said that a recording shows: the labels beside it, which `segments.train` learns from."""

    id: RequestId
    """The reply carries it."""

    name: str
    """A name that `library.list` gave."""

    type: Literal["replay.labels"]


class CallReplayLabel(TypedDict):
    """Says what a recording shows for a while, in the place of what was said of that time before; kept beside it,
    where `segments.train` reads it. The recording needs a digest.
    """

    from_s: float
    """Since when, stage time, s."""

    id: RequestId
    """The reply carries it."""

    label: str
    """What it shows, 200 bytes at most; empty: nothing is said of that time any more."""

    name: str
    """A name that `library.list` gave."""

    to_s: float
    """Until when, s."""

    type: Literal["replay.label"]


class CallLibraryList(TypedDict):
    """Tells which recordings there are, with what can be known of each without reading it."""

    bin: NotRequired[bool]
    """Those in the bin instead; absent: those in the folder."""

    id: RequestId
    """The reply carries it."""

    type: Literal["library.list"]


class CallLibraryDigest(TypedDict):
    """Tells what happens in a recording."""

    id: RequestId
    """The reply carries it."""

    make: NotRequired[bool]
    """Whether a job makes one where there is none: by a replay, as long as that takes; needs the role `operate`.
    Absent: no.
    """

    name: str
    """A name that `library.list` gave."""

    type: Literal["library.digest"]


class CallLibraryRename(TypedDict):
    """Gives a recording another name; what is kept beside it goes along."""

    id: RequestId
    """The reply carries it."""

    name: str
    """A name that `library.list` gave."""

    to: str
    """File name of letters, digits, `-`, `_`, `.` and spaces, without a path; one that is free."""

    type: Literal["library.rename"]


class CallLibraryRemove(TypedDict):
    """Puts a recording into the bin."""

    id: RequestId
    """The reply carries it."""

    name: str
    """A name that `library.list` gave."""

    type: Literal["library.remove"]


class CallLibraryRestore(TypedDict):
    """Takes a recording out of the bin."""

    id: RequestId
    """The reply carries it."""

    name: str
    """A name that `library.list` of the bin gave."""

    type: Literal["library.restore"]


class CallLibraryEmptyBin(TypedDict):
    """Removes for good what is in the bin."""

    id: RequestId
    """The reply carries it."""

    type: Literal["library.empty_bin"]


class CallLibraryExport(TypedDict):
    """Writes a recording as a file for another program into the folder `exports`, from where `/exports/FILE` serves
    it; a job, whose result is `{file, rows, bytes}`.
    """

    body: NotRequired[str | None]
    """As `--body`: which of several bodies is shown, by name."""

    bones: NotRequired[str | None]
    """As `--bones`, for `bvh`; absent: `posed`."""

    format: str
    """As `--to` of `posed export`: `csv`, `jsonl`, `bvh`, `trc`, `glb`, `vrm`, `vrma`, `usda`, `c3d`, `sto`, `mot`,
    `mcap`.
    """

    frame: NotRequired[str | None]
    """As `--frame`, for `csv`: `room` or `transmitter`; absent: `room`."""

    id: RequestId
    """The reply carries it."""

    model: NotRequired[str | None]
    """As `--model`, for `mot`; absent: `rajagopal`."""

    name: str
    """A name that `library.list` gave."""

    type: Literal["library.export"]


class CallHealthHistory(TypedDict):
    """Tells how the sensors were in the last hour."""

    id: RequestId
    """The reply carries it."""

    type: Literal["health.history"]


class CallFieldStart(TypedDict):
    """Begins a guided calibration of the field: move the pole, and follow what the topic `field` says."""

    id: RequestId
    """The reply carries it."""

    sensors: list[str]
    """The pole's sensors by name, in their order along it."""

    spacing_m: float
    """Measured distance between neighbours, m."""

    type: Literal["field.start"]


class CallFieldFinish(TypedDict):
    """Ends the guided calibration and solves it, as a job."""

    anchors: NotRequired[list[AnchorSpec]]
    """Surveyed points that a sensor of the pole stood on meanwhile; three or more make positions absolute."""

    id: RequestId
    """The reply carries it."""

    type: Literal["field.finish"]


class CallFieldAccept(TypedDict):
    """Uses the map of the last calibration from the next frame on, and keeps it as the stage's newest version."""

    id: RequestId
    """The reply carries it."""

    type: Literal["field.accept"]


class CallFieldRollback(TypedDict):
    """Goes back to the version before; to no map before the first."""

    id: RequestId
    """The reply carries it."""

    type: Literal["field.rollback"]


class CallExerciseList(TypedDict):
    """Names the exercises that can be selected: those in the stage's folder."""

    id: RequestId
    """The reply carries it."""

    type: Literal["exercise.list"]


class CallExerciseDemonstration(TypedDict):
    """Shows how an exercise was taught, as a figure that moves."""

    exercise: str
    """Its name, as `exercise.list` gave it."""

    id: RequestId
    """The reply carries it."""

    type: Literal["exercise.demonstration"]


class CallExerciseTeach(TypedDict):
    """Teaches an exercise from what is tracked; a job. The exercise is kept as a file, loaded, and counted for the
    subject from then on.
    """

    body: NotRequired[str | None]
    """The body whose joints are looked at, by name; absent: the one that is called as the subject, or else the first
    one.
    """

    channels: NotRequired[list[str] | None]
    """Only these channels; absent: those that do the same in every repetition."""

    id: RequestId
    """The reply carries it."""

    last_s: NotRequired[float | None]
    """The repetitions lie in the last so many seconds; absent: they are about to be done, and the job ends once they
    were done and the subject rests.
    """

    name: str
    """Name of the exercise: 1 to 64 letters, digits, spaces, `-` and `_`."""

    repetitions: int
    """How many repetitions it is taught from; 3 to 10 are good."""

    sensors: NotRequired[list[str] | None]
    """Only these sensors, by name; absent: all."""

    subject: NotRequired[str | None]
    """Who moves; absent: the name of the body, or `default`."""

    type: Literal["exercise.teach"]


class CallExerciseSelect(TypedDict):
    """Counts exercises from 0 for a subject, and no others."""

    body: NotRequired[str | None]
    """The body whose joints are counted, by name; absent: the one that is called as the subject, or else the first
    one.
    """

    exercises: list[str]
    """Their names; none ends the counting."""

    id: RequestId
    """The reply carries it."""

    repetitions: NotRequired[int | None]
    """Repetitions of a set; absent: one set without end."""

    rest_s: NotRequired[float | None]
    """Rest after a set, s; absent: none."""

    sensors: NotRequired[dict[str, str] | None]
    """For each sensor that the exercises were taught with the one that this subject wears; absent: the same."""

    sets: NotRequired[int | None]
    """Sets of each exercise; absent: no end."""

    subject: NotRequired[str | None]
    """Who moves; absent: the name of the body, or `default`."""

    type: Literal["exercise.select"]


class CallExerciseReset(TypedDict):
    """Counts a subject's exercises from 0 again."""

    id: RequestId
    """The reply carries it."""

    subject: NotRequired[str | None]
    """Who moves; absent: `default`."""

    type: Literal["exercise.reset"]


class CallFaultsTrain(TypedDict):
    """Learns a fault map; a job. It is kept as a file, and takes the place of the one in use."""

    id: RequestId
    """The reply carries it."""

    last_s: NotRequired[float | None]
    """From the last so many seconds; absent: from all that is remembered, five minutes at most."""

    recording: NotRequired[str | None]
    """From a recording instead: a name that `replay.list` gave."""

    type: Literal["faults.train"]


CallFaultsNameCell = TypedDict(
    "CallFaultsNameCell",
    {
        "class": "FaultClass",
        "column": "int",
        "id": "RequestId",
        "row": "int",
        "type": 'Literal["faults.name_cell"]',
    },
)
"""Gives a cell of the fault map another class; kept as a file."""


class CallSegmentsTrain(TypedDict):
    """Learns to name segments of the motion from the recordings that have labels beside them (`TAKE.labels.csv` or
    `TAKE.eaf`); a job. The model is kept as a file, and takes the place of the one in use.
    """

    epochs: NotRequired[int | None]
    """Most epochs; absent: 30."""

    id: RequestId
    """The reply carries it."""

    look_ahead: NotRequired[int | None]
    """Frames of 1/24 s that the network may look ahead: the fewer, the sooner labels are sure. More than 40, half of
    what it sees, is 40; absent: 40.
    """

    type: Literal["segments.train"]


class CallBodyCalibrate(TypedDict):
    """Finds how the body's sensors sit, and with `assign` on which segment each does, from poses and movements that
    the job's message asks for one after the other; a job. It notices by itself when each was done, and swaps in
    what it found if it is good to five degrees. Its result has `quality_deg` and `sensors` by segment.
    """

    body: NotRequired[str | None]
    """The person, by the name of the body; absent: the only one."""

    how: NotRequired[Thoroughness | None]
    """How much is asked for; absent: `full`."""

    id: RequestId
    """The reply carries it."""

    type: Literal["body.calibrate"]


class CallHeadingReset(TypedDict):
    """The person looks this way now, upright: the headings of IMUs on the body that no field identifies begin anew
    from it. Gyros drift; this takes it away.
    """

    body: NotRequired[str | None]
    """The person, by the name of the body; absent: the one who wears the IMU, or the only one."""

    heading_deg: NotRequired[float | None]
    """How far to the left of the room's x the person looks, degrees, -360 to 360; absent: 0."""

    id: RequestId
    """The reply carries it."""

    sensor: NotRequired[str | None]
    """The IMU, by name; absent: all on the body."""

    type: Literal["heading.reset"]


class CallStageAlign(TypedDict):
    """Finds how the transmitter stands in the room, and how the IMU sits on a magnetic sensor that has one; a job,
    whose message states what to do next. Both are swapped in if they are good.
    """

    anchors: NotRequired[list[RoomPoint]]
    """Surveyed points of the room that the sensor is held at, in this order; three or more where no IMU is attached to
    it.
    """

    id: RequestId
    """The reply carries it."""

    sensor: NotRequired[str | None]
    """The magnetic sensor, by name; absent: the first that has an IMU, else the first."""

    type: Literal["stage.align"]


class CallImuCalibrate(TypedDict):
    """Finds the intrinsics of an IMU that is placed in one direction after the other and turned between; a job, whose
    message states what to do next and whose result states which directions were held. They are kept as a file of
    the unit and used from then on, if they are good.
    """

    id: RequestId
    """The reply carries it."""

    sensor: NotRequired[str | None]
    """The sensor, by name; absent: the only IMU of the stage."""

    type: Literal["imu.calibrate"]


class CallSessionBegin(TypedDict):
    """Begins a session: what a subject does from now on is kept for this person. With a plan its steps are selected
    one after the other, with their rests, and the session ends after the last.
    """

    id: RequestId
    """The reply carries it."""

    person: str
    """Who trains: a name or a number of 1 to 64 bytes; taken in where it is new."""

    plan: NotRequired[str | None]
    """A plan that `session.plans` gave; absent: what is selected by hand."""

    subject: NotRequired[str | None]
    """The subject of the exercises; absent: `default`."""

    type: Literal["session.begin"]


class CallSessionEnd(TypedDict):
    """Ends a session."""

    id: RequestId
    """The reply carries it."""

    subject: NotRequired[str | None]
    """Of this subject; absent: `default`."""

    type: Literal["session.end"]


class CallSessionList(TypedDict):
    """Names sessions, the newest first."""

    id: RequestId
    """The reply carries it."""

    limit: NotRequired[int | None]
    """At most so many, 1 to 1000; absent: 100."""

    person: NotRequired[str | None]
    """Only those of this person."""

    type: Literal["session.list"]


class CallSessionShow(TypedDict):
    """Gives a session in full."""

    id: RequestId
    """The reply carries it."""

    session: int
    """Its number."""

    type: Literal["session.show"]


class CallSessionReport(TypedDict):
    """Writes a report of one session, or of all sessions of a person."""

    id: RequestId
    """The reply carries it."""

    language: NotRequired[ReportLanguage | None]
    """In which language; absent: `english`."""

    person: NotRequired[str | None]
    """the person."""

    session: NotRequired[int | None]
    """Number of the session; or"""

    time_zone: NotRequired[str | None]
    """Time zone of its dates by its IANA name, `Europe/Berlin`; absent: that of the daemon."""

    type: Literal["session.report"]


class CallSessionCorrect(TypedDict):
    """Keeps the count of a set that somebody has seen, beside the one that was counted."""

    counted: int
    """Repetitions that were really done."""

    id: RequestId
    """The reply carries it."""

    session: int
    """Number of the session."""

    set: int
    """Number of the set in it."""

    type: Literal["session.correct"]


class CallSessionPeople(TypedDict):
    """Names everybody who trains."""

    id: RequestId
    """The reply carries it."""

    type: Literal["session.people"]


class CallSessionForget(TypedDict):
    """Removes a person with everything of them."""

    id: RequestId
    """The reply carries it."""

    person: str
    """Who."""

    recordings: bool
    """Whether the recordings of their sessions go too, whoever else is in them."""

    type: Literal["session.forget"]


class CallSessionPlans(TypedDict):
    """Gives all plans."""

    id: RequestId
    """The reply carries it."""

    type: Literal["session.plans"]


class CallSessionSavePlan(TypedDict):
    """Keeps a plan, in the place of one of its name."""

    id: RequestId
    """The reply carries it."""

    plan: Plan
    """The plan."""

    type: Literal["session.save_plan"]


class CallSessionDeletePlan(TypedDict):
    """Removes a plan."""

    id: RequestId
    """The reply carries it."""

    name: str
    """Its name."""

    type: Literal["session.delete_plan"]


class CallSetupRead(TypedDict):
    """Reads the stage file, as it would be with these changes, and says all that is wrong with it; nothing is written."""

    changes: NotRequired[list[StageChange]]
    """Made one after the other; none: the file as it is."""

    id: RequestId
    """The reply carries it."""

    type: Literal["setup.read"]


class CallSetupSave(TypedDict):
    """Writes changes into the stage file, keeps the file of before beside it (its name and `~`), and begins the
    changed stage: all connections are closed with code 1012 and served again at once. Refused as `busy` while a
    recording or another job runs, as `changed` where the file is not what was read, as `failed` where the stage
    could not run like this.
    """

    changes: list[StageChange]
    """Made one after the other."""

    id: RequestId
    """The reply carries it."""

    revision: str
    """The `revision` that `setup.read` gave."""

    type: Literal["setup.save"]


class CallSetupFind(TypedDict):
    """Asks the ports that no device of the stage has what is there; a job, whose `result` (`Found`) grows as they
    answer. A unit that streams is stopped by the question; nothing else is changed.
    """

    id: RequestId
    """The reply carries it."""

    port: NotRequired[str | None]
    """Only this one: path of a serial port, tcp://HOST:PORT or udp://HOST:PORT; absent: all serial ports, and the
    units that announce themselves on the network.
    """

    type: Literal["setup.find"]


class CallPhoneInvite(TypedDict):
    """Lets phones come as sensors, and says how: an address with a token that allows only this, as a text and as a QR
    code. The daemon listens there from then on.
    """

    id: RequestId
    """The reply carries it."""

    type: Literal["phone.invite"]


class CallPhoneList(TypedDict):
    """The phones and other devices that are connected to the websocket `/imu` just now."""

    id: RequestId
    """The reply carries it."""

    type: Literal["phone.list"]


class CallPhoneBlink(TypedDict):
    """Has one of them show itself: a phone's page flashes. Refused as `not_connected` where it is not there."""

    id: RequestId
    """The reply carries it."""

    phone_id: str
    """Its id."""

    type: Literal["phone.blink"]


class CallJobCancel(TypedDict):
    """Cancels a job."""

    id: RequestId
    """The reply carries it."""

    job: int
    """Its number."""

    type: Literal["job.cancel"]


class CallModelLoad(TypedDict):
    """Swaps a model in between two frames."""

    id: RequestId
    """The reply carries it."""

    model: Model
    """The model, in full."""

    type: Literal["model.load"]


Call: TypeAlias = "CallRecordStart | CallRecordStop | CallMark | CallReplayList | CallReplayOpen | CallReplayTrack | CallReplaySeek | CallReplaySpeed | CallReplayLook | CallReplayLabels | CallReplayLabel | CallLibraryList | CallLibraryDigest | CallLibraryRename | CallLibraryRemove | CallLibraryRestore | CallLibraryEmptyBin | CallLibraryExport | CallHealthHistory | CallFieldStart | CallFieldFinish | CallFieldAccept | CallFieldRollback | CallExerciseList | CallExerciseDemonstration | CallExerciseTeach | CallExerciseSelect | CallExerciseReset | CallFaultsTrain | CallFaultsNameCell | CallSegmentsTrain | CallBodyCalibrate | CallHeadingReset | CallStageAlign | CallImuCalibrate | CallSessionBegin | CallSessionEnd | CallSessionList | CallSessionShow | CallSessionReport | CallSessionCorrect | CallSessionPeople | CallSessionForget | CallSessionPlans | CallSessionSavePlan | CallSessionDeletePlan | CallSetupRead | CallSetupSave | CallSetupFind | CallPhoneInvite | CallPhoneList | CallPhoneBlink | CallJobCancel | CallModelLoad"
"""Requests for the daemon. All but those that only tell something need the role `operate`: `replay.list`,
`replay.track`, `replay.look`, `replay.labels`, `library.list`, `library.digest` without `make`, `health.history`,
`exercise.list` and `exercise.demonstration`.
"""


Cause: TypeAlias = 'Literal["reference_sensor", "rigid_pair", "hum"]'
"""What tells of a disturbance."""


class ChainCalibration(TypedDict):
    """What a calibration found of a chain."""

    segments: list[CalibratedSegment]
    """One per segment, in the order of the stage file."""


class Change(TypedDict):
    """The statistic of key poses: it speaks of an earlier frame, since it needs the frames around it."""

    score: float
    """How clear a change of motion there would be: without unit, comparable between sensors; with `method = "paper"`,
    m a frame.
    """

    t_s: float
    """Capture time of the frame that it speaks of, s."""

    threshold: float
    """What a peak must exceed to be a key pose; with `method = "paper"`, a share of the mean motion before it."""


ClientMessage: TypeAlias = "Feed | Call"
"""Everything a client can send."""


class Contacts(TypedDict):
    """How likely each foot stands on the floor, 0 to 1: any part of it, or without a sensor on it, all of it."""

    foot_l: float
    """The left foot."""

    foot_r: float
    """The right foot."""

    sole_l: Sole | None
    """Heel and toes of the left foot; null where it wears no sensor."""

    sole_r: Sole | None
    """Heel and toes of the right foot; null where it wears no sensor."""


class Demonstration(TypedDict):
    """How an exercise was taught, as a figure that moves."""

    angles: list[str]
    """The angles that are shown, by their channels; all other joints hang straight."""

    duration_s: float
    """How long a repetition takes, s: the median of the lesson."""

    exercise: str
    """Name of the exercise."""

    frames: list[list[FigureSegment]]
    """The figure at equal distances in time, from the beginning of a repetition to its end."""

    revision: int
    """How often it was taught."""


class Deviation(TypedDict):
    """How a repetition differed from the taught ones."""

    channel: str
    """The channel that deviated most."""

    fifth_tempo: list[float]
    """Duration of each fifth of the movement, the taught one being 1."""

    jerk: float
    """Log dimensionless jerk above the taught one; 0.7 is twice the jerk."""

    phase: float
    """Where in the movement: 0 is the beginning, 1 the end."""

    range: float
    """Range of the channel, the taught one being 1."""

    size: float
    """Its deviation, in the channel's unit; positive is more than taught. At a turning point that of its way, beside
    how far the other joints went.
    """

    tempo: float
    """Duration, the taught median being 1."""

    worth: float
    """The same, the least that is worth a word being 1; 0 of a channel that no word is said of."""


DeviationKind: TypeAlias = 'Literal["too_far", "short", "too_high", "too_low", "moved"]'
"""In which way a channel deviates."""


class DeviceStatus(TypedDict):
    """Health of a device. Counts never go back."""

    age_s: float | None
    """Age of its newest sample, s; null before the first."""

    bytes_skipped: int
    """Bytes that belong to no accepted record and no answer."""

    driver: str
    """Its driver."""

    name: str
    """Its name."""

    port: str
    """Its port."""

    rate_hz: float | None
    """Measured rate, Hz; null until known."""

    reason: str | None
    """Why, and what to check; null while streaming."""

    records: int
    """Records accepted."""

    rejected: int
    """Records refused."""

    sigma_t_s: float | None
    """How well its clock is fitted to the host's: standard deviation of its capture times, s; null until known."""

    state: LinkState
    """What its link does."""


class Digest(TypedDict):
    """What happens in a recording. Times are stage time, s, as in `status.replay`. Of more than 2000 of a kind an even
    choice is listed.
    """

    begun_s: float
    """Stage time at which the recording begins, s."""

    counts: DigestCounts
    """How many of each kind happened."""

    dropped: DigestCounts
    """How many of each kind are not listed."""

    faults: list[FaultSpan]
    """Faults of sensors. One that has gone on since before the recording is in it from its end on."""

    first_frame_s: float | None
    """Capture time of its first frame, s: labels that are kept beside it count from there. Null where there is none."""

    key_poses: list[DigestKeyPose]
    """Confirmed key poses."""

    length_s: float
    """From there to its last entry, s."""

    marks: list[DigestMark]
    """Moments that somebody noted."""

    picture: Picture
    """Where sensors went."""

    repetitions: list[DigestRepetition]
    """Repetitions that were judged."""

    segments: list[SegmentSpan]
    """Segments of motion."""


class DigestCounts(TypedDict):
    """How many of each kind there are."""

    faults: int
    """Faults of sensors that began or went on."""

    key_poses: int
    """Confirmed key poses."""

    marks: int
    """Moments that somebody noted."""

    repetitions: int
    """Repetitions of exercises that were judged."""

    segments: int
    """Segments of motion."""


class DigestKeyPose(TypedDict):
    """A frame at which a sensor's motion changes."""

    sensor: str
    """Which sensor."""

    t_s: float
    """When, s."""


class DigestMark(TypedDict):
    """A moment that somebody noted."""

    label: str
    """What happened, in their words; may be empty."""

    t_s: float
    """When, s."""


class DigestRepetition(TypedDict):
    """A repetition that was judged."""

    counted: bool
    """Whether it counts."""

    exercise: str
    """The exercise."""

    from_s: float
    """Its beginning, s."""

    subject: str
    """Who moved."""

    t_s: float
    """Its end, s."""


class DigestedDigest(TypedDict):
    """The recording has one."""

    digest: Digest
    """It."""


class DigestedUnknown(TypedDict):
    """It has none, and none was to be made."""

    unknown: bool
    """Always true."""


class DigestedJob(TypedDict):
    """A job makes it; ask again when that has ended."""

    job: int
    """Its number."""


Digested: TypeAlias = "DigestedDigest | DigestedUnknown | DigestedJob"
"""What `library.digest` is answered with."""


DropPolicy: TypeAlias = 'Literal["latest", "queue"]'
"""What to do with messages for which a client is too slow. Either way the oldest goes first and is counted."""


class Durations(TypedDict):
    """Durations of repetitions, s."""

    interval_s: NotRequired[float]
    """Median from the end of one to the end of the next; 0: not known."""

    longest_s: float
    """Longest."""

    median_s: float
    """Median."""

    shortest_s: float
    """Shortest."""


EndedBy: TypeAlias = 'Literal["request", "plan", "daemon", "interruption", "recording"]'
"""How a session ended."""


Erasure: TypeAlias = 'Literal["done", "pending"]'
"""Whether the bytes of somebody who was forgotten are gone from the disk."""


class ErrorReply(TypedDict):
    """Reply to a request that was not carried out."""

    code: str
    """For programs: `bad_message`, `bad_request`, `unknown_type`, `unknown_sensor`, `forbidden`, `busy`, ..."""

    id: RequestId | None
    """The request's; null where it could not be read."""

    message: str
    """For people: what was wrong and what would be right, in one sentence."""

    reason: NotRequired[RefusalReason | None]
    """Which sentence, for who says it in another language; null where only `message` has it."""

    type: Literal["error"]
    """Which message it is."""

    values: NotRequired[dict[str, str]]
    """What the sentence names, by name: all that another language needs to say `reason`."""


class Exercise(TypedDict):
    """A taught exercise."""

    channels: list[str]
    """The channels it looks at, as `channels` names them."""

    durations: Durations
    """Durations of the taught repetitions."""

    format: str
    """`posed-exercise`."""

    gate: Gate
    """What a repetition must be like to count."""

    log_jerk: float
    """Log dimensionless jerk of the taught repetitions."""

    movement: Movement
    """Values and velocities of the channels, in this order."""

    name: str
    """Name, as in events."""

    rate_hz: float
    """Frames per second of the model."""

    rest: NotRequired[list[float]]
    """Where each channel was while all joints of the lesson rested, in the order of `channels`; empty: not known."""

    revision: NotRequired[int]
    """Counts how often an exercise of this name was taught, from 1."""

    sizes: NotRequired[list[float]]
    """Sizes in which the movement was taught, falling from 1: the first and the last step of a walk are smaller."""

    still: NotRequired[list[Still]]
    """Joints that keep still in it; empty: nothing is known of them."""

    tempi: NotRequired[list[float]]
    """Tempi in which it is counted, the taught one, 1, first: how fast joints go against the lesson. Other people go
    about it in their own.
    """

    turns: NotRequired[list[Turn]]
    """Turning point of each channel, in the order of `channels`; empty: those of the states' means, whose spread is
    not known.
    """

    version: int
    """Version of the format."""


class ExerciseEventMessageLoaded(TypedDict):
    """An exercise was loaded or taught, and can be selected."""

    channels: list[str]
    """The channels it looks at."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    duration_s: float
    """Median duration of a repetition, s."""

    event: Literal["loaded"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    exercise: str
    """Its name."""

    revision: int
    """How often an exercise of this name was taught."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    subject: str | None
    """Who moves; null where it concerns all."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s: of a repetition its end."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["exercise"]
    """Which message it is."""


class ExerciseEventMessageState(TypedDict):
    """Exercises were selected or reset, a set was completed, or a rest is over."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["state"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    state: ExerciseState
    """How far the subject is."""

    subject: str | None
    """Who moves; null where it concerns all."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s: of a repetition its end."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["exercise"]
    """Which message it is."""


class ExerciseEventMessageStarted(TypedDict):
    """A repetition has begun."""

    count: int
    """Repetitions counted since it was selected or reset; only rises."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["started"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    exercise: str
    """The exercise."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    set_count: int
    """Repetitions of the set."""

    subject: str | None
    """Who moves; null where it concerns all."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_start_s: float
    """Beginning of the repetition, s."""

    t_valid_s: float
    """Capture time it speaks of, s: of a repetition its end."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["exercise"]
    """Which message it is."""


class ExerciseEventMessageProvisional(TypedDict):
    """A repetition seems to be complete; `counted`, `rejected` or `withdrawn` follows."""

    count: int
    """Repetitions counted since it was selected or reset; only rises."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["provisional"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    exercise: str
    """The exercise."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    set_count: int
    """Repetitions of the set."""

    subject: str | None
    """Who moves; null where it concerns all."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_start_s: float
    """Beginning of the repetition, s."""

    t_valid_s: float
    """Capture time it speaks of, s: of a repetition its end."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["exercise"]
    """Which message it is."""


class ExerciseEventMessageWithdrawn(TypedDict):
    """What was provisional was none."""

    count: int
    """Repetitions counted since it was selected or reset; only rises."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["withdrawn"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    exercise: str
    """The exercise."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    set_count: int
    """Repetitions of the set."""

    subject: str | None
    """Who moves; null where it concerns all."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_start_s: float
    """Beginning of the repetition, s."""

    t_valid_s: float
    """Capture time it speaks of, s: of a repetition its end."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["exercise"]
    """Which message it is."""


class ExerciseEventMessageCounted(TypedDict):
    """A repetition is complete and counts."""

    count: int
    """Repetitions counted since it was selected or reset, with this one; only rises."""

    deviation: Deviation | None
    """What deviated most, worth a word or not."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["counted"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    exercise: str
    """The exercise."""

    reason: Reason | None
    """Why it does not count; null where it does."""

    remark: Spoken | None
    """The one thing to say of it; null where all was as taught."""

    score: Score | None
    """The repetition in points; null of one that does not count, and where it was not measured."""

    sentence: str | None
    """The same in words of the body; of one that does not count, why; null too of a movement that was not meant:
    another one, outside of a set.
    """

    sentence_de: str | None
    """The same in German."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    set_count: int
    """Repetitions of the set, with this one."""

    subject: str | None
    """Who moves; null where it concerns all."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_start_s: float
    """Beginning of the repetition, s."""

    t_valid_s: float
    """Capture time it speaks of, s: of a repetition its end."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["exercise"]
    """Which message it is."""


class ExerciseEventMessageRejected(TypedDict):
    """A repetition is complete and does not count."""

    count: int
    """Repetitions counted since it was selected or reset, with this one; only rises."""

    deviation: Deviation | None
    """What deviated most, worth a word or not."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["rejected"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    exercise: str
    """The exercise."""

    reason: Reason | None
    """Why it does not count; null where it does."""

    remark: Spoken | None
    """The one thing to say of it; null where all was as taught."""

    score: Score | None
    """The repetition in points; null of one that does not count, and where it was not measured."""

    sentence: str | None
    """The same in words of the body; of one that does not count, why; null too of a movement that was not meant:
    another one, outside of a set.
    """

    sentence_de: str | None
    """The same in German."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    set_count: int
    """Repetitions of the set, with this one."""

    subject: str | None
    """Who moves; null where it concerns all."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_start_s: float
    """Beginning of the repetition, s."""

    t_valid_s: float
    """Capture time it speaks of, s: of a repetition its end."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["exercise"]
    """Which message it is."""


class ExerciseEventMessageHint(TypedDict):
    """What deviates just now; may still turn out otherwise."""

    anomaly: bool
    """For half a second the movement has been likelier to be something else."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["hint"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    exercise: str | None
    """Its name; null, like the rest: what was said before is over."""

    phase: float | None
    """Where in the movement: 0 is the beginning, 1 the end."""

    sentence: str | None
    """In words."""

    sentence_de: str | None
    """The same in German."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    subject: str | None
    """Who moves; null where it concerns all."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s: of a repetition its end."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["exercise"]
    """Which message it is."""


ExerciseEventMessage: TypeAlias = "ExerciseEventMessageLoaded | ExerciseEventMessageState | ExerciseEventMessageStarted | ExerciseEventMessageProvisional | ExerciseEventMessageWithdrawn | ExerciseEventMessageCounted | ExerciseEventMessageRejected | ExerciseEventMessageHint"
"""What every data message starts with, and its body."""


class ExerciseProgress(TypedDict):
    """How far a subject is with an exercise."""

    count: int
    """Repetitions since it was selected or reset."""

    done: bool
    """All sets are complete."""

    exercise: str
    """Name of the exercise."""

    rest_until_s: float | None
    """End of the rest that goes on, s; null: none."""

    set: int
    """Number of the set, from 1."""

    set_count: int
    """Repetitions of that set."""


class ExerciseState(TypedDict):
    """Exercises of a subject, and how far it is."""

    body: str | None
    """The body whose joints are counted, by name; null on a stage without bodies."""

    exercises: list[ExerciseProgress]
    """The exercises that are counted."""

    repetitions: int | None
    """Repetitions of a set; null: one set without end."""

    rest_s: float
    """Rest after a set, s."""

    sets: int | None
    """Sets of each exercise; null: no end."""


class Exercises(TypedDict):
    """The exercises of the stage's folder."""

    exercises: list[KeptExercise]
    """By name."""


Family: TypeAlias = 'Literal["flock", "3d-guidance"]'
"""A family of units that share commands, words and error codes."""


FaultCause: TypeAlias = 'Literal["hemisphere_inversion", "vertical_inversion", "stuck", "gate", "missing", "not_finite", "saturated", "misfit", "swapped", "jump", "bone", "map", "distance"]'
"""Why a measurement, or a sensor, is not simply good."""


FaultClass: TypeAlias = 'Literal["clean", "inverted", "anomalous", "unknown"]'
"""What a measurement, or a frame, is."""


class FaultMessageFault(TypedDict):
    """A fault began or ended."""

    active: bool
    """Whether it began or ended."""

    cause: FaultCause
    """What is wrong with it."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["fault"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    sensor: str
    """Which sensor."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["faults"]
    """Which message it is."""


class FaultMessageMap(TypedDict):
    """A fault map was swapped in, or one of its cells has another name."""

    cells: list[FaultClass]
    """Class of each cell, row by row."""

    columns: int
    """Columns of the map."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["map"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    revision: int
    """Counted up by `faults.train` and `faults.name_cell`."""

    rows: int
    """Rows of the map."""

    sensors: list[str]
    """The sensors that it knows."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["faults"]
    """Which message it is."""

    usual_distance: float
    """A frame that is farther from its cell than this is unusual."""


FaultMessage: TypeAlias = "FaultMessageFault | FaultMessageMap"
"""What every data message starts with, and its body."""


class FaultSpan(TypedDict):
    """How long a sensor had a fault."""

    fault: FaultCause
    """What was wrong with it."""

    from_s: float
    """Since when, s: the recording's beginning where it had begun before."""

    sensor: str
    """Which sensor."""

    to_s: float
    """Until when, s: the recording's end where it went on."""


class FeedSubscribe(TypedDict):
    """Subscribes to topics; again for the same topic: with the new options. The reply is followed by the last state."""

    drop: NotRequired[DropPolicy | None]
    """What to do when this client is too slow; absent: `latest`."""

    fields: NotRequired[list[Field] | None]
    """What `sensors` and `truth` say of each sensor, beside its name and state; absent: `device`, `position_m`,
    `orientation_wxyz`, `sigma_m`.
    """

    id: RequestId
    """The reply carries it."""

    max_rate_hz: NotRequired[float | None]
    """At most so many messages per second and topic, events excepted; absent: every frame."""

    sensors: NotRequired[list[str] | None]
    """Only these sensors, by name; absent: all."""

    topics: list[Topic]
    """Which ones."""

    type: Literal["subscribe"]


class FeedUnsubscribe(TypedDict):
    """Ends subscriptions."""

    id: RequestId
    """The reply carries it."""

    topics: list[Topic]
    """Which ones."""

    type: Literal["unsubscribe"]


class FeedResume(TypedDict):
    """Sends the events of the subscribed topics that came after one, of the last ten minutes."""

    after: int
    """The last `event_id` that the client has; 0: all."""

    id: RequestId
    """The reply carries it."""

    type: Literal["resume"]


Feed: TypeAlias = "FeedSubscribe | FeedUnsubscribe | FeedResume"
"""Requests about what this client receives."""


Field: TypeAlias = 'Literal["name", "state", "device", "position_m", "orientation_wxyz", "sigma_m", "measured", "covariance", "velocity", "quality", "fault", "change"]'
"""Something that a `sensors` entry can say; name and state are always said."""


class FieldAskShow(TypedDict):
    """Switch its sensors on, or bring it near: none of them is seen."""

    ask: Literal["show"]


class FieldAskMove(TypedDict):
    """Move it."""

    ask: Literal["move"]


class FieldAskBegin(TypedDict):
    """Move it for a minute: there is too little to judge by."""

    ask: Literal["begin"]

    instants: int
    """Instants that could be used so far."""


class FieldAskCarry(TypedDict):
    """Carry it along a direction."""

    along: list[float]
    """Which."""

    ask: Literal["carry"]

    moved_m: float
    """How far its middle has moved that way (standard deviation), m."""


class FieldAskHold(TypedDict):
    """Hold it along a direction, in which it was hardly ever."""

    along: list[float]
    """Which."""

    ask: Literal["hold"]


class FieldAskHoldOnce(TypedDict):
    """The same, where it never was."""

    along: list[float]
    """Which."""

    ask: Literal["hold_once"]


class FieldAskVisit(TypedDict):
    """Go near a place."""

    ask: Literal["visit"]

    near_m: list[float]
    """Middle of what was not, m."""

    visited: float
    """Share of the volume that was visited, 0 to 1."""


class FieldAskGoOn(TypedDict):
    """Go on: everything was seen, but too briefly."""

    ask: Literal["go_on"]


FieldAsk: TypeAlias = "FieldAskShow | FieldAskMove | FieldAskBegin | FieldAskCarry | FieldAskHold | FieldAskHoldOnce | FieldAskVisit | FieldAskGoOn"
"""What somebody is asked to do with the pole. Directions and places are in the transmitter's frame."""


class FieldEventMessageModelSwapped(TypedDict):
    """A model was swapped in between two frames."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["model_swapped"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    model: Model
    """The model, in full."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["field"]
    """Which message it is."""


class FieldEventMessageMapSwapped(TypedDict):
    """A map was swapped in between two frames, or taken away."""

    anchors_m: float | None
    """Rms at the anchors, m; null without three."""

    arrows_m: list[list[list[float]]]
    """What it does: pairs of a reading and its corrected place all over the calibrated volume, transmitter frame, m."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["map_swapped"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    heldout_m: float | None
    """The same on blocks that were held out, m."""

    map: str | None
    """What it is made of; null: poses are not corrected."""

    raw_m: float | None
    """Rms distance from straight poles when it was made, m: without correction, and with it; null without a map."""

    residual_m: float | None
    """See `raw_m`."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["field"]
    """Which message it is."""

    version: int
    """Its number on this stage, 0 for none."""


class FieldEventMessageDisturbed(TypedDict):
    """Metal or the mains disturb the field, or do so no longer. Meanwhile poses are less certain and nothing is
    learnt.
    """

    active: bool
    """Began or ended."""

    cause: Cause
    """What tells of it."""

    deviation_m: float
    """How far off they are, m."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["disturbed"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    sensors: list[str]
    """The reference sensor, or the pair."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["field"]
    """Which message it is."""


class FieldEventMessageDrifted(TypedDict):
    """The field has changed for good: calibrate again."""

    deviation_m: float
    """How far off they have stayed, m."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["drifted"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    sensors: list[str]
    """The reference sensor, or the pair."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["field"]
    """Which message it is."""


class FieldEventMessageCalibrating(TypedDict):
    """How far a guided calibration is, once a second."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: Literal["calibrating"]

    event_id: int
    """Stage-wide number of the event, from 1."""

    progress: Progress
    """Where it is."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time it speaks of, s."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["field"]
    """Which message it is."""


FieldEventMessage: TypeAlias = "FieldEventMessageModelSwapped | FieldEventMessageMapSwapped | FieldEventMessageDisturbed | FieldEventMessageDrifted | FieldEventMessageCalibrating"
"""What every data message starts with, and its body."""


class FigureMessage(TypedDict):
    """What every data message starts with, and its body."""

    contacts: Contacts | None
    """How likely each foot stands; null unless sensors show the pelvis and both legs now."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    heading: HeadingSource
    """Where the heading comes from."""

    heading_held_s: float
    """For how long it has been held without a field that is believed, s; 0 otherwise."""

    heading_sigma_deg: float | None
    """Standard deviation of the heading, degrees: a calibrated magnetometer's, or how far calibrated gyros drift since
    a field last identified it, or since `heading.reset`; null where it is not known.
    """

    joints: list[JointEntry]
    """The joints between them."""

    name: str
    """Which body it is, by its name in the stage file."""

    position_sigma_m: float | None
    """Standard deviation of the position along each level axis, m: by trackers, or from where they were heard last, or
    where it began, by the feet; null where nobody knows how far it has gone.
    """

    position_source: PositionSource
    """Where the position comes from."""

    segments: list[SegmentEntry]
    """The segments, parents and children by the skeleton of the stage."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Capture time of the newest sample in it, s; rises strictly from one message of this body to the next."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["body"]
    """Which message it is."""


class FigureSegment(TypedDict):
    """A segment of a figure that stands above the room's origin and looks along the room's x."""

    name: str
    """Its name, as in `body`."""

    orientation_wxyz: list[float]
    """Segment to room, unit, scalar first."""

    position_m: list[float]
    """Its origin, room, m."""


class Forgotten(TypedDict):
    """What went with a person."""

    erasure: Erasure
    """Whether the bytes are gone too."""

    recordings: list[str]
    """The recordings that these sessions name; whoever has the files removes them."""

    sessions: int
    """Sessions with all that was in them."""


class Found(TypedDict):
    """The `result` of a job of `setup.find`, of `posed doctor` likewise; grows while ports answer."""

    ports: list[FoundPort]
    """What was found at each port."""


class FoundPort(TypedDict):
    """What was found at one port."""

    addressing: Addressing | None
    """How units on the bus are numbered."""

    adds: NotRequired[list[StageChange]]
    """The changes that add the device with its sensors to the stage file; none where nothing usable answers."""

    baud: int | None
    """Line rate at which it answers, bit/s."""

    device: NotRequired[str | None]
    """The device of this stage that the port belongs to, by name: it is not asked. Absent where there is none."""

    driver: str | None
    """The driver that understands what is there; null where nothing answers."""

    family: NotRequired[Family | None]
    """Which of Ascension's units it is, where it is no Flock of Birds."""

    fix: str | None
    """What to do about it."""

    local_port: NotRequired[int | None]
    """Port of this computer that the device sends to, where it has a certain one."""

    model: str | None
    """Model as the unit writes it."""

    port: str
    """The port as a stage file names it."""

    problem: str | None
    """What is wrong."""

    rate_hz: float | None
    """Measurement rate, Hz."""

    revision: str | None
    """Software revision, such as `3.67`."""

    sensors: list[FoundSensor]
    """Units that have a sensor, by rising address."""


class FoundSensor(TypedDict):
    """One unit with a sensor."""

    address: int
    """Address on the device; 0 is a stand-alone unit."""

    serial: NotRequired[str | None]
    """Serial number, where the device reports one; a SlimeVR tracker's network address."""


class FrameLabel(TypedDict):
    """What the fault map reports about a frame."""

    cause: FaultCause | None
    """Why; null where it is clean."""

    cell: int | None
    """The cell that wins: row times columns plus column; null where no sensor is there."""

    distance: float | None
    """Distance of the frame from its cell, in shares of a chain; null where no sensor is there."""

    label: FaultClass
    """Rules and map together: inverted if most sensors are, anomalous if any is not clean."""


class Gate(TypedDict):
    """What a repetition must be like to count; see `judge`."""

    duration: list[float]
    """Least and greatest duration, the taught one being 1."""

    fifth_log_ratio: float
    """Least mean log ratio in the worst fifth."""

    gain: list[float]
    """Least and greatest size of the movement, the taught one being 1."""

    mean_log_ratio: float
    """Least mean log ratio of exercise and background, per frame."""

    similarity: float
    """Least correlation with the taught movement."""

    visited: float
    """Least share of the states visited."""


class Gaussians(TypedDict):
    """Means and standard deviations of Gaussians with one variance per channel, `[channel][state]`."""

    mean: list[list[float]]
    """Mean, in the channel's unit (velocities: per second)."""

    sd: list[list[float]]
    """Standard deviation, in the same."""


HeadingSource: TypeAlias = 'Literal["unknown", "field", "held"]'
"""Where a body's heading comes from."""


class HealthHistory(TypedDict):
    """The last hour in equal steps, the oldest first. All lists have the same length, 360 at most; null where nothing
    is known of a step.
    """

    bin_s: float
    """Length of a step, s."""

    newest_t_s: float | None
    """Host time at which the newest step ends, s; null before the first."""

    sensors: list[SensorHistory]
    """Sensors, in the stage file's order."""


class Hello(TypedDict):
    """Who speaks, and what there is."""

    bodies: list[HelloBody]
    """The bodies that wear sensors, in the stage's order."""

    epoch_utc: str
    """The stage's epoch: UTC in RFC 3339 with nanoseconds."""

    height_m: float | None
    """Its height, m: gives the lengths of the segments; null where it is not known."""

    last_event_id: int
    """Number of the newest event, 0 before the first: what a client that starts now has not missed."""

    role: Role
    """What this client may do."""

    sensors: list[HelloSensor]
    """The stage's sensors, in the order of the `sensors` message."""

    skeleton: Skeleton | None
    """The first body's skeleton; null on a stage without a body."""

    stage: str
    """Name of the stage."""

    topics: list[Topic]
    """Topics that this stage publishes."""

    transmitter: Pose
    """Magnetic transmitter to room, as the stage file has it; a `field` event tells when it is changed."""

    transmitter_given: bool
    """Whether the stage file says how the transmitter stands; without, `transmitter` is where the room's axes are
    taken from.
    """

    type: Literal["hello"]
    """Which message it is."""

    version: str
    """Version of the daemon."""


class HelloBody(TypedDict):
    """Who wears sensors."""

    color: str
    """Colour that it is to be drawn in, `#rrggbb`."""

    height_m: float | None
    """Its height, m: gives the lengths of its segments; null where it is not known."""

    name: str
    """Its name."""

    skeleton: Skeleton
    """Its skeleton."""


class HelloSensor(TypedDict):
    """A sensor by name."""

    device: str
    """Its device's name."""

    magnetic: bool
    """Whether it is a magnetic tracker's, and so measures positions."""

    name: str
    """Its name."""


class HostClock(TypedDict):
    """The wall clock of the computer that the stage runs on. The stage's own times do not follow it: they count from
    `hello.epoch_utc`.
    """

    estimated_error_s: float
    """How far off it is taken to be, s."""

    max_error_s: float
    """How far off it may be at most, s; 16 s and more where nothing follows."""

    synchronised: bool
    """Whether it follows another clock, by NTP or PTP."""

    tai_offset_s: int | None
    """TAI minus UTC, s, which PTP works with; null where nobody has set it."""


class Intrinsics(TypedDict):
    """What was found for one unit."""

    accel_bias_m_s2: list[float]
    """Subtract from the accelerometer, m/s²; then multiply by scale and cross-axis terms."""

    accel_cross: NotRequired[list[float]]
    """What each axis feels of another, beside the scale: yz, xz, xy of a symmetric matrix; zero from fewer than 12
    directions.
    """

    accel_residual_m_s2: float
    """Root mean square of the length's error over the rests, m/s²."""

    accel_scale: list[float]
    """Multiply the accelerometer, after subtracting the bias."""

    directions: int
    """Directions that were held."""

    gyro_bias_rad_s: list[float]
    """Subtract from the gyro, rad/s."""

    gyro_bias_sigma_rad_s: float
    """Standard deviation of that bias between the rests, rad/s."""

    mag: NotRequired[MagIntrinsics | None]
    """The magnetometer's, where there is one."""

    unit: NotRequired[str | None]
    """The unit: its serial number, or the sensor's name where the device tells none; absent: the file's name specifies
    it.
    """


class Invitation(TypedDict):
    """How a phone comes."""

    authority: str | None
    """What the daemon's own authority is called, which a phone may be set to trust; null where the stage file names a
    certificate.
    """

    fingerprint: str
    """The SHA-256 fingerprint of the authority's certificate; empty where the stage file names a certificate."""

    others: list[str]
    """The same page by the other addresses and the name of this computer."""

    page: str
    """The page to open on the phone, with the token for sensors behind `#`."""

    qr: QrCode
    """`page` as a QR code."""


class Job(TypedDict):
    """A long job."""

    job: int
    """Its number, for `job.cancel`."""

    kind: str
    """What it does, by the name of the request that started it."""

    message: str | None
    """Outcome or reason of failure, in one sentence."""

    progress: float | None
    """0 to 1; null where it has no known end, as a recording."""

    remaining_s: float | None
    """Expected time to its end, s; null where unknown."""

    result: NotRequired[Any]
    """What came of it, where it is more than a sentence: of `exercise.teach` where the repetitions were seen."""

    state: JobState
    """How it stands."""


JobState: TypeAlias = 'Literal["running", "done", "failed", "cancelled"]'
"""How a job stands."""


class JobsMessage(TypedDict):
    """What every data message starts with, and its body."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    jobs: list[Job]
    """All jobs, running and lately ended."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Host time, s; rises strictly."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["jobs"]
    """Which message it is."""


class JointEntry(TypedDict):
    """A joint."""

    angle_sigmas_deg: dict[str, float | None]
    """Standard deviation of each angle, degrees, by the same names; null where the angle is."""

    angles_deg: dict[str, float | None]
    """Its angles by name, degrees; null where a segment beside it is not known."""

    covariance_of: list[str]
    """The independent angles, in the order of the covariance's rows: a shoulder's flexion and abduction follow from
    the others.
    """

    covariance_rad2: list[float] | None
    """Covariance of the angles in `covariance_of`, rad²: the upper triangle row by row; null where they are."""

    limited_by: str | None
    """The segment whose sensor is faulty or missing, if any: why the joint is not `ok`."""

    name: str
    """Its name."""

    sigma_deg: float
    """Root mean square of the expected error of one angle, degrees."""

    state: SegmentState
    """How far to trust it: as the worse of the segments beside it."""


class Judged(TypedDict):
    """A repetition that is judged."""

    count: int
    """Repetitions counted since it was selected or reset, with this one; only rises."""

    deviation: Deviation | None
    """What deviated most, worth a word or not."""

    exercise: str
    """The exercise."""

    reason: Reason | None
    """Why it does not count; null where it does."""

    remark: Spoken | None
    """The one thing to say of it; null where all was as taught."""

    score: Score | None
    """The repetition in points; null of one that does not count, and where it was not measured."""

    sentence: str | None
    """The same in words of the body; of one that does not count, why; null too of a movement that was not meant:
    another one, outside of a set.
    """

    sentence_de: str | None
    """The same in German."""

    set_count: int
    """Repetitions of the set, with this one."""

    t_start_s: float
    """Beginning of the repetition, s."""


class KeptExercise(TypedDict):
    """An exercise that can be selected."""

    name: str
    """Its name."""

    revision: int
    """The newest revision: how often it was taught."""


class KeptFile(TypedDict):
    """A file that was written."""

    file: str
    """Its name."""

    revision: int
    """The revision of what it holds."""


class KeyPoseMessage(TypedDict):
    """What every data message starts with, and its body."""

    corner: bool
    """Whether the velocity changes at once rather than gently."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event_id: int
    """Stage-wide number of the event, from 1."""

    phase: Phase
    """Whether it is for good."""

    score: float
    """How clear the change is: without unit, comparable between sensors; with `method = "paper"`, m a frame."""

    screw: ScrewMotion | None
    """Where it is for good: what the sensor did since the key pose before it, as one screw motion; null where nothing
    moved, or nobody knows where the sensor is.
    """

    sensor: str
    """Which sensor."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time of the key pose, s: the same in all events about one key pose."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["keyframes"]
    """Which message it is."""


class LabelSpan(TypedDict):
    """What somebody says that a motion shows for a while."""

    from_s: float
    """Since when, stage time, s."""

    label: str
    """What it shows."""

    to_s: float
    """Until when, s."""


class Labels(TypedDict):
    """What somebody says that a recording shows."""

    labels: list[LabelSpan]
    """In order of time."""


class LearntEntry(TypedDict):
    """What movements have shown of a segment."""

    length_m: float | None
    """Length of a thigh, an upper arm or a shank, m; null for a forearm."""

    length_sigma_m: float | None
    """Its standard deviation, m."""

    mounting_sigma_deg: float
    """How well it is known how its sensor sits, root mean square about an axis, degrees."""

    turned_deg: float
    """By how much its sensor sits otherwise than the calibration found, degrees: a strap has slipped, or a pose was
    not held so well.
    """


class LibraryTake(TypedDict):
    """A recording in one line."""

    bytes: int
    """Size of the file, bytes."""

    complete: bool
    """Whether it has an index: it was ended in order, or repaired."""

    counts: DigestCounts | None
    """How much happens in it; null where it has no digest."""

    length_s: float | None
    """How long it is, s; null where that is not known without reading all of it."""

    name: str
    """Its file name."""

    picture: Picture | None
    """A small picture; null where it has no digest."""

    stage: str
    """Name of its stage; empty where it cannot be read."""

    unreadable: str | None
    """Why it cannot be read; null where it can."""

    utc: str | None
    """When it begins: UTC in RFC 3339; null where it cannot be read."""


LinkState: TypeAlias = 'Literal["streaming", "connecting", "silent", "failed"]'
"""What a device's link does."""


class ListedSessions(TypedDict):
    """Sessions in one line each."""

    sessions: list[SessionSummary]
    """The newest first."""


class Look(TypedDict):
    """Where everything was, as a recording shows it to viewers: five times a second, in a full one at every frame."""

    bodies: list[LookBody]
    """Bodies of which something was shown, in the stage file's order."""

    sensors: list[LookSensor]
    """Sensors that were good then, in the stage file's order."""

    t_s: float
    """Stage time of what is shown, s: of several the latest."""


class LookBody(TypedDict):
    """A body at a time."""

    name: str
    """Its name."""

    segments: list[FigureSegment]
    """Its segments, as in `body`."""


class LookSensor(TypedDict):
    """A sensor at a time."""

    name: str
    """Its name."""

    orientation_wxyz: list[float]
    """Sensor to room, unit quaternion, scalar first."""

    position_m: list[float] | None
    """Its position in the room, m; null for one that measures none."""


class MagIntrinsics(TypedDict):
    """Hard and soft iron: `m = matrix (raw - offset)` has the length `norm` in every direction."""

    matrix: list[list[float]]
    """Soft iron, row by row; symmetric, determinant 1."""

    norm: float
    """Length of the corrected field, in the unit of the samples."""

    offset: list[float]
    """Hard iron, in the unit of the samples."""

    residual: float
    """Root mean square of the length's error, as a part of the length."""


class MapVersion(TypedDict):
    """The map of the field that is in use now."""

    version: int
    """Its version."""


class MarkMessage(TypedDict):
    """What every data message starts with, and its body."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event_id: int
    """Stage-wide number of the event, from 1."""

    label: str
    """What happened, in the words of whoever noted it; may be empty."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was noted, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time of the frame before it, s."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["marks"]
    """Which message it is."""


class Measured(TypedDict):
    """A raw record in device axes."""

    angular_velocity_rad_s: NotRequired[list[float] | None]
    """Angular rate of a body-worn sensor in its own axes, rad/s; this and the following only where the record holds
    them.
    """

    button: int | None
    """Button byte; null where button mode is off."""

    linear_acceleration_m_s2: NotRequired[list[float] | None]
    """Acceleration in sensor axes with gravity taken out by the device, m/s²."""

    magnetic_field: NotRequired[list[float] | None]
    """Magnetic field in sensor axes, about 1 at the place of calibration."""

    orientation_wxyz: list[float] | None
    """Sensor to device axes; null in position-only formats."""

    position_m: list[float] | None
    """Position in device axes, m; null in orientation-only formats."""

    specific_force_m_s2: NotRequired[list[float] | None]
    """Specific force in sensor axes (+g on the axis that points up, at rest), m/s²."""

    t_s: float
    """Capture time of this record, s."""


class ModelTransmitter(TypedDict):
    """Where the transmitter stands in the room."""

    kind: Literal["transmitter"]

    orientation_wxyz: list[float]
    """Turns transmitter coordinates into room coordinates."""

    position_m: list[float]
    """Position of the transmitter in the room, m."""


class ModelTrackerNoise(TypedDict):
    """How noisy the tracker is: standard deviations at the reference distance `r0_m`."""

    device: str
    """The device it speaks of, by name."""

    kind: Literal["tracker_noise"]

    r0_m: float
    """Reference distance from the transmitter, m."""

    sigma_radial_m: float
    """Standard deviation along the transmitter ray at `r0_m`, m (grows with r^4)."""

    sigma_rotation_rad: float
    """Rotation standard deviation at `r0_m`, rad (grows with r^3)."""


class ModelField(TypedDict):
    """Where metal bends the field: what a file of `posed field solve` holds."""

    kind: Literal["field"]

    map: NotRequired[dict[str, Any] | None]
    """The map; null takes the present one away."""

    version: int
    """Number of the map on its stage, from 1; 0 is none."""


class ModelMounting(TypedDict):
    """How the body's sensors sit, as a calibration found it."""

    body: NotRequired[str | None]
    """The body, by name; absent: the only one."""

    kind: Literal["mounting"]

    sensors: list[MountedSensor]
    """One per sensor on the body."""


class ModelChain(TypedDict):
    """How the sensors of a chain of hinges sit and where its axes are, as a calibration found it."""

    body: NotRequired[str | None]
    """The body, by name; absent: the only one."""

    calibration: ChainCalibration
    """One entry per segment of the stage file."""

    kind: Literal["chain"]


class ModelAttachedImu(TypedDict):
    """How an IMU sits on the magnetic sensor that it is attached to, as `stage.align` found it."""

    clock_offset_s: float
    """Capture time of a magnetic record on the IMU's clock minus the one it is given, s."""

    kind: Literal["attached_imu"]

    offset_m: list[float]
    """From the magnetic sensor to the IMU, the magnetic sensor's axes, m."""

    quat_wxyz: list[float]
    """Turns the IMU's coordinates into the magnetic sensor's."""

    sensor: str
    """The magnetic sensor, by name."""


class ModelImu(TypedDict):
    """Intrinsics of an IMU; they take the place of those before, and filters that knew the unit begin anew."""

    intrinsics: Intrinsics
    """As in its file; the field in the unit that the device itself measures in, about 1."""

    kind: Literal["imu"]

    unit: str
    """The unit: its serial number, or the name of its sensor where neither device nor stage file tell one."""


class ModelExercise(TypedDict):
    """A taught exercise; it takes the place of the one of its name."""

    exercise: Exercise
    """The exercise, as in its file."""

    kind: Literal["exercise"]


Model: TypeAlias = "ModelTransmitter | ModelTrackerNoise | ModelField | ModelMounting | ModelChain | ModelAttachedImu | ModelImu | ModelExercise"
"""A model that can be swapped in between two frames."""


class MotionSegmentMessage(TypedDict):
    """What every data message starts with, and its body."""

    body: str | None
    """Whose motion it is, by the name of the body; null on a stage without one."""

    confidence: float
    """The network's probability of the label at the segment's first frame, 0 to 1; 0 of a withdrawn one."""

    delay_s: float
    """How long after its beginning a segment is confirmed at the latest, s."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    event: SegmentEvent
    """What is said of the segment."""

    event_id: int
    """Stage-wide number of the event, from 1."""

    label: str
    """What it shows."""

    segment: int
    """Number of the segment, from 1, body by body: all events of one segment carry it. It ends where the next
    confirmed one of the body begins.
    """

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame)."""

    t_valid_s: float
    """Capture time at which the segment begins, s; of a confirmed one it may differ a little from the provisional
    one's.
    """

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["segments"]
    """Which message it is."""


class MountedSensor(TypedDict):
    """How one sensor sits on its segment."""

    mount_quat_wxyz: list[float]
    """Turns sensor coordinates into segment coordinates."""

    offset_m: list[float]
    """Where it sits, segment frame, m."""

    segment: NotRequired[str | None]
    """The segment it was found on, by name; absent: where it was taken to sit before."""

    sensor: str
    """The sensor, by name."""

    sigma_deg: NotRequired[list[float] | None]
    """How well the rotation is known: standard deviations about the segment's axes, degrees; absent: it is exact."""


class Movement(TypedDict):
    """What is known about an exercise's movement."""

    amplitude: list[float]
    """Half the range of the mean of the largest channel of each channel's kind."""

    background: Gaussians
    """Background: state 0 is rest, 1 is any movement."""

    states: Gaussians
    """The states in order."""


MovementPhase: TypeAlias = 'Literal["start", "way_up", "top", "way_back", "end"]'
"""Where in the movement, relative to the turning point of the channel."""


class OkReply(TypedDict):
    """Reply to a request that was carried out."""

    id: RequestId | None
    """The request's."""

    result: NotRequired[Answer | None]
    """What was asked for, where the request asks for something: see `Answers`."""

    type: Literal["ok"]
    """Which message it is."""


class People(TypedDict):
    """Everybody who trains."""

    people: list[Person]
    """By name."""


class Person(TypedDict):
    """Somebody who trains."""

    last: NotRequired[str | None]
    """When the newest began, RFC 3339 in UTC; absent: none yet."""

    name: str
    """A name or a number."""

    sessions: int
    """Sessions so far."""


Phase: TypeAlias = 'Literal["provisional", "confirmed", "withdrawn"]'
"""How final an event is that can be taken back."""


class Phone(TypedDict):
    """One that is connected."""

    adds: list[StageChange]
    """The changes that make it one, without a segment; none where it is one."""

    orientation_wxyz: list[float] | None
    """How it is held, as it reports that itself: its axes in a world whose z is up; null where it has not."""

    peer: str
    """Where it is connected from."""

    phone_id: str
    """What it calls itself for good."""

    phone_name: str
    """Its name, for people; may be empty."""

    sensor: str | None
    """The stage's sensor that it is, by name; null: none yet."""


class Phones(TypedDict):
    """What is connected to the websocket `/imu`."""

    phones: list[Phone]
    """Each by its id, in the order of these."""


class Picture(TypedDict):
    """Where sensors went, thinned out: enough for a thumbnail."""

    paths: list[PicturePath]
    """A path for each sensor that measures positions; where none does, for hips, hands and feet of each body."""


class PicturePath(TypedDict):
    """A path of a picture."""

    name: str
    """The sensor, or `BODY/SEGMENT`."""

    position_m: list[list[float]]
    """Places in order of time, room, m."""


PictureRate: TypeAlias = 'Literal["23.976", "24", "25", "29.97", "29.97df", "30", "47.952", "48", "50", "59.94", "59.94df", "60"]'
"""A rate of pictures."""


class Plan(TypedDict):
    """A plan: its steps in order, each with all its sets."""

    name: str
    """Its name, 1 to 64 bytes."""

    steps: list[PlanStep]
    """1 to 64 of them."""


class PlanProgress(TypedDict):
    """How far a plan is."""

    exercise: str
    """The exercise of that step; how far it is with its sets: topic `exercise`."""

    name: str
    """Its name."""

    rest_until_s: float | None
    """End of the rest between two steps that goes on, s; null: none. Rests between sets: topic `exercise`."""

    step: int
    """The step that is at hand or comes after the rest, from 1."""

    steps: int
    """How many it has."""


class PlanStep(TypedDict):
    """One exercise of a plan."""

    exercise: str
    """Name of the exercise."""

    repetitions: int
    """Repetitions of each set, 1 to 1000."""

    rest_s: NotRequired[float]
    """Rest after each set, s, 0 to 3600."""

    sets: int
    """Sets, 1 to 100."""


class Plans(TypedDict):
    """All plans."""

    plans: list[Plan]
    """By name."""


class Pose(TypedDict):
    """A pose: the named frame in the room."""

    orientation_wxyz: list[float]
    """Unit quaternion, scalar first."""

    position_m: list[float]
    """Position, m."""


PositionSource: TypeAlias = 'Literal["origin", "trackers", "held", "feet"]'
"""Where a body's position comes from."""


class Problem(TypedDict):
    """Something that is wrong now."""

    code: str
    """For programs, and for who says it in another language."""

    message: str
    """For people: what to do, in one sentence of English."""

    values: dict[str, str]
    """What the sentence names, by name: all that another language needs to say the same. Empty where only `message`
    has it.
    """


class Progress(TypedDict):
    """How far a run is."""

    asks: FieldAsk | None
    """The same for programs; null when there is enough."""

    collecting: bool
    """False once the run has ended: it is the last of its reports."""

    covered: float
    """Share of the 20 cm cells inside the hull that the pole came near, 0 to 1."""

    directions: float
    """Share of the four pairs of opposite octants in which the pole was held, 0 to 1."""

    hint: str
    """What to do next; empty when there is enough."""

    instants: int
    """Instants with readings of three sensors or more."""

    residual_m: float
    """Rms distance of the last second's readings from a straight pole of the stated spacing, m: what there is to
    correct.
    """

    seconds: float
    """Time since the first reading, s."""

    sensors: list[str]
    """The pole's sensors in their order along it."""

    unvisited_m: list[list[float]]
    """Middles of cells inside the hull that it did not come near, at most 60, transmitter frame, m."""


class QrCode(TypedDict):
    """A picture of squares."""

    path: str
    """The dark ones, as a path of SVG with squares of one unit."""

    width: int
    """How many squares are side by side, without the margin of four that it needs."""


class Quality(TypedDict):
    """How good a pose is."""

    coasted: NotRequired[bool]
    """No record of this frame is in the pose: the IMU that is attached to the sensor carries it on, for half a second
    at most.
    """

    sigma_rotation_rad: float
    """Root mean square of the expected rotation error, rad."""


Reason: TypeAlias = 'Literal["too_fast", "too_slow", "too_small", "too_large", "different", "incomplete", "too_soon"]'
"""Why a repetition does not count."""


class RecordingBegun(TypedDict):
    """A recording that has begun."""

    job: int
    """Its job."""

    name: str
    """Name of the file in the folder of recordings."""


class RecordingStatus(TypedDict):
    """A recording in progress."""

    bytes: int
    """Bytes written so far."""

    name: str
    """Its file name."""

    started_s: float
    """When it began, s."""


class Recordings(TypedDict):
    """The recordings of the folder."""

    recordings: list[str]
    """Their names, in order."""


RefusalReason: TypeAlias = 'Literal["bad_name", "file_changed", "hub", "is_read", "is_recorded", "is_watched", "is_written", "job_runs", "jobs_run", "no_attached_imu", "no_body", "no_file", "no_imu", "no_magnetic", "no_sensor", "no_take", "not_magnetic", "nothing_collected", "pole_sensors", "pole_spacing", "repetitions", "requests_wait", "session_runs", "take_exists", "watches"]'
"""Why a request was not carried out, as far as other languages than English say it. Words in backquotes are names of
`values`.
"""


class RelatedClock(TypedDict):
    """How a stage's clock stands to the hub's."""

    offset_s: float
    """Hub time minus stage time, s: add it to the times of the stage's messages."""

    round_trip_s: float
    """The shortest of the round trips that it is known from, s."""

    uncertainty_s: float
    """The offset is wrong by no more than this, s, whatever the network does, as long as neither clock is wrong by
    more than 50 ppm.
    """


class Removed(TypedDict):
    """What was removed for good."""

    removed: int
    """How many recordings."""


class Renamed(TypedDict):
    """What a recording is called now."""

    name: str
    """Its file name."""


Repair: TypeAlias = 'Literal["mirrored", "coasted"]'
"""How a published pose differs from the record."""


class ReplayStatus(TypedDict):
    """A recording being replayed. After `replay.open` and `replay.seek` the times of all other topics start anew."""

    begun_s: float
    """Stage time at which it begins, s."""

    end_s: float
    """Stage time at which it ends, s."""

    ended: str | None
    """Why it goes no further: its end, or damage; null while it can go on."""

    name: str
    """Its file name."""

    passed_s: float
    """Up to where it has been passed through, s: to any time before that it is sought in a moment."""

    speed: float | None
    """Multiple of real time; 0 is a pause, null as fast as it goes."""

    t_s: float
    """Where it stands, s."""


class Report(TypedDict):
    """A report."""

    html: str
    """One self-contained HTML page."""


ReportLanguage: TypeAlias = 'Literal["english", "german"]'
"""Languages of a report."""


RequestId: TypeAlias = "int | str"
"""What a client calls its request; replies carry it."""


class Resumed(TypedDict):
    """Which events follow."""

    complete: bool
    """Whether none of those that were missed is too old to be known."""

    last_event_id: int
    """The newest of the stage."""


Role: TypeAlias = 'Literal["sensor", "watch", "operate"]'
"""What a client may do."""


class RoomPoint(TypedDict):
    """A surveyed point of the room."""

    name: str
    """For messages."""

    position_m: list[float]
    """Where it is, room, m."""


class RunningSession(TypedDict):
    """A session that goes on."""

    begun_s: float
    """When it began, s."""

    counted: int
    """Repetitions counted since."""

    person: str
    """Who trains."""

    plan: PlanProgress | None
    """How far its plan is; null: it follows none."""

    problem: str | None
    """What stands against it, in one sentence; null: nothing."""

    session: int
    """Its number, for `session.show` and others."""

    subject: str
    """The subject of the exercises."""


class Score(TypedDict):
    """A repetition beside the lesson, in points from 0 to 100: 100 is as taught."""

    amplitude: float
    """How far the joints went, in percent of the lesson, each weighted by its way; farther is 100. Without joints the
    size of the whole movement.
    """

    smoothness: float
    """100 as smooth as the lesson (log dimensionless jerk, Hogan & Sternad 2009); twice the jerk costs 15."""

    symmetry: float | None
    """The lesser of left and right in percent of the other, each beside its own way in the lesson; null where the
    exercise does not move the same joint on both sides.
    """

    tempo: float
    """100 between the shortest and the longest repetition of the lesson; beyond, their ratio in percent."""

    total: float
    """The parts below, weighted 0.5, 0.2, 0.15 and 0.15; without symmetry the others in the same proportion."""


class ScrewMotion(TypedDict):
    """A rotation about an axis and a translation along it."""

    advance_m: float
    """How far it went along the axis, m."""

    angle_deg: float
    """How far it turned, degrees; 0 for a translation."""

    axis_direction: list[float]
    """Direction of the axis, room frame: a unit vector; the rotation is positive about it."""

    axis_point_m: list[float]
    """The point of the axis that is nearest to where the sensor began, room frame, m."""

    from_m: list[float]
    """Where the sensor was then, room frame, m."""

    since_s: float
    """Capture time at which it began, s: that of the key pose before, or of the first pose."""


class SegmentEntry(TypedDict):
    """A segment."""

    fault: FaultCause | None
    """What is wrong with that sensor; null where nothing is."""

    learnt: LearntEntry | None
    """What its movements have shown of a limb's segment since its sensor was calibrated; null for other segments, and
    where the stage file says how it sits.
    """

    name: str
    """Its name."""

    orientation_wxyz: list[float] | None
    """Segment to room, unit quaternion, scalar first; null where nothing shows it."""

    position_m: list[float] | None
    """Its origin in the room, m; null where nothing shows it."""

    sensor: str | None
    """Its sensor; null where it wears none."""

    sigma_deg: float
    """Root mean square of its expected error about an axis, degrees; of limbs, against the trunk."""

    state: SegmentState
    """How far to trust it."""


SegmentEvent: TypeAlias = 'Literal["provisional", "confirmed", "withdrawn"]'
"""What is said of a segment."""


class SegmentSpan(TypedDict):
    """What a motion showed for a while."""

    body: str | None
    """Whose motion, by the name of the body; null on a stage without one."""

    from_s: float
    """Since when, s."""

    label: str
    """What it showed."""

    to_s: float
    """Until when, s: the beginning of the next one, or the end of the recording."""


SegmentState: TypeAlias = 'Literal["ok", "inferred", "suspect", "missing"]'
"""How far a segment can be trusted; the later, the less."""


class SensorEntry(TypedDict):
    """One sensor in one frame. `name` and `state` are always there; the others as `fields` asks for."""

    angular_velocity_rad_s: NotRequired[list[float] | None]
    """Angular velocity in sensor axes, rad/s."""

    change: NotRequired[Change | None]
    """The statistic of key poses; absent where they are not looked for, or not of this sensor."""

    covariance: NotRequired[list[float] | None]
    """Covariance of (position in room, m; rotation error in sensor axes, rad): the 21 numbers of the upper triangle of
    the 6 x 6 matrix, row by row.
    """

    device: NotRequired[str | None]
    """Its device's name."""

    fault: NotRequired[SensorLabel | None]
    """What the fault map reports about it; absent where the stage has none, or not for this sensor."""

    measured: NotRequired[Measured | None]
    """The raw record, unfiltered, in device axes; null where none arrived."""

    name: str
    """Its name."""

    orientation_wxyz: NotRequired[list[float] | None]
    """Sensor to room, unit quaternion, scalar first; null where there is no estimate."""

    position_m: NotRequired[list[float] | None]
    """Filtered position in the room, m; null where there is no estimate, and for sensors that measure none."""

    quality: NotRequired[Quality | None]
    """More on how good the pose is."""

    sigma_m: NotRequired[float | None]
    """Root mean square of the expected 3-D position error, m; null where there is no position."""

    state: SensorState
    """How far to trust it; only `ok`, `repaired` and `extrapolated` are poses to use."""

    velocity_m_s: NotRequired[list[float] | None]
    """Velocity in the room, m/s; null where there is no position."""


class SensorHistory(TypedDict):
    """A sensor in the last hour."""

    battery: list[float | None]
    """Charge of its battery at the end of the step, 0 to 1; null where its device reports none."""

    clock_sigma_s: list[float | None]
    """Standard deviation of the capture times of its device, s, at the end of the step."""

    faulty: list[float | None]
    """Share of the frames in which its record was suspect, stuck, or repaired: 0 to 1."""

    lost: list[float | None]
    """Share of the expected samples that were lost, as in `status`: 0 to 1."""

    name: str
    """Its name."""

    noise_m: list[float | None]
    """Noise of its measured position, m: from the median of how far each one is from the middle of its neighbours.
    Motion adds to it: that of a sensor at rest is the tracker's own. Null for one that measures no position.
    """

    rate_hz: list[float | None]
    """Samples per second."""

    signal_dbm: list[float | None]
    """Strength of its radio signal at the end of the step, dBm; null where its device reports none."""


class SensorLabel(TypedDict):
    """What the fault map reports about a sensor in a frame."""

    cause: FaultCause | None
    """Why; null where it is clean."""

    distance_m: float | None
    """Distance from the nearest place where it was in training, m; null where it is missing."""

    label: FaultClass
    """Rules and map together."""

    repair: Repair | None
    """How the published pose differs from the record; null where it does not."""


SensorState: TypeAlias = 'Literal["ok", "suspect", "missing", "late", "stuck", "repaired", "extrapolated"]'
"""How far a sensor's pose can be trusted."""


class SensorStatus(TypedDict):
    """Health of a sensor. Counts never go back."""

    age_s: float | None
    """Age of the newest sample, s; null before the first."""

    battery: float | None
    """Charge of its battery, 0 to 1; null where its device reports none, and after it is gone."""

    battery_v: float | None
    """Voltage of its battery, V; null likewise."""

    corrected: bool
    """Whether its records are corrected by its unit's own biases and scales (`imu.calibrate`), kept from before or
    found just now.
    """

    estimated: bool
    """Whether `lost` is partly estimated, because whole cycles left no trace in the bytes."""

    firmware: str | None
    """Version of its firmware, such as `0.7.3`; null likewise."""

    lost: int
    """Expected samples that were not published as `ok`, but for those with which its filter began."""

    missed: int
    """Those of `lost` that never came: by the device's own count where it has one."""

    name: str
    """Its name."""

    rate_hz: float | None
    """Samples per second, of the last second or more; null before that."""

    registered: bool | None
    """Whether the receiver on USB through which it is to come knows it; null where it comes another way, or nobody
    knows yet.
    """

    samples: int
    """Samples that arrived."""

    signal_dbm: float | None
    """Strength of its radio signal, dBm (-50 is strong, -80 weak); null likewise."""


class SensorsMessage(TypedDict):
    """What every data message starts with, and its body."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    fault: NotRequired[FrameLabel | None]
    """What the fault map reports about the frame (field `fault`)."""

    frame: NotRequired[int | None]
    """Number of the frame (field `quality`)."""

    sensors: list[SensorEntry]
    """The subscribed sensors, in the stage file's order."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    sigma_t_s: NotRequired[float | None]
    """Standard deviation of the capture time itself, s (field `quality`)."""

    t_s: float
    """Capture time that the poses belong to, s; rises strictly."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["sensors"]
    """Which message it is."""


ServerMessage: TypeAlias = "Hello | OkReply | ErrorReply | StatusMessage | SensorsMessage | FigureMessage | TruthsMessage | JobsMessage | SessionsMessage | FaultMessage | KeyPoseMessage | FieldEventMessage | ExerciseEventMessage | MotionSegmentMessage | MarkMessage | TimecodeMessage | Stages"
"""Everything a client can receive."""


class SessionBegun(TypedDict):
    """A session that has begun."""

    session: int
    """Its number."""


class SessionSummary(TypedDict):
    """A session in one line."""

    begun: str
    """When it began, RFC 3339 in UTC."""

    counted: int
    """Repetitions counted."""

    duration_s: NotRequired[float | None]
    """How long it took, s; absent while it goes on."""

    ended_by: NotRequired[EndedBy | None]
    """How it ended; absent while it goes on."""

    person: str
    """Who trained."""

    plan: NotRequired[str | None]
    """The plan that was followed; absent: none."""

    recording: NotRequired[str | None]
    """The recording of it, if one was kept."""

    rejected: int
    """Repetitions that were seen and not counted."""

    score: NotRequired[float | None]
    """Mean score of those counted, points; absent where none has one."""

    session: int
    """Its number."""

    sets: int
    """Sets begun."""


class SessionsMessage(TypedDict):
    """What every data message starts with, and its body."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    sessions: list[RunningSession]
    """Sessions that go on, one per subject at most."""

    t_s: float
    """Host time, s; rises strictly."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["session"]
    """Which message it is."""


class Setup(TypedDict):
    """A stage file, as it is or as it would be with changes, and what is wrong with it."""

    bodies: list[SetupBody]
    """Its bodies, in their order."""

    devices: list[SetupDevice]
    """Its devices, in their order."""

    file: str
    """Name of the file."""

    name: str
    """The stage's name; empty where none stands there."""

    problems: list[SetupProblem]
    """What is wrong: the stage cannot run like this. As `posed check` says it."""

    revision: str
    """Which contents of the file this was made from; `setup.save` is refused where it has others by then."""

    sensors: list[SetupSensor]
    """Its sensors, in their order."""

    toml: str
    """The text, with a placeholder for every secret."""

    warnings: list[SetupProblem]
    """What works, but hardly as it was meant."""

    why_not: str | None
    """Why it cannot be changed from here; null where it can."""


class SetupBody(TypedDict):
    """A body of a stage file."""

    height_m: float | None
    """Height of the person, m; null where it is not given."""

    name: str
    """Its name."""


class SetupDevice(TypedDict):
    """A device of a stage file; texts that are not there are empty."""

    driver: str
    """Its driver."""

    name: str
    """Its name."""

    port: str
    """Its port."""


class SetupProblem(TypedDict):
    """Something that is wrong with a stage file, or doubtful."""

    fix: str
    """What to do about it."""

    key: str
    """The key it is about; may be empty."""

    line: int
    """Line of the text, from 1."""

    message: str
    """What is wrong."""

    name: str | None
    """Which one, by the name that stands there."""

    table: StageTable | None
    """What it is about, where it is a device, a sensor or a body; null: something else."""


class SetupSensor(TypedDict):
    """A sensor of a stage file; texts that are not there are empty."""

    address: int
    """Its address on the device."""

    body: str | None
    """The body that wears it, by name; null: the only one."""

    device: str
    """Its device, by name."""

    name: str
    """Its name."""

    segment: str | None
    """The segment that it sits on, as its `segment` or its name says; null: on none."""


class Shown(TypedDict):
    """A session in full."""

    shown: Any
    """Its sets, repetitions, scores and courses, as `posed session show --json` prints them."""


Side: TypeAlias = 'Literal["left", "right"]'
"""Side of the body."""


Skeleton: TypeAlias = 'Literal["human", "custom"]'
"""Which segments a body has."""


class Sole(TypedDict):
    """How likely the two ends of a sole stand on the floor, 0 to 1."""

    heel: float
    """The heel."""

    toe: float
    """The toes, which stand by the ball of the foot."""


Speed: TypeAlias = "float | SpeedWord"
"""Speed of a replay."""


SpeedWord: TypeAlias = 'Literal["max"]'
"""A speed in words."""


class SpokenJoint(TypedDict):
    """A joint, somewhere in the movement."""

    about: Literal["joint"]

    deviation_deg: float
    """The angle less the taught one, degrees; at a turning point that of its way, beside how far the other joints
    went.
    """

    joint: str
    """`elbow`, as in the name of the angle."""

    kind: DeviationKind
    """In which way it deviates."""

    movement: str
    """`flexion`, as in the name of the angle; empty where the name has none."""

    place: MovementPhase
    """Where in the movement; `top` is the turning point of this joint."""

    side: Side | None
    """Its side; null of the trunk, and where the name has none."""


class SpokenSize(TypedDict):
    """The whole movement is smaller or larger."""

    about: Literal["size"]

    size: float
    """The taught one being 1."""


class SpokenTempo(TypedDict):
    """It was slower or faster."""

    about: Literal["tempo"]

    tempo: float
    """Duration, the taught median being 1."""


class SpokenSmoothness(TypedDict):
    """It was less smooth."""

    about: Literal["smoothness"]


Spoken: TypeAlias = "SpokenJoint | SpokenSize | SpokenTempo | SpokenSmoothness"
"""A remark for programs."""


class StageChangeNameStage(TypedDict):
    """Gives the stage another name."""

    change: Literal["name_stage"]

    name: str
    """Which."""


class StageChangePlaceTransmitter(TypedDict):
    """Says how the magnetic transmitter stands in the room."""

    change: Literal["place_transmitter"]

    orientation_wxyz: list[float]
    """Turns transmitter coordinates into room coordinates: unit quaternion, scalar first."""

    position_m: list[float]
    """Its place, m."""


class StageChangeAdd(TypedDict):
    """Adds a device, a sensor or a body behind those that there are."""

    change: Literal["add"]

    keys: dict[str, Any]
    """Its keys, as in the stage file."""

    table: StageTable
    """What."""


class StageChangeSet(TypedDict):
    """Sets a key of a device, a sensor or a body. A new `name` is used wherever the file says the old one."""

    change: Literal["set"]

    key: str
    """Which key."""

    name: str
    """Of which, by its name."""

    table: StageTable
    """Of what."""

    value: NotRequired[Any]
    """Its value, as in the stage file; null or absent: the key is removed."""


class StageChangeRemove(TypedDict):
    """Removes a device with its sensors, a sensor, or a body, which no sensor is worn by any more."""

    change: Literal["remove"]

    name: str
    """Which, by its name."""

    table: StageTable
    """What."""


StageChange: TypeAlias = "StageChangeNameStage | StageChangePlaceTransmitter | StageChangeAdd | StageChangeSet | StageChangeRemove"
"""One change of a stage file."""


class StageEntry(TypedDict):
    """One of them."""

    clock: RelatedClock | None
    """How its clock stands to the hub's; null until it is known."""

    devices: int
    """Devices, and how many of them stream."""

    epoch_utc: str | None
    """Its epoch: UTC of its own computer in RFC 3339 with nanoseconds; null until it is known."""

    events_lost: int
    """Events that are lost for good: the hub was cut off for longer than the stage keeps them."""

    frames_hz: float
    """Frames per second that arrive here."""

    fused: bool
    """Whether this hub fuses it from its input log."""

    id: str
    """Its name at this hub: its page is at `/ID/`, its websocket at `/ID/ws`."""

    last_event_id: int
    """Newest event that has arrived here."""

    name: str
    """Its own name, from the stage file; empty until it is known."""

    problems: list[Problem]
    """What is wrong there, as in its `status`."""

    since_s: float
    """Since when, s of the hub's time."""

    state: StagePresence
    """Whether it is there."""

    streaming: int
    """Of them."""

    vanished: int
    """How often it has vanished so far."""


class StageLatency(TypedDict):
    """Latency of one stage of the flow, ms."""

    max_ms: float
    """Longest, ms."""

    p50_ms: float
    """Median, ms."""

    p99_ms: float
    """99 % quantile, ms."""

    stage: str
    """From where to where."""


StagePresence: TypeAlias = 'Literal["joining", "present", "gone"]'
"""Whether a stage is there."""


StageTable: TypeAlias = 'Literal["device", "sensor", "body"]'
"""Tables that a change can be about."""


class Stages(TypedDict):
    """All stages that a hub has heard of."""

    stages: list[StageEntry]
    """In the order of their names."""

    t_s: float
    """The hub's own time, s since it was started."""

    type: Literal["stages"]
    """Which message it is."""


class Started(TypedDict):
    """A job that has begun; the topic `jobs` reports its progress."""

    job: int
    """Its number."""


class StatusMessage(TypedDict):
    """What every data message starts with, and its body."""

    clients: int
    """Connected clients."""

    devices: list[DeviceStatus]
    """Devices, in the stage file's order."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    free_bytes: int | None
    """What the disk of the recordings still takes, bytes; null where nobody knows, and in a replay."""

    host_clock: HostClock | None
    """Whether this computer's clock follows another, as its kernel tells; null where it does not, and in a replay."""

    latency: list[StageLatency]
    """How long each stage of the flow took since the last status."""

    problems: list[Problem]
    """What is wrong now, beside the devices' own reasons: disk full, wall clock set, ..."""

    recording: RecordingStatus | None
    """The recording in progress; null without one."""

    replay: ReplayStatus | None
    """The recording that is being replayed; null on a live stage."""

    sensors: list[SensorStatus]
    """Sensors, in the stage file's order."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Host time, s; rises strictly."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["status"]
    """Which message it is."""


class Still(TypedDict):
    """An angle that keeps still in an exercise, in the channel's unit."""

    channel: str
    """The channel."""

    moves: float
    """Mean of how far it goes with the movement there and back."""

    moves_sd: float
    """Standard deviation of that from repetition to repetition."""

    range: list[float]
    """Least and greatest value in the taught repetitions."""


class Takes(TypedDict):
    """The takes of the folder."""

    recording: str | None
    """The file that is being recorded into; null without one."""

    takes: list[LibraryTake]
    """The newest first; those that cannot be read last."""


Thoroughness: TypeAlias = 'Literal["quick", "full", "movement", "assign"]'
"""How much is done."""


class TimecodeMessage(TypedDict):
    """What every data message starts with, and its body."""

    drift_ppm: float | None
    """By how much the code is faster than its rate on the host's clock, ppm; null with `rate`."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    jumps: int
    """How often the code has gone on somewhere else since the stage's beginning."""

    rate: PictureRate | None
    """Rate of the pictures; null while the pace does not tell yet, which takes a MIDI source some seconds."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    sigma_s: float
    """Standard deviation of the code, s: it grows while the code is carried on."""

    state: TimecodeState
    """How the code is known."""

    t_s: float
    """When this is so, s; rises strictly."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["timecode"]
    """Which message it is."""


TimecodeState: TypeAlias = 'Literal["locked", "holding", "none"]'
"""How the time code of a moment is known."""


Topic: TypeAlias = 'Literal["status", "sensors", "body", "faults", "keyframes", "segments", "exercise", "field", "jobs", "truth", "session", "marks", "timecode"]'
"""A topic; its name is the `type` of its messages."""


class TrackedColumns(TypedDict):
    """Where no channel was asked for."""

    columns: list[str]
    """The names of all."""


class TrackedTSValues(TypedDict):
    """Those that were asked for, thinned out."""

    t_s: list[float]
    """Time of each row, s."""

    values: list[list[float | None]]
    """Each row, in the order that was asked for; null where nothing was measured."""


Tracked: TypeAlias = "TrackedColumns | TrackedTSValues"
"""Channels of a whole recording."""


TruthEntry = TypedDict(
    "TruthEntry",
    {
        "class": "str",
        "device": "NotRequired[str | None]",
        "name": "str",
        "orientation_wxyz": "NotRequired[list[float] | None]",
        "position_m": "NotRequired[list[float] | None]",
        "sigma_m": "NotRequired[float | None]",
        "state": "SensorState",
    },
)
"""Ground truth of one sensor. `name`, `state` and `class` are always there; the others as `fields` asks for."""


class TruthsMessage(TypedDict):
    """What every data message starts with, and its body."""

    dropped: int
    """Data messages of all topics that were dropped for this client so far."""

    sensors: list[TruthEntry]
    """The simulated sensors."""

    seq: int
    """Counts this topic's messages to this client from 0; a gap is a message that was dropped."""

    t_s: float
    """Capture time, exact, s; rises strictly."""

    timecode: NotRequired[str | None]
    """Time code at the message's `t_s`, `HH:MM:SS:FF.hh` with hundredths of a frame, and `;` before the frames where
    counting is drop-frame; absent where it is not known to half a frame, and on stages without `[timecode]`.
    """

    type: Literal["truth"]
    """Which message it is."""


class Turn(TypedDict):
    """The turning point of a channel, as it was taught."""

    sd: float
    """Standard deviation of the way from repetition to repetition, of a joint beside the other joints' ways."""

    state: int
    """The state in which the channel is farthest from its ends, from 0."""

    way: float
    """Mean way from the nearer end to the turning point, in the channel's unit; negative where it falls."""
