// Calibration of the field, under *Calibrate & record*: move the pole, see what is missing, solve, look at the figures, use the map.

import { acting, el, num, setText } from "../dom";
import type { FieldEventMessage, Job } from "../protocol";
import type { Context } from "../view";

type Anchor = { name: string; sensor: string; t_start: number; t_end: number; position_m: [number, number, number] };
/** What a job of `field.finish` reports. */
type Report = {
  accepted: boolean; model: string; reasons: { text: string }[]; warnings: string[];
  raw_m: number | null; residual_m: number | null; heldout_m: number | null; anchors_m: number | null;
};
type MapMessage = Extract<FieldEventMessage, { event: "map_swapped" }>;
type Progress = Extract<FieldEventMessage, { event: "calibrating" }>["progress"];

/** A sensor on an anchor must have stood there for so long, s. */
const DWELL_S = 1;

const mm = (metres: number | null | undefined) => num(metres == null ? null : metres * 1000, 2);

export class Calibration {
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly inUse = el("p", { id: "field-map", role: "status" });
  private readonly trouble = el("p", { id: "field-trouble", class: "care", role: "status" });
  private readonly sensors = el("input", { id: "field-sensors", required: true, size: 40 });
  private readonly spacing = el("input", { id: "field-spacing", type: "number", min: 0.01, max: 2, step: "any", required: true, placeholder: "measured with a rule" });
  private readonly begin = el("button", { id: "field-start", class: "primary" }, "Begin");
  private readonly run: HTMLElement;
  private readonly cells = el("progress", { id: "field-cells", max: 1, "aria-label": "share of the places" });
  private readonly directions = el("progress", { id: "field-directions", max: 1, "aria-label": "share of the directions" });
  private readonly figures = el("p", { id: "field-progress", class: "quiet" });
  private readonly hint = el("p", { id: "field-hint", class: "sentence", role: "status" });
  private readonly anchorSensor = el("select", { id: "anchor-sensor", "aria-label": "sensor on the point" });
  private readonly anchorPlace = [0, 1, 2].map((axis) =>
    el("input", { type: "number", step: "any", required: true, placeholder: "xyz"[axis]!, id: `anchor-${"xyz"[axis]}`, "aria-label": `${"xyz"[axis]} of the point, m` }));
  private readonly anchorList = el("ul", { id: "anchors", "aria-label": "Surveyed points" });
  private readonly finish = el("button", { id: "field-finish", class: "primary" }, "Solve");
  private readonly outcome = el("section", { id: "field-outcome", hidden: true });
  private readonly verdict = el("p", { id: "field-verdict" });
  private readonly table = el("tbody", { id: "field-figures" });
  private readonly remarks = el("ul", { id: "field-remarks" });
  private readonly accept = el("button", { id: "field-accept", class: "primary" }, "Use this map");
  private readonly rollback = el("button", { id: "field-rollback" }, "Back to the map before");
  private anchors: Anchor[] = [];
  private progress: Progress | null = null;
  private map: MapMessage | null = null;
  private readonly disturbed = new Map<string, string>();
  private drifted = "";
  private job: Job | null = null;
  /** Number of the job whose map was taken, so that it is not offered twice. */
  private taken = 0;
  private operated = false;
  private changed = true;

