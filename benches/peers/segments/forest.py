#!/usr/bin/env python3
"""A random forest on windowed joint features, leave one sequence out: what `posed segments` is measured against.

usage: forest.py DIR [--rate-hz 120] [--trees 300] [--together] [TEST ...]      needs numpy and scikit-learn (PyPI)

DIR holds CSV sequences as `posed segments train` reads them (`label`, `transition`, NAME_x,NAME_y,NAME_z; y up).
Per frame: joints relative to the root, turned to where the body faces (line of the joints l* and r*), and for each
of these coordinates the mean, standard deviation and speed over windows of 0.25, 0.5 and 1 s; then a median filter of 1 s over the
predicted classes. Frames whose class does not occur in training are not scored. Prints a row per test sequence; with `--together` none of them is learned from for any.
"""
import argparse
import csv
import gzip
import pathlib

import numpy as np
from sklearn.ensemble import RandomForestClassifier


def read(path):
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt") as file:
        rows = csv.reader(line for line in file if not line.startswith("#"))
        header = next(rows)
        data = list(rows)
    names = [column[:-2] for column in header if column.endswith("_x")]
    columns = [[header.index(f"{name}_{axis}") for axis in "xyz"] for name in names]
    points = np.array([[[float(row[c]) for c in joint] for joint in columns] for row in data])
    label, transition = header.index("label"), header.index("transition")
    labels = np.array([row[label] if row[transition] != "1" else "" for row in data])
    return names, points / 1000.0, labels


def features(names, points, rate_hz):
    left = [i for i, n in enumerate(names) if n[0] == "l" and "r" + n[1:] in names]
    right = [names.index("r" + names[i][1:]) for i in left]
    side = (points[:, left] - points[:, right]).sum(axis=1)[:, [0, 2]]
    side /= np.linalg.norm(side, axis=1, keepdims=True) + 1e-9
    body = points - points[:, :1]
    x, z = body[..., 0], body[..., 2]
    across = x * side[:, :1] + z * side[:, 1:]
    along = x * side[:, 1:] - z * side[:, :1]
    flat = np.stack([across, body[..., 1], along], axis=-1).reshape(len(points), -1)
    flat = np.concatenate([flat, points[:, :1, 1]], axis=1)
    speed = np.abs(np.gradient(flat, axis=0)) * rate_hz
    parts = [flat]
    for seconds in (0.25, 0.5, 1.0):
        window = max(3, int(seconds * rate_hz) | 1)

        def smooth(values):
            padded = np.pad(values, ((window // 2, window // 2), (0, 0)), mode="edge")
            sums = np.cumsum(np.pad(padded, ((1, 0), (0, 0))), axis=0)
            return (sums[window:] - sums[:-window]) / window

        mean = smooth(flat)
        parts += [mean, np.sqrt(np.maximum(smooth(flat**2) - mean**2, 0)), smooth(speed)]
    return np.concatenate(parts, axis=1)


def median_filter(votes, window):
    """Most frequent class in a window."""
    half = window // 2
    sums = np.cumsum(np.pad(votes, ((half + 1, half), (0, 0))), axis=0)
    return (sums[window:] - sums[:-window]).argmax(axis=1)


def runs(classes):
    out, first = [], 0
    for i in range(1, len(classes) + 1):
        if i == len(classes) or classes[i] != classes[first]:
            out.append((classes[first], first, i))
            first = i
    return out


def f1(truth, named, overlap):
    a, b = runs(truth), runs(named)
    taken, hits = set(), 0
    for c, first, end in b:
        best = max(((min(end, e) - max(first, f)) / (max(end, e) - min(first, f)), k)
                   for k, (d, f, e) in enumerate(a) if d == c) if any(d == c for d, _, _ in a) else (0, -1)
        if best[0] >= overlap and best[1] not in taken:
            taken.add(best[1])
            hits += 1
    return 200.0 * hits / (len(a) + len(b))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("dir", type=pathlib.Path)
    parser.add_argument("tests", nargs="*", default=["13_29", "13_30", "14_20"])
    parser.add_argument("--rate-hz", type=float, default=120.0)
    parser.add_argument("--trees", type=int, default=300)
    parser.add_argument("--step", type=int, default=3, help="learn from every step-th frame")
    parser.add_argument("--together", action="store_true")
    args = parser.parse_args()
    data = {}
    for path in sorted(args.dir.glob("*.csv*")):
        names, points, labels = read(path)
        data[path.name.split(".")[0]] = (features(names, points, args.rate_hz), labels)
    right = frames = 0
    for held in [args.tests] if args.together else [[test] for test in args.tests]:
        x = np.concatenate([f[::args.step] for n, (f, _) in data.items() if n not in held])
        y = np.concatenate([l[::args.step] for n, (_, l) in data.items() if n not in held])
        x, y = x[y != ""], y[y != ""]
        forest = RandomForestClassifier(args.trees, min_samples_leaf=3, max_features="sqrt", n_jobs=1, random_state=1)
        forest.fit(x, y)
        for test in held:
            f, truth = data[test]
            window = int(args.rate_hz) | 1
            p = forest.predict_proba(f)
            for kind, named in (("plain", p.argmax(axis=1)), ("1 s filter", median_filter(p, window))):
                named = forest.classes_[named]
                scored = np.isin(truth, forest.classes_)
                hit = (named == truth) & scored
                print(f"{test} {kind:10} right {100 * hit.sum() / scored.sum():5.1f} %  "
                      f"F1@50 {f1(truth[scored], named[scored], 0.5):5.1f}", flush=True)
            right, frames = right + hit.sum(), frames + scored.sum()
    print(f"all right {100 * right / frames:.1f} %")


main()
