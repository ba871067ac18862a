// The small live page: subscribes to `sensors` (a few times per second) and `status`, reconnects by itself, and greys
// out numbers that are old.
"use strict";

const STALE_MS = 1500;
const RETRY_MS = [500, 1000, 2000, 5000];
const STATE_CLASS = {
  ok: "good", repaired: "good", streaming: "good",
  suspect: "warn", late: "warn", extrapolated: "warn", connecting: "warn", silent: "warn",
  missing: "bad", stuck: "bad", failed: "bad",
};

const byId = (id) => document.getElementById(id);
const lost = new Map();
let attempts = 0;
let lastFrame = 0;
let streaming = false;

function connect() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  const token = new URLSearchParams(location.search).get("token");
  const query = token === null ? "" : `?token=${encodeURIComponent(token)}`;
  const socket = new WebSocket(`${scheme}//${location.host}/ws${query}`, "posed.v1");
  socket.onopen = () => {
    attempts = 0;
    socket.send(JSON.stringify({ type: "subscribe", id: 1, topics: ["sensors"], max_rate_hz: 15 }));
    socket.send(JSON.stringify({ type: "subscribe", id: 2, topics: ["status", "exercise"] }));
  };
  socket.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    const show = { hello: showHello, sensors: showSensors, status: showStatus, exercise: showExercise }[message.type];
    if (show) show(message);
  };
  socket.onclose = ({ code, reason }) => {
    streaming = false;
    const wait = RETRY_MS[Math.min(attempts++, RETRY_MS.length - 1)];
    const why = reason || (code === 1006 ? "no connection; a wrong or missing ?token= looks the same" : `closed (${code})`);
    say(`${why}. Trying again.`, "bad");
    setTimeout(connect, wait);
  };
}

function say(text, kind) {
  const link = byId("link");
  if (link.textContent !== text) link.textContent = text;
  link.className = kind;
}

function showHello({ stage, version }) {
  document.title = `${stage} – posed`;
  byId("stage").textContent = stage;
  say(`connected, posed ${version}`, "good");
}

function showSensors({ sensors, t_s, dropped }) {
  lastFrame = performance.now();
  streaming = true;
  document.body.classList.remove("stale");
  rows(byId("sensors"), sensors.map((s) => [
    [s.name],
    [s.state, `word ${STATE_CLASS[s.state] ?? ""}`],
    ...numbers(s.position_m, 3, 4),
    ...numbers(s.orientation_wxyz, 4, 4),
    [s.sigma_m === null ? "–" : (s.sigma_m * 1000).toFixed(2)],
    [String(lost.get(s.name) ?? "–")],
  ]));
  byId("frame").textContent = `stage time ${t_s.toFixed(2)} s` + (dropped ? `, ${dropped} messages dropped for this page` : "");
}

function showStatus({ devices, sensors, problems }) {
  for (const s of sensors) lost.set(s.name, s.lost);
  rows(byId("devices"), devices.map((d) => [
    [d.name],
    [d.driver, "word"],
    [d.port, "word"],
    [d.reason ? `${d.state}: ${d.reason}` : d.state, `word reason ${STATE_CLASS[d.state] ?? ""}`],
    [d.rate_hz === null ? "–" : d.rate_hz.toFixed(2)],
    [String(d.records)], [String(d.rejected)], [String(d.bytes_skipped)],
  ]));
  const list = byId("problems");
  list.hidden = problems.length === 0;
  list.replaceChildren(...problems.map(({ message }) => {
    const item = document.createElement("li");
    item.textContent = message;
    return item;
  }));
}

// One line per subject and exercise: the count, and what was said last.
const exercises = new Map();

function showExercise({ event, subject, exercise, count, reason, sentence, state }) {
  if (event === "state") {
    for (const key of exercises.keys()) if (key.startsWith(`${subject}: `)) exercises.delete(key);
    for (const one of state.exercises) exercises.set(`${subject}: ${one.exercise}`, { count: one.count, said: "" });
  } else if (event === "counted" || event === "rejected") {
    const said = event === "counted" ? sentence ?? "good" : `not counted: ${reason}`;
    exercises.set(`${subject}: ${exercise}`, { count, said });
  } else {
    return;
  }
  byId("exercise").hidden = exercises.size === 0;
  rows(byId("exercises"), [...exercises].map(([name, { count: n, said }]) => [[name], [String(n)], [said, "word"]]));
}

function numbers(values, count, digits) {
  return Array.from({ length: count }, (_, i) => [values ? values[i].toFixed(digits) : "–"]);
}

// Cells are kept and only their text changes: selection and screen readers stay where they are.
function rows(body, table) {
  while (body.rows.length > table.length) body.deleteRow(-1);
  table.forEach((cells, r) => {
    const row = body.rows[r] ?? body.insertRow();
    cells.forEach(([text, kind = ""], c) => {
      const cell = row.cells[c] ?? row.insertCell();
      if (cell.textContent !== text) cell.textContent = text;
      if (cell.className !== kind) cell.className = kind;
    });
  });
}

setInterval(() => {
  const age = performance.now() - lastFrame;
  if (age > STALE_MS) {
    document.body.classList.add("stale");
    if (streaming) say(`no frame for ${(age / 1000).toFixed(0)} s`, "warn");
  } else if (streaming) {
    say("live", "good");
  }
}, 250);

connect();
