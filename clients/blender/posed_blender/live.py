"""The connection to a daemon: its newest frames on the scene, and all of them in actions while it records."""

import numpy as np

import bpy
import posed

from . import actions
from .skeleton import Skeleton

FIELDS = ["position_m", "orientation_wxyz"]


class Live:
    """Bodies on armatures, sensors on empties."""

    def __init__(self, address, token=None, bodies=True, sensors=True):
        self.stage = posed.connect(address, token=token)
        topics = self.stage.hello["topics"]
        self.bodies = self.stage.body(drop="queue") if bodies and "body" in topics else None
        self.sensors = self.stage.sensors(fields=FIELDS, drop="queue") if sensors else None
        self.skeletons, self.empties = {}, {}
        self.recorded = None
        self.newest_s = None

    def close(self):
        self.stage.close()

    def step(self):
        """Takes what has come since, and shows the newest. How many frames there were."""
        frames = 0
        for stream, take in ((self.bodies, self._body), (self.sensors, self._sensors)):
            newest = {}
            for frame in waiting(stream):
                frames += 1
                self.newest_s = frame.t_s
                newest[getattr(frame, "name", None)] = frame
                self._record(frame)
            for frame in newest.values():
                take(frame)
        return frames

    def record(self):
        self.recorded = {}

    def _record(self, frame):
        if self.recorded is None:
            return
        if isinstance(frame, posed.BodyFrame):
            self.recorded.setdefault(frame.name, []).append(frame)
        else:
            self.recorded.setdefault(None, []).append(frame)

    def stop(self):
        """Ends recording; the actions, by the object's name. All of them begin at the first frame that was recorded."""
        recorded, self.recorded = self.recorded or {}, None
        from_s = min((frames[0].t_s for frames in recorded.values()), default=0.0)
        made = {}
        for name, frames in recorded.items():
            if name is not None and name in self.skeletons:
                skeleton = self.skeletons[name]
                of = [(frame.t_s, frame.position_m, frame.q_room_segment_wxyz) for frame in frames]
                made[skeleton.object.name] = actions.write(skeleton.object, f"{name} {from_s:.3f} s", *skeleton.motion(of), from_s)
            elif name is None:
                for sensor, empty in self.empties.items():
                    made[empty.name] = actions.write(empty, f"{sensor} {from_s:.3f} s", *of_sensor(frames, sensor), from_s)
        return made

    def _body(self, frame):
        skeleton = self.skeletons.get(frame.name)
        # One that is at hand still knows its lengths.
        if skeleton is None and np.isfinite(frame.position_m).all():
            skeleton = self.skeletons[frame.name] = Skeleton(frame.name, frame.segments, frame.position_m, frame.q_room_segment_wxyz)
        if skeleton is not None:
            skeleton.pose(frame.position_m, frame.q_room_segment_wxyz)

    def _sensors(self, frame):
        for at in np.flatnonzero(frame.usable):
            name = frame.names[at]
            empty = self.empties.get(name)
            if empty is None:
                empty = self.empties[name] = empty_of(name)
            # An IMU measures no position: its empty stays where it was put.
            if np.isfinite(frame.position_m[at]).all():
                empty.location = frame.position_m[at]
            if np.isfinite(frame.q_room_sensor_wxyz[at]).all():
                empty.rotation_quaternion = frame.q_room_sensor_wxyz[at]


def waiting(stream):
    while stream is not None:
        try:
            yield stream.get(timeout_s=0)
        except TimeoutError:
            return


def empty_of(name):
    empty = bpy.data.objects.new(name, None)
    empty.empty_display_type, empty.empty_display_size = "ARROWS", 0.05
    empty.rotation_mode = "QUATERNION"
    bpy.context.scene.collection.objects.link(empty)
    return empty


def of_sensor(frames, name):
    """Times and curves of an empty; a pose that is not to be used has no key."""
    at = frames[0].index(name)
    absent = [np.where(frame.usable[at], 0.0, np.nan) for frame in frames]
    location = np.array([frame.position_m[at] + no for frame, no in zip(frames, absent)])
    rotation = np.array([frame.q_room_sensor_wxyz[at] + no for frame, no in zip(frames, absent)])
    return np.array([frame.t_s for frame in frames]), {"location": location, "rotation_quaternion": rotation}
