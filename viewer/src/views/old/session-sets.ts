// One session in its sets: each repetition beside its lesson, and the count put right where the daemon was wrong. Part of Sessions.

import uPlot from "uplot";
import { acting, el, num, setText } from "../dom";
import { ownLanguage, spokenIn } from "../feedback";
import type { Context } from "../view";
import { axisLook } from "./joints";

const HEIGHT = 240;

/** As `posed session show --json` has them; docs/sessions.md. */
interface TrainedRepetition {
  number: number | null;
  t_start_s: number;
  t_end_s: number;
  reason?: string;
  score?: { total: number };
  sentence?: string;
  sentence_de?: string;
  joints: { name: string; course_deg: number[] }[];
}
interface TrainedSet {
  set: number;
  lesson: { exercise: string; joints: { name: string; demonstration_deg: number[] }[] };
  planned?: number;
  corrected?: number;
  repetitions: TrainedRepetition[];
}

export class SessionSets {
  readonly element: HTMLElement;
  private readonly title = el("h2", { id: "sets-title" });
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly sets = el("tbody", { id: "session-sets" });
  private readonly summary = el("p", { id: "repetition-summary" });
  private readonly joint = el("select", { id: "repetition-joint", "aria-label": "joint" });
  private readonly holder = el("section", { class: "curve", "aria-label": "The repetition and its lesson" });
  private readonly beside = el("div", { id: "repetition", hidden: true }, this.summary, el("label", {}, "Joint ", this.joint), this.holder);
  private session = 0;
  private plot: uPlot | null = null;
  private shown: { set: TrainedSet; repetition: TrainedRepetition } | null = null;

  constructor(private readonly context: Context) {
    const head = ["set", "exercise", "planned", "counted", "really done", "repetitions"].map((text) => el("th", { scope: "col" }, text));
    this.joint.addEventListener("change", () => this.draw());
    this.element = el("section", { "aria-labelledby": "sets-title", hidden: true }, this.title, this.says,
      el("div", { class: "scroll", tabindex: 0, role: "region", "aria-labelledby": "sets-title" },
        el("table", {}, el("thead", {}, el("tr", {}, ...head)), this.sets)),
      this.beside);
  }

  /** Asks for a session, and shows its sets. */
  async show(session: number): Promise<void> {
    const { shown } = await this.context.link.request({ type: "session.show", session });
    const { person, training } = shown as { person: string; training: TrainedSet[] };
    this.session = session;
    setText(this.title, `Session ${session} of ${person}`);
    this.sets.replaceChildren(...training.map((set) => this.row(set)));
    this.element.hidden = false;
    this.beside.hidden = true;
  }

  hide(): void {
    this.element.hidden = true;
  }

  private row(set: TrainedSet): HTMLElement {
    const counted = set.repetitions.filter(({ reason }) => reason === undefined).length;
    const done = el("input", { type: "number", min: 0, max: 1000, required: true, value: set.corrected ?? counted, "aria-label": `repetitions really done in set ${set.set}` });
    const keep = el("form", { class: "row" }, done, el("button", {}, "Keep"),
      el("span", { class: "quiet" }, set.corrected === undefined ? "" : "put right"));
    keep.addEventListener("submit", acting(this.says, async () => {
      await this.context.link.request({ type: "session.correct", session: this.session, set: set.set, counted: Number(done.value) });
      await this.show(this.session);
    }));
    const repetitions = set.repetitions.map((repetition) => {
      const { number, reason, score } = repetition;
      const words = reason === undefined ? `${number ?? "?"}${score ? ` (${Math.round(score.total)})` : ""}` : "not counted";
      return el("button", { type: "button", class: reason === undefined ? "" : "quiet", onclick: () => this.look(set, repetition) }, words);
    });
    const cells = [String(set.set), set.lesson.exercise, set.planned === undefined ? "" : String(set.planned), String(counted)];
    return el("tr", {}, ...cells.map((cell) => el("td", {}, cell)), el("td", {}, keep), el("td", {}, ...repetitions));
  }

  private look(set: TrainedSet, repetition: TrainedRepetition): void {
    const { number, reason, score, t_start_s, t_end_s } = repetition;
    const { sentence = null, sentence_de = null } = repetition;
    this.shown = { set, repetition };
    const what = reason === undefined ? `Repetition ${number ?? "?"}` : "A movement";
    const points = score ? `, ${Math.round(score.total)} of 100` : "";
    const said = spokenIn(ownLanguage(), { sentence, sentence_de });
    setText(this.summary, `${what} of set ${set.set}, ${num(t_end_s - t_start_s, 1)} s${points}${said === null ? "" : `: ${said}`}.`);
    const range = (name: string) => {
      const course = set.lesson.joints.find((joint) => joint.name === name)?.demonstration_deg ?? [0];
      return Math.max(...course) - Math.min(...course);
    };
    const names = repetition.joints.map(({ name }) => name).sort((a, b) => range(b) - range(a));
    const chosen = names.includes(this.joint.value) ? this.joint.value : names[0];
    this.joint.replaceChildren(...names.map((name) => el("option", { value: name, selected: name === chosen }, jointWords(name))));
    this.beside.hidden = false;
    this.draw();
  }

  /** The chosen joint over the share of the repetition. */
  private draw(): void {
    if (this.shown === null) return;
    const { set, repetition } = this.shown;
    const of = ({ name }: { name: string }) => name === this.joint.value;
    const taught = set.lesson.joints.find(of)?.demonstration_deg ?? [];
    const own = repetition.joints.find(of)?.course_deg ?? [];
    if (!this.plot) {
      const axis = axisLook();
      this.plot = new uPlot({ width: Math.max(this.holder.clientWidth, 400), height: HEIGHT, scales: { x: { time: false } },
        axes: [axis, { ...axis, size: 60 }],
        series: [{ label: "% of it" }, { label: "taught, °", stroke: "#2a9d8f", width: 4 }, { label: "done, °", stroke: "#3469c9", width: 2 }] },
      [[], [], []], this.holder);
    }
    const length = Math.max(taught.length, own.length);
    const share = Array.from({ length }, (_, point) => Math.round((100 * point) / Math.max(1, length - 1)));
    const padded = (values: number[]) => share.map((_, point) => values[point] ?? null);
    this.plot.setData([share, padded(taught), padded(own)]);
  }
}

/** `elbow_r_flexion_deg` as people say it. */
function jointWords(name: string): string {
  return name.replace(/_deg$|_rad$/, "").replace(/_r(?=_|$)/, " right").replace(/_l(?=_|$)/, " left").replaceAll("_", " ");
}
