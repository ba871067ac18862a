// Replay: open a recording of the daemon's folder, go to any time in it, change the speed, compare two of them.

import { acting, el, setText } from "../dom";
import type { Context, View } from "../view";
import { ComparePanel } from "./compare";

const SPEEDS: [string, number | "max"][] = [["pause", 0], ["¼ ×", 0.25], ["1 ×", 1], ["4 ×", 4], ["as fast as it goes", "max"]];

export class ReplayView implements View {
  readonly id = "replay";
  readonly title = "Replay";
  readonly element: HTMLElement;
  private readonly says = el("p", { class: "says", role: "alert" });
  private readonly list = el("ul", { id: "recordings", "aria-label": "Recordings" });
  private readonly slider = el("input", { type: "range", id: "scrub", step: "any", "aria-label": "time in the recording, s" });
  private readonly time = el("output", { for: "scrub" });
  private readonly steer = el("div", { hidden: true });
  private readonly live = el("p", { class: "quiet" });
  private readonly name = el("h2", {}, "Replay");
  private readonly compare: ComparePanel;
  private scrubbing = false;

  constructor(private readonly context: Context) {
    const { link } = context;
    this.compare = new ComparePanel(context);
    const seek = () => link.request({ type: "replay.seek", t_s: Number(this.slider.value) });
    this.slider.addEventListener("pointerdown", () => (this.scrubbing = true));
    this.slider.addEventListener("change", acting(this.says, () => {
      this.scrubbing = false;
      return seek();
    }));
    this.slider.addEventListener("input", () => this.showTime(Number(this.slider.value)));
    const speeds = SPEEDS.map(([words, speed]) =>
      el("button", { onclick: acting(this.says, () => link.request({ type: "replay.speed", speed })) }, words));
    this.steer.append(
      el("div", { class: "row" }, this.slider, this.time),
      el("div", { class: "row", role: "group", "aria-label": "Speed" }, ...speeds),
    );
    const again = el("button", { onclick: acting(this.says, () => this.refresh()) }, "Refresh");
    this.element = el("div", {}, this.name, this.live, this.steer, this.says,
      el("h2", {}, "Recordings in the folder"), this.list, again, this.compare.element);
    context.model.listen((message) => {
      if (message.type === "hello" && !this.element.hidden) this.shown();
    });
  }

  shown(): void {
    // Before the connection stands there is nobody to ask; its greeting asks again.
    if (this.context.model.hello) acting(this.says, () => this.refresh())(new Event("shown"));
  }

  draw(_now: number, fresh: boolean): void {
    if (!fresh) return;
    const { status, sensors } = this.context.model;
    const replay = status?.replay ?? null;
    this.steer.hidden = replay === null;
    setText(this.name, replay ? replay.name : "Replay");
    setText(this.live, replay ? replay.ended ?? "" : "This daemon tracks a live stage. To see a recording here, start `posed replay FILE`.");
    if (!replay) return;
    const [min, max] = [String(replay.begun_s), String(replay.end_s)];
    if (this.slider.min !== min || this.slider.max !== max) [this.slider.min, this.slider.max] = [min, max];
    if (this.scrubbing) return;
    const t_s = replay.speed === 0 || !sensors ? replay.t_s : Math.max(replay.t_s, sensors.t_s);
    this.slider.value = String(t_s);
    this.showTime(t_s);
  }

  private showTime(t_s: number): void {
    setText(this.time, `${t_s.toFixed(2)} of ${Number(this.slider.max).toFixed(1)} s`);
  }

  private async refresh(): Promise<void> {
    const { link, model } = this.context;
    const { recordings } = await link.request({ type: "replay.list" });
    setText(this.says, "");
    const row = (name: string) => {
      const open = el("button", { onclick: acting(this.says, () => link.request({ type: "replay.open", name })) }, "Open");
      open.disabled = !model.status?.replay;
      return el("li", { class: "row" }, name, open);
    };
    this.list.replaceChildren(...(recordings.length ? recordings.map(row) : [el("li", { class: "quiet" }, "none yet")]));
    await this.compare.offer(recordings);
  }
}
