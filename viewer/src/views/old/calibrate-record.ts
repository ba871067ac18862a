// Calibrate and record: what the operator starts and ends while the stage is live.

import { acting, type Cell, el, num, prompt, setText, Table } from "../dom";
import type { Job, Thoroughness } from "../protocol";
import type { Context, View } from "../view";
import { Alignment } from "./alignment";
import { Calibration } from "./calibration";
import { Units } from "./units";

export class CalibrateRecordView implements View {
  readonly id = "calibrate-record";
  readonly title = "Calibrate & record";
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly name = el("input", { id: "record-name", placeholder: "stage and time", maxlength: 100 });
  private readonly start = el("button", { id: "record-start", class: "primary" }, "Record");
  private readonly stop = el("button", { id: "record-stop" }, "Stop");
  private readonly recording = el("p", { id: "recording", class: "quiet", role: "status" });
  private readonly how = el("select", { id: "calibrate-how", "aria-label": "How much" },
    el("option", { value: "full" }, "poses, elbows and knees"), el("option", { value: "quick" }, "two poses only"),
    el("option", { value: "movement" }, "no pose: walk about"),
    el("option", { value: "assign" }, "every limb: find which sensor sits where"));
  private readonly calibrate = el("button", { id: "calibrate", class: "primary" }, "Calibrate the body");
  private readonly ahead = el("button", { id: "heading-reset", title: "Stand upright and look along the room's x" }, "I look ahead: headings begin anew");
  private readonly prompt = el("p", { id: "prompt", class: "sentence", role: "status" });
  private readonly quality = new Table("mounting", "How well each sensor's mounting shows", [["Segment"], ["Sensor"], ["Disagreement, degrees"]]);
  private readonly body = el("section", { hidden: true });
  private readonly jobs = el("ul", { id: "jobs", "aria-label": "Jobs" });
  private readonly noJobs = el("p", { class: "quiet" }, "Nothing is running and nothing was run yet.");
  private readonly calibration: Calibration;
  private readonly alignment: Alignment;
  private readonly units: Units;
  private rows = new Map<number, JobRow>();

  constructor(private readonly context: Context) {
    const { link } = context;
    this.calibration = new Calibration(context);
    this.alignment = new Alignment(context);
    this.units = new Units(context);
    this.start.addEventListener("click", acting(this.says, () => {
      const name = this.name.value.trim();
      return link.request(name === "" ? { type: "record.start" } : { type: "record.start", name });
    }));
    this.stop.addEventListener("click", acting(this.says, () => link.request({ type: "record.stop" })));
    this.ahead.addEventListener("click", acting(this.says, () => link.request({ type: "heading.reset", ...context.model.about })));
    this.calibrate.addEventListener("click", acting(this.says, () =>
      link.request({ type: "body.calibrate", how: this.how.value as Thoroughness, ...context.model.about })));
    this.quality.element.hidden = true;
    this.body.append(el("h2", {}, "Body"),
      el("div", { class: "row" }, el("label", {}, "What is done ", this.how), this.calibrate, this.ahead), this.prompt, this.quality.element);
    this.element = el("div", {},
      el("h2", {}, "Recording"),
      el("div", { class: "row" }, el("label", {}, "Name ", this.name), this.start, this.stop),
      this.recording, this.says, this.body,
      this.units.element,
      this.alignment.element,
      this.calibration.element,
      el("h2", {}, "Jobs"), this.noJobs, this.jobs,
    );
  }

  shown(): void {
    this.calibration.shown();
  }

  draw(_now: number, fresh: boolean): void {
    this.calibration.draw();
    if (!fresh) return;
    const { status, jobs, hello, looked } = this.context.model;
    const recording = status?.recording ?? null;
    const operates = hello?.role === "operate" && !status?.replay;
    this.start.disabled = !operates || recording !== null;
    this.stop.disabled = !operates || recording === null;
    setText(this.recording, recording
      ? `recording ${recording.name}, ${(recording.bytes / 1e6).toFixed(1)} MB since ${recording.started_s.toFixed(0)} s`
      : hello?.role === "watch" ? "watching only: an operator's token can record"
      : status?.replay ? "this is a replay; recordings belong to a live stage"
      : "not recording");
    this.body.hidden = !looked || !!status?.replay;
    this.how.parentElement!.hidden = looked?.skeleton !== "human";
    // Where the field tells the headings nobody has to.
    this.ahead.hidden = looked?.skeleton !== "human" || this.context.model.body?.heading !== "held";
    this.ahead.disabled = !operates;
    const calibrations = jobs?.jobs.filter(({ kind }) => kind === "body.calibrate") ?? [];
    this.drawCalibration(calibrations[calibrations.length - 1], operates);
    this.units.draw(jobs?.jobs ?? [], operates);
    this.alignment.element.hidden = !!status?.replay;
    this.alignment.draw(jobs?.jobs ?? [], operates);
    this.drawJobs(jobs?.jobs ?? []);
  }

  /** What to do next, large; then how well it went. */
  private drawCalibration(job: Job | undefined, operates: boolean): void {
    const running = job?.state === "running";
    this.calibrate.disabled = !operates || running;
    prompt(this.prompt, job, "Shows how each sensor sits on its segment; needed where the stage file does not say it.");
    const found = job?.result as { quality_deg?: Record<string, number>; sensors?: Record<string, string> } | null | undefined;
    const quality = found?.quality_deg;
    this.quality.element.hidden = running || !quality;
    this.quality.fill(Object.entries(quality ?? {}).map(([segment, degrees]): Cell[] => [
      [segment], [found?.sensors?.[segment] ?? ""], [num(degrees, 1), degrees > 5 ? "bad" : "good"],
    ]));
  }

  private drawJobs(jobs: Job[]): void {
    this.noJobs.hidden = jobs.length > 0;
    for (const [number, row] of this.rows) {
      if (!jobs.some(({ job }) => job === number)) {
        row.element.remove();
        this.rows.delete(number);
      }
    }
    for (const job of jobs) {
      let row = this.rows.get(job.job);
      if (!row) {
        row = new JobRow(acting(this.says, () => this.context.link.request({ type: "job.cancel", job: job.job })));
        this.rows.set(job.job, row);
        this.jobs.prepend(row.element);
      }
      row.fill(job);
    }
  }
}

class JobRow {
  private readonly words = el("span");
  private readonly bar = el("progress", { max: 1 });
  private readonly cancel: HTMLButtonElement;
  readonly element: HTMLLIElement;

  constructor(onCancel: EventListener) {
    this.cancel = el("button", { onclick: onCancel }, "Cancel");
    this.element = el("li", { class: "row" }, this.words, this.bar, this.cancel);
  }

  fill({ job, kind, state, progress, remaining_s, message }: Job): void {
    const running = state === "running";
    const left = running && remaining_s !== null ? `, ${num(remaining_s, 0)} s left` : "";
    setText(this.words, `${job} · ${kind} · ${state}${left}${message ? ` · ${message}` : ""}`);
    this.words.className = state === "failed" ? "bad" : state === "done" ? "good" : "";
    this.bar.hidden = this.cancel.hidden = !running;
    this.bar.setAttribute("aria-label", `progress of job ${job}`);
    if (progress === null) this.bar.removeAttribute("value");
    else this.bar.value = progress;
  }
}
