#!/usr/bin/env python3
"""Three stages and a hub in network namespaces of their own, over links with delay and loss that are cut and repaired.

    cargo test --features zenoh --test it --no-run
    sudo python3 benches/hub/cut.py target/debug/posed

Needs root, iproute2 and /dev/net/tun. Every packet between a stage and the hub passes through this program, which delays it, loses some, and
during the cut all: no netem in the kernel is needed. Prints what it found as JSON; exit code 1 where an event was lost, came twice or
out of order, a fused stage said something else than the stage itself, or poses took longer than a second to flow again.
"""
import argparse
import base64
import collections
import fcntl
import hashlib
import json
import os
import queue
import random
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

ZENOH_PORT = 27447
HUB_PORT = 28790
STAGE_PORT = 28787


class Link:
    """A tun device here and one in a namespace, with a bad network between them."""

    def __init__(self, name, number, options):
        self.namespace, self.cut, self.options = name, False, options
        self.random = random.Random(number)
        self.passed = collections.Counter()
        run("ip", "netns", "add", name)
        ends = [self.device(f"ph{number}a"), self.device(f"ph{number}b")]
        run("ip", "link", "set", f"ph{number}b", "netns", name)
        run("ip", "addr", "add", f"10.77.{number}.1/30", "dev", f"ph{number}a")
        run("ip", "link", "set", f"ph{number}a", "up")
        inside = ["ip", "-n", name]
        run(*inside, "addr", "add", f"10.77.{number}.2/30", "dev", f"ph{number}b")
        run(*inside, "link", "set", f"ph{number}b", "up")
        run(*inside, "link", "set", "lo", "up")
        for way, (source, target) in (("up", ends[::-1]), ("down", ends)):
            waiting = queue.Queue()
            threading.Thread(target=self.read, args=(way, source, waiting), daemon=True).start()
            threading.Thread(target=self.write, args=(target, waiting), daemon=True).start()

    @staticmethod
    def device(name):
        tun = os.open("/dev/net/tun", os.O_RDWR)
        fcntl.ioctl(tun, 0x400454CA, struct.pack("16sH", name.encode(), 0x1001))
        return tun

    def read(self, way, source, waiting):
        while True:
            try:
                packet = os.read(source, 65536)
            except OSError:
                # Its namespace is gone.
                return
            if self.cut or self.random.random() < self.options.loss:
                self.passed[f"{way}_lost"] += 1
                continue
            self.passed[f"{way}_bytes"] += len(packet)
            waiting.put((time.monotonic() + self.options.delay_ms * 1e-3, packet))

    @staticmethod
    def write(target, waiting):
        while True:
            due, packet = waiting.get()
            time.sleep(max(0.0, due - time.monotonic()))
            try:
                os.write(target, packet)
            except OSError:
                return


