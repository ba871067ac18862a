"""Blender opens the files of the folder it is run in: BVH by each profile, and glTF. Writes where it has the bones' joints: blender.json.

By file, bone and frame: metres, in Blender's own axes (x to a figure's left, z up, the figure looks along -y).
"""

import json

import bpy  # isort: skip: it brings the other one
import addon_utils

FILES = {"take.bvh": 1.0, "take-blender.bvh": 1.0, "take-motionbuilder.bvh": 0.01, "take-mixamo.bvh": 0.01, "take.glb": None, "take.vrm": None}


def opened(file, scale, rate_hz):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if scale is None:
        addon_utils.enable("io_scene_gltf2")
        # A time of a file is a frame of the scene: as many a second as the take has.
        bpy.context.scene.render.fps = round(rate_hz)
        if file.endswith(".vrm"):
            # To Blender it is glTF of another name.
            with open(file, "rb") as whole, open("vrm.glb", "wb") as copy:
                copy.write(whole.read())
            file = "vrm.glb"
        bpy.ops.import_scene.gltf(filepath=file, bone_heuristic="TEMPERANCE")
    else:
        addon_utils.enable("io_anim_bvh")
        bpy.ops.import_anim.bvh(filepath=file, global_scale=scale, rotate_mode="NATIVE")
    return next(item for item in bpy.data.objects if item.type == "ARMATURE")


def main():
    with open("truth.json") as file:
        truth = json.load(file)
    found = {}
    for file, scale in FILES.items():
        armature = opened(file, scale, truth["rate_hz"])
        first = 0
        if scale is not None:
            # Blender counts from 1; a profile of other programs begins with the rest.
            first = 1 if file == "take.bvh" else 2
        joints = {bone.name: [] for bone in armature.pose.bones}
        for frame in truth["frames"]:
            bpy.context.scene.frame_set(first + frame)
            for bone in armature.pose.bones:
                joints[bone.name].append(list(armature.matrix_world @ bone.head))
        found[file] = joints
    with open("blender.json", "w") as file:
        json.dump(found, file)


main()
