// Curves of one joint's angles, each in a band of two standard deviations.

import uPlot from "uplot";
import { el } from "../dom";
import { showNewest } from "../plot";
import type { Rows } from "../rows";

const COLOURS = ["#3469c9", "#c8452f", "#2f8f46", "#8a5ac2", "#b07400"];
const HEIGHT = 220;
/** A band that is wider than this says that the angle is not known, and would hide the curves, degrees. */
const WIDEST_DEG = 15;

const finite = (value: number): number | null => (Number.isFinite(value) ? value : null);

export function axisLook(): uPlot.Axis {
  return { stroke: getComputedStyle(document.body).color, grid: { stroke: "#8884" }, ticks: { stroke: "#8888" } };
}

/** Hidden until there is a body. */
export class JointCurves {
  readonly element: HTMLElement;
  private readonly choice = el("select", { id: "joint-choice", "aria-label": "Joint" });
  private readonly holder = el("section", { class: "joint", "aria-label": "Joint angles, degrees" });
  private plot: uPlot | null = null;
  private shown = "";

  constructor() {
    const row = el("div", { class: "row" }, el("h2", {}, "Joint angles with two sigma, degrees"), el("label", {}, "Joint ", this.choice));
    this.element = el("section", { hidden: true }, row, this.holder);
  }

  draw(joints: Map<string, Rows>, sigmas: Map<string, Rows>): void {
    this.element.hidden = joints.size === 0;
    if (this.element.hidden) return;
    const names = [...joints.keys()];
    if (names.join("\n") !== [...this.choice.options].map((option) => option.value).join("\n")) {
      const chosen = this.choice.value;
      this.choice.replaceChildren(...names.map((name) => el("option", { value: name }, name.replaceAll("_", " "))));
      this.choice.value = names.includes(chosen) ? chosen : names.includes("elbow_r") ? "elbow_r" : names[0]!;
    }
    const angles = joints.get(this.choice.value)!;
    if (this.shown !== this.choice.value) this.make(angles);
    const t = angles.column(0);
    const columns = angles.names.map((_, i) => Array.from(angles.column(i + 1), finite));
    const spread = sigmas.get(this.choice.value);
    // Upper and lower edge of each band, behind the curves.
    const edges = [2, -2].map((times) => columns.map((column, i) => {
      const sigma = spread?.column(i + 1);
      return column.map((value, row) => {
        const wide = sigma?.[row] ?? NaN;
        return value !== null && wide < WIDEST_DEG ? value + times * wide : null;
      });
    }));
    showNewest(this.plot, [t, ...columns, ...edges.flat()]);
  }

  resize(): void {
    const width = this.holder.clientWidth;
    if (width > 0) this.plot?.setSize({ width, height: HEIGHT });
  }

  private make(angles: Rows): void {
    this.shown = this.choice.value;
    this.plot?.destroy();
    const axis = axisLook();
    const colour = (i: number) => COLOURS[i % COLOURS.length]!;
    const count = angles.names.length;
    const series: uPlot.Series[] = angles.names.map((label, i) => ({ label, stroke: colour(i), width: 1.5 }));
    const edges: uPlot.Series[] = ["+2σ", "−2σ"].flatMap((edge) => angles.names.map((name) => ({ label: `${name} ${edge}`, width: 0, points: { show: false } })));
    const options: uPlot.Options = {
      width: Math.max(this.holder.clientWidth, 400), height: HEIGHT,
      scales: { x: { time: false } },
      axes: [axis, { ...axis, size: 60 }],
      series: [{ label: "t, s" }, ...series, ...edges],
      bands: angles.names.map((_, i) => ({ series: [1 + count + i, 1 + 2 * count + i], fill: `${colour(i)}33` })),
      // The legend names the curves, not the edges of their bands.
      hooks: { init: [(plot) => plot.root.querySelectorAll<HTMLElement>(".u-legend .u-series").forEach((row, i) => (row.hidden = i > count))] },
    };
    this.plot = new uPlot(options, [[], ...series.map(() => []), ...edges.map(() => [])] as unknown as uPlot.AlignedData, this.holder);
  }
}
