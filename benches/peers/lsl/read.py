"""What pylsl reads of a stage beside our own websocket: streams, channels, capture times, poses.

Usage: pip install pylsl ./clients/python; posed demo --stage STAGE.toml (with [lsl]);
       python benches/peers/lsl/read.py 127.0.0.1:8787 "STAGE NAME" [SECONDS]

Capture times of the two are related by this computer's own clocks: UTC of the stage's epoch, and liblsl's clock against UTC, asked here. They must agree within
a millisecond, and poses of equal times within the rounding of our messages. Ends with 1 if they do not.
"""

import asyncio
import json
import math
import sys
import time

import posed
import pylsl

address, stage = sys.argv[1:3]
seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 5.0


def lsl_minus_utc():
    """By the quickest of some looks, s."""
    looks = []
    for _ in range(50):
        before = time.time()
        lsl = pylsl.local_clock()
        after = time.time()
        looks.append((after - before, lsl - (before + after) / 2))
    return min(looks)[1]


def inlet(name):
    found = pylsl.resolve_byprop("name", f"{stage} {name}", timeout=10)
    assert found, f"no stream `{stage} {name}`"
    return pylsl.StreamInlet(found[0])


def labels(inlet):
    channel = inlet.info().desc().child("channels").child("channel")
    names = []
    while not channel.empty():
        names.append(channel.child_value("label"))
        channel = channel.next_sibling("channel")
    return names


async def watch(end):
    frames = {}
    async with posed.aio.connect(address) as ours:
        async for frame in ours.sensors(drop="queue"):
            frames[frame.t_s] = frame.message["sensors"]
            if time.monotonic() >= end:
                return ours.epoch_utc.astype("int64") * 1e-9, frames


def read(inlet, end):
    samples = []
    while time.monotonic() < end:
        sample, t_s = inlet.pull_sample(timeout=0.5)
        if sample is not None:
            samples.append((t_s + inlet.time_correction(), sample))
    return samples


async def main():
    poses, events = inlet("poses"), inlet("events")
    names = labels(poses)
    print(f"{len(names)} channels: {names[:8]} ...; events are {events.info().type()}, {events.info().channel_format()}")
    poses.open_stream()
    events.open_stream()
    poses.time_correction(timeout=5)
    end = time.monotonic() + seconds
    reading = asyncio.get_running_loop().run_in_executor(None, read, poses, end)
    (epoch, frames), samples = await asyncio.gather(watch(end), reading)
    offset = lsl_minus_utc() + epoch
    compared, worst_s, worst = 0, 0.0, 0.0
    for lsl_s, sample in samples:
        t_s = min(frames, key=lambda other: abs(other + offset - lsl_s), default=None)
        if t_s is None or abs(t_s + offset - lsl_s) > 4e-3:
            continue
        compared += 1
        worst_s = max(worst_s, abs(t_s + offset - lsl_s))
        for at, sensor in enumerate(frames[t_s]):
            x, y, z, qx, qy, qz, qw = sample[7 * at : 7 * at + 7]
            if sensor["state"] not in ("ok", "repaired", "extrapolated"):
                assert math.isnan(qw), f"{sensor['name']} is {sensor['state']} and has a pose"
                continue
            theirs = [qw, qx, qy, qz] + ([x, y, z] if sensor["position_m"] else [])
            ours = sensor["orientation_wxyz"] + (sensor["position_m"] or [])
            worst = max(worst, *(abs(a - b) for a, b in zip(theirs, ours)))
    print(f"{len(samples)} samples, {len(frames)} frames, {compared} of equal times; times agree within {worst_s * 1e3:.3f} ms, numbers within {worst:.1e}")
    marks = []
    while (mark := events.pull_sample(timeout=0.0))[0] is not None:
        marks.append(json.loads(mark[0][0])["type"])
    print(f"{len(marks)} events: {sorted(set(marks))}")
    return 0 if compared > 0.9 * len(samples) > 0 and worst_s < 1e-3 and worst < 1e-5 else 1


sys.exit(asyncio.run(main()))
