"""A recording of ours as the MCAP library of others reads it.

Usage: pip install mcap jsonschema; python benches/peers/foxglove/recording.py REC.mcap

Reads the whole file with all checksums, in file order and by its index; both must give the same messages. Every JSON message is held against the
schema in the file (null, which is what is not known, aside), every schema against what the viewers' parser takes. The poses of the viewers' channels
must be those of our own messages at equal times. Ends with 1 at the first thing that does not fit.
"""

import json
import sys
from collections import Counter

import jsonschema
from mcap.reader import NonSeekingReader, SeekingReader


def known(value):
    """Without what is null."""
    if isinstance(value, dict):
        return {key: known(of) for key, of in value.items() if of is not None}
    return [known(of) for of in value] if isinstance(value, list) else value


def plain(schema, at):
    """What the parser that Foxglove Studio published takes, and nothing else."""
    if "oneOf" in schema:
        assert all(isinstance(one["const"], int) for one in schema["oneOf"]), at
    elif schema["type"] == "object":
        for name, of in schema["properties"].items():
            plain(of, f"{at}.{name}")
    elif schema["type"] == "array":
        assert schema["items"]["type"] != "array", at
        plain(schema["items"], f"{at}[]")
    else:
        assert schema["type"] in ("number", "integer", "string", "boolean"), at


path = sys.argv[1]
counts, checks, theirs, ours = Counter(), {}, {}, {}
with open(path, "rb") as file:
    for schema, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False):
        counts[channel.topic] += 1
        if channel.message_encoding != "json":
            continue
        assert schema is not None, f"{channel.topic} has no schema"
        if schema.id not in checks:
            text = json.loads(schema.data)
            plain(text, schema.name)
            checks[schema.id] = jsonschema.Draft202012Validator(text)
        value = json.loads(message.data)
        checks[schema.id].validate(known(value))
        if schema.name == "foxglove.PoseInFrame":
            name = channel.topic.removeprefix("/sensors/").removesuffix("/pose")
            theirs[message.log_time, name] = value["pose"]
        elif channel.topic == "/posed/sensors":
            for sensor in value["sensors"]:
                if sensor["state"] in ("ok", "repaired", "extrapolated"):
                    ours[message.log_time, sensor["name"]] = sensor
with open(path, "rb") as file:
    reader = SeekingReader(file, validate_crcs=True)
    summary = reader.get_summary()
    indexed = Counter(channel.topic for _, channel, _ in reader.iter_messages())
assert summary is not None and summary.statistics is not None, "it has no index"
assert indexed == counts, f"by the index {indexed}, in file order {counts}"
assert summary.statistics.message_count == counts.total()
assert theirs and theirs.keys() == ours.keys(), f"{len(theirs)} poses for viewers, {len(ours)} of our own"
for key, pose in theirs.items():
    w, x, y, z = ours[key]["orientation_wxyz"]
    assert pose["orientation"] == {"x": x, "y": y, "z": z, "w": w}, key
    assert list(pose["position"].values()) == (ours[key]["position_m"] or [0, 0, 0]), key
for topic, count in sorted(counts.items()):
    print(f"{topic}: {count}")
print(f"{len(checks)} schemas, {counts.total()} messages, {len(theirs)} equal poses")
