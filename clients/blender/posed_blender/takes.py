"""A recording as actions, on new armatures and empties."""

import numpy as np

import posed

from . import actions
from .live import empty_of
from .skeleton import Skeleton

USABLE = ("ok", "repaired", "extrapolated")


def load(path, program=None):
    """Objects by name, with their actions; frame 1 is the take's first frame. See `posed.read` for `program`."""
    take = posed.read(path, frames="numpy", program=program)
    body, sensors = take.table("body"), take.table("sensors")
    from_s = min((float(table["t_s"][0]) for table in (body, sensors) if len(table["t_s"])), default=0.0)
    segments = [name.removesuffix("_state") for name in body if name.endswith("_state")]
    made = {}
    for name in dict.fromkeys(body["body"]):
        own = body["body"] == name
        position_m, q_wxyz = (
            np.stack([np.column_stack([body[f"{segment}_{column}"][own] for column in columns]) for segment in segments], axis=1).astype(float)
            for columns in (("x_m", "y_m", "z_m"), ("qw", "qx", "qy", "qz"))
        )
        whole = np.flatnonzero(np.isfinite(position_m).all(axis=(1, 2)))
        if len(whole) == 0:
            continue
        skeleton = Skeleton(name, segments, position_m[whole[0]], q_wxyz[whole[0]])
        times, curves = skeleton.motion(list(zip(body["t_s"][own], position_m, q_wxyz)))
        actions.write(skeleton.object, f"{take.path.stem} {name}", times, curves, from_s)
        made[name] = skeleton.object
    for name in dict.fromkeys(sensors["sensor"]):
        own = (sensors["sensor"] == name) & np.isin(sensors["state"].astype(str), USABLE)
        if not own.any():
            continue
        location, rotation = (np.column_stack([sensors[column][own] for column in columns]).astype(float) for columns in (("x_m", "y_m", "z_m"), ("qw", "qx", "qy", "qz")))
        made[name] = empty_of(name)
        actions.write(made[name], f"{take.path.stem} {name}", sensors["t_s"][own], {"location": location, "rotation_quaternion": rotation}, from_s)
    return made
