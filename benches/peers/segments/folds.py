#!/usr/bin/env python3
"""`posed segments` and a random forest on sequences that neither has learned from, over several seeds.

usage: folds.py FOLDER --rate-hz HZ (--held A,B ... | --deal N) [--seeds N] [--forest N] [--trees N] [--posed PATH] [-- OPTIONS OF segments train ...]

FOLDER holds CSV sequences as `posed segments train` reads them (`label`, `transition`, NAME_x,NAME_y,NAME_z in mm, y up). In each
fold the sequences of one `--held` are tested and all others learned from; `--deal N` deals the sequences to N folds in alphabetical
order. Frames of classes that were not learned from are not scored. Prints accuracy and F1@50 in %, by fold the median over seeds; then their means over the folds: median over seeds, and the worst seed.
Needs numpy and scikit-learn (PyPI).
"""
import argparse
import csv
import gzip
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile

import forest


def name(path):
    return path.name.split(".")[0]


def labels_of(file):
    labels = forest.read(file)[2]
    return set(labels) - {""}


def copy_known(file, to, known):
    """Copies a sequence; frames whose label is not `known` are marked as not to be scored."""
    opener = gzip.open if file.suffix == ".gz" else open
    with opener(file, "rt") as rows, opener(to, "wt", newline="") as out:
        rows = csv.reader(line for line in rows if not line.startswith("#"))
        header = next(rows)
        label, transition = header.index("label"), header.index("transition")
        out = csv.writer(out, lineterminator="\n")
        out.writerow(header)
        for row in rows:
            row[transition] = row[transition] if row[label] in known else "1"
            out.writerow(row)


def posed(args, held, files, seed, options):
    """Accuracy and F1@50 of a network that was trained with this seed."""
    form = ["--rate-hz", str(args.rate_hz), "--unit", "mm"]

    def segments(*command):
        return subprocess.run([args.posed, "segments", *command], check=True, capture_output=True, text=True).stdout

    with tempfile.TemporaryDirectory() as work:
        folders = {part: pathlib.Path(work) / part for part in ("train", "test")}
        for folder in folders.values():
            folder.mkdir()
        known = set().union(*(args.labels[name(file)] for file in files if name(file) not in held))
        for file in files:
            if name(file) in held:
                copy_known(file, folders["test"] / file.name, known)
            else:
                (folders["train"] / file.name).symlink_to(file.resolve())
        model = str(pathlib.Path(work) / "model.safetensors")
        segments("train", str(folders["train"]), *form, "--seed", str(seed), "-o", model, *options)
        answer = json.loads(segments("evaluate", model, str(folders["test"]), *form, "--json"))
    return answer["accuracy"], answer["f1_50"]


def row(title, figures, folds):
    """`figures`: by seed and fold, accuracy and F1@50."""
    cells = [f"{statistics.median(seed[k][0] for seed in figures):.1f}, {statistics.median(seed[k][1] for seed in figures):.1f}"
             for k in range(folds)]
    means = [[sum(fold[k] for fold in seed) / folds for seed in figures] for k in (0, 1)]
    cells += [f"{statistics.median(mean):.1f} ({min(mean):.1f})" for mean in means]
    print(f"| {title} |", " | ".join(cells), "|", flush=True)


def main():
    own, options = sys.argv[1:], []
    if "--" in own:
        own, options = own[: own.index("--")], own[own.index("--") + 1 :]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--rate-hz", type=float, required=True)
    parser.add_argument("--held", action="append", help="sequences of a fold, with commas")
    parser.add_argument("--deal", type=int)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--forest", type=int, default=1, help="seeds of the forest; 0: none")
    parser.add_argument("--trees", type=int, default=150)
    parser.add_argument("--posed", default="target/release/posed")
    args = parser.parse_args(own)
    files = sorted(args.folder.glob("*.csv*"))
    args.labels = {name(file): labels_of(file) for file in files}
    if args.deal:
        folds = [[name(file) for file in files[k :: args.deal]] for k in range(args.deal)]
    else:
        folds = [held.split(",") for held in args.held or []]
    print("| |", " | ".join(", ".join(fold) for fold in folds), "| accuracy, mean | F1@50, mean |")
    print("|---" * (len(folds) + 3) + "|", flush=True)
    if args.forest:
        data = {}
        for file in files:
            joints, points, labels = forest.read(file)
            data[name(file)] = (forest.features(joints, points, args.rate_hz), labels)
        both = [[forest.evaluate(data, held, args.rate_hz, args.trees, seed) for held in folds]
                for seed in range(1, args.forest + 1)]
        for k, title in enumerate(("random forest", "random forest, 1 s filter")):
            row(title, [[fold[k] for fold in seed] for seed in both], len(folds))
    if args.seeds:
        row("posed", [[posed(args, held, files, seed, options) for held in folds] for seed in range(1, args.seeds + 1)], len(folds))


main()