  constructor(private readonly context: Context) {
    const { link, model } = context;
    const form = el("form", { class: "row" },
      el("label", {}, "Sensors along the pole ", this.sensors), el("label", {}, "Distance of neighbours, m ", this.spacing), this.begin);
    form.addEventListener("submit", acting(this.says, () => this.start()));
    const anchor = el("form", { class: "row" },
      el("span", {}, "Surveyed point, transmitter frame, m:"), this.anchorSensor, ...this.anchorPlace,
      el("button", { id: "anchor-add" }, `It stands there, and has for ${DWELL_S} s`));
    anchor.addEventListener("submit", acting(this.says, async () => this.addAnchor()));
    this.finish.addEventListener("click", acting(this.says, () => link.request({ type: "field.finish", anchors: this.anchors })));
    this.run = el("section", { id: "field-run", hidden: true },
      this.hint,
      el("div", { class: "row" }, el("label", {}, "places ", this.cells), el("label", {}, "directions ", this.directions)),
      this.figures, anchor, this.anchorList, this.finish);
    this.accept.addEventListener("click", acting(this.says, async () => {
      const job = this.job?.job ?? 0;
      await link.request({ type: "field.accept" });
      this.taken = job;
      this.changed = true;
    }));
    this.rollback.addEventListener("click", acting(this.says, () => link.request({ type: "field.rollback" })));
    const head = el("tr", {}, ...["", "mm"].map((text) => el("th", { scope: "col" }, text)));
    this.outcome.append(this.verdict, el("table", {}, el("thead", {}, head), this.table), this.remarks, this.accept);
    this.element = el("section", { "aria-label": "Field" },
      el("h2", {}, "Field"), this.inUse, this.trouble, this.rollback, this.says, form, this.run, this.outcome);
    model.listen((message) => {
      if (message.type === "hello") this.greet();
      else if (message.type === "field") this.take(message);
      else if (message.type === "jobs") this.look(message.jobs);
    });
  }

  shown(): void {
    this.changed = true;
  }

  draw(): void {
    const { hello, status } = this.context.model;
    const operates = hello?.role === "operate" && !status?.replay;
    if (!this.changed && operates === this.operated) return;
    [this.changed, this.operated] = [false, operates];
    this.drawMap(operates);
    this.drawRun(operates);
    this.drawOutcome(operates);
  }

  private greet(): void {
    // Another daemon, or the same one anew: what holds comes again.
    [this.progress, this.map, this.job, this.drifted] = [null, null, null, ""];
    this.disturbed.clear();
    this.changed = true;
    if (this.sensors.value !== "") return;
    const names = this.context.model.hello?.sensors.filter(({ magnetic }) => magnetic).map(({ name }) => name) ?? [];
    const pole = names.filter((name) => /pole/i.test(name));
    this.sensors.value = (pole.length >= 3 ? pole : names).join(", ");
  }

  private take(message: FieldEventMessage): void {
    this.changed = true;
    switch (message.event) {
      case "map_swapped":
        this.map = message;
        this.disturbed.clear();
        this.drifted = "";
        break;
      case "disturbed": {
        const key = `${message.cause} ${message.sensors.join(" and ")}`;
        const cause = { reference_sensor: "seems to move", rigid_pair: "seem to move apart", hum: "hears the mains hum" }[message.cause];
        if (message.active) this.disturbed.set(key, `${message.sensors.join(" and ")} ${cause} (${mm(message.deviation_m)} mm)`);
        else this.disturbed.delete(key);
        break;
      }
      case "drifted":
        this.drifted = `The field has changed for good: ${message.sensors.join(" and ")} are ${mm(message.deviation_m)} mm off. Calibrate again.`;
        break;
      case "calibrating":
        if (message.progress.collecting && !this.progress?.collecting) this.anchors = [];
        this.progress = message.progress;
        break;
    }
  }

  private look(jobs: Job[]): void {
    const job = jobs.filter(({ kind }) => kind === "field.finish").at(-1) ?? null;
    if (job?.job === this.job?.job && job?.state === this.job?.state) return;
    this.job = job;
    this.changed = true;
  }

  private start(): Promise<unknown> {
    const sensors = this.sensors.value.split(",").map((name) => name.trim()).filter((name) => name !== "");
    return this.context.link.request({ type: "field.start", sensors, spacing_m: Number(this.spacing.value) });
  }

