// Segments of the motion as bands over time: what is confirmed, and what only seems to be. Part of Analysis.

import { acting, el, setText } from "../dom";
import type { Context } from "../view";
import type { MotionSegmentMessage } from "../protocol";

/** Time that the bands show, s. */
const SPAN_S = 60;
/** So many labels are distinguished by colour; all by their names. */
const COLOURS = 8;
/** Frames of 1/24 s that a network may see of what comes after: the fewer, the sooner a name is sure. */
const LOOK_AHEADS: [number, string][] = [[40, "1.7 s ahead"], [12, "0.5 s ahead"], [0, "nothing ahead"]];

export class SegmentsPanel {
  readonly element: HTMLElement;
  private readonly now = el("p", { id: "segment-now" });
  private readonly confirmed = el("div", { id: "segments-confirmed", class: "band" });
  private readonly provisional = el("div", { id: "segments-provisional", class: "band" });
  private readonly known: HTMLElement;
  private readonly train = el("button", { id: "segments-train" }, "Learn");
  private readonly sure = el("select", { id: "segments-sure" },
    ...LOOK_AHEADS.map(([frames, words]) => el("option", { value: frames }, words)));
  private readonly says = el("p", { id: "segments-says", class: "says", role: "alert" });
  private readonly labels: string[] = [];

  constructor(private readonly context: Context) {
    const row = (title: string, band: HTMLElement) => el("div", { class: "band-row" }, el("span", { class: "quiet" }, title), band);
    this.known = el("div", { hidden: true }, this.now, row("sure", this.confirmed), row("provisional", this.provisional));
    const form = el("form", { class: "row" },
      el("label", {}, "Learn from the recordings with labels beside them (TAKE.eaf or TAKE.labels.csv) a network that sees ", this.sure), this.train);
    form.addEventListener("submit", acting(this.says, () =>
      context.link.request({ type: "segments.train", look_ahead: Number(this.sure.value) })));
    this.element = el("section", { "aria-labelledby": "segments-title" },
      el("h2", { id: "segments-title" }, `Segments of the last ${SPAN_S} s`), this.known, form, this.says);
  }

  draw(): void {
    const { segments, sensors, hello, status, jobs } = this.context.model;
    const last = segments.at(-1);
    const job = jobs?.jobs.filter(({ kind }) => kind === "segments.train").at(-1);
    this.train.disabled = hello?.role !== "operate" || !!status?.replay || job?.state === "running";
    if (job?.message) setText(this.says, job.message);
    this.says.className = `says ${job?.state === "done" ? "good" : ""}`;
    this.known.hidden = last === undefined;
    if (!last || !sensors) return;
    const end = sensors.t_s;
    const sure = segments.filter(({ event }) => event === "confirmed");
    const open = segments.filter(({ event }) => event === "provisional");
    // Until a segment's time to be confirmed is over, nothing is sure.
    this.fill(this.confirmed, sure, end, end - last.delay_s);
    this.fill(this.provisional, open, end, end);
    setText(this.now, last.event === "confirmed"
      ? `Now: ${last.label}.`
      : `Now, it seems: ${last.label}; sure at the latest ${last.delay_s.toFixed(1)} s after its beginning.`);
  }

  /** Draws segments, each up to the next one; the last up to `until`. */
  private fill(band: HTMLElement, segments: MotionSegmentMessage[], end: number, until: number): void {
    const from = end - SPAN_S;
    const spans = segments.flatMap(({ label, t_valid_s }, at) => {
      const [a, b] = [Math.max(t_valid_s, from), Math.min(segments[at + 1]?.t_valid_s ?? until, until)];
      if (b <= a) return [];
      const span = el("span", { class: `segment c${this.colour(label)}`, title: `${label} from ${t_valid_s.toFixed(1)} s` }, label);
      span.style.left = `${(100 * (a - from)) / SPAN_S}%`;
      span.style.width = `${(100 * (b - a)) / SPAN_S}%`;
      return [span];
    });
    band.replaceChildren(...spans);
  }

  private colour(label: string): number {
    let at = this.labels.indexOf(label);
    if (at < 0) at = this.labels.push(label) - 1;
    return at % COLOURS;
  }
}
