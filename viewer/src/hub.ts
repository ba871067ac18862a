// The page of a hub: every stage with how it is, and the way to its own page.

import "./theme.css";
import { el, num, setText } from "./dom";
import { Link } from "./link";
import type { StageEntry, Stages } from "./protocol";

const byId = (id: string) => document.getElementById(id)!;
const table = byId("stages") as HTMLTableElement;

const link = new Link(
  (message) => {
    if (message.type === "stages") show(message);
    else if (message.type === "hello") setText(byId("stage"), message.stage);
  },
  (state, why) => {
    setText(byId("link"), why);
    byId("token").hidden = state !== "unauthorised";
    document.body.classList.toggle("stale", state !== "open");
  },
);
byId("token").addEventListener("submit", (event) => {
  event.preventDefault();
  link.useToken(String(new FormData(event.target as HTMLFormElement).get("token")));
});
link.connect();

function show({ t_s, stages }: Stages): void {
  byId("none").hidden = stages.length > 0;
  table.hidden = stages.length === 0;
  const body = table.tBodies[0]!;
  while (body.rows.length > stages.length) body.deleteRow(-1);
  stages.forEach((entry, index) => fill(body.rows[index] ?? body.insertRow(), entry, t_s));
}

function fill(row: HTMLTableRowElement, entry: StageEntry, now_s: number): void {
  const first = row.cells[0] ?? row.insertCell();
  const anchor = first.querySelector("a") ?? first.appendChild(el("a", {}));
  // The token goes along in this tab's own storage.
  const target = `${encodeURIComponent(entry.id)}/`;
  if (anchor.getAttribute("href") !== target) anchor.setAttribute("href", target);
  setText(anchor, entry.name === "" ? entry.id : entry.name);
  const wrong = entry.problems.map((problem) => problem.message);
  if (entry.events_lost > 0) wrong.unshift(`${entry.events_lost} events are lost`);
  const cells: [text: string, kind: string][] = [
    presence(entry, now_s),
    [`${entry.streaming} of ${entry.devices}`, entry.streaming < entry.devices ? "care" : ""],
    [num(entry.frames_hz, 1), ""],
    [clock(entry), ""],
    [wrong.join(" · "), "reason word"],
  ];
  cells.forEach(([text, kind], index) => {
    const cell = row.cells[index + 1] ?? row.insertCell();
    setText(cell, text);
    if (cell.className !== kind) cell.className = kind;
  });
}

function presence({ state, since_s, vanished, fused }: StageEntry, now_s: number): [string, string] {
  const lasts = duration(now_s - since_s);
  if (state === "gone") return [`vanished ${lasts} ago`, "bad"];
  if (state === "joining") return ["joining", "care"];
  const times = vanished === 0 ? "" : `, had vanished ${vanished}×`;
  return [`there for ${lasts}${times}${fused ? ", fused here" : ""}`, "good"];
}

function clock({ clock }: StageEntry): string {
  if (!clock) return "–";
  return `${num(clock.offset_s, 4)} s ± ${num(clock.uncertainty_s * 1e3, 2)} ms`;
}

function duration(s: number): string {
  if (s < 120) return `${s.toFixed(0)} s`;
  return s < 7200 ? `${(s / 60).toFixed(0)} min` : `${(s / 3600).toFixed(1)} h`;
}
