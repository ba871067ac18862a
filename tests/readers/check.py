"""Holds what readers that others wrote find in the files and streams of a folder against truth.json, which tests/it/exports.rs wrote.

BVH and glTF by Blender (blender.json), VRM by three-vrm (vrm.json), glTF by pygltflib, USD by UsdSkel, C3D by ezc3d, TRC, STO and MOT by OpenSim, VMC by
python-osc; MVN's stream by the layout of its specification. Ends with 1 where a joint is off by a millimetre.
"""

import json
import pathlib
import struct
import sys

import numpy as np

import osim
from truth import FIFTEEN, FRAMES, MARKERS, MM, ROOM, SEGMENTS, TRUTH, WHOLE, failures, held, matrices

# From the axes of readers to the room's: x ahead of a person who is not turned, y left, z up.
FROM_FIGURE = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # left, up, ahead
FROM_BLENDER = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # left, back, up
FROM_UNITY = np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0]])  # right, up, ahead of a person who looks along the room's y

SIDES = {"l": "Left", "r": "Right"}
LIMBS = {"shoulder": "Shoulder", "upper_arm": "UpperArm", "forearm": "LowerArm", "hand": "Hand", "upper_leg": "UpperLeg", "lower_leg": "LowerLeg", "foot": "Foot", "toe": "Toes"}


def sided(names, make):
    return {make(theirs, side): f"{ours}_{side}" for ours, theirs in names.items() for side in "lr"}


# The reader's names of bones, and ours. Skeletons without a bone for L3 end the lowest piece of the spine otherwise, so T12 is not where ours is.
VRM = {"hips": "pelvis", "spine": "l5", "upperChest": "t8", "neck": "neck", "head": "head", **sided(LIMBS, lambda name, side: SIDES[side].lower() + name)}
UNITY = {"Hips": "pelvis", "Spine": "l3", "Chest": "t12", "UpperChest": "t8", "Neck": "neck", "Head": "head", **sided(LIMBS, lambda name, side: SIDES[side] + name)}
RIGIFY = {"spine": "pelvis", "spine.001": "l5", "spine.003": "t8", "spine.004": "neck", "spine.006": "head", **sided(
    {"shoulder": "shoulder", "upper_arm": "upper_arm", "forearm": "forearm", "hand": "hand", "upper_leg": "thigh", "lower_leg": "shin", "foot": "foot", "toe": "toe"},
    lambda name, side: f"{name}.{side.upper()}")}
HUMANIK_LIMBS = sided(
    {"shoulder": "Shoulder", "upper_arm": "Arm", "forearm": "ForeArm", "hand": "Hand", "upper_leg": "UpLeg", "lower_leg": "Leg", "foot": "Foot", "toe": "ToeBase"},
    lambda name, side: SIDES[side] + name)
HUMANIK = {"Hips": "pelvis", "Spine": "l5", "Spine1": "l3", "Spine2": "t12", "Spine3": "t8", "Neck": "neck", "Head": "head", **HUMANIK_LIMBS}
MIXAMO = {f"mixamorig:{name}": ours for name, ours in {"Hips": "pelvis", "Spine": "l5", "Spine2": "t8", "Neck": "neck", "Head": "head", **HUMANIK_LIMBS}.items()}
BLENDER = {"take.bvh": None, "take-blender.bvh": RIGIFY, "take-motionbuilder.bvh": HUMANIK, "take-mixamo.bvh": MIXAMO, "take.glb": VRM, "take.vrm": VRM}


def gltf(path):
    """Joints by node's name from the node's local rotations and translations (glTF 2.0, Animations)."""
    from pygltflib import GLTF2

    read = GLTF2().load_binary(path)
    assert read is not None
    blob = read.binary_blob()

    def numbers(at):
        accessor = read.accessors[at]
        view = read.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        return np.frombuffer(blob, "<f4", accessor.count * width, view.byteOffset or 0).reshape(-1, width)

    animation = read.animations[0]
    moved = {(c.target.node, c.target.path): numbers(animation.samplers[c.sampler].output)[FRAMES] for c in animation.channels}
    parents = {child: at for at, node in enumerate(read.nodes) for child in node.children or []}
    whole = {}
    for at, node in enumerate(read.nodes):
        if (at, "rotation") not in moved:
            continue
        here, axes = whole.get(parents.get(at), (np.zeros(3), np.eye(3)[None]))
        offset = moved[at, "translation"] if (at, "translation") in moved else np.array([node.translation])
        whole[at] = (here + np.einsum("nij,nj->ni", axes, np.broadcast_to(offset, (len(FRAMES), 3))), axes @ matrices(moved[at, "rotation"]))
    return {read.nodes[at].name: here for at, (here, _) in whole.items()}


