"""What the Python client adds to a bare websocket, and which share of a core it takes: both in one run, of one daemon.

    pip install ./clients/python
    python benches/python/live.py target/release/posed --sensors 100 --seconds 20

The daemon simulates so many magnetic sensors at 100 Hz. Bare sockets (JSON and MessagePack; of a message only the time is looked for), the same decoded by hand, and
the clients' loops over `stage.sensors()` that look at `position_m` as an array listen turn about, each in a process of its own, round after round, so that all meet the
same load and none disturbs another. For each frame it is noted when user code has it. That less the frame's capture time is the latency but for a constant, which is the
same for all; compared are medians of each round with that of the bare socket in the same round. Processor time is that of the process. Prints a line for each as JSON.
"""

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

# Beside each the bare socket that it is compared with.
BASE = {"bare-msgpack": "bare-msgpack", "blocking": "bare-msgpack", "asyncio": "bare-msgpack", "bare-json": "bare-json", "json-by-hand": "bare-json"}
FORMS = tuple(BASE)


def stage_file(folder, sensors):
    lines = ['name = "Hundred"']
    flocks = range((sensors + 3) // 4)
    for flock in flocks:
        lines += ["[[device]]", f'name = "flock-{flock}"', 'driver = "flock-of-birds"', f'port = "/dev/flock-{flock}"']
    for sensor in range(sensors):
        lines += ["[[sensor]]", f'name = "bird-{sensor}"', f'device = "flock-{sensor // 4}"', f"address = {sensor % 4 + 1}"]
    for flock in flocks:
        lines += ["[[simulation.device]]", f'name = "flock-{flock}"', "boot_ms = 0.0"]
    path = os.path.join(folder, "hundred.toml")
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    return path


def cpu_s():
    about = os.times()
    return about.user + about.system


class Noted:
    """When user code had each frame, less its capture time; what came in the first half second is left out."""

    def __init__(self, seconds):
        self.begun = time.monotonic() + 0.5
        self.until = self.begun + seconds
        self.late_s, self.before, self.sum = [], None, 0

    def frame(self, t_s):
        now = time.monotonic()
        if now < self.begun:
            return True
        if self.before is None:
            self.before = (now, cpu_s())
        self.late_s.append(now - t_s)
        return now < self.until

    def told(self):
        began, used = self.before
        lasted = time.monotonic() - began
        return {"late_s": sorted(self.late_s), "core": (cpu_s() - used) / lasted, "rate_hz": len(self.late_s) / lasted}


async def bare(address, seconds, protocol, decoded):
    """As fast as a socket of the same library can: of a message only the time is looked for, in its first bytes."""
    import msgspec
    from websockets.asyncio.client import connect

    noted = Noted(seconds)
    async with connect(f"ws://{address}/ws", subprotocols=[protocol], compression=None, max_size=None, proxy=None) as socket:
        await socket.recv()
        request = {"type": "subscribe", "id": 1, "topics": ["sensors"]}
        encode = msgspec.msgpack.encode if protocol.endswith("msgpack") else lambda message: json.dumps(message)
        await socket.send(encode(request))
        packed = protocol.endswith("msgpack")
        while True:
            data = await socket.recv(decode=False)
            if decoded:
                message = json.loads(data)
                if message["type"] != "sensors":
                    continue
                positions = [sensor["position_m"] for sensor in message["sensors"]]
                noted.sum += len(positions)
                t_s = message["t_s"]
            elif packed:
                at = data.find(b"\xa3t_s")
                if b"\xa7sensors" not in data[:40] or at < 0:
                    continue
                t_s = msgspec.msgpack.decode(data[at + 4 : at + 13])
            else:
                if not data.startswith(b'{"type":"sensors"'):
                    continue
                t_s = float(data[data.find(b'"t_s":', 0, 120) + 6 :].split(b",", 1)[0])
            if not noted.frame(t_s):
                return noted.told()


def blocking(address, seconds):
    import posed

    noted = Noted(seconds)
    with posed.connect(address) as stage:
        for frame in stage.sensors():
            noted.sum += frame.position_m.shape[0]
            if not noted.frame(frame.t_s):
                return noted.told()


async def awaited(address, seconds):
    import posed

    noted = Noted(seconds)
    async with posed.aio.connect(address) as stage:
        async for frame in stage.sensors():
            noted.sum += frame.position_m.shape[0]
            if not noted.frame(frame.t_s):
                return noted.told()


def listen(form, address, seconds):
    if form == "blocking":
        return blocking(address, seconds)
    if form == "asyncio":
        return asyncio.run(awaited(address, seconds))
    protocol = "posed.v1.msgpack" if form == "bare-msgpack" else "posed.v1"
    return asyncio.run(bare(address, seconds, protocol, form == "json-by-hand"))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("posed", help="the program")
    parser.add_argument("--sensors", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=2.0, help="of each listener in each round")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--listen", nargs=2, metavar=("FORM", "ADDRESS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.listen:
        print(json.dumps(listen(*options.listen, options.seconds)))
        return
    with tempfile.TemporaryDirectory() as folder:
        stage = stage_file(folder, options.sensors)
        demo = subprocess.Popen([options.posed, "demo", "--stage", stage, "--listen", "127.0.0.1:0"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            address = demo.stdout.readline().split("http://")[1].split("/")[0]
            time.sleep(3)
            found = {form: [] for form in FORMS}
            for _ in range(options.rounds):
                for form in FORMS:
                    command = [sys.executable, __file__, options.posed, "--seconds", str(options.seconds), "--listen", form, address]
                    found[form].append(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout))
        finally:
            demo.terminate()
            demo.wait()
    at = {"median": 0.5, "p99": 0.99}
    late_ms = {form: {name: [1e3 * one["late_s"][int(share * len(one["late_s"]))] for one in rounds] for name, share in at.items()} for form, rounds in found.items()}
    for form, rounds in found.items():
        added = {name: [a - b for a, b in zip(late_ms[form][name], late_ms[BASE[form]][name])] for name in at}
        print(json.dumps({
            "client": form, "sensors": options.sensors, "rate_hz": round(statistics.median(one["rate_hz"] for one in rounds), 1),
            "core_percent": round(100 * statistics.median(one["core"] for one in rounds), 1), "than": BASE[form],
            "added_ms": {name: {"median": round(statistics.median(values), 3), "least": round(min(values), 3), "most": round(max(values), 3)} for name, values in added.items()},
        }), flush=True)


main()
