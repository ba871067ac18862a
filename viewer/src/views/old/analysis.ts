// Analysis: curves of one sensor and one joint, where the motion changes, its segments, the fault map, and the events as
// they come.

import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { type Cell, Table, el, spoken } from "../dom";
import { showNewest } from "../plot";
import { JointCurves, axisLook } from "./joints";
import type { Context, View } from "../view";
import { ChangeCurve } from "./changes";
import { FaultsPanel } from "./faults";
import { SegmentsPanel } from "./segments";

/** Curves are drawn so often; numbers move faster than eyes. */
const DRAW_MS = 100;

const CURVES: { title: string; unit: string; series: [label: string, column: number, colour: string][]; scale: number }[] = [
  { title: "Position", unit: "m", scale: 1, series: [["x", 1, "#c8452f"], ["y", 2, "#2f8f46"], ["z", 3, "#3469c9"]] },
  { title: "Speed", unit: "m/s", scale: 1, series: [["speed", 4, "#8a5ac2"]] },
  { title: "Uncertainty", unit: "mm", scale: 1000, series: [["σ", 5, "#b07400"]] },
];

export class AnalysisView implements View {
  readonly id = "analysis";
  readonly title = "Analysis";
  readonly element: HTMLElement;
  private readonly choice = el("select", { id: "sensor-choice", "aria-label": "Sensor" });
  private readonly curves = el("div", { class: "curves" });
  private readonly faults = new Table("faults", "Faults, newest first", [["Last, s"], ["Sensor", "word"], ["Cause", "word"], ["Times"], ["", "word"]]);
  private readonly repetitions = new Table("repetitions", "Repetitions, newest first",
    [["End, s"], ["Exercise", "word"], ["Took, s"], ["Number"], ["", "word"], ["What was off", "word reason"]]);
  private readonly map: FaultsPanel;
  private readonly changes = new ChangeCurve();
  private readonly segments: SegmentsPanel;
  private readonly joints = new JointCurves();
  private plots: uPlot[] = [];
  private lastDraw = -Infinity;
  private readonly panels: (() => void)[] = [
    () => this.drawChoice(),
    ...CURVES.map((_, index) => () => this.drawCurve(index)),
    () => this.drawChanges(),
    () => this.joints.draw(this.context.model.angles, this.context.model.angleSigmas),
    () => this.segments.draw(),
    () => this.drawRepetitions(),
    () => this.map.draw(),
    () => this.drawFaults(),
  ];
  /** The panel that is drawn next. */
  private next = 0;

  constructor(private readonly context: Context) {
    this.map = new FaultsPanel(context);
    this.segments = new SegmentsPanel(context);
    this.element = el("div", {}, el("div", { class: "row" }, el("label", {}, "Sensor ", this.choice)), this.curves, this.changes.element, this.joints.element, this.segments.element, this.repetitions.element, this.map.element, this.faults.element);
    addEventListener("resize", () => this.resize());
  }

  shown(): void {
    if (this.plots.length === 0) this.makePlots();
    this.resize();
  }

  /** One panel in each frame: all at once would take longer than a frame may. */
  draw(now_ms: number, fresh: boolean): void {
    if (this.next === 0) {
      if (!fresh || now_ms < this.lastDraw + DRAW_MS) return;
      this.lastDraw = now_ms;
    }
    this.panels[this.next]!();
    this.next = (this.next + 1) % this.panels.length;
  }

  private drawChanges(): void {
    const { changes, keyPoses } = this.context.model;
    this.changes.draw(changes.get(this.choice.value), keyPoses.filter(({ sensor }) => sensor === this.choice.value));
  }

  private drawFaults(): void {
    const newest = [...this.context.model.faults.values()].sort((a, b) => b.t_s - a.t_s).slice(0, 40);
    this.faults.fill(newest.map(({ t_s, sensor, cause, times, active }): Cell[] => [
      [t_s.toFixed(2)], [sensor, "word"], [spoken(cause), "word"], [String(times)],
      [active ? "lasts" : "over", `word ${active ? "care" : "good"}`],
    ]));
  }

  private drawRepetitions(): void {
    const { repetitions } = this.context.model;
    this.repetitions.element.hidden = repetitions.length === 0;
    this.repetitions.fill(repetitions.slice(-40).reverse().map((repetition): Cell[] => {
      const counted = repetition.event === "counted";
      return [
        [repetition.t_valid_s.toFixed(2)], [repetition.exercise, "word"],
        [(repetition.t_valid_s - repetition.t_start_s).toFixed(1)], [counted ? String(repetition.count) : "–"],
        [counted ? "counted" : `not counted: ${spoken(repetition.reason ?? "")}`, `word ${counted ? "good" : "care"}`],
        [counted ? (repetition.sentence ?? "as taught") : "", "word reason"],
      ];
    }));
  }

  private drawChoice(): void {
    const names = this.context.model.hello?.sensors.map(({ name }) => name) ?? [];
    if (names.join("\n") === [...this.choice.options].map((option) => option.value).join("\n")) return;
    const chosen = this.choice.value;
    this.choice.replaceChildren(...names.map((name) => el("option", { value: name }, name)));
    if (names.includes(chosen)) this.choice.value = chosen;
  }

  private drawCurve(index: number): void {
    const history = this.context.model.history.get(this.choice.value);
    const plot = this.plots[index];
    if (!history || !plot) return;
    const t = history.column(0);
    const { series, scale } = CURVES[index]!;
    const columns = series.map(([, column]) => Array.from(history.column(column), (value) => (Number.isFinite(value) ? scale * value : null)));
    showNewest(plot, [t, ...columns]);
  }

  private makePlots(): void {
    const axis = axisLook();
    this.plots = CURVES.map(({ title, unit, series }) => {
      const holder = el("section", { class: "curve", "aria-label": `${title}, ${unit}` }, el("h2", {}, `${title}, ${unit}`));
      this.curves.append(holder);
      const options: uPlot.Options = {
        width: 400, height: 180,
        scales: { x: { time: false } },
        axes: [axis, { ...axis, size: 60 }],
        series: [{ label: "t, s" }, ...series.map(([label, , stroke]) => ({ label, stroke, width: 1.5 }))],
      };
      return new uPlot(options, [[], ...series.map(() => [])] as unknown as uPlot.AlignedData, holder);
    });
  }

  private resize(): void {
    this.joints.resize();
    this.changes.resize();
    for (const plot of this.plots) {
      const width = plot.root.parentElement?.clientWidth ?? 0;
      if (width > 0) plot.setSize({ width, height: 180 });
    }
  }
}
