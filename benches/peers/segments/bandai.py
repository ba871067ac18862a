#!/usr/bin/env python3
"""Labelled sequences of the single actions of the Bandai Namco motion data set, a sequence per style, for `folds.py`.

usage: bandai.py DIR FOLDER

DIR holds a CSV per action (`clip` = ACTION_STYLE_NUMBER, `frame`, JOINT_x,JOINT_y,JOINT_z in mm, y up, 30 Hz). The clips of a
style are put one behind the other in an order of chance, each turned and shifted so that the hips go on where they were; the label is the action.
Actions seen in fewer than five styles are left out, because no fold of four could both learn and test them.
"""
import argparse
import collections
import math
import pathlib
import random

import sequences

LEAST_STYLES, SEED = 5, 1


def clips(folder):
    """Per style a list of (action, joints, frames as rows of x, y, z)."""
    styles = collections.defaultdict(list)
    for path in sorted(folder.glob("*.csv.gz")):
        header, rows = sequences.read(path)
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
    sequences.write(path, header, ([label, 0, *(f"{value:.1f}" for value in row)] for label, row in zip(labels, rows)))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dir", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    order = random.Random(SEED)
    for style, takes in clips(args.dir).items():
        write(args.folder / f"{style}.csv.gz", takes[0][1], *joined(takes, order))


main()
