#!/usr/bin/env python3
"""`posed segments` and a random forest on sequences that neither has learned from, over several seeds.

usage: folds.py FOLDER --rate-hz HZ (--held A,B ... | --deal N) [--seeds N] [--forest N] [--trees N] [--posed PATH] [-- OPTIONS OF segments train ...]

FOLDER holds CSV sequences as `posed segments train` reads them (`label`, `transition`, NAME_x,NAME_y,NAME_z in mm, y up). In each
fold the sequences of one `--held` are tested and all others learned from; `--deal N` deals the sequences to N folds in alphabetical
order. Frames of classes that were not learned from are not scored. Prints accuracy and F1@50 in %, by fold the median over seeds; then their means over the folds: median over seeds, and the worst seed.
Needs numpy and scikit-learn (PyPI).
"""
import argparse
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile

import forest
import sequences


def name(path):
    return path.name.split(".")[0]


def known(header, rows):
    """Labels that are learned from."""
    label, transition = header.index("label"), header.index("transition")
    return {row[label] for row in rows if row[transition] != "1"} - {""}


def only(labels, header, rows):
    """The sequence with frames of other labels marked as not to be scored."""
    label, transition = header.index("label"), header.index("transition")
    marked = [list(row) for row in rows]
    for row in marked:
        row[transition] = row[transition] if row[label] in labels else "1"
    return header, marked


def posed(args, options, files, data, held):
    """By seed, accuracy and F1@50 of a network that has learned from all sequences but those `held`."""
    form = ["--rate-hz", str(args.rate_hz), "--unit", "mm"]

    def segments(*command):
        return subprocess.run([args.posed, "segments", *command], check=True, capture_output=True, text=True).stdout

    labels = set().union(*(known(*data[name(file)]) for file in files if name(file) not in held))
    figures = []
    with tempfile.TemporaryDirectory() as work:
        train, test = (pathlib.Path(work) / part for part in ("train", "test"))
        train.mkdir()
        test.mkdir()
        for file in files:
            if name(file) in held:
                sequences.write(test / f"{name(file)}.csv.gz", *only(labels, *data[name(file)]))
            else:
                (train / file.name).symlink_to(file.resolve())
        model = str(pathlib.Path(work) / "model.safetensors")
        for seed in range(1, args.seeds + 1):
            segments("train", str(train), *form, "--seed", str(seed), "-o", model, *options)
            answer = json.loads(segments("evaluate", model, str(test), *form, "--json"))
            figures.append((answer["accuracy"], answer["f1_50"]))
    return figures


def forests(args, data, folds):
    """By fold and seed, accuracy and F1@50 of the forest, plain and with the filter."""
    seen = {}
    for key, sequence in data.items():
        joints, points, labels = forest.arrays(*sequence)
        seen[key] = (forest.features(joints, points, args.rate_hz), labels)
    seeds = range(1, args.forest + 1)
    return [[forest.evaluate(seen, held, args.rate_hz, args.trees, seed) for seed in seeds] for held in folds]


def row(title, figures):
    """`figures`: by fold and seed, accuracy and F1@50."""
    cells = [", ".join(f"{statistics.median(column):.1f}" for column in zip(*fold)) for fold in figures]
    means = [[statistics.fmean(fold[k] for fold in seed) for seed in zip(*figures)] for k in (0, 1)]
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
    data = {name(file): sequences.read(file) for file in files}
    if args.deal:
        folds = [[name(file) for file in files[k :: args.deal]] for k in range(args.deal)]
    else:
        folds = [held.split(",") for held in args.held or []]
    print("| |", " | ".join(", ".join(fold) for fold in folds), "| accuracy, mean | F1@50, mean |")
    print("|---" * (len(folds) + 3) + "|", flush=True)
    if args.forest:
        both = forests(args, data, folds)
        for k, title in enumerate(("random forest", "random forest, 1 s filter")):
            row(title, [[seed[k] for seed in fold] for fold in both])
    if args.seeds:
        row("posed", [posed(args, options, files, data, held) for held in folds])


main()
