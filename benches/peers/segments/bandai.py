#!/usr/bin/env python3
"""Single actions of the Bandai Namco motion data set in styles that were not learned from, four folds.

usage: bandai.py DIR WORK [--posed PATH] [-- OPTIONS OF segments train ...]

DIR holds a CSV per action (`clip` = ACTION_STYLE_NUMBER, `frame`, JOINT_x,JOINT_y,JOINT_z in mm, y up, 30 Hz). The clips of a
style are put one behind the other in an order of chance, each turned and shifted so that the hips go on where they were; the label is the action. Styles are
dealt to four folds in alphabetical order; actions seen in fewer than five styles are left out, because no fold could
both learn and test them. WORK/all holds all sequences, for `forest.py WORK/all --rate-hz 30 --together STYLE ...`.
"""
import argparse
import collections
import csv
import gzip
import json
import math
import pathlib
import random
import shutil
import subprocess
import sys

FOLDS, LEAST_STYLES, SEED = 4, 5, 1


def clips(folder):
    """Per style a list of (action, joints, frames as rows of x, y, z)."""
    styles = collections.defaultdict(list)
    for path in sorted(folder.glob("*.csv.gz")):
        with gzip.open(path, "rt") as file:
            rows = csv.reader(file)
            header = next(rows)
            joints = [name[:-2] for name in header if name.endswith("_x")]
            whole = collections.defaultdict(list)
            for row in rows:
                whole[row[0]].append([float(cell) for cell in row[2:]])
        for name, frames in whole.items():
            action, style, _ = name.rsplit("_", 2)
            styles[style].append((action, joints, frames))
    seen = collections.defaultdict(set)
    for style, takes in styles.items():
        for action, _, _ in takes:
            seen[action].add(style)
    kept = {style: [take for take in takes if len(seen[take[0]]) >= LEAST_STYLES] for style, takes in styles.items()}
    return {style: takes for style, takes in sorted(kept.items()) if takes}


def facing(joints, frame):
    """Yaw of the line from the right to the left joints, rad."""
    at = {name: 3 * k for k, name in enumerate(joints)}
    sides = [(at[name], at[name.replace("_L", "_R")]) for name in joints if "_L" in name]
    x, z = (sum(frame[l + axis] - frame[r + axis] for l, r in sides) for axis in (0, 2))
    return math.atan2(z, x)


def joined(takes, order):
    """Labels and rows of clips, one behind the other; the hips (first joint) go on."""
    order.shuffle(takes)
    at, ahead = (0.0, 0.0), 0.0
    labels, rows = [], []
    for action, joints, frames in takes:
        turn = ahead - facing(joints, frames[0])
        c, s = math.cos(turn), math.sin(turn)
        x0, z0 = frames[0][0], frames[0][2]
        for frame in frames:
            row = list(frame)
            for k in range(0, len(row), 3):
                x, z = frame[k] - x0, frame[k + 2] - z0
                row[k], row[k + 2] = c * x - s * z + at[0], s * x + c * z + at[1]
            rows.append(row)
            labels.append(action)
        at, ahead = (rows[-1][0], rows[-1][2]), facing(joints, rows[-1])
    return labels, rows


def side_first(name):
    """As other files call their joints: `l_UpperArm`."""
    return f"{name[-1].lower()}_{name[:-2]}" if name.endswith(("_L", "_R")) else name


def write(path, joints, labels, rows):
    header = ["label", "transition", *(f"{side_first(joint)}_{axis}" for joint in joints for axis in "xyz")]
    with gzip.open(path, "wt", compresslevel=1, newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(header)
        out.writerows([label, 0, *(f"{value:.1f}" for value in row)] for label, row in zip(labels, rows))


def segments(posed, *command):
    command = [posed, "segments", *command]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def main():
    own, options = sys.argv[1:], []
    if "--" in own:
        own, options = own[: own.index("--")], own[own.index("--") + 1 :]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dir", type=pathlib.Path)
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--posed", default="target/release/posed")
    args = parser.parse_args(own)
    styles = clips(args.dir)
    order = random.Random(SEED)
    every = args.work / "all"
    every.mkdir(parents=True, exist_ok=True)
    for style, takes in styles.items():
        write(every / f"{style}.csv.gz", takes[0][1], *joined(takes, order))
    form = ["--rate-hz", "30", "--unit", "mm"]
    print("| fold | tested styles | accuracy | edit | F1@10 | F1@25 | F1@50 |\n|---|---|---|---|---|---|---|", flush=True)
    figures = []
    for fold in range(FOLDS):
        tested = [style for k, style in enumerate(styles) if k % FOLDS == fold]
        folders = {part: args.work / f"fold{fold}" / part for part in ("train", "test")}
        for folder in folders.values():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        for style in styles:
            shutil.copy(every / f"{style}.csv.gz", folders["test" if style in tested else "train"])
        model = args.work / f"fold{fold}" / "model.safetensors"
        segments(args.posed, "train", str(folders["train"]), *form, "-o", str(model), *options)
        answer = json.loads(segments(args.posed, "evaluate", str(model), str(folders["test"]), *form, "--json"))
        figures.append([answer[key] for key in ("accuracy", "edit", "f1_10", "f1_25", "f1_50")])
        print(f"| {fold + 1} | {', '.join(tested)} |", " | ".join(f"{value:.1f}" for value in figures[-1]), "|", flush=True)
    print("| all | |", " | ".join(f"{sum(column) / FOLDS:.1f}" for column in zip(*figures)), "|")


main()
