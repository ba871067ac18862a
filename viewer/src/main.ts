// Starts the page: one link, one model, one view at a time.

import "./theme.css";
import { el, setText } from "./dom";
import { Link, type LinkState } from "./link";
import { Model, PERSON } from "./model";
import { Pace } from "./pace";
import type { View } from "./view";
import { AnalysisView } from "./views/analysis";
import { HealthView } from "./views/health";
import { PatientView } from "./views/patient";
import { ReplayView } from "./views/replay";
import { CalibrateRecordView } from "./views/calibrate-record";
import { SessionsView } from "./views/sessions";
import { StageView } from "./views/stage";
import { TrainerView } from "./views/trainer";

/** Data older than this are shown as old. */
const STALE_MS = 1500;

const byId = (id: string) => document.getElementById(id)!;
const model = new Model();
let linkState: LinkState = "connecting";
let linkWords = "connecting…";
const link = new Link(
  (message) => model.take(message),
  (state, why) => {
    linkState = state;
    linkWords = why;
    byId("token").hidden = state !== "unauthorised";
  },
);

// At once: the stage answers while the views are being made.
link.connect();
const pace = new Pace((rate_hz) => link.useRate(rate_hz));
const context = { model, link };
const views: View[] = [
  new StageView(context),
  new TrainerView(context),
  new PatientView(context),
  new SessionsView(context),
  new HealthView(context),
  new CalibrateRecordView(context),
  new AnalysisView(context),
  new ReplayView(context),
];
let shown: View | null = null;
let drawn = -1;

function show(view: View): void {
  if (view === shown) return;
  shown = view;
  drawn = -1;
  for (const each of views) {
    each.element.hidden = each !== view;
    const tab = byId(`tab-${each.id}`);
    tab.setAttribute("aria-selected", String(each === view));
    tab.tabIndex = each === view ? 0 : -1;
  }
  view.shown?.();
}

/** Shows a view, and says so in the address; a page that was opened without one in it keeps the focus at its top. */
function choose(view: View): void {
  show(view);
  history.replaceState(null, "", `#${view.id}`);
}

function addTabs(): void {
  for (const view of views) {
    const tab = el("button", { id: `tab-${view.id}`, role: "tab", "aria-controls": view.id, onclick: () => choose(view) }, view.title);
    byId("tabs").append(tab);
    view.element.id = view.id;
    view.element.setAttribute("role", "tabpanel");
    view.element.setAttribute("aria-labelledby", tab.id);
    byId("views").append(view.element);
  }
  byId("tabs").addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (step === undefined || !shown) return;
    const next = views[(views.indexOf(shown) + step + views.length) % views.length]!;
    choose(next);
    byId(`tab-${next.id}`).focus();
  });
}

/** Whom all views but the stage's are about: the page begins anew with somebody else, at an address of its own. */
function introduce(names: string[]): void {
  byId("person").hidden = !model.several;
  byId("person-choice").replaceChildren(...names.map((name) => el("option", { value: name, selected: name === model.person }, name)));
}

/** The line at the top: live, old, or why there is no connection. */
function drawLink(now_ms: number): void {
  const age_ms = now_ms - model.lastFrameMs;
  const known = Number.isFinite(model.lastFrameMs);
  const old = known && age_ms > STALE_MS;
  document.body.classList.toggle("stale", old || (known && linkState !== "open"));
  const replay = model.status?.replay;
  const [words, kind] =
    linkState !== "open" ? [linkWords, "bad"]
    : replay && (replay.speed === 0 || replay.ended !== null) ? [replay.ended ?? "paused", "good"]
    : old ? [`no frame for ${(age_ms / 1000).toFixed(0)} s`, "care"]
    : known ? ["live", "good"]
    : [linkWords, "care"];
  setText(byId("link"), words);
  byId("link").className = kind;
}

function draw(now_ms: number): void {
  const fresh = model.version !== drawn;
  drawn = model.version;
  pace.frame(now_ms);
  drawLink(now_ms);
  shown?.draw(now_ms, fresh);
  requestAnimationFrame(draw);
}

model.listen((message) => {
  if (message.type === "hello") {
    document.title = `${message.stage} – posed`;
    setText(byId("stage"), message.stage);
    introduce(message.bodies.map(({ name }) => name));
  } else if (message.type === "status") {
    const list = byId("problems");
    list.hidden = message.problems.length === 0;
    const said = message.problems.map((problem) => problem.message);
    if (list.dataset["said"] !== said.join("\n")) {
      list.dataset["said"] = said.join("\n");
      list.replaceChildren(...said.map((text) => el("li", {}, text)));
    }
  }
});
byId("token").addEventListener("submit", (event) => {
  event.preventDefault();
  const token = new FormData(event.target as HTMLFormElement).get("token");
  if (typeof token === "string") link.useToken(token);
});

byId("person-choice").addEventListener("change", ({ target }) => {
  const address = new URL(location.href);
  address.searchParams.set(PERSON, (target as HTMLSelectElement).value);
  location.assign(address);
});

addTabs();
show(views.find((view) => `#${view.id}` === location.hash) ?? views[0]!);
requestAnimationFrame(draw);
