"""Client of `posed`, the motion tracking daemon.

    import posed
    with posed.connect("127.0.0.1:8787") as stage:
        for body in stage.body(max_rate_hz=100):
            print(f"{body.t_s:.3f} s: {body.angles_deg['elbow_r_flexion']:.1f} deg")

`posed.aio.connect` is the same for `asyncio`; `posed.read("take.mcap")` makes data frames of a recording. Times are capture times, s since the stage's epoch;
poses are in the room: metres, z up, unit quaternions scalar first.
"""

from . import aio
from ._blocking import Connection, Stream, connect
from .errors import Disconnected, JobFailed, NoProgram, PosedError, Refused, Unauthorised
from .frames import BodyFrame, SensorsFrame
from .take import Take, read

__all__ = [
    "BodyFrame",
    "Connection",
    "Disconnected",
    "JobFailed",
    "NoProgram",
    "PosedError",
    "Refused",
    "SensorsFrame",
    "Stream",
    "Take",
    "Unauthorised",
    "aio",
    "connect",
    "read",
]