def usd(path):
    from pxr import Usd, UsdSkel

    stage = Usd.Stage.Open(path)
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate) or [None]
    skeleton = binding.GetSkeleton() if binding else UsdSkel.Skeleton(stage.GetPrimAtPath("/Body/Skel"))
    query = cache.GetSkelQuery(skeleton)
    names = [joint.split("/")[-1] for joint in query.GetJointOrder()]
    moved = [[list(m.ExtractTranslation()) for m in query.ComputeJointSkelTransforms(frame)] for frame in FRAMES]
    return dict(zip(names, np.array(moved).transpose(1, 0, 2)))


def c3d(path):
    """Joints by the rotations' last columns, the markers, m, and the joints' angles, degrees."""
    import ezc3d

    read = ezc3d.c3d(path)
    of_points, labels = read["parameters"]["POINT"], read["parameters"]["ROTATION"]["LABELS"]["value"]
    assert (of_points["UNITS"]["value"], of_points["ANGLE_UNITS"]["value"]) == (["mm"], ["deg"])
    rotations = read["data"]["rotations"]
    points = {name: read["data"]["points"][:3, at, FRAMES].T for at, name in enumerate(of_points["LABELS"]["value"])}
    angles = {name: points.pop(name) for name in of_points["ANGLES"]["value"]}
    joints = {name: rotations[:3, 3, at, FRAMES].T / MM for at, name in enumerate(labels)}
    return joints, {name: at / MM for name, at in points.items()}, angles


def datagrams(path):
    return [bytes.fromhex(line) for line in pathlib.Path(path).read_text().split()]


def at_times(times):
    """Truth of the bodies that were sent, which tell their time in single precision."""
    bodies = TRUTH["bodies"]
    all_s = np.array([body["t_s"] for body in bodies])
    nearest = [int(np.abs(all_s - t_s).argmin()) for t_s in times]
    assert np.abs(all_s[nearest] - times).max() < 2e-3
    return {name: np.array([bodies[at]["whole_m"][k] for at in nearest]) for k, name in enumerate(SEGMENTS)}


# The avatar's bones hang on one another as Unity has it.
UNITY_PARENTS = {"Spine": "Hips", "Chest": "Spine", "UpperChest": "Chest", "Neck": "UpperChest", "Head": "Neck", **{
    side + name: above if above in ("Hips", "UpperChest") else side + above for side in ("Left", "Right") for name, above in {
        "Shoulder": "UpperChest", "UpperArm": "Shoulder", "LowerArm": "UpperArm", "Hand": "LowerArm", "UpperLeg": "Hips", "LowerLeg": "UpperLeg", "Foot": "LowerLeg",
        "Toes": "Foot"}.items()}}


def vmc(path):
    """Times, s, and joints in Unity's axes from the bones' local poses, by bone."""
    from pythonosc.osc_packet import OscPacket

    times, frames = [], []
    for datagram in datagrams(path):
        assert len(datagram) <= 1400
        for timed in OscPacket(datagram).messages:
            address, values = timed.message.address, timed.message.params
            if address == "/VMC/Ext/T":
                times.append(values[0])
                frames.append({})
            elif address == "/VMC/Ext/OK":
                assert values == [1], values
            elif address == "/VMC/Ext/Bone/Pos":
                assert len(values) == 8 and all(isinstance(value, float) for value in values[1:])
                frames[-1][values[0]] = values[1:]
    found = {name: [] for name in UNITY}
    for bones in frames:
        whole = {}
        for name in UNITY:
            here, axes = whole[UNITY_PARENTS[name]] if name in UNITY_PARENTS else (np.zeros(3), np.eye(3))
            # Left-handed axes: the same product, of turns that go the other way about.
            whole[name] = (here + axes @ bones[name][:3], axes @ matrices([bones[name][3:]])[0])
            found[name].append(whole[name][0])
    return times, found


