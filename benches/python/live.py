"""What the Python client adds to a bare websocket, and which share of a core it takes: both in one run.

    pip install ./clients/python
    python benches/python/live.py target/release/posed --sensors 100 --rounds 10

A `posed demo` of so many magnetic sensors gives one `sensors` message in each encoding, with the default fields. A server in a process of its own sends it 100 times a
second with the time of sending (this computer's monotonic clock) as `t_s`, so that the latency from there to user code is known, whatever a simulation beside would do to
the machine. Turn about, round after round, listen: bare sockets that look for nothing but the time; JSON decoded by hand; and the loops of both forms of the client over
`stage.sensors()` that look at `position_m` as an array. What each adds is its latency less that of the bare socket of its encoding in the same round. Processor time is
that of the listening process. Prints a line for each as JSON.
"""

import argparse
import asyncio
import contextlib
import json
import os
import statistics
import struct
import subprocess
import sys
import tempfile
import time

import msgspec
import posed
from websockets.asyncio.client import connect
from websockets.asyncio.server import serve
from websockets.exceptions import ConnectionClosed

RATE_HZ = 100
# Beside each the bare socket that it is compared with.
BASE = {"bare MessagePack": "bare MessagePack", "blocking": "bare MessagePack", "asyncio": "bare MessagePack", "bare JSON": "bare JSON", "JSON by hand": "bare JSON"}
PROTOCOLS = ("posed.v1", "posed.v1.msgpack")
encode, decode = msgspec.msgpack.encode, msgspec.msgpack.decode


