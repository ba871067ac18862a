#!/usr/bin/env python3
"""The whole grid of Cheema et al. 2019 on an accelerator: every network on every fold, noise level, border and mask, at the paper's sizes.

usage: grid.py WORK RESULTS.jsonl [--epochs 100] [--only NETWORK ...] [--folds FOLD ...] [--minutes M] [--at-once 128]
       grid.py RESULTS.jsonl --table

WORK holds the sequences of `experiments.py WORK --primitives --prepare`. All runs of a network train side by side, each on sequences, labels and weights of its own;
runs that RESULTS.jsonl already has are not done again. Needs jax (PyPI); on a processor it is slow.

The networks see 224 rows, as the paper's image has: 19 joints, each in 11 or 12 rows. Rows of one joint carry the same numbers, so their weights have the same
gradient: here each joint is one row whose weight is their sum, drawn as a sum and with Adam's step as many times as large. Nothing else is saved.
Sizes: DT-FCN 663,562 parameters, ED-TCN 1,613,770, DilatedTCN 388,874 (causal, four stacks of six layers), Bi-LSTM 378,634, as in the paper's Table 2.

A tenth of the training sequences is held out; the weights of the epoch with the least loss there are the ones that are tested, and those of the last epoch, too.
One sequence per step; Bi-LSTM, whose time is steps one behind the other, four.
"""
import argparse
import json
import pathlib
import random
import time

import numpy as np

from experiments import FOLDS, measures, near_borders
from sequences import read

ROWS = 224
NOISE = range(0, 101, 10)
WINDOWS = (11, 21, 31)
NETWORKS = ["dt-fcn", "ed-tcn", "dilated-tcn", "bi-lstm"]
SIZES = {"dt-fcn": 663_562, "ed-tcn": 1_613_770, "dilated-tcn": 388_874, "bi-lstm": 378_634}
PAPER = {
    "bi-lstm": [81.95, 83.70, 79.94, 85.02, 84.29, 81.72, 83.08, 82.16, 81.91, 71.74, 8.76],
    "ed-tcn": [88.69, 89.16, 89.46, 89.40, 89.02, 87.40, 88.65, 87.66, 80.46, 54.91, 10.39],
    "dilated-tcn": [88.47, 89.37, 88.86, 88.90, 88.64, 87.93, 86.14, 79.46, 61.82, 34.99, 11.85],
    "dt-fcn": [90.81, 90.99, 90.75, 91.20, 91.13, 91.04, 92.99, 90.11, 89.55, 81.18, 11.24],
}
PAPER_WINDOWS = {
    "bi-lstm": [84.57, 81.47, 78.94, 81.02, 80.05, 76.71],
    "ed-tcn": [88.15, 83.82, 75.75, 88.25, 85.88, 84.88],
    "dilated-tcn": [87.50, 85.48, 80.62, 89.04, 86.80, 86.01],
    "dt-fcn": [91.45, 89.03, 83.59, 92.42, 91.93, 90.48],
}
PAPER_TRAINING = {"bi-lstm": 86.32, "ed-tcn": 90.05, "dilated-tcn": 90.64, "dt-fcn": 95.42}


def grid(networks, folds):
    """All runs: a dictionary each."""
    for network in networks:
        for width in (3, 5) if network == "dt-fcn" else (3,):
            plain = {"network": network, "width": width, "noise": 0, "border": 0, "mask": 0}
            for fold in folds:
                for noise in NOISE:
                    yield {**plain, "noise": noise, "fold": fold}
                for frames in WINDOWS if width == 3 else ():
                    yield {**plain, "border": frames, "fold": fold}
                    yield {**plain, "mask": frames, "fold": fold}


