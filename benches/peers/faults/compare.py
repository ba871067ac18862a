"""CPU time of MiniSom on the same task as `cargo bench --bench faults`: one chain of 41 neurons per sensor and a map
of 21 x 21, the paper's rule, sigma 1, 100 epochs.

Usage: pip install minisom numpy; python benches/peers/faults/compare.py [FRAMES]
"""

import sys
import time

import numpy as np
from minisom import MiniSom

SENSORS = 16


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 407
    t = np.arange(count)[:, None, None] / 30.0
    s = np.arange(SENSORS)[None, :, None]
    axis = np.arange(3)[None, None, :]
    data = 0.4 * np.sin(0.7 * t + s + axis) + 0.2 * np.cos(2.3 * t + 0.3 * s * axis) + 0.1 * s
    start = time.process_time()
    indices = np.empty((count, SENSORS))
    for sensor in range(SENSORS):
        x = data[:, sensor]
        chain = MiniSom(1, 41, 3, sigma=1.0, learning_rate=0.5, random_seed=1)
        chain.pca_weights_init(x)
        chain.train_random(x, 100 * count)
        indices[:, sensor] = [chain.winner(row)[1] / 41 for row in x]
    grid = MiniSom(21, 21, SENSORS, sigma=1.0, learning_rate=0.5, random_seed=1)
    grid.pca_weights_init(indices)
    grid.train_random(indices, 100 * count)
    print(f"MiniSom: {count} frames, {time.process_time() - start:.2f} s, error {grid.quantization_error(indices):.4f}")


if __name__ == "__main__":
    main()
