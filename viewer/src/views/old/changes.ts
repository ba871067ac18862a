// The statistic of key poses of one sensor over time, what a peak must exceed, and the key poses that were confirmed.

import uPlot from "uplot";
import { el } from "../dom";
import { showNewest } from "../plot";
import type { Rows } from "../rows";
import type { KeyPoseMessage } from "../protocol";
import { axisLook } from "./joints";

const HEIGHT = 180;
/** A key pose is drawn at a point of the curve that is so near; the page is reported fewer frames than there are. */
const NEAR_S = 0.05;

/** Hidden while the stage does not look for key poses of the sensor. */
export class ChangeCurve {
  readonly element = el("section", { class: "curve", id: "change-curve", "aria-label": "Key poses, root of the statistic", hidden: true },
    el("h2", {}, "Key poses, root of the statistic"));
  private plot: uPlot | null = null;

  draw(series: Rows | undefined, keys: KeyPoseMessage[]): void {
    this.element.hidden = series === undefined;
    if (!series) return;
    this.plot ??= this.make();
    const t = series.column(0);
    const [scores, thresholds] = [1, 2].map((column) => Array.from(series.column(column), Math.sqrt)) as [number[], number[]];
    const marks = new Array<number | null>(t.length).fill(null);
    for (const { t_valid_s } of keys) {
      const at = t.findIndex((time) => time >= t_valid_s - NEAR_S / 2);
      if (at >= 0 && Math.abs(t[at]! - t_valid_s) <= NEAR_S) marks[at] = scores[at]!;
    }
    showNewest(this.plot, [t, scores, thresholds, marks]);
  }

  resize(): void {
    const width = this.element.clientWidth;
    if (width > 0) this.plot?.setSize({ width, height: HEIGHT });
  }

  private make(): uPlot {
    const axis = axisLook();
    const options: uPlot.Options = {
      width: Math.max(this.element.clientWidth, 400), height: HEIGHT,
      scales: { x: { time: false } },
      axes: [axis, { ...axis, size: 60 }],
      series: [
        { label: "t, s" },
        { label: "statistic", stroke: "#3469c9", width: 1.5 },
        { label: "threshold", stroke: "#c8452f", width: 1, dash: [6, 4] },
        { label: "key pose", stroke: "#c8452f", paths: () => null, points: { show: true, size: 8, fill: "#c8452f" } },
      ],
    };
    return new uPlot(options, [[], [], [], []], this.element);
  }
}