def load(work):
    """Sequences as arrays: image (sequence, frame, joint and axis), class and whether there is such a frame; and the classes' names."""
    files = sorted((work / "local").glob("*.csv.gz"))
    images, labels = [], []
    for path in files:
        header, rows = read(path)
        columns = [k for k, name in enumerate(header) if name[-2:] in ("_x", "_y", "_z")]
        x = np.array([[float(row[k]) for k in columns] for row in rows], np.float32).reshape(len(rows), -1, 3)
        images.append((x - x.mean(axis=1, keepdims=True)).reshape(len(rows), -1))
        labels.append([row[header.index("label")] for row in rows])
    classes = sorted({label for sequence in labels for label in sequence})
    length = -(-max(map(len, labels)) // 4) * 4
    x = np.zeros((len(files), length, images[0].shape[1]), np.float32)
    y, there = np.zeros((len(files), length), np.int32), np.zeros((len(files), length), np.float32)
    for k, (image, label) in enumerate(zip(images, labels)):
        x[k, : len(label)], there[k, : len(label)] = image, 1
        y[k, : len(label)] = [classes.index(name) for name in label]
    return x, y, there, classes


def spoiled(run, y, there, classes, test):
    """Labels to learn from, and how much each frame counts."""
    out, weight = y.copy(), there.copy()
    for k in (k for k in range(len(y)) if k not in test):
        frames = int(there[k].sum())
        truth = list(y[k, :frames])
        rng = random.Random(f"{run['fold']} {run['noise']} {run['border']} {k}")
        noisy, masked = near_borders(truth, run["border"]), near_borders(truth, run["mask"])
        for frame in range(frames):
            if rng.random() < run["noise"] / 100 or noisy[frame]:
                out[k, frame] = rng.randrange(classes)
            if masked[frame]:
                weight[k, frame] = 0
    return out, weight


class Layers:
    """Draws weights as Keras does, and remembers by how much Adam's step is larger where one stands for several."""

    def __init__(self, key):
        self.key, self.weights, self.copies = key, [], []

    def draw(self, shape, fan_in, fan_out, copies=None):
        import jax

        self.key, key = jax.random.split(self.key)
        limit = np.sqrt(6 / (fan_in + fan_out))
        if copies is None:
            self.weights.append(jax.random.uniform(key, shape, minval=-limit, maxval=limit))
            self.copies.append(np.float32(1))
        else:
            drawn = jax.random.uniform(key, (int(copies.max()), *shape), minval=-limit, maxval=limit)
            used = (np.arange(int(copies.max()))[:, None] < copies).astype(np.float32)
            self.weights.append((drawn * used.reshape(len(used), *[1] * (len(shape) - 2), -1, 1)).sum(axis=0))
            self.copies.append(copies.astype(np.float32)[:, None])

    def convolution(self, width, inputs, outputs, copies=None):
        rows = inputs if copies is None else int(copies.sum())
        self.draw((width, inputs, outputs), width * rows, width * outputs, copies)
        self.bias(np.zeros(outputs, np.float32))

    def bias(self, values):
        self.weights.append(np.asarray(values, np.float32))
        self.copies.append(np.float32(1))

    def orthogonal(self, rows, columns):
        import jax

        self.key, key = jax.random.split(self.key)
        q, r = np.linalg.qr(np.array(jax.random.normal(key, (columns, rows))))
        self.weights.append((q * np.sign(np.diag(r))).T.astype(np.float32))
        self.copies.append(np.float32(1))


def convolve(x, kernel, bias, dilation, causal=False):
    """(frames, inputs) by (taps, inputs, outputs), zeros around."""
    import jax.numpy as jnp

    taps, frames = kernel.shape[0], x.shape[0]
    before = (taps - 1) * dilation if causal else (taps // 2) * dilation
    padded = jnp.pad(x, ((before, (taps - 1) * dilation - before), (0, 0)))
    rows = [padded[tap * dilation : tap * dilation + frames] for tap in range(taps)]
    return jnp.concatenate(rows, axis=1) @ kernel.reshape(-1, kernel.shape[2]) + bias


def norm_relu(x):
    import jax.numpy as jnp

    x = jnp.maximum(x, 0)
    return x / (x.max(axis=-1, keepdims=True) + 1e-5)


def dropped(x, key, share=0.3):
    """Whole channels, while training."""
    import jax

    if key is None:
        return x
    return x * jax.random.bernoulli(key, 1 - share, (1, x.shape[1])) / (1 - share)


def keys(key, count):
    import jax

    return [None] * count if key is None else list(jax.random.split(key, count))


FILTERS = (64, 64, 128, 256, 512)


def dt_fcn(layers, copies, classes, width):
    inputs = len(copies)
    for k, outputs in enumerate(FILTERS):
        layers.convolution(width, inputs, outputs, copies if k == 0 else None)
        inputs = outputs
    layers.convolution(1, inputs, classes)


def dt_fcn_of(weights, x, there, key, width):
    weights = iter(weights)
    for k in range(5):
        x = convolve(x, next(weights), next(weights), width**k)
        x = (x * (x > 0) if k < 4 else norm_relu(x)) * there
    return convolve(x, next(weights), next(weights), 1)


def ed_tcn(layers, copies, classes, _):
    inputs = len(copies)
    for k, outputs in enumerate((64, 96, 96, 64)):
        layers.convolution(25, inputs, outputs, copies if k == 0 else None)
        inputs = outputs
    layers.convolution(1, inputs, classes)


def ed_tcn_of(weights, x, there, key, _):
    import jax.numpy as jnp

    weights, masks = iter(weights), [there]
    drop = iter(keys(key, 4))
    for k in range(4):
        if k >= 2:
            x, there = jnp.repeat(x, 2, axis=0), masks[1 - (k - 2)]
            x = x * there
        x = norm_relu(dropped(convolve(x, next(weights), next(weights), 1), next(drop))) * there
        if k < 2:
            x = x.reshape(-1, 2, x.shape[1]).max(axis=1)
            there = there.reshape(-1, 2, 1).max(axis=1)
            masks.append(there)
    return convolve(x, next(weights), next(weights), 1)


def dilated_tcn(layers, copies, classes, _):
    layers.convolution(2, len(copies), 64, copies)
    for _ in range(24):
        layers.convolution(2, 64, 64)
        layers.convolution(1, 64, 64)
    layers.convolution(1, 64, 64)
    layers.convolution(1, 64, classes)


def dilated_tcn_of(weights, x, there, key, _):
    weights, drop, skips = iter(weights), iter(keys(key, 24)), 0
    x = convolve(x, next(weights), next(weights), 1, causal=True) * there
    for k in range(24):
        inner = convolve(x, next(weights), next(weights), 2 ** (k % 6), causal=True)
        inner = norm_relu(dropped(inner, next(drop))) * there
        inner = convolve(inner, next(weights), next(weights), 1) * there
        skips, x = skips + inner, x + inner
    x = skips * (skips > 0)
    x = convolve(x, next(weights), next(weights), 1)
    return convolve(x * (x > 0), next(weights), next(weights), 1)


UNITS = 64


def bi_lstm(layers, copies, classes, _):
    for _ in range(2):
        layers.draw((len(copies), 4 * UNITS), int(copies.sum()), 4 * UNITS, copies)
        layers.orthogonal(UNITS, 4 * UNITS)
        layers.bias(np.repeat([0, 1, 0, 0], UNITS))
    layers.convolution(1, 2 * UNITS, classes)


def bi_lstm_of(weights, x, there, key, _):
    import jax
    import jax.numpy as jnp

    kernel, recurrent, bias = (jnp.stack([weights[k], weights[3 + k]]) for k in range(3))
    # Backwards it begins at the last frame that is there.
    frames = there.shape[0]
    back = (there.sum().astype(jnp.int32) - 1 - jnp.arange(frames)) % frames
    entry = jnp.stack([x, x[back]]) @ kernel + bias[:, None]

    def step(carry, now):
        held, cell = carry
        gates = now + jnp.einsum("du,dug->dg", held, recurrent)
        i, f, g, o = jnp.split(gates, 4, axis=-1)
        cell = jax.nn.sigmoid(f) * cell + jax.nn.sigmoid(i) * jnp.tanh(g)
        held = jax.nn.sigmoid(o) * jnp.tanh(cell)
        return (held, cell), held

    begin = jnp.zeros((2, UNITS))
    _, out = jax.lax.scan(step, (begin, begin), entry.swapaxes(0, 1), unroll=8)
    return convolve(jnp.concatenate([out[:, 0], out[back, 1]], axis=1), weights[6], weights[7], 1)


MADE = {"dt-fcn": (dt_fcn, dt_fcn_of), "ed-tcn": (ed_tcn, ed_tcn_of), "dilated-tcn": (dilated_tcn, dilated_tcn_of), "bi-lstm": (bi_lstm, bi_lstm_of)}


def train(network, width, runs, data, epochs, minutes):
    """Trains these runs side by side; yields for each what it named in all sequences, with the best weights and with the last."""
    import jax
    import jax.numpy as jnp

    make, forward_of = MADE[network]
    x, y, there, classes = data
    joints = x.shape[2] // 3
    copies = np.repeat(np.bincount(np.arange(ROWS) * joints // ROWS, minlength=joints), 3)
    size = len(x) // FOLDS
    drawn, orders, held, spans, lows, labels, weights = [], [], [], [], [], [], []
    for run in runs:
        test = range(run["fold"] * size, (run["fold"] + 1) * size)
        learned = np.array([k for k in range(len(x)) if k not in test])
        rng = np.random.default_rng(run["fold"] + 1)
        rng.shuffle(learned)
        held.append(learned[: len(learned) // 10])
        learned = learned[len(learned) // 10 :]
        orders.append([rng.permutation(learned) for _ in range(epochs)])
        own = there[[k for k in range(len(x)) if k not in test]] > 0
        frames = x[[k for k in range(len(x)) if k not in test]][own]
        lows.append(frames.min(axis=0))
        spans.append(frames.max(axis=0) - frames.min(axis=0) + 1e-6)
        label, weight = spoiled(run, y, there, len(classes), test)
        labels.append(label.astype(np.int8))
        weights.append(weight.astype(bool))
        layers = Layers(jax.random.key(run["fold"] + 1))
        make(layers, copies, len(classes), width)
        drawn.append(layers.weights)
        rate = [1e-3 * c for c in layers.copies]
        parameters = sum(int(np.prod(np.shape(w))) for w in layers.weights)
        # Each row that a joint stands for has weights of its own in the paper's count.
        parameters += (ROWS * 3 - 3 * joints) * int(np.prod(np.shape(layers.weights[0]))) // (3 * joints) * (2 if network == "bi-lstm" else 1)
    if width == 3 and len(classes) == 10:
        assert parameters == SIZES[network], parameters
    batch = 4 if network == "bi-lstm" else 1
    params = [jnp.stack([jnp.asarray(one[k]) for one in drawn]) for k in range(len(drawn[0]))]
    orders = np.array(orders)
    orders = orders[:, :, : orders.shape[2] // batch * batch].reshape(len(runs), epochs, -1, batch)
    steps = orders.shape[2]
    x, there = jnp.asarray(x), jnp.asarray(there)[:, :, None]
    labels, weights = jnp.asarray(np.array(labels)), jnp.asarray(np.array(weights))
    lows, spans, held = (jnp.asarray(np.array(part)) for part in (lows, spans, held))

    def logits(params, k, low, span, key):
        return forward_of(params, (x[k] - low) / span * there[k], there[k], key, width)

    def sums(params, k, low, span, label, weight, key):
        """Sum of the losses of one sequence, and of its frames that count."""
        out = jax.nn.log_softmax(logits(params, k, low, span, key))
        weight = weight[k].astype(jnp.float32)
        return -(jnp.take_along_axis(out, label[k].astype(jnp.int32)[:, None], axis=1)[:, 0] * weight).sum(), weight.sum()

    def loss(params, which, low, span, label, weight, key):
        each = jax.vmap(lambda k, key: sums(params, k, low, span, label, weight, key))
        total, count = each(which, jax.random.split(key, len(which)))
        return (total / (count + 1e-6)).mean()

    def one_epoch(params, first, second, step, order, low, span, label, weight, key):
        def update(carry, which):
            params, first, second, step, key = carry
            key, now = jax.random.split(key)
            slope = jax.grad(loss)(params, which, low, span, label, weight, now)
            step = step + 1
            first = [0.9 * m + 0.1 * g for m, g in zip(first, slope)]
            second = [0.999 * v + 0.001 * g * g for v, g in zip(second, slope)]
            scale = jnp.sqrt(1 - 0.999**step) / (1 - 0.9**step)
            params = [p - r * scale * m / (jnp.sqrt(v) + 1e-7) for p, r, m, v in zip(params, rate, first, second)]
            return (params, first, second, step, key), None

        carry, _ = jax.lax.scan(update, (params, first, second, step, key), order)
        return carry

    def held_loss(params, which, low, span, label, weight):
        total, count = jax.vmap(lambda k: sums(params, k, low, span, label, weight, None))(which)
        return total.sum() / count.sum()

    @jax.jit
    def epoch(state, best, order):
        params, first, second, step, key = state
        state = jax.vmap(one_epoch)(params, first, second, step, order, lows, spans, labels, weights, key)
        now = jax.vmap(held_loss)(state[0], held, lows, spans, labels, weights)
        kept, least, at = best
        better = now < least
        pick = lambda a, b: jnp.where(better.reshape(-1, *[1] * (a.ndim - 1)), a, b)
        return state, ([pick(a, b) for a, b in zip(state[0], kept)], jnp.where(better, now, least), jnp.where(better, state[3] // steps, at))

    @jax.jit
    def name(params, k):
        return jax.vmap(lambda p, low, span: logits(p, k, low, span, None).argmax(axis=-1).astype(jnp.int8))(params, lows, spans)

    zeros = [jnp.zeros_like(p) for p in params]
    random_keys = jax.random.split(jax.random.key(7), len(runs))
    state = (params, zeros, zeros, jnp.zeros(len(runs), jnp.int32), random_keys)
    best = (params, jnp.full(len(runs), jnp.inf), jnp.zeros(len(runs), jnp.int32))
    begun, done = time.time(), 0
    while done < epochs and time.time() - begun < 60 * minutes:
        state, best = epoch(state, best, jnp.asarray(orders[:, done]))
        best[1].block_until_ready()
        done += 1
        if done < 4 or done % 10 == 0:
            print(f"{network} w{width} epoch {done} after {time.time() - begun:.1f} s: held-out loss {float(best[1].mean()):.4f}", flush=True)
    named = {what: np.stack([np.array(name(p, k)) for k in range(len(x))], axis=1) for what, p in (("best", best[0]), ("last", state[0]))}
    for r, run in enumerate(runs):
        test = range(run["fold"] * size, (run["fold"] + 1) * size)

        def pairs(which, what):
            lengths = [int(np.array(there[k]).sum()) for k in which]
            return [(list(y[k, :n]), list(named[what][r, k, :n])) for k, n in zip(which, lengths)]

        training = [k for k in range(len(x)) if k not in test]
        yield {**run, **measures(pairs(test, "best")), "training_accuracy": accuracy(pairs(training, "best")),
               "last_accuracy": accuracy(pairs(test, "last")),
               "last_training_accuracy": accuracy(pairs(training, "last")),
               "best_epoch": int(best[2][r]), "epochs": done, "parameters": parameters}


def accuracy(pairs):
    right = sum(int((np.array(truth) == np.array(named)).sum()) for truth, named in pairs)
    return 100 * right / sum(len(truth) for truth, _ in pairs)


def table(results):
    def found(**want):
        return [r for r in results if all(r[k] == v for k, v in want.items())]

    def cell(what="accuracy", **want):
        values = [r[what] for r in found(**want)]
        if not values:
            return "-"
        return f"{sum(values) / len(values):.1f} ({min(values):.1f} to {max(values):.1f})"

    plain = {"border": 0, "mask": 0}
    print("| label noise, % |", " | ".join(f"{n}, published | {n}, here" for n in NETWORKS), "| dt-fcn, width 5 |")
    print("|---" * 10 + "|")
    for k, noise in enumerate(NOISE):
        cells = [f"{PAPER[n][k]:.1f} | {cell(network=n, width=3, noise=noise, **plain)}" for n in NETWORKS]
        print(f"| {noise} |", " | ".join(cells), "|", cell(network="dt-fcn", width=5, noise=noise, **plain), "|")
    print("\n| at borders | frames |", " | ".join(f"{n}, published | {n}, here" for n in NETWORKS), "|")
    print("|---" * 10 + "|")
    for w, what in enumerate(("border", "mask")):
        for k, frames in enumerate(WINDOWS):
            want = {"noise": 0, **plain, "width": 3, what: frames}
            cells = [f"{PAPER_WINDOWS[n][3 * w + k]:.1f} | {cell(network=n, **want)}" for n in NETWORKS]
            print(f"| {'noise' if what == 'border' else 'mask'} | {frames} |", " | ".join(cells), "|")
    print("\n| network | parameters | training, published | training | test | edit | F1@50 | best epoch | last epoch: training | test |")
    print("|---" * 10 + "|")
    for network in NETWORKS:
        want = {"network": network, "width": 3, "noise": 0, **plain}
        cells = [cell(what, **want) for what in ("training_accuracy", "accuracy", "edit", "f1_50", "best_epoch", "last_training_accuracy", "last_accuracy")]
        print(f"| {network} | {SIZES[network]} | {PAPER_TRAINING[network]} |", " | ".join(cells), "|")
    print(f"\n{len(results)} runs")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("results", type=pathlib.Path, nargs="?")
    parser.add_argument("--epochs", type=int, default=100)
    parser.add_argument("--only", nargs="+", default=NETWORKS, choices=NETWORKS)
    parser.add_argument("--folds", nargs="+", type=int, default=list(range(FOLDS)))
    parser.add_argument("--width", type=int, choices=(3, 5))
    parser.add_argument("--minutes", type=float, default=1e9, help="for each network: no epoch begins later")
    parser.add_argument("--at-once", type=int, default=128)
    parser.add_argument("--table", action="store_true")
    args = parser.parse_args()
    kept = args.results or args.work
    results = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    if args.table:
        return table(results)
    known = [{k: r[k] for k in ("network", "width", "noise", "border", "mask", "fold")} for r in results]
    data = load(args.work)
    print(f"{len(data[0])} sequences of up to {data[0].shape[1]} frames", flush=True)
    todo = [run for run in grid(args.only, args.folds) if run not in known and args.width in (None, run["width"])]
    groups = {}
    for run in todo:
        groups.setdefault((run["network"], run["width"]), []).append(run)
    for (network, width), runs in groups.items():
        for first in range(0, len(runs), args.at_once):
            begun = time.time()
            with open(kept, "a") as file:
                for answer in train(network, width, runs[first : first + args.at_once], data, args.epochs, args.minutes):
                    file.write(json.dumps(answer) + "\n")
                    file.flush()
            print(f"{network}, width {width}: {len(runs[first:first + args.at_once])} runs in {time.time() - begun:.0f} s", flush=True)


main()
