"""Key poses beside the methods of others: ruptures and the Singular Spectrum Transform, on the same motions.

Usage: pip install ruptures changepoynt numpy; cargo build --release;
       python benches/peers/keyframes/compare.py target/release/posed

Motions are made here, so that no code under test makes the truth. The penalty and the SST's threshold are chosen on 20
other motions (the choice with the fewest errors). Every method sees at each frame only the past plus the stated delay of
ours (2 N frames), and what it has said once stays said. Prints false positives and misses per method.
"""

import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import ruptures
from changepoynt.algorithms.sst import SST

N = 30
DELAY = 2 * N
CHANGES = [140, 250, 300, 500, 700, 820]
FRAMES = 1000


def motion(seed, shape, size_m, sigma_m):
    """Positions of seven pieces with different velocities, and noise."""
    random = np.random.default_rng(seed)
    speed = size_m / 600
    p, last, rows = np.zeros(3), None, []
    for start, end in zip([0] + CHANGES, CHANGES + [FRAMES]):
        while True:
            v = random.normal(size=3)
            v *= speed * random.uniform(0.7, 1.3) / np.linalg.norm(v)
            if v @ p <= 0 and (last is None or v @ last <= 0):
                break
        bend = random.uniform(-0.5, 0.5)
        side = random.normal(size=3)
        side *= speed / np.linalg.norm(side)
        for k in range(end - start):
            rows.append(p.copy())
            s = k / (end - start)
            step = {
                "straight": v,
                "bent": v * (1 + bend * (2 * s - 1)),
                "swaying": v + side * 0.5 * np.sin(2 * np.pi * 0.75 * s),
            }[shape]
            p = p + step
        last = step
    return np.array(rows) + random.normal(size=(FRAMES, 3)) * sigma_m


def errors(found):
    hit, false = set(), 0
    for frame in found:
        near = [c for c in CHANGES if abs(c - frame) < 10]
        if near and near[0] not in hit:
            hit.add(near[0])
        else:
            false += 1
    return false, len(CHANGES) - len(hit)


def online(detect, x, step):
    """Runs a batch method on growing prefixes; a detection is final once the delay has passed."""
    said = []
    for end in range(4 * N, len(x) + 1, step):
        for frame in detect(x[max(0, end - 400) : end]):
            frame += max(0, end - 400)
            if frame <= end - DELAY and all(abs(frame - old) >= N for old in said):
                said.append(frame)
    return sorted(said)


def by_ruptures(search, penalty):
    def detect(x):
        # A change of velocity is a change of the increments' mean.
        v = np.diff(x, axis=0)
        v = v / (v.std(axis=0) + 1e-12)
        return search.fit(v).predict(pen=penalty)[:-1]

    return detect


def sst_score(x):
    """Of the whole motion: it sees more of the future than the others."""
    transform = SST(N, n_windows=N, lag=N, rank=3, method="naive")
    return np.sum([transform.transform(x[:, c]) for c in range(3)], axis=0)


def by_sst(score, threshold):
    return [
        i for i in range(N, len(score) - N)
        if score[i] > threshold and score[i] == score[i - N : i + N + 1].max()
    ]


def ours(binary, x):
    with tempfile.TemporaryDirectory() as folder:
        poses, keys = Path(folder, "poses.csv"), Path(folder, "keys.csv")
        with poses.open("w") as file:
            file.write("t,x,y,z\n")
            for k, row in enumerate(x):
                file.write(f"{k / 100}," + ",".join(repr(float(v)) for v in row) + "\n")
        command = [binary, "--log", "error", "keyframes", poses, "-o", keys, "--window", str(N)]
        subprocess.run(command, check=True, capture_output=True)
        return [int(row["frame"]) for row in csv.DictReader(keys.open())]


def main():
    binary = sys.argv[1]
    cases = [(s, a, n) for s in ("straight", "bent", "swaying") for a, n in ((2.0, 0.005), (1.0, 0.001), (0.5, 0.002))]
    training = [motion(1000 + k, *cases[k % len(cases)]) for k in range(20)]
    tests = [motion(k, *cases[k % len(cases)]) for k in range(18)]

    def total(results):
        return sum(a + b for a, b in results)

    # Pelt in Python is slow: it looks at every 20th frame only, which delays what it says but changes little of it.
    candidates = {
        "ruptures KernelCPD linear": (5, lambda p: by_ruptures(ruptures.KernelCPD(kernel="linear", min_size=5), p)),
        "ruptures KernelCPD rbf": (5, lambda p: by_ruptures(ruptures.KernelCPD(kernel="rbf", min_size=5), p)),
        "ruptures Pelt": (20, lambda p: by_ruptures(ruptures.Pelt(model="l2", min_size=5, jump=5), p)),
    }
    print("method,parameter,false_positives,misses")
    found = [errors(ours(binary, x)) for x in tests]
    print(f"posed keyframes,default,{sum(f for f, _ in found)},{sum(m for _, m in found)}", flush=True)
    for name, (step, make) in candidates.items():
        penalties = [1, 2, 5, 10, 20, 40, 80, 160]
        best = min(penalties, key=lambda p: total(errors(online(make(p), x, step)) for x in training))
        found = [errors(online(make(best), x, step)) for x in tests]
        print(f"{name},{best},{sum(f for f, _ in found)},{sum(m for _, m in found)}", flush=True)
    thresholds = [0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 1.5, 2.0]
    scores = [sst_score(x) for x in training]
    best = min(thresholds, key=lambda t: total(errors(by_sst(score, t)) for score in scores))
    found = [errors(by_sst(sst_score(x), best)) for x in tests]
    print(f"SST (offline),{best},{sum(f for f, _ in found)},{sum(m for _, m in found)}")


if __name__ == "__main__":
    main()
