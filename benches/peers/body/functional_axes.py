"""Knees and elbows of recorded people by VQF and functional axes, on the samples of `cargo bench --bench body people`, as Markdown.

    python3 -m venv venv && venv/bin/pip install numpy vqf==2.1.2 qmt==0.2.4
    cargo bench --bench body people write=FOLDER
    venv/bin/python benches/peers/body/functional_axes.py FOLDER

What a laboratory does without a magnetometer and without our filters (Laidig & Seel 2023; Olsson, Kok, Seel & Halvorsen 2020; Lehmann, Laidig &
Seel 2020): each sensor's orientation by VQF, real time, without the field; which way is up in a segment by the first seconds of standing; the axis of a hinge by
`qmt.jointAxisEstHingeOlsson` over the first minute of movement; the heading of the lower segment against the upper one by `qmt.headingCorrection` (knee:
one axis; elbow: two). Two things it is given: the sign of each hinge's axis, by the truth, and that it may look at all of the run at once where
`headingCorrection` filters. Root mean square against the truth, degrees, ten seconds after the calibration on.
"""

import contextlib
import pathlib
import sys

import numpy as np
import qmt
from vqf import VQF

RATE_HZ = 100.0
STANDS_S = 6.0
CALIBRATION_S = 110.0
JOINTS = {
    "knee": [("thigh_r", "shank_r"), ("thigh_l", "shank_l")],
    "elbow": [("upper_arm_r", "forearm_r"), ("upper_arm_l", "forearm_l")],
}


def read(path):
    with open(path) as file:
        file.readline()
        columns = file.readline().strip().split(",")
        data = np.loadtxt(file, delimiter=",")
    place = {name: at for at, name in enumerate(columns)}

    def segment(name):
        take = lambda *axes: np.ascontiguousarray(data[:, [place[f"{name}_{axis}"] for axis in axes]])
        return {"gyro": take("gx", "gy", "gz"), "accel": take("ax", "ay", "az"), "q": take("qw", "qx", "qy", "qz")}

    return {name: segment(name) for pairs in JOINTS.values() for pair in pairs for name in pair}


def orientation(sensor):
    """Sensor to a level frame of any heading."""
    return VQF(1.0 / RATE_HZ).updateBatch(sensor["gyro"], sensor["accel"])["quat6D"]


def alignment(sensor, axis):
    """Sensor to segment (forward, up, right), from standing and a hinge to the right."""
    up = sensor["accel"][: int(STANDS_S * RATE_HZ)].mean(axis=0)
    up /= np.linalg.norm(up)
    right = axis / np.linalg.norm(axis)
    up -= right * (right @ up)
    up /= np.linalg.norm(up)
    return np.array([np.cross(up, right), up, right])


def true_right(sensor):
    """The segment's right in the sensor's axes by how the truth turns while the sensor turns: for the sign alone."""
    q = sensor["q"]
    turned = qmt.qmult(qmt.qinv(q[:-1]), q[1:])
    turned *= np.sign(turned[:, :1])
    rate = 2.0 * RATE_HZ * turned[:, 1:]
    gyro = sensor["gyro"][1:]
    # Wahba's problem: segment = R sensor.
    u, _, vt = np.linalg.svd(rate.T @ gyro)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return rotation.T @ np.array([0.0, 0.0, 1.0])


def angles(joint, q):
    """Flexion, and pronation of an elbow."""
    m = qmt.quatToRotMat(q)
    flexion = np.arctan2(-m[:, 0, 1], m[:, 1, 1])
    if joint == "knee":
        return {"flexion": -flexion}
    rest = qmt.qmult(qmt.quatFromAngleAxis(-flexion, [0, 0, 1]), q)
    m = qmt.quatToRotMat(rest)
    return {"flexion": flexion, "pronation": np.arctan2(m[:, 0, 2], m[:, 0, 0])}


def solve(joint, upper, lower):
    begin = int(CALIBRATION_S * RATE_HZ)
    span = slice(begin, begin + int(60 * RATE_HZ))
    with contextlib.redirect_stdout(None):
        axes = qmt.jointAxisEstHingeOlsson(
            upper["accel"][span], lower["accel"][span], upper["gyro"][span], lower["gyro"][span]
        )
    segments = []
    for sensor, axis in zip((upper, lower), axes):
        axis = np.asarray(axis).ravel()
        if axis @ true_right(sensor) < 0:
            axis = -axis
        rotation = alignment(sensor, axis)
        q_segment_sensor = qmt.quatFromRotMat(rotation)
        q = qmt.qmult(orientation(sensor), qmt.qinv(q_segment_sensor))
        segments.append((sensor["gyro"] @ rotation.T, q))
    (gyro_u, q_u), (gyro_l, q_l) = segments
    t = np.arange(len(q_u)) / RATE_HZ
    dof = [[0, 0, 1]] if joint == "knee" else [[0, 0, 1], [0, 1, 0]]
    corrected = qmt.headingCorrection(gyro_u, gyro_l, q_u, q_l, t, np.array(dof, float).squeeze(), {})[0]
    found = angles(joint, qmt.qmult(qmt.qinv(q_u), corrected))
    expected = angles(joint, qmt.qmult(qmt.qinv(upper["q"]), lower["q"]))
    after = slice(begin, None)
    off = {name: qmt.wrapToPi(found[name] - expected[name])[after] for name in found}
    return {name: float(np.rad2deg(np.sqrt(np.mean(value**2)))) for name, value in off.items()}


def main():
    print("| VQF, functional axes | knee flexion | elbow flexion | elbow pronation |\n|---|---|---|---|")
    rows = []
    for path in sorted(pathlib.Path(sys.argv[1]).glob("*.csv")):
        body = read(path)
        sums = {}
        for joint, pairs in JOINTS.items():
            for pair in pairs:
                for name, value in solve(joint, body[pair[0]], body[pair[1]]).items():
                    sums.setdefault(f"{joint} {name}", []).append(value)
        row = [np.sqrt(np.mean(np.square(sums[key]))) for key in ("knee flexion", "elbow flexion", "elbow pronation")]
        rows.append(row)
        print(f"| {path.stem} | " + " | ".join(f"{value:.1f}" for value in row) + " |", flush=True)
    print("| median | " + " | ".join(f"{value:.1f}" for value in np.median(rows, axis=0)) + " |")


main()
