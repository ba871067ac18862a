"""Orientation error of `posed orient` and of VQF 2.1.2 (real time) on BROAD trials with samples lost, as Markdown.

    venv/bin/python benches/peers/orient/gaps.py target/release/posed FOLDER_WITH_TRIALS

What `compare.py` needs. From 5 s on, of every 1.5 s the first part is lost. posed is given which samples are missing; VQF, which takes samples
at an even rate, gets the last one again, as a driver would do it. Means over the trials, degrees; of rows with movement, a reference and a sample.
"""

import csv
import gzip
import pathlib
import sys
import tempfile

import numpy as np
from vqf import VQF

from compare import errors, posed, read

EVERY_S, FROM_S, LOST_S = 1.5, 5.0, [0.0, 0.05, 0.1, 0.2]
CHANNELS = [f"{kind}{axis}" for kind in "agm" for axis in "xyz"]


def without(path, lost, target):
    with gzip.open(path, "rt") as file:
        file.readline()
        rows = list(csv.DictReader(file))
    with open(target, "w") as file:
        writer = csv.writer(file)
        writer.writerow(CHANNELS)
        writer.writerows([""] * len(CHANNELS) if gone else [row[c] for c in CHANNELS] for row, gone in zip(rows, lost))


def main(binary, folder, *options):
    print("| lost of every 1.5 s | posed | | VQF real time | |\n|---|---|---|---|---|\n| | total | inclination | total | inclination |")
    for lost_s in LOST_S:
        table = []
        for path in sorted(pathlib.Path(folder).glob("*.csv.gz")):
            rate_hz, accel, gyro, mag, reference, movement = read(path)
            t_s = np.arange(len(accel)) / rate_hz
            lost = (t_s > FROM_S) & (t_s % EVERY_S < lost_s)
            with tempfile.TemporaryDirectory() as place:
                source = pathlib.Path(place) / "imu.csv"
                without(path, lost, source)
                own, _ = posed(binary, source, rate_hz, options)
            last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(accel))))
            held = [np.ascontiguousarray(x[last]) for x in (gyro, accel, mag)]
            found = [errors(q, reference, movement & ~lost) for q in (own, VQF(1 / rate_hz).updateBatch(*held)["quat9D"])]
            table.append([e for total, _, inclination in found for e in (total, inclination)])
        print(f"| {lost_s} s | " + " | ".join(f"{e:.2f}" for e in np.mean(table, axis=0)) + " |", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
