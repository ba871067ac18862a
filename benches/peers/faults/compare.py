"""MiniSom on the same task as `cargo bench --bench faults`: one chain of 41 neurons per sensor and a map of 21 x 21, 100
epochs. Prints CPU time and quantisation errors of both.

Usage: pip install minisom numpy; cargo build --release;
       python benches/peers/faults/compare.py target/release/posed [FRAMES]

`paper` is the paper's rule (step falls linearly to zero, neighbourhood of one neuron throughout), `default` MiniSom's own
(both fall to a third). `on our indices` trains only the second layer, on what our first layer says.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from minisom import MiniSom

SENSORS = 16
RULES = {
    "paper": {"decay_function": "linear_decay_to_zero", "sigma_decay_function": "linear_decay_to_one"},
    "default": {},
}


def train(rows, columns, data, rule):
    som = MiniSom(rows, columns, data.shape[1], sigma=1.0, learning_rate=0.5, random_seed=1, **RULES[rule])
    som.pca_weights_init(data)
    som.train_random(data, 100 * len(data))
    return som


def theirs(data, rule):
    start = time.process_time()
    indices = np.empty(data.shape[:2])
    for sensor in range(SENSORS):
        chain = train(1, 41, data[:, sensor], rule)
        indices[:, sensor] = [chain.winner(row)[1] / 41 for row in data[:, sensor]]
    grid = train(21, 21, indices, rule)
    print(f"MiniSom {rule}: {time.process_time() - start:.2f} s, error {grid.quantization_error(indices):.4f}", flush=True)


def ours(binary, data, published):
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
    chains = np.array(weights["layer1"]["weights"])
    cells = np.array(weights["layer2"]["weights"]).reshape(-1, SENSORS)
    indices = np.linalg.norm(data[:, :, None] - chains[None], axis=3).argmin(2) / 41
    error = np.linalg.norm(indices[:, None] - cells[None], axis=2).min(1).mean()
    name = "as published" if published else "paper's rule, shrinking"
    print(f"posed {name}: {seconds:.2f} s with reading and rules, error {error:.4f}", flush=True)
    return indices


def main():
    binary, count = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 407
    t = np.arange(count)[:, None, None] / 30.0
    s = np.arange(SENSORS)[None, :, None]
    axis = np.arange(3)[None, None, :]
    data = 0.4 * np.sin(0.7 * t + s + axis) + 0.2 * np.cos(2.3 * t + 0.3 * s * axis) + 0.1 * s
    for rule in RULES:
        theirs(data, rule)
    for published in (True, False):
        indices = ours(binary, data, published)
        if published:
            for rule in RULES:
                error = train(21, 21, indices, rule).quantization_error(indices)
                print(f"MiniSom {rule} on our indices: error {error:.4f}", flush=True)


if __name__ == "__main__":
    main()
