"""What tests/it/exports.rs says of the take in the folder it wrote, and what it is held against."""

import json
import pathlib

import numpy as np

MM = 1000.0
ROOM = np.eye(3)

TRUTH = json.loads(pathlib.Path("truth.json").read_text())
FRAMES = TRUTH["frames"]
WHOLE = {name: np.array(joints) for name, joints in TRUTH["whole_m"].items()}
FIFTEEN = {name: np.array(joints) for name, joints in TRUTH["fifteen_m"].items()}
SEGMENTS = TRUTH["segments"]
# Markers of TRC and C3D that are joints of the fifteen segments.
MARKERS = {"hips": "pelvis", **{f"{theirs}_{side}": f"{ours}_{side}" for side in "lr" for theirs, ours in {
    "shoulder": "upper_arm", "elbow": "forearm", "wrist": "hand", "hip": "thigh", "knee": "shank", "ankle": "foot"}.items()}}
failures = []


def held(what, reader, found, names, truth, axes):
    """Prints the worst of the joints that `found` has by the reader's names, one row per frame of `truth`."""
    off = {theirs: float(np.linalg.norm(np.asarray(found[theirs]) @ axes.T - truth[ours], axis=1).max()) * MM for theirs, ours in names.items()}
    worst = max(off, key=off.get)
    count = len(next(iter(truth.values())))
    print(f"| {what} | {reader} | {len(off)} | {count} | {off[worst]:.3f} | {worst} |")
    if not off[worst] < 1.0 or count < 10:
        failures.append(f"{what}, {reader}: off by {off[worst]:.1f} mm at {worst}, {count} frames")


def matrices(xyzw):
    """Rotations of quaternions, one in each row, scalar last."""
    x, y, z, w = np.asarray(xyzw, float).T
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]).transpose(2, 0, 1)
