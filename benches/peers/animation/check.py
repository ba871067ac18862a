#!/usr/bin/env python3
"""Opens the animations of a recording in readers that others wrote, and holds the joints of all against one another.

usage: check.py RECORDING [--posed PATH] [--node FOLDER]

Needs bvh, ezc3d, numpy, pygltflib and usd-core (PyPI); with --node, a folder in which `npm i gltf-validator` was run, glTF's own validator, too.
USD by UsdSkel (Pixar), BVH by the package bvh, glTF by pygltflib, C3D by ezc3d (rotations and, of hips and legs, points); poses of every tenth frame. It ends with 1 where a joint is off by a millimetre
or a validator finds an error; where a skeleton has fewer pieces of the spine than ours, the shoulders' and the head's limit is 3 mm.
"""
import argparse
import json
import math
import pathlib
import struct
import subprocess
import sys
import tempfile

import ezc3d
import numpy as np
from bvh import Bvh
from pxr import Usd, UsdSkel
from pygltflib import GLTF2

VRM = {"leftHand": "hand_l", "rightHand": "hand_r", "head": "head", "leftToes": "toe_l", "rightToes": "toe_r", "hips": "pelvis", "rightLowerLeg": "lower_leg_r"}
NAMES = {
    "blender": (1, {"hand.L": "hand_l", "hand.R": "hand_r", "spine.006": "head", "toe.L": "toe_l", "toe.R": "toe_r", "spine": "pelvis", "shin.R": "lower_leg_r"}),
    "motionbuilder": (100, {"LeftHand": "hand_l", "RightHand": "hand_r", "Head": "head", "LeftToeBase": "toe_l", "RightToeBase": "toe_r", "Hips": "pelvis", "RightLeg": "lower_leg_r"}),
    "mixamo": (100, {f"mixamorig:{name}": own for name, own in {"LeftHand": "hand_l", "RightHand": "hand_r", "Head": "head", "LeftToeBase": "toe_l", "RightToeBase": "toe_r", "Hips": "pelvis", "RightLeg": "lower_leg_r"}.items()}),
}
SHORTER = {"blender", "mixamo", "glb"}
UPPER = {"hand_l", "hand_r", "head"}


