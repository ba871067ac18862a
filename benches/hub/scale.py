#!/usr/bin/env python3
"""What a hub costs per stage and per viewer: simulated stages and viewers on loopback, processor time and bytes from /proc.

    python3 benches/hub/scale.py target/release/posed --sensors 10 --stages 0 1 2 4 --viewers 0 20 40

Each stage is a `posed demo` of its own with so many magnetic sensors; a viewer is a websocket client at one stage of the hub that takes what the page takes.
Processor time is what each process has used, so that others on the machine disturb little. Prints a line per measurement as JSON.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from cut import Client, connected  # noqa: E402

ZENOH_PORT, HUB_PORT, STAGE_PORT = 27448, 28791, 28800
FIELDS = ["device", "position_m", "orientation_wxyz", "sigma_m", "measured", "fault", "change"]


def stage(folder, number, sensors, zenoh):
    lines = [f'name = "Stage {number}"']
    for device in range((sensors + 3) // 4):
        lines += ["[[device]]", f'name = "flock-{device}"', 'driver = "flock-of-birds"', f'port = "/dev/flock-{device}"']
    for sensor in range(sensors):
        lines += ["[[sensor]]", f'name = "bird-{sensor}"', f'device = "flock-{sensor // 4}"', f"address = {sensor % 4 + 1}"]
    for device in range((sensors + 3) // 4):
        lines += ["[[simulation.device]]", f'name = "flock-{device}"', "boot_ms = 0.0"]
    if zenoh:
        lines += ["[zenoh]", f'connect = ["tcp/127.0.0.1:{ZENOH_PORT}"]']
    path = os.path.join(folder, f"stage-{number}.toml")
    with open(path, "w", encoding="utf-8") as out:
        out.write("\n".join(lines) + "\n")
    return path


def cpu_s(process):
    with open(f"/proc/{process.pid}/stat", encoding="utf-8") as stat:
        fields = stat.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(process):
    with open(f"/proc/{process.pid}/status", encoding="utf-8") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))


def loopback_bytes():
    with open("/proc/net/dev", encoding="utf-8") as devices:
        return next(int(line.split(":")[1].split()[0]) for line in devices if line.strip().startswith("lo:"))


class Viewer(threading.Thread):
    """Takes and forgets."""

    def __init__(self, path):
        super().__init__(daemon=True)
        self.client, self.bytes = connected(HUB_PORT, path), 0
        self.client.request(type="subscribe", id=0, topics=["sensors"], fields=FIELDS, max_rate_hz=60)

    def run(self):
        try:
            while True:
                self.bytes += len(self.client.socket.recv(1 << 18))
        except OSError:
            pass


def measure(options, stages, viewers):
    folder = tempfile.mkdtemp()
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    hub = subprocess.Popen([options.posed, "hub", "--listen", f"tcp/127.0.0.1:{ZENOH_PORT}", "--http", f"127.0.0.1:{HUB_PORT}"], **quiet)
    demos = []
    try:
        for number in range(stages):
            file = stage(folder, number, options.sensors, True)
            demos.append(subprocess.Popen([options.posed, "demo", "--stage", file, "--listen", f"127.0.0.1:{STAGE_PORT + number}"], **quiet))
        board = connected(HUB_PORT, "/ws")
        frames = 0.0
        for message in board.messages():
            if message["type"] == "stages":
                entries = message["stages"]
                frames = sum(entry["frames_hz"] for entry in entries)
                if len(entries) == stages and all(entry["frames_hz"] > 50 for entry in entries):
                    break
        watching = [Viewer(f"/stage-{n % stages}/ws") for n in range(viewers)]
        for viewer in watching:
            viewer.start()
        time.sleep(2.0)
        before = (time.monotonic(), cpu_s(hub), [cpu_s(demo) for demo in demos], sum(v.bytes for v in watching), loopback_bytes())
        time.sleep(options.seconds)
        after = (time.monotonic(), cpu_s(hub), [cpu_s(demo) for demo in demos], sum(v.bytes for v in watching), loopback_bytes())
        lasted = after[0] - before[0]
        seen = (after[3] - before[3]) / lasted
        return {
            "stages": stages, "viewers": viewers, "sensors": options.sensors, "frames_hz": round(frames, 1),
            "hub_cores": round((after[1] - before[1]) / lasted, 4),
            "stage_cores": round(sum(b - a for a, b in zip(before[2], after[2])) / lasted / max(stages, 1), 4),
            "viewers_bytes_per_s": round(seen),
            # Both ways, headers included; on a machine where others use loopback too, an upper bound.
            "stages_bytes_per_s": round((after[4] - before[4]) / lasted - seen),
            "hub_mb": round(resident_mb(hub), 1),
        }
    finally:
        for process in demos + [hub]:
            process.terminate()
        for process in demos + [hub]:
            process.wait()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("posed", help="the program")
    parser.add_argument("--sensors", type=int, default=10)
    parser.add_argument("--stages", type=int, nargs="+", default=[0, 1, 2, 4])
    parser.add_argument("--viewers", type=int, nargs="+", default=[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    for stages in options.stages:
        for viewers in options.viewers:
            if stages > 0 or viewers == 0:
                print(json.dumps(measure(options, stages, viewers)), flush=True)


if __name__ == "__main__":
    main()
