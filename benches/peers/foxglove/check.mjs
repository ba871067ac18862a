// Foxglove's own client library (@foxglove/ws-protocol) and schemas (@foxglove/schemas) beside our websocket, on a running stage.
//
// Usage: npm install --prefix benches/peers/foxglove; posed demo;
//        node benches/peers/foxglove/check.mjs ws://127.0.0.1:8787 [SECONDS]
//
// Lists the channels, subscribes to all, decodes every message, holds each against its schema (Foxglove's own for foxglove.*), and compares the
// poses of both websockets at equal times. Ends with 1 at the first thing that does not fit.

import protocol from "@foxglove/ws-protocol";
import schemas from "@foxglove/schemas/jsonschema.js";
import Ajv from "ajv";
import WebSocket from "ws";

const { FoxgloveClient } = protocol;
const [address, seconds = "5"] = process.argv.slice(2);
const utf8 = new TextDecoder();
const fail = (sentence) => {
  console.error(sentence);
  process.exit(1);
};

const ajv = new Ajv({ strict: false, allErrors: true });
const published = new Map(Object.entries(schemas).map(([name, schema]) => [`foxglove.${name}`, schema]));

// What is not known is null in our own messages; in schemas as viewers read them a field has one type.
const known = (value) => {
  if (Array.isArray(value)) return value.map(known);
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).filter(([, of]) => of !== null).map(([key, of]) => [key, known(of)]));
};

const counts = new Map();
const poses = new Map(); // time in us and sensor: pose of the viewer
const own = new Map(); // the same of our own websocket
let bytes = 0;

const viewer = new FoxgloveClient({ ws: new WebSocket(address, [FoxgloveClient.SUPPORTED_SUBPROTOCOL, "foxglove.sdk.v1"]) });
const channels = new Map();
let epoch_us;
viewer.on("error", (error) => fail(`the client library says: ${error}`));
viewer.on("serverInfo", (info) => console.log(`${info.name}, capabilities [${info.capabilities}], session ${info.sessionId}`));
viewer.on("status", (status) => console.log(`status ${status.level}: ${status.message}`));
viewer.on("advertise", (list) => {
  for (const channel of list) {
    const theirs = published.get(channel.schemaName);
    if (channel.schemaName.startsWith("foxglove.") && !theirs) fail(`${channel.schemaName} is no schema of Foxglove's`);
    const checks = [theirs, JSON.parse(channel.schema)].filter(Boolean).map((schema) => ajv.compile(schema));
    channels.set(viewer.subscribe(channel.id), { channel, checks });
    counts.set(channel.topic, 0);
  }
});
viewer.on("message", ({ subscriptionId, timestamp, data }) => {
  const { channel, checks } = channels.get(subscriptionId);
  const message = JSON.parse(utf8.decode(data));
  bytes += data.byteLength;
  counts.set(channel.topic, counts.get(channel.topic) + 1);
  for (const check of checks) {
    if (!check(known(message))) fail(`${channel.topic} does not fit its schema: ${ajv.errorsText(check.errors)}`);
  }
  if (channel.schemaName === "foxglove.PoseInFrame") {
    const name = channel.topic.split("/").slice(2, -1).join("/");
    poses.set(`${timestamp / 1000n} ${name}`, message.pose);
  }
});

const ours = new WebSocket(`${address}/ws`, "posed.v1");
ours.on("message", (text) => {
  const message = JSON.parse(text);
  if (message.type === "hello") {
    const [whole, fraction] = message.epoch_utc.replace("Z", "").split(".");
    epoch_us = BigInt(Date.parse(`${whole}Z`)) * 1000n + BigInt(fraction.padEnd(9, "0").slice(0, 6));
    ours.send(JSON.stringify({ type: "subscribe", id: 1, topics: ["sensors"], drop: "queue" }));
  }
  if (message.type !== "sensors") return;
  const at = epoch_us + BigInt(Math.round(message.t_s * 1e6));
  for (const sensor of message.sensors) {
    if (["ok", "repaired", "extrapolated"].includes(sensor.state)) own.set(`${at} ${sensor.name}`, sensor);
  }
});

setTimeout(() => {
  let compared = 0;
  for (const [key, pose] of poses) {
    const sensor = own.get(key);
    if (!sensor) continue;
    const [w, x, y, z] = sensor.orientation_wxyz;
    const [px, py, pz] = sensor.position_m ?? [0, 0, 0];
    const same = JSON.stringify(pose) === JSON.stringify({ position: { x: px, y: py, z: pz }, orientation: { x, y, z, w } });
    if (!same) fail(`${key}: ${JSON.stringify(pose)} here, ${JSON.stringify(sensor)} there`);
    compared += 1;
  }
  for (const [topic, count] of [...counts].sort()) console.log(`${topic}: ${count}`);
  console.log(`${bytes} bytes; ${poses.size} poses here, ${own.size} there, ${compared} of equal times are equal`);
  process.exit(compared > 0 ? 0 : 1);
}, Number(seconds) * 1000);
