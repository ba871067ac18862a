#!/usr/bin/env python3
"""The experiments of Cheema et al. 2019 on made-up sequences: label noise, noise and masks at borders, width 5.

usage: experiments.py WORK [--posed PATH] [--primitives] [--prepare] [--only NETWORK ...] [--folds FOLD ...] [--width 3|5]   runs what is not in WORK/results.jsonl yet
       experiments.py WORK --table                                                  prints what is

Several may run at once, on networks or folds of their own.

`posed` trains the paper's network (`segments train --paper`, 19 rows); the others need tensorflow-cpu (PyPI). All learn from the same
files: 70 sequences of `posed segments generate` (with `--primitives` of the paper's ten labels; a WORK of its own) in local coordinates, as the paper's images are (origin in the mean of the joints, axes
turned to where the body faces, which follows with 0.3 s), fold k tests ten of them; noise replaces labels in the training
files by any of the ten at random, a mask takes frames out of learning. All stop early: a tenth of the training frames
is held out (blocks of 2 s in posed, whole sequences in Keras), patience 10, at most 25 epochs, Adam 1e-3, one sequence per step.
"""
import argparse
import json
import math
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile
import time

from sequences import hits, read, segments, write

SEQUENCES, FOLDS, EPOCHS, PATIENCE = 70, 7, 25, 10
FACING_S = 0.3
PEERS = ["ed-tcn", "dilated-tcn", "bi-lstm"]
# The paper's network by other hands: a difference is one of training, not of the network.
TWIN = "dt-fcn in keras"
PAPER_NOISE = [90.81, 90.99, 90.75, 91.20, 91.13, 91.04, 92.99, 90.11, 89.55, 81.18, 11.24]


def grid():
    """All runs, those first that the most can be said with."""
    for fold in range(2):
        for noise in (0, 40, 80, 90):
            for network in ["dt-fcn", *PEERS]:
                yield {"network": network, "width": 3, "noise": noise, "border": 0, "mask": 0, "fold": fold}
    for fold in range(2):
        for noise in (0, 80):
            yield {"network": TWIN, "width": 3, "noise": noise, "border": 0, "mask": 0, "fold": fold}
    for frames in (11, 21, 31):
        for network in ["dt-fcn", *PEERS]:
            yield {"network": network, "width": 3, "noise": 0, "border": frames, "mask": 0, "fold": 0}
            yield {"network": network, "width": 3, "noise": 0, "border": 0, "mask": frames, "fold": 0}
    for fold in range(2):
        for noise in (0, 40, 80):
            yield {"network": "dt-fcn", "width": 5, "noise": noise, "border": 0, "mask": 0, "fold": fold}
    for fold in range(FOLDS):
        for noise in range(0, 101, 10):
            yield {"network": "dt-fcn", "width": 3, "noise": noise, "border": 0, "mask": 0, "fold": fold}


def localise(source, target):
    """Writes a sequence in the body's own axes: x forward, y up, z to the left."""
    header, rows = read(source)
    at = {name: k for k, name in enumerate(header)}
    joints = [name[:-2] for name in header if name.endswith("_x")]
    pairs = [(joint, "r" + joint[1:]) for joint in joints if joint.startswith("l_")]
    step_s = float(rows[1][0]) - float(rows[0][0])
    left = None
    for row in rows:
        place = {joint: [float(row[at[f"{joint}_{axis}"]]) for axis in "xyz"] for joint in joints}
        mean = [sum(p[axis] for p in place.values()) / len(place) for axis in range(3)]
        now = [sum(place[l][axis] - place[r][axis] for l, r in pairs) for axis in (0, 2)]
        left = now if left is None else [a + min(1, step_s / FACING_S) * (b - a) for a, b in zip(left, now)]
        size = math.hypot(*left)
        c, s = left[1] / size, left[0] / size
        for joint, (x, y, z) in place.items():
            x, y, z = x - mean[0], y - mean[1], z - mean[2]
            for axis, value in zip("xyz", (c * x - s * z, y, s * x + c * z)):
                row[at[f"{joint}_{axis}"]] = f"{value:.4f}"
    write(target, header, rows)


