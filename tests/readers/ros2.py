"""Listens as sessions of rmw_zenoh do, with others' zenoh, CDR, type hashes and XXH3: ros2.py PORT TOKENS

Is the router on that port; waits for so many liveliness tokens; takes three messages of each topic that they name, and prints tokens and messages as one line of JSON. Then
it waits until the node's token is gone. Ends with 1 where a key, a hash, an attachment or a byte is not as ROS 2 has it.
"""

import dataclasses
import json
import queue
import struct
import sys
import time

import numpy as np
import xxhash
import zenoh
from rosbags.typesys import Stores, get_typestore

RELEASES = [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL]
MESSAGES = 3
PATIENCE_S = 60


def session(mode, **ends):
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for key, end in ends.items():
        config.insert_json5(f"{key}/endpoints", json.dumps([end]))
    return zenoh.open(config)


def plain(value):
    """A message as JSON has it."""
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value) if field.name != "__msgtype__"}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def checked(sample, token, name, stores):
    """The message of a sample, held against what its publisher's token says."""
    number, sent_ns, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
    low_first = xxhash.xxh3_128(token.encode()).intdigest().to_bytes(16, "little")
    assert number >= 1 and length == 16 and gid == low_first, token
    assert abs(time.time_ns() - sent_ns) < 5_000_000_000, "sent by another clock"
    payload = sample.payload.to_bytes()
    messages = [store.deserialize_cdr(payload, name) for store in stores]
    for store, message in zip(stores, messages):
        assert bytes(store.serialize_cdr(message, name)) == payload, f"{token}: {payload.hex()}"
    return number, plain(messages[0])


def main():
    port, count = int(sys.argv[1]), int(sys.argv[2])
    stores = [get_typestore(release) for release in RELEASES]
    router = session("router", listen=f"tcp/127.0.0.1:{port}")
    peer = session("peer", connect=f"tcp/127.0.0.1:{port}", listen="tcp/127.0.0.1:0")
    news = queue.Queue()
    # As the graph of ROS 2 is made.
    listener = peer.liveliness().declare_subscriber("@ros2_lv/0/**", lambda sample: news.put((str(sample.key_expr), sample.kind)), history=True)
    tokens = set()
    while len(tokens) < count:
        token, kind = news.get(timeout=PATIENCE_S)
        assert kind == zenoh.SampleKind.PUT
        tokens.add(token)
    assert len({token.split("/")[2] for token in tokens}) == 1, "one session"
    samples, subscribers, topics = queue.Queue(), [], {}
    for token in tokens:
        # Space, domain, zenoh's id, node, entity, kind, enclave, namespace, node's name; of publishers topic, type, hash, QoS.
        space, domain, zid, node, entity, kind, enclave, namespace, name, *rest = token.split("/")
        assert (space, domain, node, enclave, namespace, name) == ("@ros2_lv", "0", "0", "%", "%hall", "posed_demo"), token
        assert int(zid, 16) and zid == zid.lower(), token
        if kind == "NN":
            assert entity == node and not rest
            continue
        topic, dds, digest, qos = rest
        assert kind == "MP" and qos == "::,10:,:,:,,", token
        package, _, _, short = dds.split("::")
        ros = f"{package}/msg/{short.removesuffix('_')}"
        assert all(store.hash_rihs01(ros) == digest for store in stores), token
        topic = topic.replace("%", "/")
        topics[topic] = {"type": ros, "messages": []}
        take = lambda sample, at=(token, topic, ros): samples.put((sample, *at))
        subscribers.append(peer.declare_subscriber(f"{domain}{topic}/{dds}/{digest}", take))
    numbers = {}
    while any(len(topic["messages"]) < MESSAGES for topic in topics.values()):
        sample, token, topic, ros = samples.get(timeout=PATIENCE_S)
        number, message = checked(sample, token, ros, stores)
        assert number > numbers.get(topic, 0), topic
        numbers[topic] = number
        topics[topic]["messages"].append(message)
    print(json.dumps(topics), flush=True)
    subscribers.clear()
    while tokens:
        token, kind = news.get(timeout=PATIENCE_S)
        assert kind == zenoh.SampleKind.DELETE
        tokens.remove(token)
    print("gone", flush=True)
    del listener
    peer.close()
    router.close()


main()
