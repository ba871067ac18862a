// Two recordings over one another: one channel of both, from their beginnings or shifted, and how far they lie apart. Part of Replay.

import uPlot from "uplot";
import { acting, el, num, setText } from "../dom";
import type { Context } from "../view";
import { axisLook } from "./joints";

const HEIGHT = 260;

interface Track {
  t_s: number[];
  values: (number | null)[];
}

export class ComparePanel {
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly names = ["compare-a", "compare-b"].map((id) => el("select", { id }));
  private readonly channel = el("select", { id: "compare-channel" });
  private readonly shift = el("input", { id: "compare-shift", type: "number", step: "0.05", value: 0 });
  private readonly verdict = el("p", { id: "compare-verdict" });
  private readonly holder = el("section", { class: "curve", "aria-label": "Both recordings over time" });
  private tracks: Track[] = [];
  private plot: uPlot | null = null;

  constructor(private readonly context: Context) {
    const [a, b] = this.names as [HTMLSelectElement, HTMLSelectElement];
    a.addEventListener("change", acting(this.says, () => this.readChannels()));
    this.shift.addEventListener("input", () => this.draw());
    const form = el("form", { class: "row" }, el("label", {}, "Compare ", a), el("label", {}, "with ", b), el("label", {}, "by ", this.channel),
      el("label", {}, "the second later by ", this.shift, " s"), el("button", { id: "compare" }, "Compare"));
    form.addEventListener("submit", acting(this.says, () => this.compare()));
    this.element = el("section", { "aria-labelledby": "compare-title", hidden: true },
      el("h2", { id: "compare-title" }, "Compare two runs"), form, this.verdict, this.holder, this.says);
  }

  /** The recordings there are. */
  async offer(recordings: string[]): Promise<void> {
    this.element.hidden = recordings.length === 0;
    if (recordings.length === 0) return;
    const before = this.names[0]!.value;
    this.names.forEach((select, i) => {
      const chosen = select.value;
      select.replaceChildren(...recordings.map((name) => el("option", { value: name }, name)));
      select.value = recordings.includes(chosen) ? chosen : recordings[Math.min(i, recordings.length - 1)]!;
    });
    if (this.names[0]!.value !== before) await this.readChannels();
  }

  private async readChannels(): Promise<void> {
    const answer = await this.context.link.request({ type: "replay.track", name: this.names[0]!.value });
    const columns = "columns" in answer ? answer.columns : [];
    const chosen = this.channel.value;
    this.channel.replaceChildren(...columns.map((name) => el("option", { value: name }, name)));
    if (columns.includes(chosen)) this.channel.value = chosen;
  }

  private async compare(): Promise<void> {
    setText(this.verdict, "Reading …");
    this.tracks = [];
    for (const { value: name } of this.names) {
      // One after the other: the daemon reads one recording at a time.
      const answer = await this.context.link.request({ type: "replay.track", name, columns: [this.channel.value] });
      if (!("t_s" in answer)) continue;
      const begun_s = answer.t_s[0] ?? 0;
      this.tracks.push({ t_s: answer.t_s.map((t) => t - begun_s), values: answer.values.map(([value]) => value ?? null) });
    }
    this.draw();
  }

  private draw(): void {
    const [a, b] = this.tracks;
    if (!a || !b) return;
    const later_s = Number(this.shift.value) || 0;
    const second = a.t_s.map((t) => valueAt(b, t - later_s));
    const pairs = a.values.flatMap((value, i) => (value !== null && second[i] !== null ? [value - second[i]!] : []));
    const rms = Math.sqrt(pairs.reduce((sum, d) => sum + d * d, 0) / pairs.length);
    setText(this.verdict, pairs.length > 0
      ? `${this.channel.value}: ${num(rms, 4)} apart (root mean square over ${pairs.length} times that both show).`
      : "There is no time that both show.");
    const colours = ["#3469c9", "#c8452f"];
    if (!this.plot) {
      const axis = axisLook();
      const series = ["first", "second"].map((label, i) => ({ label, stroke: colours[i]!, width: 1.5, dash: i ? [6, 3] : [] }));
      this.plot = new uPlot({ width: Math.max(this.holder.clientWidth, 400), height: HEIGHT, scales: { x: { time: false } },
        axes: [axis, { ...axis, size: 60 }], series: [{ label: "t, s" }, ...series] }, [[], [], []], this.holder);
    }
    this.plot.setData([a.t_s, a.values, second]);
  }
}

/** The value at a time, between the two rows beside it; nothing outside, in gaps and where one of them has none. */
function valueAt({ t_s, values }: Track, t: number): number | null {
  let [low, high] = [0, t_s.length - 1];
  if (high < 1 || t < t_s[0]! || t > t_s[high]!) return null;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t_s[middle]! <= t) low = middle;
    else high = middle;
  }
  const [before, after] = [values[low], values[high]];
  if (before == null || after == null) return null;
  const span = t_s[high]! - t_s[low]!;
  return span > 0 ? before + ((after - before) * (t - t_s[low]!)) / span : before;
}
