"""Curves as an action: keys stand at capture times, between frames of the scene where these fall there."""

import bpy
import numpy as np


def continuous(q_wxyz):
    """The same rotations with the sign of each quaternion nearest to that before it: curves run between them."""
    steps = np.einsum("ij,ij->i", q_wxyz[1:], q_wxyz[:-1])
    signs = np.cumprod(np.concatenate([[1.0], np.where(steps < 0, -1.0, 1.0)]))
    return q_wxyz * signs[:, None]


def frames_of(times_s, from_s):
    """Frames of the scene at capture times; the first one is frame 1."""
    render = bpy.context.scene.render
    return 1 + (np.asarray(times_s) - from_s) * render.fps / render.fps_base


def write(target, name, times_s, curves, from_s):
    """An action of that name on an object; values that are not known have no key."""
    action = bpy.data.actions.new(name)
    slot = action.slots.new(id_type="OBJECT", name=target.name)
    bag = action.layers.new("posed").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
    frames = frames_of(times_s, from_s)
    for path, values in curves.items():
        known = np.isfinite(values).all(axis=1)
        if not known.any():
            continue
        kept = continuous(values[known]) if path.endswith("rotation_quaternion") else values[known]
        for index in range(kept.shape[1]):
            curve = bag.fcurves.new(path, index=index)
            curve.keyframe_points.add(len(kept))
            curve.keyframe_points.foreach_set("co", np.column_stack([frames[known], kept[:, index]]).astype(np.float32).ravel())
            curve.keyframe_points.foreach_set("interpolation", np.full(len(kept), 1, dtype=np.int32))
            curve.update()
    data = target.animation_data or target.animation_data_create()
    data.action, data.action_slot = action, slot
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, max(int(np.ceil(frames[-1])), 1)
    return action
