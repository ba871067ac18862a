"""The bones that python-osc receives, put together again, beside the body of our own websocket.

Usage: pip install python-osc websockets; posed demo --stage STAGE.toml (with [vmc] and a body);
       python benches/peers/vmc/receive.py ws://127.0.0.1:8787/ws [PORT] [SECONDS]

Forward kinematics of /VMC/Ext/Bone/Pos gives the joints in Unity's axes: hips, shoulders, elbows, hips' joints, knees. They must be the origins of the segments in
`body` messages of the same time (z and y exchanged) within a millimetre. Ends with 1 if they are not, or if nothing could be compared.
"""

import asyncio
import json
import socket
import sys
import time

from pythonosc.osc_packet import OscPacket
from websockets.asyncio.client import connect

PARENT = {
    "Hips": None, "Spine": "Hips",
    "LeftUpperArm": "Spine", "LeftLowerArm": "LeftUpperArm", "RightUpperArm": "Spine", "RightLowerArm": "RightUpperArm",
    "LeftUpperLeg": "Hips", "LeftLowerLeg": "LeftUpperLeg", "RightUpperLeg": "Hips", "RightLowerLeg": "RightUpperLeg",
}
# The torso's origin lies in its middle, the spine's joint at the hips.
SEGMENT = {
    "Hips": "pelvis", "LeftUpperArm": "upper_arm_l", "LeftLowerArm": "forearm_l", "RightUpperArm": "upper_arm_r",
    "RightLowerArm": "forearm_r", "LeftUpperLeg": "thigh_l", "LeftLowerLeg": "shank_l", "RightUpperLeg": "thigh_r",
    "RightLowerLeg": "shank_r",
}


def times(a, b):
    """Product of quaternions, scalar last."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def turned(q, v):
    x, y, z, w = q
    return times(times(q, (*v, 0.0)), (-x, -y, -z, w))[:3]


def joints(bones):
    whole = {}
    for name, parent in PARENT.items():
        if name in bones and (parent is None or parent in whole):
            at, q = whole[parent] if parent else ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            offset, rotation = bones[name]
            whole[name] = (tuple(a + b for a, b in zip(at, turned(q, offset))), times(q, rotation))
    return whole


async def main(address, port, seconds):
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", port))
    receiver.setblocking(False)
    loop = asyncio.get_running_loop()
    bodies, frames = {}, []
    end = time.monotonic() + seconds

    async def listen():
        while time.monotonic() < end:
            try:
                datagram = await asyncio.wait_for(loop.sock_recv(receiver, 65536), 1)
            except TimeoutError:
                continue
            assert len(datagram) <= 1400
            t_s, loaded, bones = None, None, {}
            for timed in OscPacket(datagram).messages:
                address, params = timed.message.address, timed.message.params
                if address == "/VMC/Ext/OK":
                    loaded = params[0]
                elif address == "/VMC/Ext/T":
                    t_s = params[0]
                elif address == "/VMC/Ext/Bone/Pos":
                    assert len(params) == 8 and all(isinstance(value, float) for value in params[1:])
                    bones[params[0]] = (tuple(params[1:4]), tuple(params[4:8]))
            frames.append((t_s, loaded, bones))

    async def watch():
        async with connect(address, subprotocols=["posed.v1"]) as ours:
            await ours.send(json.dumps({"type": "subscribe", "id": 1, "topics": ["body"], "drop": "queue"}))
            while time.monotonic() < end:
                message = json.loads(await ours.recv())
                if message["type"] == "body":
                    bodies[message["t_s"]] = {segment["name"]: segment for segment in message["segments"]}

    await asyncio.gather(listen(), watch())
    compared, worst_m = 0, 0.0
    for t_s, loaded, bones in frames:
        at = min(bodies, key=lambda other: abs(other - t_s), default=None)
        # The time is a single-precision number.
        if at is None or abs(at - t_s) > 2e-3 or not loaded:
            continue
        for name, (joint, _) in joints(bones).items():
            segment = bodies[at].get(SEGMENT.get(name))
            if segment:
                x, y, z = segment["position_m"]
                worst_m = max(worst_m, *(abs(a - b) for a, b in zip(joint, (x, z, y))))
                compared += 1
    loaded = sum(1 for _, loaded, _ in frames if loaded)
    print(f"{len(frames)} frames in {seconds} s, {loaded} with bones; {compared} joints compared, worst {worst_m * 1e3:.3f} mm")
    return 0 if compared > 0 and worst_m < 1e-3 else 1


if __name__ == "__main__":
    arguments = sys.argv[1:]
    port = int(arguments[1]) if len(arguments) > 1 else 39539
    sys.exit(asyncio.run(main(arguments[0], port, float(arguments[2]) if len(arguments) > 2 else 5.0)))
