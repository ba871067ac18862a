"""An armature of a body: a bone for each segment, hanging on its parent, and the motion of its bones.

Rest is the pose in which every segment's axes are the room's: upright, looking along x, arms hanging. So a bone's pose is the segment's orientation after the bone's
own rest, and Blender's axes are the room's: metres, z up.
"""

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

PARENTS = {
    "torso": "pelvis", "head": "torso",
    **{
        f"{child}_{side}": parent if parent in ("torso", "pelvis") else f"{parent}_{side}"
        for side in "rl"
        for child, parent in (
            ("shoulder", "torso"), ("upper_arm", "torso"), ("forearm", "upper_arm"), ("hand", "forearm"), ("thigh", "pelvis"), ("shank", "thigh"), ("foot", "shank"),
        )
    },
}
# A bone ends where its child begins; one without a child, or with several, is drawn so long and in this direction at rest.
ENDS_AT = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shank", "shank": "foot"}
TIPS = {"foot": (0.2, 0.0, 0.0), "hand": (0.0, 0.0, -0.18), "head": (0.0, 0.0, 0.2), "shoulder": (0.0, 0.0, 0.1)}
TIP = (0.0, 0.0, 0.2)


def transform(position_m, q_wxyz):
    return Matrix.LocRotScale(Vector(position_m), Quaternion(q_wxyz), None)


class Skeleton:
    """The armature of one body, in the scene."""

    def __init__(self, name, segments, position_m, q_wxyz):
        """From the first frame in which all segments are known: it tells how long they are."""
        self.segments = list(segments)
        poses = {segment: transform(p, q) for segment, p, q in zip(segments, position_m, q_wxyz)}
        self.parent = {segment: PARENTS.get(segment) if PARENTS.get(segment) in poses else None for segment in segments}
        # Parents before children.
        self.order = sorted(segments, key=self._depth)
        armature = bpy.data.armatures.new(name)
        self.object = bpy.data.objects.new(name, armature)
        bpy.context.scene.collection.objects.link(self.object)
        bpy.context.view_layer.objects.active = self.object
        bpy.ops.object.mode_set(mode="EDIT")
        heads = {}
        for segment in self.order:
            parent = self.parent[segment]
            # From the parent's origin to ours, in the parent's axes: at rest these are the room's.
            offset = (poses[parent].inverted() @ poses[segment]).translation if parent else Vector((0.0, 0.0, 0.0))
            heads[segment] = (heads[parent] if parent else Vector((0.0, 0.0, poses[segment].translation.z))) + offset
        for segment in self.order:
            bone = armature.edit_bones.new(segment)
            bone.head = heads[segment]
            kind, _, side = segment.rpartition("_")
            child = f"{ENDS_AT.get(kind)}_{side}"
            bone.tail = heads[child] if child in heads else heads[segment] + Vector(TIPS.get(kind or segment, TIP))
            bone.parent = armature.edit_bones[self.parent[segment]] if self.parent[segment] else None
        bpy.ops.object.mode_set(mode="OBJECT")
        self.bones = {segment: self.object.pose.bones[segment] for segment in self.order}
        self.rest = {segment: bone.bone.matrix_local.copy() for segment, bone in self.bones.items()}
        self.rest_axes = {segment: rest.to_quaternion().to_matrix().to_4x4() for segment, rest in self.rest.items()}
        for bone in self.bones.values():
            bone.rotation_mode = "QUATERNION"

    def _depth(self, segment):
        parent = self.parent[segment]
        return 0 if parent is None else 1 + self._depth(parent)

    def bases(self, position_m, q_wxyz):
        """What each bone has beside its rest (location, quaternion), by segment; a segment that is not known goes with its parent as at rest."""
        poses, found = {}, {}
        for segment in self.order:
            at, parent = self.segments.index(segment), self.parent[segment]
            between = self.rest[parent].inverted() @ self.rest[segment] if parent else self.rest[segment]
            hung = poses[parent] @ between if parent else between
            known = np.isfinite(position_m[at]).all() and np.isfinite(q_wxyz[at]).all()
            poses[segment] = transform(position_m[at], q_wxyz[at]) @ self.rest_axes[segment] if known else hung
            basis = hung.inverted() @ poses[segment]
            found[segment] = (basis.translation, basis.to_quaternion())
        return found

    def pose(self, position_m, q_wxyz):
        """Shows a frame."""
        for segment, (location, rotation) in self.bases(position_m, q_wxyz).items():
            self.bones[segment].location, self.bones[segment].rotation_quaternion = location, rotation

    def motion(self, frames):
        """Curves of frames (t_s, position_m, q_wxyz), by the data path of a bone."""
        times = np.array([t_s for t_s, _, _ in frames])
        bases = [self.bases(position_m, q_wxyz) for _, position_m, q_wxyz in frames]
        curves = {}
        for segment in self.order:
            path = self.bones[segment].path_from_id()
            curves[f"{path}.location"] = np.array([one[segment][0] for one in bases])
            curves[f"{path}.rotation_quaternion"] = np.array([one[segment][1] for one in bases])
        return times, curves
