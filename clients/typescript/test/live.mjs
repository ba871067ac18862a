// The client on a stage that runs: node live.mjs ADDRESS CLIENT, the latter compiled. Prints what it saw as JSON.
import WebSocket from "ws";

const [address, compiled] = process.argv.slice(2);
const { Client, Refused } = await import(compiled);

const sockets = [];
const states = [];
const open = (at, protocol) => {
  sockets.push(new WebSocket(at, protocol));
  return sockets.at(-1);
};
const client = new Client(address, { socket: open, onState: (state) => states.push(state) }).connect();

/** The next `count` messages of a topic that are of use. */
async function take(topic, count, choice, isOfUse = () => true) {
  const taken = [];
  for await (const message of client.frames(topic, choice)) if (isOfUse(message) && taken.push(message) === count) return taken;
}

const wand = { sensors: ["wand"], fields: ["position_m"], drop: "queue" };
const frames = await take("sensors", 5, wand, ({ sensors }) => sensors[0].state === "ok");
const age_s = (Date.now() - client.captureTime(frames.at(-1).t_s)) / 1000;
const refused = await client.request({ type: "job.cancel", job: 999 }).catch((error) => error);

// The connection breaks, and somebody else marks a moment meanwhile.
const marked = take("marks", 2);
await client.request({ type: "mark", label: "before" });
const other = new Client(address, { socket: open }).connect();
const lost = client.request({ type: "library.list" }).catch((error) => error);
sockets[0].terminate();
await other.request({ type: "mark", label: "meanwhile" });
other.close();
const marks = await marked;
const [again] = await take("sensors", 1);

// While a connection closes nothing is sent over it: a browser complains of that on its console.
const before = sockets.at(-1);
const silenced = [];
before.send = (text) => silenced.push(text);
before.close();
const back = new Promise((resolve) => client.on("hello", resolve));
const closing = await client.request({ type: "library.list" }).catch((error) => error);
await back;

const stream = client.frames("sensors");
client.close();
const { done } = await stream.next();
const closed = await client.request({ type: "library.list" }).catch((error) => error);

console.log(JSON.stringify({
  frames, age_s, states, done,
  refused: [refused instanceof Refused, refused.code],
  lost: (await lost).code,
  marks: marks.map(({ label }) => label),
  after: again.t_s,
  closing: [closing.code, silenced.length],
  closed: closed.code,
}));
