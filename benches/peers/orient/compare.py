"""Orientation error of `posed orient` and of VQF 2.1.2 (real time and offline) on BROAD trials, per trial, as Markdown.

    python3 -m venv venv && venv/bin/pip install numpy vqf==2.1.2
    cargo build --release
    venv/bin/python benches/peers/orient/compare.py target/release/posed FOLDER_WITH_TRIALS

Errors as BROAD defines them (Laidig, Caruso, Cereatti & Seel 2021): `q_imu * inverse(q_optical)`, its total angle, its
part about the vertical and the rest; root mean square over the rows with movement = 1 that have a reference.
Further arguments go to `posed orient`, for example `--gyro-delay-ms 0`.
"""

import csv
import gzip
import json
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
from vqf import VQF, offlineVQF


def read(path):
    with gzip.open(path, "rt") as file:
        rate_hz = float(file.readline().split("=")[1])
        rows = csv.DictReader(file)
        columns = rows.fieldnames
        data = np.array([[float(row[c]) if row[c] else np.nan for c in columns] for row in rows])
    pick = lambda *names: np.ascontiguousarray(data[:, [columns.index(n) for n in names]])
    return rate_hz, pick("ax", "ay", "az"), pick("gx", "gy", "gz"), pick("mx", "my", "mz"), \
        pick("qw", "qx", "qy", "qz"), pick("movement")[:, 0] > 0


def errors(q, reference, movement):
    """Root mean square (total, heading, inclination), degrees."""
    use = movement & ~np.isnan(reference[:, 0])
    a, b = q[use], reference[use] / np.linalg.norm(reference[use], axis=1)[:, None]
    a = a / np.linalg.norm(a, axis=1)[:, None]
    w = np.sum(a * b, axis=1)
    z = -a[:, 0] * b[:, 3] + a[:, 3] * b[:, 0] - a[:, 1] * b[:, 2] + a[:, 2] * b[:, 1]
    total = 2 * np.arccos(np.clip(np.abs(w), 0, 1))
    heading = 2 * np.arctan(np.abs(z / w))
    inclination = 2 * np.arccos(np.clip(np.hypot(w, z), 0, 1))
    return [np.rad2deg(np.sqrt(np.mean(e**2))) for e in (total, heading, inclination)]


def posed(binary, path, rate_hz, options):
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / "q.csv"
        command = [binary, "orient", path, "--rate-hz", repr(rate_hz), "-o", out, "--json", *options]
        answer = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        with open(out) as file:
            q = np.array([[float(row[c]) for c in ("qw", "qx", "qy", "qz")] for row in csv.DictReader(file)])
    return q, answer["ns_per_sample"]


def main(binary, folder, *options):
    print("| trial | posed | | VQF real time | | VQF offline | |")
    print("|---|---|---|---|---|---|---|")
    print("| | total | inclination | total | inclination | total | inclination |")
    table, times = [], []
    for path in sorted(pathlib.Path(folder).glob("*.csv.gz")):
        rate_hz, accel, gyro, mag, reference, movement = read(path)
        q, ns = posed(binary, path, rate_hz, options)
        vqf = VQF(1 / rate_hz)
        start = time.perf_counter()
        real_time = vqf.updateBatch(gyro, accel, mag)["quat9D"]
        vqf_ns = (time.perf_counter() - start) / len(gyro) * 1e9
        offline = offlineVQF(gyro, accel, mag, 1 / rate_hz)["quat9D"]
        found = [errors(x, reference, movement) for x in (q, real_time, offline)]
        table.append([e for total, _, inclination in found for e in (total, inclination)])
        times.append((ns, vqf_ns))
        print(f"| {path.name[:-7].replace('_', ' ')} | " + " | ".join(f"{e:.3f}" for e in table[-1]) + " |")
    print("| **mean** | " + " | ".join(f"**{e:.3f}**" for e in np.mean(table, axis=0)) + " |")
    ns, vqf_ns = np.median(times, axis=0)
    print(f"\nMedian time per sample: posed {ns:.0f} ns, VQF real time {vqf_ns:.0f} ns.")


if __name__ == "__main__":
    main(*sys.argv[1:])
