// A take in the place of a stage: node mock.mjs CLIENT, compiled. Prints what a client saw of it as JSON.
const { Client, Refused, mockStage } = await import(process.argv[2]);

const sensors = (t_s) => ({ type: "sensors", seq: 9, dropped: 3, t_s, sensors: ["left", "wand"].map((name) => ({ name, device: "flock", state: "ok", position_m: [t_s, 0, 0] })) });
const mark = (t_s, event_id) => ({ type: "marks", seq: 0, dropped: 0, t_s, event_id, t_valid_s: t_s, label: "here" });
const said = [sensors(290), mark(290.1, 1), ...Array.from({ length: 99 }, (_, n) => sensors(290.11 + 0.01 * n)), mark(291.2, 2)];
const lines = said.map((message) => JSON.stringify(message)).join("\n\n");

/** Everything of it that a client wants, at a speed. */
async function played(speed) {
  const [frames, marks, states] = [[], [], []];
  const began = performance.now();
  const [hello, refused] = await new Promise((resolve) => {
    const client = new Client("ws://mock", {
      socket: mockStage(lines, { speed, onEnd: () => (client.close(), resolve([hello, refused])) }),
      onState: (state) => states.push(state),
    });
    let hello, refused;
    client.on("hello", (message) => (hello = message));
    client.on("marks", ({ event_id }) => marks.push(event_id));
    client.on("sensors", (frame) => frames.push(frame));
    client.connect();
    client.request({ type: "mark", label: "no" }).catch((error) => (refused = [error instanceof Refused, error.code]));
    client.subscribe({ topics: ["sensors"], sensors: ["wand"], max_rate_hz: 20 });
    client.subscribe({ topics: ["marks"] });
  });
  return { topics: hello.topics, stage: hello.sensors, refused, states, marks, seq: frames.map(({ seq }) => seq), first: frames[0], ms: performance.now() - began };
}

const why = ["", "1", "{}", "roses are red"].map((line) => {
  try {
    mockStage(`${lines}\n${line}`);
    return null;
  } catch (error) {
    return error.message;
  }
});
console.log(JSON.stringify({ fast: await played(Infinity), timed: await played(4), why }));
