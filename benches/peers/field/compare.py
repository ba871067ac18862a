"""The map alone, by other libraries: the same readings and targets that the field bench exports.

    mkdir /tmp/field && cargo bench --bench field -- --map --export /tmp/field
    pip install numpy scipy scikit-learn
    python benches/peers/field/compare.py /tmp/field [SCENE...]
"""

import pathlib
import sys
import time

import numpy as np
from scipy.interpolate import RBFInterpolator
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.linear_model import Ridge
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

SEED = 1


def load(path):
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    return rows[:, :3], rows[:, 3:]


def rbf(smoothing):
    class Peer:
        def fit(self, z, d):
            self.f = RBFInterpolator(z, d, neighbors=50, kernel="thin_plate_spline", smoothing=smoothing)
            return self

        def predict(self, z):
            return self.f(z)

    return Peer()


class GaussianProcess:
    """1,000 of the readings: an exact process of all 15,000 needs days."""

    def fit(self, z, d):
        pick = np.random.default_rng(SEED).choice(len(z), min(1000, len(z)), replace=False)
        self.scale = d.std()
        kernel = 1.0 * RBF([0.5, 0.5, 0.5]) + WhiteKernel(0.01)
        self.f = GaussianProcessRegressor(kernel, random_state=SEED).fit(z[pick], d[pick] / self.scale)
        return self

    def predict(self, z):
        return self.f.predict(z) * self.scale


class Mlp:
    def fit(self, z, d):
        self.scale = d.std()
        self.f = make_pipeline(StandardScaler(), MLPRegressor(hidden_layer_sizes=(64, 64), max_iter=300, random_state=SEED))
        self.f.fit(z, d / self.scale)
        return self

    def predict(self, z):
        return self.f.predict(z) * self.scale


def polynomial(degree):
    return make_pipeline(StandardScaler(), PolynomialFeatures(degree), Ridge(1e-6))


PEERS = {
    "thin-plate RBF, 50 neighbours": lambda: rbf(0.0),
    "the same, smoothing 0.1": lambda: rbf(0.1),
    "Gaussian process": GaussianProcess,
    "MLP 64, 64": Mlp,
    "polynomial 4": lambda: polynomial(4),
    "polynomial 6": lambda: polynomial(6),
}

folder = pathlib.Path(sys.argv[1])
scenes = sys.argv[2:] or sorted(path.name.split("-")[1] for path in folder.glob("*-fit.csv"))
print("| scene | peer | fit, s | evaluate, ns | median, mm | 95 %, mm |\n|---|---|---|---|---|---|")
for scene in scenes:
    z, p = load(folder / f"scene-{scene}-fit.csv")
    z_test, p_test = load(folder / f"scene-{scene}-held-out.csv")
    for name, make in PEERS.items():
        begun = time.perf_counter()
        peer = make().fit(z, p - z)
        fit_s = time.perf_counter() - begun
        begun = time.perf_counter()
        found = z_test + peer.predict(z_test)
        evaluate_ns = (time.perf_counter() - begun) / len(z_test) * 1e9
        errors = 1e3 * np.linalg.norm(found - p_test, axis=1)
        median, most = np.percentile(errors, [50, 95])
        print(f"| {scene} | {name} | {fit_s:.2f} | {evaluate_ns:.0f} | {median:.3f} | {most:.3f} |", flush=True)
