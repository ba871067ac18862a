#!/usr/bin/env python3
"""The paper's network in posed, Keras (tensorflow-cpu) and onnxruntime, in turns in one run: one thread each, processor time.

usage: speed.py [--posed PATH] [--frames 1300] [--turns 5]

Inference of one sequence with 19 and with 224 input rows (posed folds these into 19 when it reads a model), and one epoch of
training (60 sequences, one a step, Adam): of posed the processor time of `segments train --paper` for six epochs less that for one,
so all that an epoch needs. Needs tensorflow-cpu, tf2onnx and onnxruntime (PyPI). A turn of inference is the shortest of 30 calls. The
least over all turns is printed, and the median: on a machine with other work the least says more. posed's inference is of the wall clock.
"""
import os

os.environ.update(TF_CPP_MIN_LOG_LEVEL="3", TF_ENABLE_ONEDNN_OPTS="1", OMP_NUM_THREADS="1", KERAS_BACKEND="tensorflow")
import argparse
import json
import statistics
import subprocess
import tempfile
import time

import keras
import numpy as np
import onnxruntime
import tensorflow as tf
import tf2onnx

from networks import dt_fcn

CLASSES, SEQUENCES, CALLS = 10, 60, 30


def least(call):
    """Processor time of the shortest of some calls, ms."""
    times = []
    for _ in range(CALLS):
        begin = time.process_time()
        call()
        times.append((time.process_time() - begin) * 1e3)
    return min(times)


def write(x, y, folder):
    """Writes sequences as posed reads them."""
    joints = [f"j{k}_{axis}" for k in range(x.shape[2] // 3) for axis in "xyz"]
    for number, (places, labels) in enumerate(zip(x, y)):
        with open(os.path.join(folder, f"{number:02}.csv"), "w") as file:
            file.write(",".join(["t", *joints, "label"]) + "\n")
            for frame, (row, label) in enumerate(zip(places, labels)):
                file.write(f"{frame / 72:.6f}," + ",".join(f"{value:.4f}" for value in row) + f",c{label}\n")


def training(posed, folder, epochs):
    """Processor time of a training, ms."""
    before = os.times()
    with tempfile.TemporaryDirectory() as place:
        command = [posed, "segments", "train", folder, "--paper", "--epochs", str(epochs), "-o", os.path.join(place, "model")]
        subprocess.run(command, check=True, capture_output=True, env={**os.environ, "RAYON_NUM_THREADS": "1"})
    after = os.times()
    return (after.children_user + after.children_system - before.children_user - before.children_system) * 1e3


def onnx(model, folder):
    path = os.path.join(folder, "network.onnx")
    signature = [tf.TensorSpec(model.inputs[0].shape, tf.float32, name="x")]
    function = tf.function(lambda x: model(x, training=False), input_signature=signature)
    tf2onnx.convert.from_function(function, input_signature=signature, opset=17, output_path=path)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--posed", default="target/release/posed")
    parser.add_argument("--frames", type=int, default=1300)
    parser.add_argument("--turns", type=int, default=5)
    args = parser.parse_args()
    tf.config.threading.set_intra_op_parallelism_threads(1)
    tf.config.threading.set_inter_op_parallelism_threads(1)
    rng = np.random.default_rng(1)
    found = {}
    for rows in (19, 224):
        x = rng.random((1, args.frames, 3 * rows), dtype=np.float32)
        model = dt_fcn(3 * rows, CLASSES)
        forward = tf.function(lambda x, model=model: model(x, training=False), jit_compile=False)
        with tempfile.TemporaryDirectory() as folder:
            session = onnx(model, folder)
        expected, answer = forward(x).numpy(), session.run(None, {"x": x})[0]
        assert np.abs(expected - answer).max() < 1e-3, "the converted network is another"
        for _ in range(args.turns):
            command = [args.posed, "segments", "bench", "--json", "--rows", str(rows), "--joints", "19", "--frames", str(args.frames), "--repeat", str(CALLS)]
            own = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            found.setdefault((f"{rows} rows, inference", "posed"), []).append(own["inference_least_ms"])
            found.setdefault((f"{rows} rows, inference", "keras"), []).append(least(lambda: forward(x)))
            found.setdefault((f"{rows} rows, inference", "onnxruntime"), []).append(least(lambda: session.run(None, {"x": x})))
            if rows == 19:
                found.setdefault(("frame of a stream", "posed"), []).append(own["stream_frame_ms"])
    model = dt_fcn(57, CLASSES)
    model.compile(keras.optimizers.Adam(1e-3), keras.losses.SparseCategoricalCrossentropy(from_logits=True))
    x = rng.random((SEQUENCES, args.frames, 57), dtype=np.float32)
    y = rng.integers(0, CLASSES, (SEQUENCES, args.frames))
    model.fit(x, y, batch_size=1, epochs=1, verbose=0)
    with tempfile.TemporaryDirectory() as folder:
        write(x, y, folder)
        for _ in range(args.turns):
            one, six = (training(args.posed, folder, epochs) for epochs in (1, 6))
            found.setdefault(("epoch of 60", "posed"), []).append((six - one) / 5)
            begin = time.process_time()
            model.fit(x, y, batch_size=1, epochs=1, verbose=0)
            found.setdefault(("epoch of 60", "keras"), []).append((time.process_time() - begin) * 1e3)
    print(f"{args.frames} frames\n\n| what | with | least, ms | median, ms |\n|---|---|---|---|")
    for (what, peer), times in found.items():
        print(f"| {what} | {peer} | {min(times):.4g} | {statistics.median(times):.4g} |")


main()
