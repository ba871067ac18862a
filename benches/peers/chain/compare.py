"""Hinge angles of `posed body solve` beside those of two VQF filters with a functional axis, on simulated chains.

    python3 -m venv venv && venv/bin/pip install numpy vqf==2.1.2
    cargo build --release
    venv/bin/python benches/peers/chain/compare.py target/release/posed

Chains of three segments and two hinges, held and moved by hand, made here so that no code under test makes the truth. IMUs of
MPU class after calibration at 100 Hz, without magnetometers, mounted at random, rigidly or on foam: a second-order system (8 Hz,
damping 0.2) that the segment's acceleration drives, so that the sensor plays by one to three degrees (and more in fast motion)
and by millimetres. Root mean square error of the angle in degrees, per joint, with the posture of the first quarter of a second as zero for both.

The peer: VQF 2.1.2 (6D, offline, which is its better one) per sensor, the hinge's axis in both sensors by Gauss-Newton from the
rates (Seel, Raisch & Schauer 2014), and the heading between the two level frames from the axis, which must point the same way in
the room: the mean direction over a window of ten seconds, weighed by how level the axis lies.
"""

import csv
import json
import pathlib
import subprocess
import sys
import tempfile

import numpy as np
from vqf import offlineVQF

RATE, FINE, GRAVITY = 100, 1000, 9.81


def qmul(a, b):
    w, v, x, u = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    return np.concatenate([w * x - np.sum(v * u, -1, keepdims=True), w * u + x * v + np.cross(v, u)], -1)


def conj(q):
    return q * [1, -1, -1, -1]


def rot(q, v):
    t = 2 * np.cross(q[..., 1:], v)
    return v + q[..., :1] * t + np.cross(q[..., 1:], t)


def exp(v):
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * v], -1)


def log(q):
    q = q * np.where(q[..., :1] < 0, -1, 1)
    n = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    return np.where(n > 1e-12, 2 * np.arctan2(n, q[..., :1]) * q[..., 1:] / np.maximum(n, 1e-12), 2 * q[..., 1:])


def smooth(random, t, amplitude, fastest_hz, envelope):
    """A sum of sines with random frequencies, growing and pausing with the envelope."""
    out = np.zeros_like(t)
    for _ in range(4):
        f = random.uniform(0.15, fastest_hz)
        out += random.uniform(0.3, 1) * np.sin(2 * np.pi * f * t + random.uniform(0, 6.3))
    return amplitude * envelope * out / 2


def envelope(random, t, pauses):
    out = 1 / (1 + np.exp(-(t - 2) * 3))
    if pauses:
        for start in np.arange(10, t[-1], random.uniform(12, 20)):
            out *= 1 - 1 / (1 + np.exp(-(t - start) * 4)) / (1 + np.exp((t - start - 4) * 4))
    return out


def derivative(x):
    return np.gradient(x, 1 / FINE, axis=0)


def rates(q):
    turn = log(qmul(conj(q[:-2]), q[2:])) * FINE / 2
    return np.concatenate([turn[:1], turn, turn[-1:]])


def foam(acceleration, gain):
    """What a mass on foam does when its support accelerates: 8 Hz, damping 0.2."""
    w, d, dt = 2 * np.pi * 8, 0.2, 1 / FINE
    x, v, out = np.zeros(3), np.zeros(3), np.empty_like(acceleration)
    for k, a in enumerate(acceleration):
        v = v + dt * (-w * w * x - 2 * d * w * v - w * w * gain * a)
        x = x + dt * v
        out[k] = x
    return out