def mvn(path):
    """By type of MXTP: per sample its time, s, and the items' ids and numbers. Header of 24 bytes, all big-endian (MV0305P)."""
    layouts = {"01": "i6f", "02": "i7f", "20": "2i3f", "21": "i9f", "22": "i10f", "24": "3f"}
    found = {}
    for datagram in datagrams(path):
        kind, sample, part, items, ms, character, bodies, props, fingers, _, size = struct.unpack_from(">4x2sIBBIBBBBHH", datagram)
        kind = kind.decode()
        assert datagram[:4] == b"MXTP" and size == len(datagram) - 24 and part == 0x80 and (bodies, props, fingers) == (23, 0, 0)
        if kind in layouts:
            rows = list(struct.iter_unpack(">" + layouts[kind], datagram[24:]))
            assert len(rows) == items
            found.setdefault(kind, []).append((ms / MM, np.array(rows)))
        elif kind == "25":
            assert struct.unpack_from(">i", datagram, 24)[0] == len(datagram) - 28 == 12
    return found


def main():
    print("| file or stream | reader | joints | frames | worst off, mm | at |\n|---|---|---|---|---|---|")
    if pathlib.Path("blender.json").exists():
        blender = json.loads(pathlib.Path("blender.json").read_text())
        for file, names in BLENDER.items():
            held(file, "Blender", blender[file], names or {name: name for name in SEGMENTS}, WHOLE, FROM_BLENDER)
    for file, joints in json.loads(pathlib.Path("vrm.json").read_text()).items():
        held(file, "three-vrm", joints, VRM, WHOLE, FROM_FIGURE)
    for file in ("take.glb", "take.vrma"):
        held(file, "pygltflib", gltf(file), VRM, WHOLE, FROM_FIGURE)
    held("take.usda", "UsdSkel", usd("take.usda"), {name: name for name in SEGMENTS}, WHOLE, FROM_FIGURE)
    rotations, points, angles = c3d("take.c3d")
    held("take.c3d", "ezc3d", rotations, {name: name for name in SEGMENTS}, WHOLE, ROOM)
    held("take.c3d points", "ezc3d", points, MARKERS, FIFTEEN, ROOM)
    osim.files()
    coordinates = osim.motion()
    for side in "rl":
        hips = np.array([coordinates[f"hip_{turn}_{side}"] for turn in ("flexion", "adduction", "rotation")]).T
        off = np.abs(angles[f"hip_{side}_angles"] - hips).max()
        if not off < 0.01:
            failures.append(f"angles of take.c3d are {off:.2f} degrees off those of take.mot")
    times, bones = vmc("vmc.hex")
    held("VMC", "python-osc", bones, UNITY, at_times(times), FROM_UNITY)
    types = mvn("mvn.hex")
    began_s = TRUTH["bodies"][0]["t_s"]
    for kind, axes in (("01", FROM_FIGURE / 100), ("02", ROOM), ("21", ROOM)):
        assert all((rows[:, 0] == range(1, 24)).all() for _, rows in types[kind])
        found = {name: np.array([rows[at, 1:4] for _, rows in types[kind]]) for at, name in enumerate(SEGMENTS)}
        held(f"MXTP{kind}", "its layout", found, {name: name for name in SEGMENTS}, at_times([began_s + t_s for t_s, _ in types[kind]]), axes)
    poses, turns, masses = (np.array([rows for _, rows in types[kind]]) for kind in ("02", "22", "24"))
    if not (poses[:, :, 4:] == turns[:, :, 1:5]).all():
        failures.append("MXTP22 turns segments otherwise than MXTP02")
    # Somebody who walks upright has the centre of mass a little above the hips.
    above_m = masses[:, 0] - poses[:, 0, 1:4]
    if np.abs(above_m[:, :2]).max() > 0.15 or not (0 < above_m[:, 2]).all() or above_m[:, 2].max() > 0.2:
        failures.append("MXTP24: the centre of mass is not above the hips")
    sys.exit("\n".join(failures) or 0)


main()
