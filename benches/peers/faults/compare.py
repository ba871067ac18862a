"""The two-layer map beside MiniSom and Somoclu: one chain of 41 neurons per sensor and a map of 21 x 21, 100 epochs.

Usage: pip install minisom numpy [somoclu]; cargo build --release;
       python benches/peers/faults/compare.py target/release/posed [FRAMES ...]

16 sensors sway about places of their own; as in the paper's first file a stretch is inverted and two are anomalous. Prints
CPU time of the training, mean quantisation errors of both layers, and the purity of the cells (share of frames that are
in a cell of their own class), for each way of training:

`paper` is the paper's rule (step falls linearly to zero, neighbourhood of one neuron throughout), `default` the peer's own;
`second layer` trains that layer alone, on what our first layer says: same rule and same input for both.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from minisom import MiniSom

SENSORS = 16
RULES = {
    "paper": {"decay_function": "linear_decay_to_zero", "sigma_decay_function": "linear_decay_to_one"},
    "default": {},
}


def recording(count):
    """Positions (m) and classes: inverted, anomalous, clean and anomalous stretches, as long as in the paper's file F1."""
    t = np.arange(count)[:, None, None] / 30.0
    s = np.arange(SENSORS)[None, :, None]
    axis = np.arange(3)[None, None, :]
    data = 1.5 + 0.4 * np.sin(0.7 * t + s + axis) + 0.2 * np.cos(2.3 * t + 0.3 * s * axis) + 0.1 * s
    share = np.arange(count) / count
    classes = np.where(share < 50 / 407, 1, np.where((share < 217 / 407) | (share >= 348 / 407), 2, 0))
    data[classes == 1] *= -1
    data[classes == 2, 3:6] += 0.4
    return data, classes


def train(rows, columns, data, rule):
    som = MiniSom(rows, columns, data.shape[1], sigma=1.0, learning_rate=0.5, random_seed=1, **RULES[rule])
    som.pca_weights_init(data)
    som.train_random(data, 100 * len(data))
    return som.get_weights().reshape(rows * columns, -1)


def somoclu(rows, columns, data):
    import somoclu

    som = somoclu.Somoclu(columns, rows, initialization="pca", compactsupport=False)
    som.train(data.astype(np.float32), epochs=100, radius0=max(rows, columns) / 4, radiusN=1)
    return som.codebook.reshape(rows * columns, -1)


def winners(weights, data):
    distances = np.stack([np.linalg.norm(weights - row, axis=1) for row in data])
    return distances.argmin(1), distances.min(1).mean()


def purity(cells, classes):
    counts = Counter(zip(cells, classes))
    largest = Counter()
    for (cell, _), count in counts.items():
        largest[cell] = max(largest[cell], count)
    return sum(largest.values()) / len(cells)


def say(name, seconds, first, indices, grid, classes):
    cells, error = winners(grid, indices)
    print(f"{len(classes)},{name},{seconds:.2f},{first:.4f},{error:.4f},{purity(cells, classes):.4f}", flush=True)


def theirs(name, train_one, data, classes):
    start = time.process_time()
    indices, errors = np.empty(data.shape[:2]), []
    for sensor in range(SENSORS):
        found, error = winners(train_one(1, 41, data[:, sensor]), data[:, sensor])
        indices[:, sensor] = found / 41
        errors.append(error)
    grid = train_one(21, 21, indices)
    say(name, time.process_time() - start, np.mean(errors), indices, grid, classes)


def ours(binary, data, classes, published):
    with tempfile.TemporaryDirectory() as folder:
        poses, network = Path(folder, "poses.csv"), Path(folder, "faults.json")
        with poses.open("w") as file:
            file.write("t,sensor,x,y,z\n")
            for k, frame in enumerate(data):
                for sensor, p in enumerate(frame):
                    file.write(f"{k / 30},s{sensor}," + ",".join(repr(float(v)) for v in p) + "\n")
        command = [binary, "--log", "error", "faults", "train", poses, "-o", network, "--rule", "paper", "--epochs", "100"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        subprocess.run(command + (["--as-published"] if published else ["--subset", "0"]), check=True, capture_output=True)
        seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        weights = json.loads(network.read_text())
    found = [winners(np.array(chain), data[:, k]) for k, chain in enumerate(weights["layer1"]["weights"])]
    indices = np.stack([cells for cells, _ in found], axis=1) / 41
    grid = np.array(weights["layer2"]["weights"]).reshape(-1, SENSORS)
    name = "posed paper" if published else "posed paper shrinking"
    say(name + " whole command", seconds, np.mean([error for _, error in found]), indices, grid, classes)
    return indices


def main():
    binary, counts = sys.argv[1], [int(count) for count in sys.argv[2:]] or [407]
    print("frames,method,cpu_s,error_first_m,error_second,purity")
    for count in counts:
        data, classes = recording(count)
        ours(binary, data, classes, False)
        indices = ours(binary, data, classes, True)
        for rule in RULES:
            start = time.process_time()
            grid = train(21, 21, indices, rule)
            say(f"MiniSom {rule}: second layer", time.process_time() - start, 0.0, indices, grid, classes)
        for rule in RULES:
            theirs(f"MiniSom {rule}", lambda r, c, x: train(r, c, x, rule), data, classes)
        try:
            theirs("Somoclu", somoclu, data, classes)
        except ImportError as error:
            print(f"{count},Somoclu: {error}")


if __name__ == "__main__":
    main()