class Client:
    """As much of a websocket client as this needs."""

    def __init__(self, port, path):
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.buffer = b""
        key = base64.b64encode(os.urandom(16)).decode()
        head = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        self.socket.sendall((head + f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n").encode())
        answer = self.until(b"\r\n\r\n")
        if b" 101 " not in answer.split(b"\r\n")[0]:
            raise ConnectionError(answer.decode(errors="replace"))

    def until(self, end):
        while end not in self.buffer:
            self.more()
        found, self.buffer = self.buffer.split(end, 1)
        return found

    def more(self):
        read = self.socket.recv(1 << 16)
        if not read:
            raise ConnectionError("closed")
        self.buffer += read

    def take(self, count):
        while len(self.buffer) < count:
            self.more()
        taken, self.buffer = self.buffer[:count], self.buffer[count:]
        return taken

    def send(self, payload, opcode=1):
        mask = os.urandom(4)
        size = len(payload)
        head = struct.pack("!BB", 0x80 | opcode, 0x80 | size) if size < 126 else struct.pack("!BBH", 0x80 | opcode, 0xFE, size)
        self.socket.sendall(head + mask + bytes(byte ^ mask[at % 4] for at, byte in enumerate(payload)))

    def request(self, **request):
        self.send(json.dumps(request).encode())

    def messages(self):
        while True:
            opcode, size = struct.unpack("!BB", self.take(2))
            if size == 126:
                (size,) = struct.unpack("!H", self.take(2))
            elif size == 127:
                (size,) = struct.unpack("!Q", self.take(8))
            payload = self.take(size)
            if opcode & 15 == 9:
                self.send(payload, 10)
            elif opcode & 15 == 8:
                return
            elif opcode & 15 == 1:
                yield json.loads(payload)


EVENTS = ["faults", "field", "keyframes", "exercise"]
FIELDS = ["device", "position_m", "orientation_wxyz", "measured", "covariance", "sigma_m"]


def digest(message):
    """What a message reports, apart from what differs from client to client."""
    said = {key: value for key, value in message.items() if key not in ("seq", "dropped", "stage")}
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def operate(port):
    """In a stage's namespace: makes an event every 0.3 s, and says at the end what the stage itself has said."""
    client = Client(port, "/ws")
    client.request(type="subscribe", id=0, topics=EVENTS)
    client.request(type="subscribe", id=1, topics=["sensors"], fields=FIELDS, drop="queue")
    said = {"events": [], "frames": {}}
    stop = threading.Event()

    def make():
        for n in range(1, 1_000_000):
            if stop.wait(0.3):
                return
            model = {"kind": "transmitter", "position_m": [n * 1e-3, 0, 0], "orientation_wxyz": [1, 0, 0, 0]}
            client.request(type="model.load", id=n + 10, model=model)

    def end(*_):
        stop.set()
        # What is on its way to this client still comes.
        threading.Timer(1.0, lambda: (print(json.dumps(said), flush=True), os._exit(0))).start()

    signal.signal(signal.SIGTERM, end)
    maker = threading.Thread(target=make, daemon=True)
    maker.start()

    def read():
        for message in client.messages():
            if "event_id" in message:
                said["events"].append(message["event_id"])
            elif message["type"] == "sensors":
                said["frames"][repr(message["t_s"])] = digest(message)

    threading.Thread(target=read, daemon=True).start()
    while True:
        signal.pause()


def run(*command):
    subprocess.run(command, check=True)


STAGE = """name = "Stage {n}"
[[device]]
name = "flock"
driver = "flock-of-birds"
port = "/dev/flock"
[[sensor]]
name = "left"
device = "flock"
address = 1
[[sensor]]
name = "right"
device = "flock"
address = 2
[[simulation.device]]
name = "flock"
boot_ms = 0.0
[zenoh]
connect = ["tcp/10.77.{n}.1:{port}"]
round_trip_ms = {round_trip_ms}
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("posed", help="the program")
    parser.add_argument("--stages", type=int, default=3)
    parser.add_argument("--delay-ms", type=float, default=20.0, help="each way")
    parser.add_argument("--loss", type=float, default=0.02, help="of packets, each way")
    parser.add_argument("--cut-s", type=float, default=10.0)
    parser.add_argument("--around-s", type=float, default=8.0, help="before the cut, and after it is repaired")
    options = parser.parse_args()
    names = [f"posed-hub-{n}" for n in range(1, options.stages + 1)]
    folder = tempfile.mkdtemp()
    links, started, operators = [], [], []
    quiet = {"stdout": subprocess.DEVNULL, "stderr": open(os.path.join(folder, "log"), "wb")}
    try:
        links = [Link(name, n, options) for n, name in enumerate(names, 1)]
        hub = [options.posed, "hub", "--listen", f"tcp/0.0.0.0:{ZENOH_PORT}", "--http", f"127.0.0.1:{HUB_PORT}", "--fuse", "stage-1"]
        started.append(subprocess.Popen(hub, **quiet))
        for n, name in enumerate(names, 1):
            file = os.path.join(folder, f"stage-{n}.toml")
            with open(file, "w", encoding="utf-8") as out:
                out.write(STAGE.format(n=n, port=ZENOH_PORT, round_trip_ms=max(100.0, 2.5 * options.delay_ms)))
            demo = [options.posed, "demo", "--stage", file, "--listen", f"127.0.0.1:{STAGE_PORT}"]
            started.append(subprocess.Popen(["ip", "netns", "exec", name, *demo], **quiet))
        result = measure(options, links, operators)
    finally:
        for process in operators + started:
            process.terminate()
        for process in started:
            process.wait()
        for name in names:
            subprocess.run(["ip", "netns", "del", name], check=False)
    print(json.dumps(result, indent=1))
    sys.exit(0 if result["good"] else 1)


def connected(port, path):
    while True:
        try:
            return Client(port, path)
        except OSError:
            time.sleep(0.2)


def measure(options, links, operators):
    client = connected(HUB_PORT, "/ws")
    client.request(type="subscribe", id=0, topics=EVENTS)
    client.request(type="subscribe", id=1, topics=["sensors"], fields=FIELDS, drop="queue")
    events, frames, arrivals = (collections.defaultdict(list) for _ in range(3))
    said, board = collections.defaultdict(dict), {"stages": [], "states": collections.defaultdict(list)}

    def read():
        for message in client.messages():
            now, stage = time.monotonic(), message.get("stage")
            if message["type"] == "stages":
                board["stages"] = message["stages"]
                for entry in message["stages"]:
                    states = board["states"][entry["id"]]
                    if not states or states[-1] != entry["state"]:
                        states.append(entry["state"])
            elif "event_id" in message:
                events[stage].append(message["event_id"])
            elif message["type"] == "sensors":
                arrivals[stage].append(now)
                said[stage][repr(message["t_s"])] = digest(message)

    threading.Thread(target=read, daemon=True).start()
    wait(lambda: len(board["stages"]) == options.stages and all(len(arrivals[e["id"]]) > 50 for e in board["stages"]), "all stages")
    for name in (link.namespace for link in links):
        command = ["ip", "netns", "exec", name, sys.executable, __file__, "operate", str(STAGE_PORT)]
        operators.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
    time.sleep(options.around_s)
    clocks = {entry["id"]: entry["clock"] for entry in board["stages"]}
    wire = {link.namespace: dict(link.passed) for link in links}
    for link in links:
        link.cut = True
    time.sleep(options.cut_s)
    repaired = time.monotonic()
    for link in links:
        link.cut = False
    time.sleep(options.around_s)
    for operator in operators:
        operator.terminate()
    local = [json.loads(operator.communicate()[0]) for operator in operators]
    time.sleep(2.0)
    stages = {}
    for n, there in enumerate(local, 1):
        stage = f"stage-{n}"
        here = events[stage]
        common = set(there["frames"]) & set(said[stage])
        after = [t for t in arrivals[stage] if t > repaired]
        stages[stage] = {
            "events_said": len(there["events"]),
            "events_missing": sorted(set(there["events"]) - set(here)),
            "events_in_order": here == sorted(set(here)),
            "states": board["states"][stage],
            "poses_again_s": round(after[0] - repaired, 3) if after else None,
            "frames_compared": len(common),
            "frames_different": sum(there["frames"][t] != said[stage][t] for t in common),
            "frames_missing_here": len(set(there["frames"]) - set(said[stage])),
            "clock": clocks[stage],
            "wire_before_the_cut": wire[f"posed-hub-{n}"],
        }
    good = all(
        not s["events_missing"] and s["events_in_order"] and s["events_said"] > 20 and s["frames_compared"] > 100
        and s["frames_different"] == 0 and s["poses_again_s"] is not None and s["poses_again_s"] <= 1.0
        for s in stages.values()
    )
    return {"good": good, "stages": stages}


def wait(fits, what):
    end = time.monotonic() + 60
    while not fits():
        if time.monotonic() > end:
            sys.exit(f"waited for {what} in vain")
        time.sleep(0.1)


if __name__ == "__main__":
    if sys.argv[1:2] == ["operate"]:
        operate(int(sys.argv[2]))
    else:
        main()