def near_borders(labels, width):
    near = [False] * len(labels)
    for frame in range(len(labels) - 1):
        if labels[frame] != labels[frame + 1]:
            first, end = frame + 1 - (width + 1) // 2, frame + 1 + width // 2
            for k in range(max(0, first), min(len(near), end)):
                near[k] = True
    return near


def spoil(source, target, run, classes, seed):
    """Writes a training file with its labels spoiled."""
    header, rows = read(source)
    label = header.index("label")
    transition = header.index("transition") if "transition" in header else None
    if transition is None:
        header, transition = [*header, "transition"], len(header)
        rows = [[*row, "0"] for row in rows]
    truth = [row[label] for row in rows]
    rng = random.Random(f"{seed} {run['noise']} {run['border']} {source.name}")
    noisy, masked = near_borders(truth, run["border"]), near_borders(truth, run["mask"])
    for row, at_border, out in zip(rows, noisy, masked):
        if rng.random() < run["noise"] / 100 or at_border:
            row[label] = rng.choice(classes)
        if out:
            row[transition] = "1"
    write(target, header, rows)


def edit(truth, named):
    """Segmental edit score, %."""
    a, b = [s[0] for s in segments(truth)], [s[0] for s in segments(named)]
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        before, row[0] = row[0], i
        for j, y in enumerate(b, 1):
            before, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, before + (x != y))
    return 100 * (1 - row[-1] / max(len(a), len(b), 1))


def measures(pairs):
    right = sum(sum(x == y for x, y in zip(t, n)) for t, n in pairs)
    out = {"accuracy": 100 * right / sum(len(t) for t, _ in pairs), "edit": sum(edit(t, n) for t, n in pairs) / len(pairs)}
    for overlap in (10, 25, 50):
        found, a, b = (sum(x) for x in zip(*(hits(t, n, overlap / 100) for t, n in pairs)))
        out[f"f1_{overlap}"] = 200 * found / (a + b)
    return out


def with_posed(posed, run, folder, tests, work):
    model = work / "model.safetensors"
    command = [posed, "segments", "train", str(folder), "--paper", "--epochs", str(EPOCHS), "--held-out", "0.1",
               "--patience", str(PATIENCE), "--width", str(run["width"]), "--seed", str(run["fold"] + 1), "-o", str(model), "--json"]
    answer = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    pairs = []
    for test in tests:
        out = work / "labels.csv"
        subprocess.run([posed, "segments", "label", str(model), str(test), "-o", str(out)], check=True, capture_output=True)
        header, rows = read(test)
        header_named, named = read(out)
        pairs.append(([row[header.index("label")] for row in rows], [row[header_named.index("label")] for row in named]))
    return pairs, answer["epochs"], answer["parameters"]


