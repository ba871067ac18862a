// Curves of one joint's angles.

import uPlot from "uplot";
import { el } from "../dom";
import { HISTORY_S } from "../model";
import type { Rows } from "../rows";

const COLOURS = ["#3469c9", "#c8452f", "#2f8f46", "#8a5ac2", "#b07400"];
const HEIGHT = 220;

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
    const row = el("div", { class: "row" }, el("h2", {}, "Joint angles, degrees"), el("label", {}, "Joint ", this.choice));
    this.element = el("section", { hidden: true }, row, this.holder);
  }

  draw(joints: Map<string, Rows>): void {
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
    const end = t[t.length - 1] ?? 0;
    const columns = angles.names.map((_, i) => Array.from(angles.column(i + 1), (value) => (Number.isFinite(value) ? value : null)));
    this.plot?.batch(() => {
      this.plot?.setData([t, ...columns] as unknown as uPlot.AlignedData, true);
      this.plot?.setScale("x", { min: end - HISTORY_S, max: end });
    });
  }

  resize(): void {
    const width = this.holder.clientWidth;
    if (width > 0) this.plot?.setSize({ width, height: HEIGHT });
  }

  private make(angles: Rows): void {
    this.shown = this.choice.value;
    this.plot?.destroy();
    const axis = axisLook();
    const series = angles.names.map((label, i) => ({ label, stroke: COLOURS[i % COLOURS.length]!, width: 1.5 }));
    const options: uPlot.Options = {
      width: Math.max(this.holder.clientWidth, 400), height: HEIGHT,
      scales: { x: { time: false } },
      axes: [axis, { ...axis, size: 60 }],
      series: [{ label: "t, s" }, ...series],
    };
    this.plot = new uPlot(options, [[], ...series.map(() => [])] as unknown as uPlot.AlignedData, this.holder);
  }
}
