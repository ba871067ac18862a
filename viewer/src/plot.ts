// What the curves of the page have in common.

import type uPlot from "uplot";
import { HISTORY_S } from "./model";

/** Shows new columns, the first of which are times in s: the newest 20 s, and in the legend the newest values unless
    somebody points at others. */
export function showNewest(plot: uPlot | null | undefined, columns: unknown[]): void {
  if (!plot) return;
  const times = columns[0] as ArrayLike<number>;
  const end = times[times.length - 1] ?? 0;
  plot.batch(() => {
    plot.setData(columns as uPlot.AlignedData, true);
    plot.setScale("x", { min: end - HISTORY_S, max: end });
  });
  if (times.length > 0 && (plot.cursor.left ?? -1) < 0) plot.setLegend({ idx: times.length - 1 });
}