def about(axis, degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array({"X": [[1, 0, 0], [0, c, -s], [0, s, c]], "Y": [[c, 0, s], [0, 1, 0], [-s, 0, c]], "Z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}[axis])


def joints_of_bvh(path, frames, per_m, skip):
    """Joint centres by frame and name, m."""
    read = Bvh(path.read_text())
    found = []
    for frame in frames:
        whole = {}
        for name in read.get_joints_names():
            parent = read.joint_parent(name)
            at, axes = whole[parent.name] if parent is not None and parent.name in whole else (np.zeros(3), np.eye(3))
            channels = read.joint_channels(name)
            value = [read.frame_joint_channel(frame + skip, name, channel) for channel in channels]
            offset = np.array(value[:3]) if len(channels) == 6 else np.array(read.joint_offset(name))
            turned = axes
            for channel, degrees in zip(channels[-3:], value[-3:]):
                turned = turned @ about(channel[0], degrees)
            whole[name] = (at + axes @ offset, turned)
        found.append({name: at / per_m for name, (at, _) in whole.items()})
    return found


def joints_of_usd(path, frames):
    stage = Usd.Stage.Open(str(path))
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(UsdSkel.Skeleton(stage.GetPrimAtPath("/Body/Skel")))
    names = [joint.split("/")[-1] for joint in query.GetJointOrder()]
    return [dict(zip(names, (np.array(m.ExtractTranslation()) for m in query.ComputeJointSkelTransforms(frame)))) for frame in frames]


def joints_of_gltf(path, frames):
    gltf = GLTF2().load_binary(str(path))
    binary = gltf.binary_blob()

    def numbers(accessor):
        accessor = gltf.accessors[accessor]
        view = gltf.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        at = view.byteOffset or 0
        return np.array(struct.unpack_from(f"<{accessor.count * width}f", binary, at)).reshape(-1, width)

    animation = gltf.animations[0]
    moved = {(c.target.node, c.target.path): numbers(animation.samplers[c.sampler].output) for c in animation.channels}
    parent = {child: k for k, node in enumerate(gltf.nodes) for child in node.children or []}

    def matrix(q):
        x, y, z, w = q
        return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])

    found = []
    for frame in frames:
        whole = {}
        for k, node in enumerate(gltf.nodes):
            if (k, "rotation") not in moved:
                continue
            at, axes = whole[parent[k]] if k in parent else (np.zeros(3), np.eye(3))
            offset = moved[k, "translation"][frame] if (k, "translation") in moved else np.array(node.translation)
            whole[k] = (at + axes @ offset, axes @ matrix(moved[k, "rotation"][frame]))
        found.append({gltf.nodes[k].name: at for k, (at, _) in whole.items()})
    return found


def joints_of_c3d(path, frames):
    """Of the rotations' last columns, and of markers, mm in the room to m in the figure's axes."""
    read = ezc3d.c3d(str(path))
    figure = lambda at: np.array([at[1], at[2], at[0]]) / 1000
    names = read["parameters"]["ROTATION"]["LABELS"]["value"]
    markers = read["parameters"]["POINT"]["LABELS"]["value"]
    rotations, points = read["data"]["rotations"], read["data"]["points"]
    legs = {"hips": "pelvis", **{f"{ours}_{side}": f"{theirs}_{side}" for side in "rl" for ours, theirs in {"hip": "upper_leg", "knee": "lower_leg", "ankle": "foot"}.items()}}
    found = []
    for frame in frames:
        whole = {name: figure(rotations[:3, 3, k, frame]) for k, name in enumerate(names)}
        whole.update({f"{theirs} marker": figure(points[:3, markers.index(ours), frame]) for ours, theirs in legs.items()})
        found.append(whole)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=pathlib.Path)
    parser.add_argument("--posed", default="target/release/posed")
    parser.add_argument("--node", type=pathlib.Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)

        def export(to, *more):
            out = folder / f"{'-'.join([to, *more[1:]])}.{to}"
            answer = subprocess.run([args.posed, "export", args.recording, "--to", to, *more, "-o", out, "--json"], check=True, capture_output=True, text=True)
            return out, json.loads(answer.stdout)["rows"]

        usd, rows = export("usda")
        frames = range(0, rows, 10)
        ours = joints_of_bvh(export("bvh")[0], frames, 1, 0)
        others = {"usda": (joints_of_usd(usd, frames), {name: name for name in ours[0]})}
        for names, (per_m, pairs) in NAMES.items():
            others[names] = (joints_of_bvh(export("bvh", "--bones", names)[0], frames, per_m, 1), pairs)
        files = [export(to)[0] for to in ("glb", "vrm", "vrma")]
        others["glb"] = (joints_of_gltf(files[0], frames), VRM)
        others["vrma"] = (joints_of_gltf(files[2], frames), VRM)
        c3d = joints_of_c3d(export("c3d")[0], frames)
        others["c3d"] = (c3d, {name: name.removesuffix(" marker") for name in c3d[0]})
        right = True
        print("| file | joints | frames | worst off, mm | at |")
        print("|---|---|---|---|---|")
        for name, (found, pairs) in others.items():
            off = [(float(np.linalg.norm(there[a] - here[b])) * 1000, b) for here, there in zip(ours, found) for a, b in pairs.items()]
            worst = max(off)
            print(f"| {name} | {len(pairs)} | {len(found)} | {worst[0]:.3f} | {worst[1]} |")
            shorter = name in SHORTER or name == "vrma"
            right &= all(mm < (3 if shorter and joint in UPPER else 1) for mm, joint in off)
        if args.node:
            script = ("const v=require('gltf-validator'),f=require('fs');Promise.all(process.argv.slice(1).map(async p=>{"
                      "const i=(await v.validateBytes(new Uint8Array(f.readFileSync(p)))).issues;console.log(p.split('.').pop(),i.numErrors,'errors',i.numWarnings,'warnings');"
                      "if(i.numErrors||i.numWarnings)process.exitCode=1}))")
            right &= subprocess.run(["node", "-e", script, *map(str, files)], cwd=args.node).returncode == 0
    sys.exit(0 if right else 1)


if __name__ == "__main__":
    main()