def chain(seed, seconds, fastest_hz, soft, pauses):
    """Samples (gyro, accelerometer) of three IMUs, and the two angles in rad."""
    random = np.random.default_rng(seed)
    t = np.arange(0, seconds, 1 / FINE)
    grow = envelope(random, t, pauses)
    whole = exp(np.stack([smooth(random, t, 0.8, fastest_hz, grow) for _ in range(3)], -1))
    place = np.stack([smooth(random, t, 0.25, fastest_hz, grow) for _ in range(3)], -1)
    q, p, truth = [whole], [place], []
    for _ in range(2):
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        angle = np.abs(smooth(random, t, 1.0, fastest_hz, grow)) ** 2 / (0.3 + np.abs(smooth(random, t, 1.0, 0.4, grow)))
        angle = np.clip(angle, 0, None)
        angle = 1.2 * np.tanh(np.convolve(angle, np.hanning(301) / np.hanning(301).sum(), "same"))
        joint = p[-1] + rot(q[-1], np.array([0, -0.15, 0.0]))
        q.append(qmul(q[-1], exp(axis * angle[:, None])))
        p.append(joint + rot(q[-1], np.array([0, -0.15, 0.0])))
        truth.append(angle)
    samples = []
    for qs, ps in zip(q, p):
        lever = random.normal(size=3) * 0.03
        a = rot(conj(qs), derivative(derivative(ps)))
        play = foam(a, soft * 5e-4 / 1.0) if soft else np.zeros_like(a)
        turn = np.cross(np.array([0, 0, 1.0]) + random.normal(size=3) * 0.3, play) / 0.03 * 0.6
        sensor = qmul(qs, exp(turn))
        where = ps + rot(qs, lever + play)
        mount = exp(random.normal(size=3))
        sensor = qmul(sensor, np.broadcast_to(mount, sensor.shape))
        gyro = rates(sensor)
        accel = rot(conj(sensor), derivative(derivative(where)) + [0, 0, GRAVITY])
        step = FINE // RATE
        mean = lambda x: x[: len(x) // step * step].reshape(-1, step, 3).mean(1)
        scale = lambda s: np.eye(3) + random.normal(size=(3, 3)) * s
        gyro = mean(gyro) @ scale(0.003) + random.normal(size=3) * np.deg2rad(0.2) + random.normal(size=(len(t) // step, 3)) * np.deg2rad(0.07)
        accel = mean(accel) @ scale(0.003) + random.normal(size=3) * 0.03 + random.normal(size=(len(t) // step, 3)) * 0.021
        samples.append((np.ascontiguousarray(gyro[20:-20]), np.ascontiguousarray(accel[20:-20])))
    step = FINE // RATE
    return samples, [angle[step - 1 :: step][20:-20][: len(samples[0][0])] for angle in truth]


def tangent(j):
    a = np.cross(j, np.eye(3)[np.argmin(np.abs(j))])
    a /= np.linalg.norm(a)
    return np.stack([a, np.cross(j, a)], -1)


def seel(w1, w2):
    """The hinge's axis in both sensors: Gauss-Newton (damped) on two spheres, with twelve starts."""
    across = lambda j: [np.cross(w1, j[0]), np.cross(w2, j[1])]
    residual = lambda j: np.linalg.norm(across(j)[0], axis=1) - np.linalg.norm(across(j)[1], axis=1)
    best = None
    for start in np.random.default_rng(1).normal(size=(12, 2, 3)):
        j, damping = [x / np.linalg.norm(x) for x in start], 1e-3
        e = residual(j)
        for _ in range(50):
            c, t = across(j), [tangent(x) for x in j]
            norm = [np.maximum(np.linalg.norm(x, axis=1), 1e-9)[:, None] for x in c]
            rows = np.hstack([np.cross(c[0], w1) / norm[0] @ t[0], -np.cross(c[1], w2) / norm[1] @ t[1]])
            normal = rows.T @ rows
            step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), rows.T @ e)
            moved = [j[0] + t[0] @ step[:2], j[1] + t[1] @ step[2:]]
            moved = [x / np.linalg.norm(x) for x in moved]
            next_e = residual(moved)
            if next_e @ next_e < e @ e:
                j, e, damping = moved, next_e, damping * 0.3
            else:
                damping *= 10
        if best is None or e @ e < best[0]:
            best = (e @ e, j)
    return best[1]


def vqf_angle(first, second):
    q1, q2 = (np.array(offlineVQF(g, a, None, 1 / RATE)["quat6D"]) for g, a in (first, second))
    j1, j2 = seel(first[0], second[0])
    best = None
    for sign in (1, -1):
        a, b = rot(q1, j1), rot(q2, sign * j2)
        # exp(i heading) from both horizontal parts.
        pair = (a[:, 0] + 1j * a[:, 1]) * np.conj(b[:, 0] + 1j * b[:, 1])
        window = np.ones(10 * RATE)
        heading = np.convolve(np.pad(pair, 5 * RATE, mode="edge"), window, "same")[5 * RATE : -5 * RATE]
        off = np.sum(np.abs(a[:, 2] - b[:, 2]))
        if best is None or off < best[0]:
            best = (off, np.angle(heading), sign * j2)
    _, heading, j2 = best
    turn = exp(np.stack([0 * heading, 0 * heading, heading], -1))
    relative = qmul(conj(q1), qmul(turn, q2))
    # Swing j2 onto j1, then the twist about j1.
    c = np.cross(j2, j1)
    swing = np.concatenate([[1 + j1 @ j2], c])
    swing /= np.linalg.norm(swing)
    q = qmul(relative, np.broadcast_to(conj(swing), relative.shape))
    return np.unwrap(2 * np.arctan2(q[:, 1:] @ j1, q[:, 0]))


def error(angle, truth):
    begin = RATE // 4
    off = lambda x: np.angle(np.exp(1j * (x - x[:begin].mean())))
    a, b = off(angle), off(truth)
    rms = lambda e: np.rad2deg(np.sqrt(np.mean(np.angle(np.exp(1j * e)) ** 2)))
    return min(rms(a - b), rms(-a - b))


def posed_angles(binary, samples):
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        stage = 'name = "chain"\n[body]\nskeleton = "custom"\n[[body.segments]]\nname = "a"\n'
        for name, parent in (("b", "a"), ("c", "b")):
            stage += f'[[body.segments]]\nname = "{name}"\nparent = "{parent}"\njoint = "j{name}"\nkind = "hinge"\n'
        (folder / "stage.toml").write_text(stage)
        with open(folder / "imu.csv", "w", newline="") as file:
            out = csv.writer(file)
            out.writerow(["t", "sensor", "ax", "ay", "az", "gx", "gy", "gz"])
            for k in range(len(samples[0][0])):
                for name, (gyro, accel) in zip("abc", samples):
                    out.writerow([f"{k / RATE:.3f}", name, *(f"{v:.7g}" for v in (*accel[k], *gyro[k]))])
        command = [binary, "body", "solve", folder / "imu.csv", "--stage", folder / "stage.toml", "-o", folder / "out.csv", "--json"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(done.stderr)
        json.loads(done.stdout)
        with open(folder / "out.csv") as file:
            rows = list(csv.DictReader(file))
    return [np.deg2rad([float(row[f"j{name}_flexion_deg"]) for row in rows]) for name in "bc"]


def main(binary, runs=4):
    print("| motion | foam | posed | two VQF filters |")
    print("|---|---|---|---|")
    means = []
    for name, fastest_hz, pauses in (("slow", 0.5, False), ("with pauses", 0.8, True), ("fast", 1.5, False)):
        for soft in (0, 1, 3):
            table = []
            for run in range(int(runs)):
                samples, truth = chain(1000 * soft + 10 * run + int(10 * fastest_hz), 60, fastest_hz, soft, pauses)
                ours = posed_angles(binary, samples)
                for k in range(2):
                    peer = vqf_angle(samples[k], samples[k + 1])
                    table.append([error(ours[k], truth[k]), error(peer, truth[k])])
            mean = np.mean(table, axis=0)
            means.append(mean)
            print(f"| {name} | {['none', 'stiff', '', 'soft'][soft]} | {mean[0]:.2f} | {mean[1]:.2f} |", flush=True)
    ours, peer = np.mean(means, axis=0)
    print(f"| **mean** | | **{ours:.2f}** | **{peer:.2f}** |")


if __name__ == "__main__":
    main(*sys.argv[1:])
