// The page: shows a session's state, and turns buttons into requests. Replace this file to make another front end.
import { Session } from "./session.ts";
import type { Socket, State } from "./session.ts";

const element = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;
const number = (id: string): number => element<HTMLInputElement>(id).valueAsNumber;

// The daemon's address and token come from the page's own: ?daemon=HOST:PORT&token=SECRET&subject=NAME
const options = new URLSearchParams(location.search);
const daemon = options.get("daemon") ?? "127.0.0.1:8787";
const token = options.get("token");
const address = `ws://${daemon}/ws${token === null ? "" : `?token=${encodeURIComponent(token)}`}`;

const session = new Session(
  () => new WebSocket(address, "posed.v1") as Socket,
  show,
  options.get("subject") ?? "default",
);

element("teach").onsubmit = (event) => {
  event.preventDefault();
  session.teach(element<HTMLInputElement>("name").value, number("teach-repetitions"));
};
element("cancel").onclick = () => session.cancelTeaching();
element("select").onsubmit = (event) => {
  event.preventDefault();
  session.select(element<HTMLSelectElement>("known").value, number("repetitions"), number("sets"), number("rest"));
};
element("reset").onclick = () => session.reset();

function show(state: State): void {
  text("link", { connecting: "connecting…", live: `connected to ${state.stage}`, lost: `no connection to ${daemon}; trying again` }[state.link]);
  text("error", state.error ?? "");
  text("teaching", state.teaching?.text ?? "");
  element("cancel").hidden = state.teaching === null || state.teaching.over;
  text("hint", state.hint ?? "");
  text("feedback", state.feedback?.text ?? "");
  element("feedback").className = state.feedback?.good === false ? "bad" : "good";

  const known = element<HTMLSelectElement>("known");
  if (known.options.length !== state.known.length) {
    known.replaceChildren(...state.known.map((name) => new Option(name)));
  }
  element("exercises").replaceChildren(...state.exercises.map((exercise) => {
    const row = document.createElement("section");
    const title = document.createElement("h2");
    const ofSets = state.sets === null ? "" : ` of ${state.sets}`;
    const rest = exercise.restUntilS === null ? "" : ", rest";
    title.textContent = `${exercise.name}: ${exercise.setCount}, set ${exercise.set}${ofSets}${exercise.done ? ", done" : rest}`;
    const bars = document.createElement("div");
    bars.className = "bars";
    // One bar per repetition of the set, and one more while it is not certain yet.
    const bar = (full: boolean, likely: boolean) => {
      const one = document.createElement("span");
      one.className = full ? "full" : likely ? "likely" : "";
      return one;
    };
    const total = Math.max(state.repetitions ?? 0, exercise.setCount + Number(exercise.provisional));
    bars.append(...Array.from({ length: total }, (_, i) =>
      bar(i < exercise.setCount, exercise.provisional && i === exercise.setCount)));
    row.append(title, bars);
    return row;
  }));
}

function text(id: string, value: string): void {
  const target = element(id);
  if (target.textContent !== value) target.textContent = value;
}