def with_keras(run, folder, tests, classes):
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import keras
    import numpy as np
    import tensorflow as tf

    from networks import NETWORKS

    tf.config.threading.set_intra_op_parallelism_threads(1)
    tf.config.threading.set_inter_op_parallelism_threads(1)
    keras.utils.set_random_seed(run["fold"] + 1)

    def load(path):
        header, rows = read(path)
        columns = [k for k, name in enumerate(header) if name[-2:] in ("_x", "_y", "_z")]
        x = np.array([[float(row[k]) for k in columns] for row in rows], np.float32).reshape(len(rows), -1, 3)
        x = (x - x.mean(axis=1, keepdims=True)).reshape(len(rows), -1)
        y = np.array([classes.index(row[header.index("label")]) for row in rows])
        weight = np.ones(len(rows), np.float32)
        if "transition" in header:
            weight[[row[header.index("transition")] == "1" for row in rows]] = 0
        return x, y, weight

    train = [load(path) for path in sorted(folder.glob("*.csv.gz"))]
    # The paper's image, as posed makes it: each coordinate of each joint from 0 to 1.
    low = np.min([x.min(axis=0) for x, _, _ in train], axis=0)
    span = np.max([x.max(axis=0) for x, _, _ in train], axis=0) - low + 1e-6

    def batch(x, y, weight):
        pad = -len(x) % 4
        x = np.pad((x - low) / span, ((0, pad), (0, 0)))
        return x[None], np.pad(y, (0, pad))[None], np.pad(weight, (0, pad))[None]

    model = NETWORKS[run["network"].removesuffix(" in keras")](train[0][0].shape[1], len(classes))
    optimizer, loss_of = keras.optimizers.Adam(1e-3), keras.losses.SparseCategoricalCrossentropy(from_logits=True, reduction="none")

    @tf.function(reduce_retracing=True)
    def step(x, y, weight):
        with tf.GradientTape() as tape:
            loss = tf.reduce_sum(loss_of(y, model(x, training=True)) * weight) / (tf.reduce_sum(weight) + 1e-6)
        optimizer.apply_gradients(zip(tape.gradient(loss, model.trainable_variables), model.trainable_variables))
        return loss

    @tf.function(reduce_retracing=True)
    def forward(x):
        return model(x, training=False)

    order, rng = np.arange(len(train)), np.random.default_rng(run["fold"] + 1)
    rng.shuffle(order)
    held, learned = order[: len(order) // 10], order[len(order) // 10:]
    best, kept, since, done = np.inf, None, 0, 0
    for done in range(1, EPOCHS + 1):
        rng.shuffle(learned)
        for k in learned:
            step(*(tf.constant(part) for part in batch(*train[k])))
        sums = np.zeros(2)
        for k in held:
            x, y, weight = batch(*train[k])
            sums += [float((np.array(loss_of(y, forward(tf.constant(x)))) * weight).sum()), weight.sum()]
        if sums[0] / sums[1] < best:
            best, kept, since = sums[0] / sums[1], model.get_weights(), 0
        else:
            since += 1
        if since >= PATIENCE:
            break
    model.set_weights(kept)
    pairs = []
    for test in tests:
        x, y, weight = load(test)
        named = np.array(forward(tf.constant(batch(x, y, weight)[0])))[0, : len(y)].argmax(axis=-1)
        pairs.append(([classes[k] for k in y], [classes[k] for k in named]))
    return pairs, done, model.count_params()


def one(work, posed, run):
    files = sorted((work / "local").glob("*.csv.gz"))
    size = len(files) // FOLDS
    tests = files[run["fold"] * size:(run["fold"] + 1) * size]
    header, rows = read(files[0])
    classes = sorted({row[header.index("label")] for path in files[:10] for row in read(path)[1]})
    with tempfile.TemporaryDirectory(dir=work) as place:
        place = pathlib.Path(place)
        folder = place / "train"
        folder.mkdir()
        for path in files:
            if path not in tests:
                spoil(path, folder / path.name, run, classes, run["fold"])
        begun, cpu = time.time(), os.times()
        if run["network"] == "dt-fcn":
            pairs, epochs, parameters = with_posed(posed, run, folder, tests, place)
        else:
            pairs, epochs, parameters = with_keras(run, folder, tests, classes)
        ended = os.times()
        cpu_s = sum(ended[:4]) - sum(cpu[:4])
        return {**run, **measures(pairs), "epochs": epochs, "parameters": parameters,
                "wall_s": round(time.time() - begun), "cpu_s": round(cpu_s)}


def table(results):
    def cell(**want):
        found = [r for r in results if all(r[k] == v for k, v in want.items())]
        if not found:
            return "-"
        values = [r["accuracy"] for r in found]
        mean = sum(values) / len(values)
        spread = f" ({min(values):.1f}-{max(values):.1f})" if len(values) > 1 else ""
        return f"{mean:.1f}{spread}"

    plain = {"border": 0, "mask": 0}
    print("| label noise, % | paper | DT-FCN |", " | ".join([TWIN, *PEERS, "DT-FCN, width 5"]), "|")
    print("|---" * (len(PEERS) + 5) + "|")
    for noise, paper in zip(range(0, 101, 10), PAPER_NOISE):
        cells = [cell(network="dt-fcn", width=3, noise=noise, **plain)]
        cells += [cell(network=peer, noise=noise, **plain) for peer in [TWIN, *PEERS]]
        print(f"| {noise} | {paper} |", " | ".join([*cells, cell(network="dt-fcn", width=5, noise=noise, **plain)]), "|")
    print("\n| at borders | frames | DT-FCN |", " | ".join(PEERS), "|")
    print("|---" * (len(PEERS) + 3) + "|")
    for what in ("border", "mask"):
        for frames in (11, 21, 31):
            want = {"noise": 0, "border": 0, "mask": 0, "width": 3, what: frames}
            print(f"| {'noise' if what == 'border' else 'mask'} | {frames} |",
                  " | ".join(cell(network=network, **want) for network in ["dt-fcn", *PEERS]), "|")
    print("\n| network | parameters | edit | F1@10 | F1@25 | F1@50 | wall s per run | CPU s |")
    print("|---" * 8 + "|")
    for network in ["dt-fcn", TWIN, *PEERS]:
        found = [r for r in results if r["network"] == network and r["noise"] == 0 and r["width"] == 3 and r["border"] == r["mask"] == 0]
        if found:
            mean = {k: sum(r[k] for r in found) / len(found) for k in ("edit", "f1_10", "f1_25", "f1_50", "wall_s", "cpu_s")}
            print(f"| {network} | {found[0]['parameters']} |", " | ".join(f"{mean[k]:.1f}" for k in mean), "|")
    print(f"\n{len(results)} runs, {sum(r['wall_s'] for r in results) / 3600:.1f} h of wall time, {sum(r['cpu_s'] for r in results) / 3600:.1f} h of processor time")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--posed", default="target/release/posed")
    parser.add_argument("--primitives", action="store_true")
    parser.add_argument("--prepare", action="store_true", help="write WORK/local and stop")
    parser.add_argument("--only", nargs="+", default=["dt-fcn", TWIN, *PEERS])
    parser.add_argument("--folds", nargs="+", type=int, default=list(range(FOLDS)))
    parser.add_argument("--width", type=int, choices=(3, 5))
    parser.add_argument("--table", action="store_true")
    args = parser.parse_args()
    kept = args.work / "results.jsonl"
    results = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    if args.table:
        return table(results)
    local = args.work / "local"
    if len(list(local.glob("*.csv.gz"))) < SEQUENCES:
        shutil.rmtree(local, ignore_errors=True)
        local.mkdir(parents=True)
        kind = ["--primitives"] if args.primitives else []
        with tempfile.TemporaryDirectory(dir=args.work) as made:
            subprocess.run([args.posed, "segments", "generate", made, "--sequences", str(SEQUENCES), *kind], check=True)
            for source in sorted(pathlib.Path(made).glob("*.csv.gz")):
                localise(source, local / source.name)
    if args.prepare:
        return
    known = [{k: r[k] for k in ("network", "width", "noise", "border", "mask", "fold")} for r in results]
    for run in grid():
        if run in known or run["network"] not in args.only or run["fold"] not in args.folds or args.width not in (None, run["width"]):
            continue
        known.append(run)
        # A process of its own: Keras gives memory back only at its end.
        command = [sys.executable, __file__, "--run", json.dumps(run), str(args.work), args.posed]
        answer = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1]
        with open(kept, "a") as file:
            file.write(answer + "\n")
        print(answer, flush=True)


if __name__ == "__main__" and len(sys.argv) > 2 and sys.argv[1] == "--run":
    print(json.dumps(one(pathlib.Path(sys.argv[3]), sys.argv[4], json.loads(sys.argv[2]))))
elif __name__ == "__main__":
    main()