  private addAnchor(): void {
    const t_end = this.context.model.sensors?.t_s ?? 0;
    const [x, y, z] = this.anchorPlace.map((input) => Number(input.value)) as [number, number, number];
    const name = `point ${this.anchors.length + 1}`;
    this.anchors.push({ name, sensor: this.anchorSensor.value, t_start: t_end - DWELL_S, t_end, position_m: [x, y, z] });
    this.changed = true;
  }

  private drawMap(operates: boolean): void {
    const { map } = this;
    setText(this.inUse, !map || map.map === null ? "Poses are the tracker's own: no map is in use."
      : `Map ${map.version || "of the stage file"} is in use: ${map.map}; a pole is bent by ${mm(map.raw_m)} mm without it and by ${mm(map.heldout_m)} mm with it`
        + (map.anchors_m === null ? "." : `, ${mm(map.anchors_m)} mm at surveyed points.`));
    this.rollback.hidden = !map || map.version === 0;
    this.rollback.disabled = !operates || !map || map.version === 0;
    const disturbed = this.disturbed.size ? [`Disturbed now: ${[...this.disturbed.values()].join("; ")}. Poses are less certain.`] : [];
    const said = [...disturbed, ...(this.drifted ? [this.drifted] : [])].join(" ");
    setText(this.trouble, said);
    this.trouble.hidden = said === "";
  }

  private drawRun(operates: boolean): void {
    const { progress } = this;
    const collecting = progress?.collecting ?? false;
    this.begin.disabled = !operates;
    setText(this.begin, collecting ? "Begin anew" : "Begin");
    this.run.hidden = !collecting;
    this.finish.disabled = !operates;
    if (!progress || !collecting) return;
    this.cells.value = progress.covered;
    this.directions.value = progress.directions;
    setText(this.figures, `${num(progress.seconds, 0)} s, ${progress.instants} instants; ${num(100 * progress.covered, 0)} % of the places, `
      + `${num(100 * progress.directions, 0)} % of the directions; readings are ${mm(progress.residual_m)} mm off a straight pole`);
    setText(this.hint, progress.hint === "" ? "Enough to solve; more makes it better." : progress.hint);
    this.hint.className = `sentence ${progress.hint === "" ? "good" : "care"}`;
    const names = [...this.anchorSensor.options].map(({ value }) => value);
    if (names.join() !== progress.sensors.join()) {
      this.anchorSensor.replaceChildren(...progress.sensors.map((name) => el("option", { value: name }, name)));
    }
    this.anchorList.replaceChildren(...this.anchors.map((anchor) => {
      const away = () => {
        this.anchors = this.anchors.filter((other) => other !== anchor);
        this.changed = true;
      };
      const words = `${anchor.name}: ${anchor.sensor} at ${anchor.position_m.join(", ")} m`;
      return el("li", { class: "row" }, words, el("button", { type: "button", onclick: away }, "Remove"));
    }));
  }

  private drawOutcome(operates: boolean): void {
    const report = (this.job?.result as { report?: Report } | null | undefined)?.report ?? null;
    const solving = this.job?.state === "running";
    this.outcome.hidden = !report || solving;
    if (!report || this.outcome.hidden) return;
    setText(this.verdict, report.accepted ? `The map is good: ${report.model}.` : "The calibration is refused.");
    this.verdict.className = report.accepted ? "good" : "bad";
    const rows: [string, number | null][] = [
      ["off a straight pole, before", report.raw_m],
      ["off a straight pole, corrected", report.residual_m],
      ["the same on readings that were held out", report.heldout_m],
      ["off the surveyed points", report.anchors_m],
    ];
    this.table.replaceChildren(...rows.map(([words, metres]) => el("tr", {}, el("th", { scope: "row" }, words), el("td", {}, mm(metres)))));
    this.remarks.replaceChildren(...[...report.reasons.map(({ text }) => text), ...report.warnings].map((text) => el("li", {}, text)));
    this.accept.disabled = !operates || !report.accepted || this.taken === this.job?.job;
  }
}