def stage_file(folder, sensors):
    lines = ['name = "Many"']
    flocks = range((sensors + 3) // 4)
    for flock in flocks:
        lines += ["[[device]]", f'name = "flock-{flock}"', 'driver = "flock-of-birds"', f'port = "/dev/flock-{flock}"']
    for sensor in range(sensors):
        lines += ["[[sensor]]", f'name = "bird-{sensor}"', f'device = "flock-{sensor // 4}"', f"address = {sensor % 4 + 1}"]
    for flock in flocks:
        lines += ["[[simulation.device]]", f'name = "flock-{flock}"', "boot_ms = 0.0"]
    path = os.path.join(folder, "many.toml")
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    return path


async def subscribed(address, protocol):
    socket = await connect(f"ws://{address}/ws", subprotocols=[protocol], compression=None, max_size=None, proxy=None)
    hello = await socket.recv(decode=False)
    request = {"type": "subscribe", "id": 1, "topics": ["sensors"]}
    await socket.send(encode(request) if protocol == PROTOCOLS[1] else json.dumps(request))
    return socket, hello


async def example(address, protocol):
    """The greeting and a message of a running daemon in which all sensors have a pose."""
    socket, hello = await subscribed(address, protocol)
    async with socket:
        while True:
            data = await socket.recv(decode=False)
            message = decode(data) if protocol == PROTOCOLS[1] else json.loads(data)
            if message["type"] == "sensors" and all(sensor["position_m"] for sensor in message["sensors"]):
                return hello, data


def timed(data, protocol):
    """The message in two pieces, between which the time stands."""
    if protocol == PROTOCOLS[1]:
        at = data.index(b"\xa3t_s\xcb") + 5
        return data[:at], data[at + 8 :]
    at = data.index(b'"t_s":') + 6
    return data[:at], data[data.index(b",", at) :]


async def send(folder):
    """Until the process is ended."""
    examples = {}
    for protocol in PROTOCOLS:
        hello, message = (open(os.path.join(folder, f"{protocol}.{part}"), "rb").read() for part in ("hello", "message"))
        examples[protocol] = (hello, *timed(message, protocol))

    async def meet(socket):
        packed = socket.subprotocol == PROTOCOLS[1]
        hello, before, behind = examples[socket.subprotocol]
        await socket.send(hello, text=not packed)
        request = decode(await socket.recv(decode=False)) if packed else json.loads(await socket.recv())
        ok = {"type": "ok", "id": request["id"]}
        await socket.send(encode(ok) if packed else json.dumps(ok))
        due = time.monotonic()
        with contextlib.suppress(ConnectionClosed):
            while True:
                due += 1 / RATE_HZ
                await asyncio.sleep(max(0.0, due - time.monotonic()))
                now = time.monotonic()
                await socket.send(before + (struct.pack(">d", now) if packed else f"{now:.6f}".encode()) + behind, text=not packed)

    async with serve(meet, "127.0.0.1", 0, subprotocols=PROTOCOLS, compression=None) as server:
        print(server.sockets[0].getsockname()[1], flush=True)
        await server.serve_forever()


class Noted:
    """The latency of each frame to user code; what came in the first half second is left out."""

    def __init__(self, seconds):
        self.begun = time.monotonic() + 0.5
        self.until = self.begun + seconds
        self.late_s, self.before, self.sum = [], None, 0

    def frame(self, t_s):
        now = time.monotonic()
        if now < self.begun:
            return True
        if self.before is None:
            self.before = (now, time.process_time())
        self.late_s.append(now - t_s)
        return now < self.until

    def reported(self):
        began, used = self.before
        lasted = time.monotonic() - began
        return {"late_s": sorted(self.late_s), "core": (time.process_time() - used) / lasted, "rate_hz": len(self.late_s) / lasted}


async def bare(address, noted, protocol, by_hand):
    socket, _ = await subscribed(address, protocol)
    async with socket:
        await socket.recv()
        while True:
            data = await socket.recv(decode=False)
            if by_hand:
                message = json.loads(data)
                noted.sum += len([sensor["position_m"] for sensor in message["sensors"]])
                t_s = message["t_s"]
            elif protocol == PROTOCOLS[1]:
                (t_s,) = struct.unpack_from(">d", data, data.index(b"\xa3t_s\xcb") + 5)
            else:
                at = data.index(b'"t_s":') + 6
                t_s = float(data[at : data.index(b",", at)])
            if not noted.frame(t_s):
                return


def blocking(address, noted):
    with posed.connect(address) as stage:
        for frame in stage.sensors():
            noted.sum += len(frame.position_m)
            if not noted.frame(frame.t_s):
                return


async def awaited(address, noted):
    async with posed.aio.connect(address) as stage:
        async for frame in stage.sensors():
            noted.sum += len(frame.position_m)
            if not noted.frame(frame.t_s):
                return


def listen(form, address, seconds):
    noted = Noted(seconds)
    if form == "blocking":
        blocking(address, noted)
    elif form == "asyncio":
        asyncio.run(awaited(address, noted))
    else:
        asyncio.run(bare(address, noted, PROTOCOLS[form == "bare MessagePack"], form == "JSON by hand"))
    return noted.reported()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("posed", help="the program")
    parser.add_argument("--sensors", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=2.0, help="of each listener in each round")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--send", metavar="FOLDER", help=argparse.SUPPRESS)
    parser.add_argument("--listen", nargs=2, metavar=("FORM", "ADDRESS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.send:
        return asyncio.run(send(options.send))
    if options.listen:
        return print(json.dumps(listen(*options.listen, options.seconds)))
    again = [sys.executable, __file__, options.posed, "--seconds", str(options.seconds)]
    found = {form: [] for form in BASE}
    with tempfile.TemporaryDirectory() as folder:
        command = [options.posed, "demo", "--stage", stage_file(folder, options.sensors), "--listen", "127.0.0.1:0"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as demo:
            address = demo.stdout.readline().split("http://")[1].split("/")[0]
            for protocol in PROTOCOLS:
                for part, data in zip(("hello", "message"), asyncio.run(example(address, protocol))):
                    with open(os.path.join(folder, f"{protocol}.{part}"), "wb") as file:
                        file.write(data)
            demo.terminate()
        with subprocess.Popen([*again, "--send", folder], stdout=subprocess.PIPE, text=True) as sender:
            address = f"127.0.0.1:{int(sender.stdout.readline())}"
            for _ in range(options.rounds):
                for form in BASE:
                    done = subprocess.run([*again, "--listen", form, address], check=True, stdout=subprocess.PIPE)
                    found[form].append(json.loads(done.stdout))
            sender.terminate()

    def late_ms(form, share):
        return [1e3 * one["late_s"][int(share * len(one["late_s"]))] for one in found[form]]

    for form, rounds in found.items():
        report = {"client": form, "sensors": options.sensors, "rate_hz": round(statistics.median(one["rate_hz"] for one in rounds), 1)}
        report["core_percent"] = round(100 * statistics.median(one["core"] for one in rounds), 1)
        for name, share in (("median", 0.5), ("p99", 0.99)):
            added = [a - b for a, b in zip(late_ms(form, share), late_ms(BASE[form], share))]
            report[name] = {"late_ms": round(statistics.median(late_ms(form, share)), 3), "added_ms": round(statistics.median(added), 3), "most_added_ms": round(max(added), 3)}
        print(json.dumps(report), flush=True)


main()
