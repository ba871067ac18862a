"""A random forest on windowed joint features: what `posed segments` is measured against in `folds.py`.

Per frame: joints relative to the root, turned to where the body faces (line of the joints l* and r*), and for each
of these coordinates the mean, standard deviation and speed over windows of 0.25, 0.5 and 1 s. Its classes are taken as they are, or after a
filter of 1 s over the votes. Needs numpy and scikit-learn (PyPI).
"""
import numpy as np
from sklearn.ensemble import RandomForestClassifier

from sequences import hits

STEP = 3  # It learns from every third frame.


def arrays(header, rows):
    """Joints, their positions (m), labels; an empty label where none is to be learned or scored."""
    names = [column[:-2] for column in header if column.endswith("_x")]
    columns = [[header.index(f"{name}_{axis}") for axis in "xyz"] for name in names]
    points = np.array([[[float(row[c]) for c in joint] for joint in columns] for row in rows])
    label, transition = header.index("label"), header.index("transition")
    labels = np.array([row[label] if row[transition] != "1" else "" for row in rows])
    return names, points / 1000.0, labels


def features(names, points, rate_hz):
    left = [i for i, n in enumerate(names) if n[0] == "l" and "r" + n[1:] in names]
    right = [names.index("r" + names[i][1:]) for i in left]
    side = (points[:, left] - points[:, right]).sum(axis=1)[:, [0, 2]]
    side /= np.linalg.norm(side, axis=1, keepdims=True) + 1e-9
    body = points - points[:, :1]
    x, z = body[..., 0], body[..., 2]
    across = x * side[:, :1] + z * side[:, 1:]
    along = x * side[:, 1:] - z * side[:, :1]
    flat = np.stack([across, body[..., 1], along], axis=-1).reshape(len(points), -1)
    flat = np.concatenate([flat, points[:, :1, 1]], axis=1)
    speed = np.abs(np.gradient(flat, axis=0)) * rate_hz
    parts = [flat]
    for seconds in (0.25, 0.5, 1.0):
        window = max(3, int(seconds * rate_hz) | 1)

        def smooth(values):
            padded = np.pad(values, ((window // 2, window // 2), (0, 0)), mode="edge")
            sums = np.cumsum(np.pad(padded, ((1, 0), (0, 0))), axis=0)
            return (sums[window:] - sums[:-window]) / window

        mean = smooth(flat)
        parts += [mean, np.sqrt(np.maximum(smooth(flat**2) - mean**2, 0)), smooth(speed)]
    return np.concatenate(parts, axis=1)


def median_filter(votes, window):
    """Most frequent class in a window."""
    half = window // 2
    sums = np.cumsum(np.pad(votes, ((half + 1, half), (0, 0))), axis=0)
    return (sums[window:] - sums[:-window]).argmax(axis=1)


def evaluate(data, tested, rate_hz, trees, seed):
    """Learns from all sequences but those `tested`; accuracy and F1@50 in % over these, plain and with the filter.

    `data`: by name, features and labels. Frames whose class does not occur in training are not scored."""
    x = np.concatenate([f[::STEP] for n, (f, _) in data.items() if n not in tested])
    y = np.concatenate([l[::STEP] for n, (_, l) in data.items() if n not in tested])
    forest = RandomForestClassifier(trees, min_samples_leaf=3, max_features="sqrt", n_jobs=1, random_state=seed)
    forest.fit(x[y != ""], y[y != ""])
    sums = np.zeros((2, 5))
    for test in tested:
        f, truth = data[test]
        votes = forest.predict_proba(f)
        scored = np.isin(truth, forest.classes_)
        for k, classes in enumerate((votes.argmax(axis=1), median_filter(votes, int(rate_hz) | 1))):
            named = forest.classes_[classes]
            right = (named == truth)[scored].sum()
            sums[k] += (right, scored.sum(), *hits(truth[scored], named[scored], 0.5))
    return [(100 * right / frames, 200 * found / (there + named)) for right, frames, found, there, named in sums]
