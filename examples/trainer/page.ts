// The page: shows a session's state, and turns buttons into requests. Replace this file to make another front end.
import { Client } from "../../clients/typescript/src/client";
import { Session, type State } from "./session";

const element = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;
const make = (tag: string): HTMLElement => document.createElement(tag);
const number = (id: string): number => element<HTMLInputElement>(id).valueAsNumber;

// The daemon's address and token come from the page's own: ?daemon=HOST:PORT&token=SECRET&subject=NAME
const options = new URLSearchParams(location.search);
const daemon = options.get("daemon") ?? "127.0.0.1:8787";
const client = new Client(`http://${daemon}/`, { token: options.get("token"), onState: (state) => session.linked(state) });
const session = new Session(client, show, options.get("subject") ?? "default");
client.connect();

element("teach").onsubmit = (event) => {
  event.preventDefault();
  session.teach(element<HTMLInputElement>("name").value, number("teach-repetitions"));
};
element("cancel").onclick = () => session.cancelTeaching();
element("select").onsubmit = (event) => {
  event.preventDefault();
  session.select(element<HTMLSelectElement>("known").value, number("repetitions"), number("sets"), number("rest"));
};
element("reset").onclick = () => session.ask({ type: "exercise.reset", subject: session.subject });

function show(state: State): void {
  const lost = `no connection to ${daemon}; trying again`;
  text("link", { connecting: "connecting…", open: `connected to ${state.stage}`, lost, unauthorised: "the daemon asks for a token: ?token=" }[state.link]);
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
  const { repetitions, sets, exercises } = state.selected ?? { repetitions: null, sets: null, exercises: [] };
  element("exercises").replaceChildren(...exercises.map((one) => {
    const [row, title, bars] = [make("section"), make("h2"), make("div")];
    const rest = one.rest_until_s === null ? "" : ", rest";
    title.textContent = `${one.exercise}: ${one.set_count}, set ${one.set}${sets === null ? "" : ` of ${sets}`}${one.done ? ", done" : rest}`;
    bars.className = "bars";
    // One bar per repetition of the set, and one more while it is not certain yet.
    const likely = state.provisional.includes(one.exercise);
    const bar = (_: unknown, i: number) => {
      const bar = make("span");
      bar.className = i < one.set_count ? "full" : likely && i === one.set_count ? "likely" : "";
      return bar;
    };
    bars.append(...Array.from({ length: Math.max(repetitions ?? 0, one.set_count + Number(likely)) }, bar));
    row.append(title, bars);
    return row;
  }));
}

function text(id: string, value: string): void {
  if (element(id).textContent !== value) element(id).textContent = value;
}
