// The last hour of every sensor, as the daemon keeps it: there at once, however late the page was opened.

import { link, live, model } from "../page.svelte";
import type { HealthHistory, SensorHistory } from "../protocol";

/** What is reported of a sensor, each a curve. */
export const KINDS = ["rate_hz", "lost", "noise_m", "clock_sigma_s", "battery", "signal_dbm"] as const;
export type Kind = (typeof KINDS)[number];

class History {
  last = $state.raw<HealthHistory | null>(null);
  private asked_t_s = -Infinity;
  private watched = 0;

  constructor() {
    model.listen((message) => {
      if (message.type === "hello") {
        this.last = null;
        this.asked_t_s = -Infinity;
      }
      if (message.type === "status") this.renew();
    });
  }

  /** Keeps it new until what it returns is called. For effects. */
  watch(): () => void {
    this.watched++;
    this.renew();
    return () => this.watched--;
  }

  /** Of a sensor; null before it is known. */
  of(name: string): SensorHistory | null {
    return this.last?.sensors.find((sensor) => sensor.name === name) ?? null;
  }

  /** Kinds of which something is known of any sensor. */
  get kinds(): Kind[] {
    return KINDS.filter((kind) => this.last?.sensors.some((sensor) => sensor[kind].some((value) => value !== null)));
  }

  /** Asked for as often as a step of it ends. */
  private renew(): void {
    const { status } = live;
    if (this.watched === 0 || !status || status.replay || status.t_s < this.asked_t_s + (this.last?.bin_s ?? 1)) return;
    this.asked_t_s = status.t_s;
    // A daemon that keeps none has none to show.
    link.request({ type: "health.history" }).then((history) => (this.last = history), () => {});
  }
}

export const history = new History();
